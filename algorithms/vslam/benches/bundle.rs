//! Local bundle adjustment of the size that a tracker meets: 10 keyframes, 1,500 points, 11,000
//! observations with noise of one pixel.

#[path = "bundle/problem.rs"]
mod problem;

use std::hint::black_box;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use vslam::bundle::{BundleSettings, Workspace, adjust};

use problem::{OBSERVATION_COUNT, problem};

fn bundle(criterion: &mut Criterion) {
    let start = problem();
    assert_eq!(start.observations.len(), OBSERVATION_COUNT);
    let converge = BundleSettings {
        iteration_count_max: 50,
        cost_decrease_min: 1e-6,
        ..BundleSettings::default()
    };
    let five_steps = BundleSettings {
        iteration_count_max: 5,
        cost_decrease_min: 0.0,
        ..BundleSettings::default()
    };
    let mut group = criterion.benchmark_group("bundle/schur/10x1500x11k");
    group.sample_size(20);
    for (name, settings) in [("converge", &converge), ("five_steps", &five_steps)] {
        let mut workspace = Workspace::default();
        let mut problem = start.clone();
        let report = adjust(&mut problem, settings, &mut workspace);
        eprintln!(
            "{name}: {} steps, cost {:.0} to {:.0}, variance factor {:.3}",
            report.iteration_count,
            report.cost_before,
            report.cost_after,
            report.variance_factor.unwrap_or(f64::NAN)
        );
        group.bench_function(name, |bencher| {
            bencher.iter_batched_ref(
                || start.clone(),
                |problem| black_box(adjust(problem, settings, &mut workspace)),
                BatchSize::LargeInput,
            );
        });
    }
    group.finish();
}

criterion_group!(benches, bundle);
criterion_main!(benches);
