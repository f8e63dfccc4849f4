//! Goal: neither a step of either rule nor an image allocates anything, not even the first.
//! Method: a counting allocator; nothing in this crate starts a thread.

#[path = "../../test_support/counting_allocator.rs"]
mod counting_allocator;

use camera::{CameraModel, Distortion, Image, Intrinsics};
use geometry::Timestamp;
use keeping::markers::{
    CameraMarkers, FinderSettings, PaperPipeline, PaperPipelineSettings, TrackerSettings,
};
use keeping::{
    CameraMount, FieldOfView, GuardedFollower, GuardedFollowerSettings, Keeper, KeeperSettings,
    MarkerModel, Obstacle, PaperRule, PaperRuleSettings, Perception, Placed, Range, Sighting,
};
use nalgebra::{UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::marker_light::MarkerScene;

use counting_allocator::allocation_count;

/// More neighbours than are followed, so that the full lists are exercised too.
const NEIGHBOUR_COUNT: usize = 200;

#[test]
fn no_step_costs_an_allocation() {
    let sightings: Vec<Sighting> = (0..NEIGHBOUR_COUNT)
        .map(|idx| {
            let (angle_rad, height) = (2.4 * idx as f64, idx as f64 / 100.0 - 1.0);
            let across = (1.0 - height * height).max(0.0).sqrt();
            let range_m = 1.5 + 0.03 * idx as f64;
            Sighting {
                direction: Vector3::new(across * angle_rad.cos(), across * angle_rad.sin(), height),
                range: Range {
                    expected_m: Some(range_m),
                    low_m: 0.9 * range_m,
                    high_m: 1.1 * range_m,
                },
            }
        })
        .collect();
    let obstacles = [Obstacle {
        direction: Vector3::x(),
        clearance_m: 1.0,
    }];
    let views = [FieldOfView::all_but_rear()];
    let rule = PaperRule::new(PaperRuleSettings::default());
    let mut keeper = Keeper::new(KeeperSettings::default());
    let before = allocation_count();
    for step in 0..10 {
        keeper.step(
            &Perception {
                sightings: &sightings,
                obstacles: &obstacles,
                views: &views,
                heading_rad: 0.1 * f64::from(step),
                velocity: Vector3::x(),
                nominal_mps: 1.0,
            },
            0.1,
        );
        rule.correction(sightings.iter().map(|sighting| Placed {
            direction: sighting.direction,
            range_m: sighting.range.low_m,
        }));
    }
    assert_eq!(allocation_count(), before);
}

#[test]
fn no_image_costs_an_allocation() {
    let mut images: Vec<Image> = MarkerScene::matrix()
        .iter()
        .map(|(_, scene)| scene.draw(1).image)
        .collect();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    // From faint noise over salt of all densities to frames of nothing but noise.
    for bright_share in [0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 0.6] {
        let mut image = Image::filled(324, 244, 0);
        for pixel in image.pixels_mut() {
            let noise: u8 = rng.random_range(0..20);
            let is_bright = rng.random::<f64>() < bright_share;
            *pixel = if is_bright { 255 - noise } else { noise };
        }
        images.push(image);
    }
    let finder = FinderSettings::default();
    let mut camera = CameraMarkers::new(finder, TrackerSettings::default(), 324);
    let mut paper = PaperPipeline::new(PaperPipelineSettings::default());
    let intrinsics = Intrinsics {
        fx: 180.9,
        fy: 180.94,
        cx: 159.23,
        cy: 155.72,
    };
    let model = CameraModel::new(324, 244, intrinsics, Distortion::None).unwrap();
    let mount = CameraMount {
        camera: model,
        heading_from_camera: UnitQuaternion::identity(),
        baseline_rad: std::f64::consts::FRAC_PI_2,
        markers: MarkerModel::default(),
    };
    let settings = GuardedFollowerSettings::calibrated(&mount);
    let mut follower = GuardedFollower::new(settings, mount);
    let obstacles = [Obstacle {
        direction: Vector3::y(),
        clearance_m: 1.0,
    }];
    let mut followed_count = 0;
    let before = allocation_count();
    let mut pair_count = 0;
    // Each picture stands for a while, so that tracks are believed.
    let stills = images.iter().flat_map(|image| [image; 5]);
    for (idx, image) in stills.enumerate() {
        let captured_at = Timestamp::from_nanoseconds(50_000_000 * idx as i64);
        pair_count += camera.see(image, captured_at, None).0.pairs.len();
        pair_count += usize::from(paper.find(image, captured_at).is_some());
        let command = follower.step(camera.tracks(), &obstacles, 0.05);
        followed_count += usize::from(command.seen.is_some());
    }
    let after = allocation_count();
    assert!(pair_count > 100, "{pair_count}");
    assert!(followed_count > 5, "{followed_count}");
    assert_eq!(after, before);
}
