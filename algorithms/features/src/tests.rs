//! Laws of the whole chain from image to matches.

use camera::Image;
use nalgebra::Vector2;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::simd::InstructionSet;
use crate::{Extractor, ExtractorSettings, FeatureGrid, Features, Keypoint, matching};

/// A random texture of waves of 7 to 70 px, about 128 ± 36, defined everywhere.
pub(crate) fn smooth_texture(x: f64, y: f64) -> f64 {
    let mut value = 128.0;
    let mut state = 7_u64;
    let mut uniform = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 40) as f64 / f64::from(1 << 24)
    };
    for wave in 0..40 {
        let length_px = 7.0 * 1.06_f64.powi(wave);
        let (sine, cosine) = (uniform() * std::f64::consts::TAU).sin_cos();
        let phase = uniform() * std::f64::consts::TAU;
        let along = (x * cosine + y * sine) / length_px * std::f64::consts::TAU;
        value += 8.0 * (along + phase).sin();
    }
    value
}

/// An image whose pixels have the given brightness.
pub(crate) fn view(
    width: usize,
    height: usize,
    mut brightness: impl FnMut(f64, f64) -> f64,
) -> Image {
    let mut image = Image::filled(width, height, 0);
    for (idx, pixel) in image.pixels_mut().iter_mut().enumerate() {
        let (x, y) = ((idx % width) as f64, (idx / width) as f64);
        *pixel = brightness(x, y).round() as u8;
    }
    image
}

/// Tiles of random brightness, 9 to 17 px, on a ramp; defined everywhere.
fn tiles(x: f64, y: f64) -> f64 {
    let (column, row) = ((x / 17.0).floor(), (y / 13.0).floor());
    let hash = |a: f64, b: f64| {
        ((a as i64 * 7919 + b as i64 * 104_729) as u64)
            .wrapping_mul(0x9e37_79b9_7f4a_7c15)
            .rotate_left(29)
            .wrapping_mul(0xd6e8_feb8_6659_fd93)
    };
    let tile = (hash(column, row) >> 57) as f64;
    let small = (hash((x / 9.0).floor(), (y / 11.0).floor()) >> 59) as f64;
    50.0 + tile + small + 0.1 * (x - y)
}

/// An image of the tiles as seen through `texture_from_pixel`, averaged over each pixel.
fn tiles_through(texture_from_pixel: &Similarity2) -> Image {
    view(320, 240, |x, y| {
        let mut sum = 0.0;
        for sub in 0..9 {
            let offset = Vector2::new(f64::from(sub % 3 - 1), f64::from(sub / 3 - 1)) / 3.0;
            let place = texture_from_pixel.apply(&(Vector2::new(x, y) + offset));
            sum += tiles(place.x, place.y);
        }
        sum / 9.0
    })
}

struct Similarity2 {
    scale: f64,
    angle_rad: f64,
    shift: Vector2<f64>,
}

impl Similarity2 {
    /// Turns and scales about the middle of the image.
    fn new(scale: f64, angle_rad: f64, shift: Vector2<f64>) -> Self {
        Self {
            scale,
            angle_rad,
            shift,
        }
    }

    fn apply(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        let middle = Vector2::new(160.0, 120.0);
        let turn = nalgebra::Rotation2::new(self.angle_rad);
        turn * (pixel - middle) * self.scale + middle + self.shift
    }
}

fn extract(image: &Image) -> (Extractor, Features) {
    let mut extractor = Extractor::new(ExtractorSettings {
        feature_count: 500,
        ..ExtractorSettings::default()
    });
    let mut features = Features::default();
    extractor.extract(image, &mut features);
    (extractor, features)
}

/// Mutual matches between the tiles seen straight and seen otherwise: for each the error of the
/// position in pixels of the coarser of both levels.
fn match_errors_px(texture_from_other: &Similarity2) -> Vec<f64> {
    let straight = Similarity2::new(1.0, 0.0, Vector2::zeros());
    let (extractor, first) = extract(&tiles_through(&straight));
    let (_, second) = extract(&tiles_through(texture_from_other));
    let settings = matching::MatchSettings::default();
    matching::match_mutual(&first.descriptors, &second.descriptors, &settings)
        .iter()
        .map(|one| {
            let seen = first.keypoints[one.query_idx as usize];
            let other = second.keypoints[one.train_idx as usize];
            let scale = extractor
                .level_scale(seen.level)
                .max(extractor.level_scale(other.level));
            (texture_from_other.apply(&other.position_px) - seen.position_px).norm() / scale
        })
        .collect()
}

#[test]
fn matches_survive_turns_and_scales() {
    // Goal: at least 80 matches, of which at least 80 % within 2 px of the truth.
    for (scale, angle_deg) in [
        (1.0, 0.0_f64),
        (1.0, 30.0),
        (1.0, 90.0),
        (1.0, -137.0),
        (1.0, 180.0),
        (0.7, 10.0),
        (1.5, -20.0),
    ] {
        let other = Similarity2::new(scale, angle_deg.to_radians(), Vector2::new(3.3, -2.6));
        let errors_px = match_errors_px(&other);
        let good = errors_px.iter().filter(|error_px| **error_px < 2.0).count();
        let case = format!(
            "scale {scale} turn {angle_deg}: {good} of {}",
            errors_px.len()
        );
        assert!(good >= 80 && 5 * good >= 4 * errors_px.len(), "{case}");
    }
}

#[test]
fn positions_are_finer_than_a_pixel() {
    // Whole pixels alone would err by 0.38 px on average (uniform in a square of side 1, both
    // images: median 0.5 px); the refined corners must do clearly better.
    let mut errors_px = match_errors_px(&Similarity2::new(1.0, 0.0, Vector2::new(0.5, 0.37)));
    errors_px.sort_by(f64::total_cmp);
    let median_px = errors_px[errors_px.len() / 2];
    assert!(median_px < 0.2, "{median_px} of {}", errors_px.len());
}

#[test]
fn results_depend_on_the_image_only() {
    // Neither on what was seen before, nor on the instruction set.
    let image = tiles_through(&Similarity2::new(1.1, 0.2, Vector2::zeros()));
    let (mut used, expected) = extract(&image);
    assert_eq!(expected.len(), 500);
    let mut features = Features::default();
    used.extract(&view(401, 133, tiles), &mut features);
    assert!(!features.is_empty());
    used.extract(&image, &mut features);
    assert_eq!(features, expected);
    for instructions in InstructionSet::all() {
        let mut extractor = Extractor::with_instructions(*used.settings(), instructions);
        extractor.extract(&image, &mut features);
        assert_eq!(features, expected, "{instructions:?}");
    }
}

#[test]
fn any_image_is_taken() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let noise = view(157, 121, |_, _| f64::from(rng.random::<u8>()));
    let flat = Image::filled(640, 360, 255);
    let (_, of_noise) = extract(&noise);
    assert!((100..=500).contains(&of_noise.len()), "{}", of_noise.len());
    assert!(extract(&flat).1.is_empty());
    for (width, height) in [
        (0, 0),
        (1, 1),
        (0, 50),
        (39, 40),
        (40, 41),
        (41, 40),
        (3000, 2),
    ] {
        let _ = extract(&Image::filled(width, height, 7));
        let mut image = Image::filled(width, height, 0);
        image
            .pixels_mut()
            .iter_mut()
            .for_each(|pixel| *pixel = rng.random());
        let _ = extract(&image);
    }
}

#[test]
fn settings_out_of_range_are_brought_into_it() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let noise = view(157, 121, |_, _| f64::from(rng.random::<u8>()));
    let mut features = Features::default();
    let defaults = ExtractorSettings::default();
    for settings in [
        ExtractorSettings {
            feature_count: 0,
            ..defaults
        },
        ExtractorSettings {
            level_count: 0,
            ..defaults
        },
        ExtractorSettings {
            level_count: usize::MAX,
            ..defaults
        },
        ExtractorSettings {
            scale_factor: 0.0,
            finest_scale: 0.0,
            ..defaults
        },
        ExtractorSettings {
            scale_factor: f64::NAN,
            ..defaults
        },
        ExtractorSettings {
            finest_scale: f64::NAN,
            ..defaults
        },
        ExtractorSettings {
            scale_factor: f64::INFINITY,
            finest_scale: 1e300,
            ..defaults
        },
        ExtractorSettings {
            corner_threshold: 0,
            corner_threshold_min: 255,
            ..defaults
        },
        ExtractorSettings {
            corner_threshold: 255,
            corner_threshold_min: 0,
            ..defaults
        },
    ] {
        Extractor::new(settings).extract(&noise, &mut features);
        assert!(features.len() <= settings.feature_count);
        assert_eq!(features.keypoints.len(), features.descriptors.len());
    }
}

#[test]
fn features_are_spread_over_the_image() {
    // Each sixteenth of a uniformly textured image holds its share, give or take a half.
    let (_, features) = extract(&view(640, 480, tiles));
    let mut counts = [0; 16];
    for keypoint in &features.keypoints {
        let (x, y) = (
            keypoint.position_px.x / 160.0,
            keypoint.position_px.y / 120.0,
        );
        counts[4 * y as usize + x as usize] += 1;
    }
    assert!(
        counts.iter().all(|count| (15..=47).contains(count)),
        "{counts:?}"
    );
}

#[test]
fn blurred_images_give_as_many_features_as_are_wanted() {
    // Waves of 42 px and more: on the finest levels a corner's ring sees hardly any contrast.
    let image = view(640, 480, |x, y| smooth_texture(x / 6.0, y / 6.0));
    let feature_count = 100;
    let mut extractor = Extractor::new(ExtractorSettings {
        feature_count,
        ..ExtractorSettings::default()
    });
    let mut features = Features::default();
    extractor.extract(&image, &mut features);
    let finest = |one: &&Keypoint| one.level < 4;
    let on_finest = features.keypoints.iter().filter(finest).count();
    assert_eq!(on_finest, 0);
    assert_eq!(features.len(), feature_count);
}

proptest! {
    #[test]
    fn the_grid_finds_what_a_loop_finds(
        places in prop::collection::vec((-40.0..360.0_f64, -40.0..280.0_f64, 0_u8..9), 0..200),
        (x, y) in (-60.0..380.0_f64, -60.0..300.0_f64),
        radius_px in -1.0..150.0_f64,
        cell_px in 0.0..70.0_f64,
        levels in (0_u8..9, 0_u8..9),
    ) {
        let keypoints: Vec<Keypoint> = places.iter().map(|&(x, y, level)| Keypoint {
            position_px: Vector2::new(x, y), level, angle_rad: 0.0, response: 0.0,
        }).collect();
        let grid = FeatureGrid::new(320, 240, cell_px, &keypoints);
        let centre_px = Vector2::new(x, y);
        let levels = levels.0..=levels.1;
        let expected: Vec<u32> = (0..keypoints.len()).filter(|&idx| {
            let distance_px = (keypoints[idx].position_px - centre_px).norm();
            distance_px <= radius_px && levels.contains(&keypoints[idx].level)
        }).map(|idx| idx as u32).collect();
        let mut found = vec![7];
        grid.query_levels(&centre_px, radius_px, levels, &mut found);
        prop_assert_eq!(found[0], 7);
        found[1..].sort_unstable();
        prop_assert_eq!(&found[1..], &expected);
    }
}
