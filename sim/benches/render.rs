//! One frame of each camera of the lab, everything included.
//!
//! The budgets are 6 ms for 324×244 and 18 ms for 640×360 on one core.

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use sim::{Renderer, Scenario, Scene};

/// Frames are taken from all over the route.
const STRIDE: usize = 37;

fn render(criterion: &mut Criterion) {
    let scenario = Scenario::lab(1);
    let scene = Arc::new(scenario.paint());
    for (vehicle_idx, name) in [(0, "render/lab/640x360"), (1, "render/lab/324x244")] {
        let vehicle = &scenario.vehicles[vehicle_idx];
        let camera = &vehicle.description.camera;
        let mut renderer = Renderer::new(Arc::clone(&scene), camera, vehicle.sensor);
        let mut frame_idx = 0;
        criterion.bench_function(name, |bencher| {
            bencher.iter(|| {
                frame_idx = (frame_idx + STRIDE) % scenario.frame_count;
                let time_s = scenario.frame_time_s(frame_idx);
                let vehicles = scenario.vehicles.iter();
                let motions: Vec<_> = vehicles.map(|v| v.route.motion(time_s)).collect();
                let neighbours = scenario.neighbours(vehicle_idx, &motions);
                let shot = scenario.shot(vehicle_idx, frame_idx);
                black_box(renderer.render_among(&shot, &neighbours))
            });
        });
    }
}

fn paint(criterion: &mut Criterion) {
    let scenario = Scenario::lab(1);
    let mut group = criterion.benchmark_group("paint");
    group.sample_size(10);
    group.bench_function("lab", |bencher| {
        bencher.iter(|| black_box(Scene::paint(&scenario.world)));
    });
    group.finish();
}

criterion_group!(benches, render, paint);
criterion_main!(benches);
