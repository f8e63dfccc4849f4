//! Whole alignments in a synthetic room; the flight knows the truth, the localiser does not.

mod world;

use geometry::{Matrix7, Similarity, Tangent7, Timestamp};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use world::{AnchorSettings, Flyer, World, publish_anchor};

struct Scene {
    world: World,
    localizer: Localizer,
    flyer: Flyer,
    rng: ChaCha8Rng,
}

fn scene(seed: u64, drift_scale: f64) -> Scene {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Scene {
        world: World::new(2500, &mut rng),
        localizer: Localizer::new(LocalizerSettings::default()),
        flyer: Flyer::new(seed + 1000, drift_scale),
        rng,
    }
}

impl Scene {
    fn publish(&mut self, settings: &AnchorSettings) {
        publish_anchor(&self.world, settings, &mut self.localizer, &mut self.rng);
    }

    fn step(&mut self, step: usize) -> AlignmentReport {
        self.flyer.fly_to(step);
        let keyframe = self.flyer.keyframe(&self.world);
        self.localizer.observe_keyframe(&keyframe)
    }

    fn estimate(&self) -> Option<Estimate> {
        self.localizer.estimate(Timestamp::from_nanoseconds(0))
    }

    /// Position error [m] and its squared norm against the stated covariance.
    fn position_error(&self) -> Option<(f64, f64)> {
        let estimate = self.estimate()?;
        let map_from_camera = self.flyer.map_from_camera();
        let pose = estimate.enu_from_camera(&map_from_camera);
        let error = pose.translation() - self.flyer.enu_from_camera.translation();
        let covariance: Matrix3<f64> = estimate.position_covariance(&map_from_camera, None);
        let inverse = covariance.try_inverse()?;
        Some((error.norm(), error.dot(&(inverse * error))))
    }
}

#[test]
fn a_flyer_finds_itself_and_follows_drift() {
    let mut scene = scene(1, 1.0);
    scene.publish(&AnchorSettings::default());
    let mut errors = Vec::new();
    for step in 0..60 {
        let report = scene.step(step);
        println!("{step} {:?} {:?}", report.verdict, report.anchors);
        if let Some((error, squared)) = scene.position_error() {
            println!("   {error:.4} {:.2}", squared / 3.0);
            errors.push(error);
        }
    }
    let estimate = scene.estimate().unwrap();
    assert!(
        errors.len() >= 55,
        "{} keyframes with an estimate",
        errors.len()
    );
    assert_eq!(estimate.jump_count, 0);
    assert!(errors.iter().all(|error| *error < 0.08));
}

/// Goal: stated position uncertainty is honest. Method: Monte Carlo over worlds, georeference
/// errors and drift; the bounds are those that a mission is judged by, widened for 20 runs.
#[test]
fn stated_uncertainty_is_honest() {
    let (mut inside, mut count, mut sum) = (0, 0, 0.0);
    for seed in 0..20 {
        let mut scene = scene(seed, 1.0);
        scene.publish(&AnchorSettings::default());
        for step in 0..40 {
            scene.step(step);
            if let Some((_, squared)) = scene.position_error() {
                inside += usize::from(squared <= 14.16);
                count += 1;
                sum += squared / 3.0;
            }
        }
    }
    let (share, mean) = (inside as f64 / count as f64, sum / count as f64);
    println!("inside {share} nees {mean} of {count}");
    assert!(share >= 0.97, "{share} inside three sigma");
    assert!(
        (0.2..1.5).contains(&mean),
        "normalised squared error {mean}"
    );
}

#[test]
fn scratch_local_part() {
    for (bend, drift) in [
        (0.003, 1.0),
        (0.0, 0.0),
        (0.003, 0.0),
        (0.01, 1.0),
        (0.003, 2.0),
    ] {
        let (mut inside, mut count, mut sum, mut sq) = (0, 0, 0.0, 0.0);
        let mut sig = 0.0;
        for seed in 0..20 {
            let mut scene = scene(seed, drift);
            scene.publish(&AnchorSettings {
                georeference_sigma: [1e-6, 1e-6, 1e-6],
                bend_m: bend,
                ..AnchorSettings::default()
            });
            for step in 0..40 {
                scene.step(step);
                if let Some((error, squared)) = scene.position_error() {
                    inside += usize::from(squared <= 14.16);
                    count += 1;
                    sum += squared / 3.0;
                    sq += error * error;
                    let e = scene.estimate().unwrap();
                    sig += e
                        .position_covariance(&scene.flyer.map_from_camera(), None)
                        .trace();
                }
            }
        }
        let n = count as f64;
        println!(
            "bend {bend} drift {drift} inside {} nees {} rmse {} sigma {} count {count}",
            inside as f64 / n,
            sum / n,
            (sq / n).sqrt(),
            (sig / n).sqrt()
        );
    }
}
