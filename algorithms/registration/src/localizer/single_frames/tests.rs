//! A camera on the spot in a synthetic room that an anchor has mapped.

use features::Descriptor;
use geometry::{Matrix7, Similarity, Timestamp};
use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{FrameLocation, FrameObservation, NearPose};
use crate::localizer::tests::world::{AnchorSettings, Flyer, World, normal_vector, publish_anchor};
use crate::localizer::{AnchorIdx, Localizer, LocalizerSettings, Refusal, Verdict};

const RATE_HZ: f64 = 10.0;

struct Scene {
    world: World,
    localizer: Localizer,
    flyer: Flyer,
    rng: ChaCha8Rng,
    frame_count: usize,
}

fn scene(seed: u64) -> Scene {
    scene_of(seed, &[AnchorSettings::default()])
}

fn scene_of(seed: u64, anchors: &[AnchorSettings]) -> Scene {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let world = World::new(2500, &mut rng);
    let mut localizer = Localizer::new(LocalizerSettings::default());
    for anchor in anchors {
        publish_anchor(&world, anchor, &mut localizer, &mut rng);
    }
    Scene {
        world,
        localizer,
        flyer: Flyer::new(seed + 1000, 0.0),
        rng,
        frame_count: 0,
    }
}

impl Scene {
    /// What the camera sees a tenth of a second after the last time.
    fn look(&mut self, yaw_rad: f64) -> FrameObservation {
        let wobble = normal_vector(&mut self.rng, 0.005);
        self.flyer
            .turn_to(Vector3::new(0.2, 0.3, 0.2) + wobble, yaw_rad);
        self.frame_count += 1;
        FrameObservation {
            captured_at: Timestamp::from_seconds(self.frame_count as f64 / RATE_HZ).unwrap(),
            features: self.flyer.keyframe(&self.world).features,
        }
    }

    fn step(&mut self, yaw_rad: f64) -> Result<FrameLocation, Verdict> {
        let frame = self.look(yaw_rad);
        self.localizer.observe_frame(&frame, None)
    }

    /// Position error (m), and squared against the stated covariance.
    fn error(&self, location: &FrameLocation) -> (f64, f64) {
        let error =
            location.enu_from_camera.translation() - self.flyer.enu_from_camera.translation();
        let covariance: Matrix3<f64> = location.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        (
            error.norm(),
            error.dot(&(covariance.try_inverse().unwrap() * error)),
        )
    }
}

#[test]
fn a_hovering_camera_is_located_without_a_map_of_its_own() {
    let mut scene = scene(1);
    let locations: Vec<_> = (0..30).map(|_| scene.step(0.5)).collect();
    let first = locations.iter().position(Result::is_ok).unwrap();
    // Three searches, a fifth of a second apart.
    assert!((4..=6).contains(&first), "{first}");
    assert_eq!(locations[first - 1].unwrap_err(), Verdict::Unconfirmed);
    assert!(locations[first..].iter().all(Result::is_ok));
}

/// The first anchor has seen nothing of what the camera sees, or as much as the second.
#[test]
fn anchors_are_searched_one_after_the_other() {
    for (chunk_count, expected) in [(2, AnchorIdx(1)), (30, AnchorIdx(0))] {
        let first = AnchorSettings {
            chunks: 0..chunk_count,
            ..AnchorSettings::default()
        };
        let second = AnchorSettings {
            idx: AnchorIdx(1),
            ..AnchorSettings::default()
        };
        let mut scene = scene_of(6, &[first, second]);
        let locations = (0..12).filter_map(|_| scene.step(2.5).ok());
        assert_eq!(locations.last().unwrap().anchor, expected);
    }
}

#[test]
fn turns_on_the_spot_are_followed() {
    let mut scene = scene(2);
    for step in 0..80 {
        // Up to 0.8 rad a second.
        let yaw_rad = 0.5 + (0.08 * step as f64).sin();
        let location = scene.step(yaw_rad);
        if step > 6 {
            let (error_m, _) = scene.error(&location.unwrap());
            assert!(error_m < 0.08, "{step}: {error_m}");
        }
    }
}

/// Goal: stated position uncertainty is honest. Method: Monte Carlo over worlds and georeference
/// errors, one frame each, since the frames of one place err alike.
#[test]
fn stated_uncertainty_is_honest() {
    let (mut inside, mut count, mut sum) = (0, 0, 0.0);
    for seed in 0..60 {
        let mut scene = scene(100 + seed);
        let yaw_rad = 6.0 * scene.rng.random::<f64>();
        let location = (0..8).filter_map(|_| scene.step(yaw_rad).ok()).last();
        let Some(location) = location else { continue };
        let (_, squared) = scene.error(&location);
        inside += usize::from(squared <= 14.16);
        count += 1;
        sum += squared / 3.0;
    }
    assert!(count >= 54, "{count} of 60 located");
    let (share, mean) = (f64::from(inside as u32) / count as f64, sum / count as f64);
    assert!(share >= 0.97, "{share} inside three sigma");
    assert!((0.2..1.5).contains(&mean), "{mean}");
}

/// A poster that hangs twice: what is on it is where it would be seen from elsewhere, and nothing
/// around it is.
#[test]
fn a_place_that_only_looks_alike_is_refused() {
    let mut refused_count = 0;
    for seed in 0..10 {
        let mut scene = scene(200 + seed);
        let mut refused = false;
        for _ in 0..20 {
            let mut frame = scene.look(0.5);
            let on_poster = |x: f64, y: f64| x.abs() < 0.4 && y.abs() < 0.35;
            for feature in &mut frame.features {
                if !on_poster(feature.position.x, feature.position.y) {
                    feature.descriptor = Descriptor(scene.rng.random());
                }
            }
            let located = scene.localizer.observe_frame(&frame, None);
            refused |= matches!(located, Err(Verdict::Refused(Refusal::Contradicted)));
            assert!(located.is_err(), "{seed}: {located:?}");
        }
        refused_count += usize::from(refused);
    }
    // It is what is around it that refuses the poster.
    assert!(refused_count >= 7, "{refused_count}");
}

#[test]
fn a_pose_from_elsewhere_makes_the_search_needless() {
    let mut scene = scene(3);
    let frame = scene.look(0.5);
    let near = NearPose {
        captured_at: Timestamp::from_seconds(0.0).unwrap(),
        enu_from_camera: scene.flyer.enu_from_camera,
    };
    let location = scene.localizer.observe_frame(&frame, Some(&near)).unwrap();
    assert!(scene.error(&location).0 < 0.06);
    assert_eq!(location.anchor, AnchorIdx(0));
}

/// Goal: many anchors whose maps show nothing of this place cost no more than two. Method: only
/// the last of five shows it.
#[test]
fn a_pose_from_elsewhere_is_looked_for_in_one_anchor_after_the_other() {
    let anchors: Vec<AnchorSettings> = (0..5)
        .map(|idx| AnchorSettings {
            idx: AnchorIdx(idx),
            chunks: if idx < 4 { 0..2 } else { 0..30 },
            ..AnchorSettings::default()
        })
        .collect();
    let mut scene = scene_of(7, &anchors);
    for frame_idx in 0..3 {
        let frame = scene.look(2.5);
        let near = NearPose {
            captured_at: frame.captured_at,
            enu_from_camera: scene.flyer.enu_from_camera,
        };
        let located = scene.localizer.observe_frame(&frame, Some(&near));
        assert_eq!(located.is_ok(), frame_idx == 2, "{frame_idx}: {located:?}");
    }
}

#[test]
fn places_in_the_map_of_an_anchor_that_is_no_longer_used_confirm_nothing() {
    let mut scene = scene(8);
    for _ in 0..2 {
        assert!(scene.step(0.5).is_err());
    }
    let now = Timestamp::from_seconds(0.3).unwrap();
    let frames = &mut scene.localizer.single_frames;
    frames.forget_old(now, &[AnchorIdx(0)]);
    assert_eq!(frames.waiting.len(), 1);
    frames.forget_old(now, &[]);
    assert!(frames.waiting.is_empty());
}

/// The error of the georeference is common to all that is seen: no number of points averages it.
#[test]
fn the_georeference_enters_the_covariance_whole() {
    let mut scene = scene(4);
    for _ in 0..6 {
        let _ = scene.step(0.5);
    }
    let before = scene.step(0.5).unwrap().covariance[(3, 3)];
    let sigma_m = 0.2;
    let mut covariance = Matrix7::zeros();
    covariance
        .fixed_view_mut::<3, 3>(3, 3)
        .fill_diagonal(sigma_m * sigma_m);
    let anchor = AnchorIdx(0);
    let located_count = scene.localizer.located_frames().count();
    scene
        .localizer
        .place_anchor(anchor, Similarity::identity(), covariance, 2);
    let after = scene.step(0.5).unwrap().covariance[(3, 3)];
    assert!(after > sigma_m * sigma_m && after < before + 1.1 * sigma_m * sigma_m);
    // What was located before stands where the anchor's map stands now.
    let located: Vec<_> = scene.localizer.located_frames().collect();
    assert_eq!(located.len(), located_count + 1);
    let way = located[0].1.inverse() * located[located_count].1;
    assert!(way.translation().norm() < 0.1, "{way:?}");
}

#[test]
fn without_landmarks_or_features_there_is_a_reason() {
    let mut scene = scene(5);
    let frame = scene.look(0.5);
    let mut empty = Localizer::new(LocalizerSettings::default());
    let refused = |refusal| Verdict::Refused(refusal);
    let located = empty.observe_frame(&frame, None);
    assert_eq!(located.unwrap_err(), refused(Refusal::NoLandmarks));
    let blind = FrameObservation {
        features: Vec::new(),
        ..frame
    };
    let located = scene.localizer.observe_frame(&blind, None);
    assert_eq!(located.unwrap_err(), refused(Refusal::BadInput));
}
