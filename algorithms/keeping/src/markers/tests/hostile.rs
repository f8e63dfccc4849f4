//! Pictures of any size and content: nothing panics, nothing is not finite, lists stay disjoint.

use camera::Image;
use geometry::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::marker_light::{Irradiance, LightSpot, Sensor};

use crate::markers::{
    CameraMarkers, FinderSettings, PaperPipeline, PaperPipelineSettings, TrackerSettings,
};

fn check(image: &Image, camera: &mut CameraMarkers, paper: &mut PaperPipeline, idx: i64) {
    let at = Timestamp::from_nanoseconds(50_000_000 * idx);
    paper.find(image, at);
    let (frame, tracks) = camera.see(image, at, None);
    let mut places = Vec::new();
    for pair in frame.pairs {
        let numbers = [pair.separation_px, pair.sigma_separation_px, pair.mismatch];
        assert!(numbers.into_iter().all(f64::is_finite), "{pair:?}");
        assert!(pair.sigma_separation_px > 0.0);
        for light in pair.lights {
            let [x, y] = light.center_px;
            assert!(x > -1.0 && y > -1.0, "{pair:?}");
            assert!(
                x < image.width() as f64 && y < image.height() as f64,
                "{pair:?}"
            );
            assert!(!places.contains(&light.center_px), "a light in two pairs");
            places.push(light.center_px);
        }
    }
    for track in tracks {
        let numbers = [
            track.u_px,
            track.v_px,
            track.separation_px,
            track.sigma_separation_px,
        ];
        assert!(numbers.into_iter().all(f64::is_finite), "{track:?}");
        assert!(track.age_s >= 0.0);
    }
}

#[test]
fn any_picture_is_looked_at() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let settings = FinderSettings::default();
    let mut camera = CameraMarkers::new(settings, TrackerSettings::default(), 64);
    let mut paper = PaperPipeline::new(PaperPipelineSettings::default());
    let sizes = [
        [0, 0],
        [1, 1],
        [3, 90],
        [31, 31],
        [32, 1],
        [33, 40],
        [100, 2],
        [97, 75],
    ];
    for (size_idx, [width, height]) in sizes.into_iter().enumerate() {
        for kind in 0..12 {
            let mut image = Image::filled(width, height, if kind == 0 { 255 } else { 40 });
            let share = [0.0, 0.002, 0.02, 0.2, 0.8][kind % 5];
            for pixel in image.pixels_mut() {
                if rng.random::<f64>() < share {
                    *pixel = if kind > 5 { rng.random() } else { 255 };
                }
            }
            check(
                &image,
                &mut camera,
                &mut paper,
                (size_idx * 12 + kind) as i64,
            );
        }
    }
}

#[test]
fn spots_at_every_edge_and_of_every_size_are_looked_at() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let settings = FinderSettings::default();
    let mut camera = CameraMarkers::new(settings, TrackerSettings::default(), 64);
    let mut paper = PaperPipeline::new(PaperPipelineSettings::default());
    for idx in 0..300 {
        let mut image = Image::filled(64, 48, rng.random_range(0..100));
        for _ in 0..12 {
            let (left, top) = (rng.random_range(0..64), rng.random_range(0..48));
            let (width, height) = (rng.random_range(1..30_usize), rng.random_range(1..30_usize));
            let shade = rng.random();
            for y in top..(top + height % 9 + 1).min(48) {
                for x in left..(left + width % 9 + 1).min(64) {
                    image.pixels_mut()[y * 64 + x] = shade;
                }
            }
        }
        check(&image, &mut camera, &mut paper, idx);
    }
}

/// Goal: a wall full of print hides no lights. Method: squares of random shades, so many that
/// they are more than the finder can look at, with lights before them.
#[test]
fn lights_before_a_busy_wall_are_found() {
    let mut camera = CameraMarkers::new(FinderSettings::default(), TrackerSettings::default(), 324);
    let sensor = Sensor {
        exposure: 1.0,
        noise: 2.0,
    };
    let mut found_count = 0;
    for seed in 0..20 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut picture = Irradiance::filled(324, 244, 90.0);
        for y in (0..244).step_by(7) {
            for x in (0..324).step_by(5) {
                let shade = rng.random_range(50.0..170.0);
                picture.fill_rectangle([x, y], [4, 6], shade);
            }
        }
        let at = [rng.random_range(40.0..280.0), rng.random_range(40.0..200.0)];
        for offset_px in [-5.0, 5.0] {
            picture.add_spot(&LightSpot {
                center_px: [at[0], at[1] + offset_px],
                sigma_px: 0.9,
                peak: 700.0,
                streak_px: [0.0, 0.0],
            });
        }
        let image = picture.expose(&sensor, &mut rng);
        let stamp = Timestamp::from_nanoseconds(1_000_000_000 * seed as i64);
        let (frame, _) = camera.see(&image, stamp, None);
        assert!(!frame.crowded);
        found_count += usize::from(frame.pairs.iter().any(|pair| {
            let offset = [0, 1].map(|axis| pair.center_px[axis] - at[axis]);
            offset[0].hypot(offset[1]) < 1.0 && (pair.separation_px - 10.0).abs() < 0.7
        }));
    }
    assert!(found_count >= 18, "{found_count}");
}
