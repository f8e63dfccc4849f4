//! Pictures of any size and content: nothing panics, nothing is not finite, lists stay disjoint.

use camera::Image;
use geometry::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

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
