//! What the finder says of single situations.

use camera::Image;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sim::marker_light::{Irradiance, LightSpot, Sensor};

use crate::markers::{FinderSettings, PairFinder};

/// A dim room with lights at these places.
fn room(lights_px: &[[f64; 2]]) -> Irradiance {
    let mut room = Irradiance::filled(324, 244, 30.0);
    for center_px in lights_px {
        room.add_spot(&LightSpot {
            center_px: *center_px,
            sigma_px: 0.9,
            peak: 350.0,
            streak_px: [0.0, 0.0],
        });
    }
    room
}

fn expose(room: &Irradiance) -> Image {
    let sensor = Sensor {
        exposure: 1.0,
        noise: 3.0,
    };
    room.expose(&sensor, &mut ChaCha8Rng::seed_from_u64(1))
}

fn finder() -> PairFinder {
    PairFinder::new(FinderSettings::default(), 324)
}

#[test]
fn a_lone_light_is_no_pair() {
    let image = expose(&room(&[[100.0, 80.0]]));
    let mut finder = finder();
    let found = finder.find(&image);
    assert_eq!(
        (found.lights.len(), found.pairs.len(), found.merged.len()),
        (1, 0, 0)
    );
}

#[test]
fn lights_of_one_drone_that_run_into_each_other_are_too_far_away() {
    for separation_px in [2.2, 2.6, 3.0] {
        let image = expose(&room(&[[100.3, 80.0], [100.3, 80.0 + separation_px]]));
        let mut finder = finder();
        let found = finder.find(&image);
        assert!(found.pairs.is_empty(), "{separation_px} px");
        let [merged] = found.merged else {
            panic!("{} merged at {separation_px} px", found.merged.len());
        };
        let error_px = merged.center_px[1] - 80.0 - 0.5 * separation_px;
        assert!(
            error_px.abs() < 0.3,
            "{error_px} px off at {separation_px} px"
        );
        assert!(merged.separation_px_max > separation_px);
    }
}

#[test]
fn lights_at_the_edge_of_the_picture_are_found() {
    for (u, v) in [(1.0, 100.0), (322.0, 100.0), (100.0, 6.0), (100.0, 237.0)] {
        let image = expose(&room(&[[u, v - 5.0], [u, v + 5.0]]));
        let mut finder = finder();
        let found = finder.find(&image);
        let [pair] = found.pairs else {
            panic!("{} pairs at ({u}, {v})", found.pairs.len());
        };
        assert!(
            (pair.separation_px - 10.0).abs() < 0.3,
            "{} at ({u}, {v})",
            pair.separation_px
        );
        assert!(pair.lights[0].center_px[1] < pair.lights[1].center_px[1]);
    }
}

#[test]
fn hot_pixels_cables_and_edges_are_no_lights() {
    let mut room = room(&[]);
    room.fill_rectangle([50, 20], [2, 200], 200.0);
    room.fill_rectangle([100, 60], [120, 1], 200.0);
    room.fill_rectangle([230, 100], [60, 80], 180.0);
    let mut image = expose(&room);
    for place in [[20, 30], [20, 40], [150, 120], [150, 130], [300, 60]] {
        let [x, y]: [usize; 2] = place;
        image.pixels_mut()[y * 324 + x] = 255;
    }
    let mut finder = finder();
    let found = finder.find(&image);
    assert!(found.lights.is_empty(), "{:?}", found.lights);
}

#[test]
fn a_rolled_camera_finds_rolled_pairs() {
    let image = expose(&room(&[[100.0, 80.0], [109.0, 84.0]]));
    let mut finder = finder();
    assert!(finder.find(&image).pairs.is_empty());
    finder.expect_baseline(25_f64.to_radians());
    assert_eq!(finder.find(&image).pairs.len(), 1);
}

#[test]
fn a_frame_full_of_spots_says_so() {
    let mut image = Image::filled(324, 244, 20);
    for (idx, pixel) in image.pixels_mut().iter_mut().enumerate() {
        let (x, y) = (idx % 324, idx / 324);
        if x % 7 == 3 && y % 7 == 3 {
            *pixel = 255;
        }
    }
    let mut finder = finder();
    let found = finder.find(&image);
    assert!(found.crowded && found.pairs.is_empty());
}
