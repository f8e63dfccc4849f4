//! Whether stated covariances are those of the errors, over many draws.

use geometry::Tangent7;
use nalgebra::DVector;

use super::*;

/// What is drawn anew in each run, by its name.
struct Scene {
    noise_m: f64,
    source_count: usize,
    with_scale: bool,
    metric: Metric,
}

/// Mean of `eᵀ P⁻¹ e` over the degrees of freedom, one where the covariance is honest.
fn mean_nees(scene: &Scene, run_count: u64) -> f64 {
    let freedom = if scene.with_scale { 7 } else { 6 };
    let total: f64 = (0..run_count)
        .map(|seed| {
            let mut rng = ChaCha8Rng::seed_from_u64(1000 + seed);
            let truth = truth(0.02, 0.02, if scene.with_scale { 1.02 } else { 1.0 });
            let target = Cloud::from_points(rough(corner(4000, &mut rng), scene.noise_m, &mut rng));
            let source = rough(
                corner(scene.source_count, &mut rng),
                scene.noise_m,
                &mut rng,
            );
            let settings = RegisterSettings {
                metric: scene.metric,
                with_scale: scene.with_scale,
                ..RegisterSettings::default()
            };
            let alignment = accepted(register(&moved(&source, &truth), &target, &settings));
            let error: Tangent7 = (truth.inverse() * alignment.target_from_source).log();
            let error = DVector::from_iterator(freedom, error.iter().copied().take(freedom));
            let covariance = alignment
                .covariance
                .view((0, 0), (freedom, freedom))
                .into_owned();
            let factor = covariance.cholesky().expect("a covariance is positive");
            error.dot(&factor.solve(&error)) / freedom as f64
        })
        .sum();
    total / run_count as f64
}

fn rough(points: Vec<Vector3<f64>>, noise_m: f64, rng: &mut impl Rng) -> Vec<Vector3<f64>> {
    let mut noise = || noise_m * 1.7 * (2.0 * rng.random::<f64>() - 1.0);
    let moved = |point| point + Vector3::new(noise(), noise(), noise());
    points.into_iter().map(moved).collect()
}

/// Goal: normalised estimation error squared within its bounds.
///
/// Method: `NEES_RUNS` draws of each scene, or 25 of those with a little noise: a mean of χ² over
/// its f degrees of freedom has the standard deviation √(2 / (f · runs)), and 99.7 % of such means
/// are within three of them. Where the noise is more than a third of the spacing, and where
/// planes alone tell the scale of a ball, half as much again is let pass: there the pairs hide a
/// part of the noise, and the bend of surfaces is no noise at all.
#[test]
fn stated_covariances_are_those_of_the_errors() {
    let runs = std::env::var("NEES_RUNS").ok();
    let many_runs: Option<u64> = runs.and_then(|runs| runs.parse().ok());
    let run_count = many_runs.unwrap_or(25);
    for (metric, _) in METRICS {
        for with_scale in [false, true] {
            for (noise_m, source_count) in [(0.01, 3000), (0.0, 3000), (0.03, 1500)] {
                let scene = Scene {
                    noise_m,
                    source_count,
                    with_scale,
                    metric,
                };
                let nees = mean_nees(&scene, run_count);
                let freedom = if with_scale { 7.0 } else { 6.0 };
                let bound = 3.0 * (2.0 / (freedom * run_count as f64)).sqrt();
                println!("{metric:?}, scale {with_scale}, {noise_m} m: {nees:.2} ± {bound:.2}");
                let is_hard = noise_m > 0.02 || (metric == Metric::Plane && with_scale);
                let above = if is_hard { 0.5 + bound } else { bound };
                assert!(
                    (1.0 - bound..1.0 + above).contains(&nees),
                    "{metric:?}, scale {with_scale}, {noise_m} m: {nees} ± {bound}"
                );
                if many_runs.is_none() {
                    break;
                }
            }
        }
    }
}
