//! The stages of the machine: extraction, the start, points, the pose graph, and whole frames by
//! what they come to. Bundle adjustment has a bench of its own.

#![expect(clippy::disallowed_methods, reason = "a bench measures time")]

#[path = "../src/slam/tests/world.rs"]
#[expect(dead_code, reason = "the tests use more of the world than the bench")]
mod world;

use std::hint::black_box;
use std::time::{Duration, Instant};

use camera::Image;
use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use features::{Extractor, ExtractorSettings, Features};
use geometry::{Camera, Map, Matrix7, Similarity, Tangent7, Timestamp, Transform, so3};
use nalgebra::{Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vslam::pose_graph::{PoseEdge, PoseGraph, PoseGraphSettings, PoseNode, optimise};
use vslam::triangulation::{Sighting, TriangulationSettings, triangulate};
use vslam::two_view::{Correspondence, TwoViewSettings, reconstruct};
use vslam::{FrameReport, MappingReport, TrackingState, Vslam, VslamSettings};

const RATE_HZ: f64 = 15.0;
const SIGMA: f64 = 1.0 / 500.0;

/// Sideways along a wall and back, with some turning.
fn walk(frame: usize) -> world::Pose {
    let phase = frame as f64 * 0.05;
    world::Pose {
        position: Vector3::new(-0.9 * phase.cos(), 0.1 * phase.sin(), 0.1 * phase.cos()),
        yaw_rad: 0.1 * phase.sin(),
        pitch_rad: 0.03 * (2.0 * phase).sin(),
    }
}

/// A walk, blank pictures long enough to be lost, and a return.
fn images() -> Vec<Image> {
    let world = world::World::new(7);
    let blank = Image::filled(world::WIDTH, world::HEIGHT, 90);
    (0..140)
        .map(|frame| match frame {
            0..100 => world.render(&walk(frame)),
            100..120 => blank.clone(),
            _ => world.render(&walk(frame - 60)),
        })
        .collect()
}

/// What a frame came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// No map yet.
    Waiting,
    /// The frame that made a map.
    Start,
    Tracked,
    Keyframe,
    Lost,
    /// The first pose after a loss.
    Relocalised,
}

fn kind(before: Option<TrackingState>, report: &FrameReport, mapping: &MappingReport) -> Kind {
    let is_keyframe = mapping.new_keyframe.is_some();
    match (before, report.state) {
        (_, TrackingState::Starting { .. }) => Kind::Waiting,
        (_, TrackingState::Lost { .. }) => Kind::Lost,
        (Some(TrackingState::Tracking), TrackingState::Tracking) if is_keyframe => Kind::Keyframe,
        (Some(TrackingState::Tracking), TrackingState::Tracking) => Kind::Tracked,
        (Some(TrackingState::Lost { .. }), TrackingState::Tracking) => Kind::Relocalised,
        (_, TrackingState::Tracking) => Kind::Start,
    }
}

/// The time of `count` frames of one kind; the others are processed and not counted.
fn timed(images: &[Image], wanted: Kind, count: u64) -> Duration {
    let mut total = Duration::ZERO;
    let mut counted = 0;
    while counted < count {
        let before_walk = counted;
        let mut vslam = Vslam::new(world::camera(), VslamSettings::default());
        let mut before = None;
        for (frame, image) in images.iter().enumerate() {
            let captured_at = Timestamp::from_seconds(frame as f64 / RATE_HZ);
            let captured_at = captured_at.expect("a frame has a finite time");
            let started = Instant::now();
            let (report, mapping) = black_box(vslam.process(image, captured_at));
            let elapsed = started.elapsed();
            if kind(before, &report, &mapping) == wanted && counted < count {
                total += elapsed;
                counted += 1;
            }
            before = Some(report.state);
        }
        assert!(counted > before_walk, "no frame came to {wanted:?}");
    }
    total
}

fn frames(criterion: &mut Criterion) {
    let images = images();
    let mut group = criterion.benchmark_group("frame");
    group.sample_size(10);
    for (name, wanted) in [
        ("wait/320x240", Kind::Waiting),
        ("start/320x240", Kind::Start),
        ("track/320x240", Kind::Tracked),
        ("keyframe/320x240", Kind::Keyframe),
        ("relocalise/320x240", Kind::Relocalised),
    ] {
        group.bench_function(name, |bencher| {
            bencher.iter_custom(|count| timed(&images, wanted, count));
        });
    }
    group.finish();
}

fn extract(criterion: &mut Criterion) {
    let image = world::World::new(7).render(&walk(0));
    let mut extractor = Extractor::new(ExtractorSettings {
        feature_count: 600,
        ..ExtractorSettings::default()
    });
    let mut features = Features::default();
    criterion.bench_function("extract/pyramid/320x240", |bencher| {
        bencher.iter(|| extractor.extract(black_box(&image), &mut features));
    });
}

fn uniform(rng: &mut ChaCha8Rng, limit: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.random_range(-limit..limit))
}

fn seen(rng: &mut ChaCha8Rng, point_in_camera: &Vector3<f64>) -> Vector2<f64> {
    let noise = Vector2::from_fn(|_, _| rng.random_range(-SIGMA..SIGMA));
    point_in_camera.xy() / point_in_camera.z + noise
}

/// Points before two cameras 0.4 apart: `depth` is the spread of their distances around 4, and
/// one in five matches is wrong.
fn correspondences(depth: f64) -> Vec<Correspondence> {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let second_from_first: Transform<Camera, Camera> = Transform::new(
        so3::exp(&Vector3::new(0.02, 0.1, -0.01)),
        Vector3::x() * -0.4,
    );
    (0..300)
        .map(|idx| {
            let wide = uniform(&mut rng, 1.0);
            let point = Vector3::new(2.0 * wide.x, 1.5 * wide.y, 4.0 + depth * wide.z);
            let first = seen(&mut rng, &point);
            let second = if idx % 5 == 0 {
                uniform(&mut rng, 0.6).xy()
            } else {
                seen(&mut rng, &(second_from_first * point))
            };
            Correspondence { first, second }
        })
        .collect()
}

fn start(criterion: &mut Criterion) {
    let settings = TwoViewSettings::default();
    for (name, depth) in [("start/room/300", 1.5), ("start/plane/300", 0.0)] {
        let matches = correspondences(depth);
        let reconstructed = || {
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            reconstruct(black_box(&matches), &settings, &mut rng)
        };
        if let Err(refusal) = reconstructed() {
            eprintln!("{name}: refused, {refusal:?}");
        }
        criterion.bench_function(name, |bencher| bencher.iter(reconstructed));
    }
}

fn points(criterion: &mut Criterion) {
    let settings = TriangulationSettings::default();
    for view_count in [2, 5] {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let point = Vector3::new(0.3, -0.2, 4.0);
        let sightings: Vec<Sighting> = (0..view_count)
            .map(|view| {
                let place = Vector3::x() * (0.2 * f64::from(view)) + uniform(&mut rng, 0.05);
                let map_from_camera: Transform<Map, Camera> =
                    Transform::new(so3::exp(&uniform(&mut rng, 0.1)), place);
                let camera_from_map = map_from_camera.inverse();
                Sighting {
                    camera_from_map,
                    position: seen(&mut rng, &(camera_from_map * point)),
                    sigma: SIGMA,
                }
            })
            .collect();
        triangulate(&sightings, &settings).expect("the rays meet");
        let name = format!("triangulate/point/{view_count}");
        criterion.bench_function(&name, |bencher| {
            bencher.iter(|| triangulate(black_box(&sightings), &settings));
        });
    }
}

/// Once around a circle by dead reckoning that drifts, and the edge that closes it.
fn drifting_loop(node_count: usize) -> PoseGraph {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let truth: Vec<Similarity<Map, Camera>> = (0..node_count)
        .map(|idx| {
            let angle_rad = std::f64::consts::TAU * idx as f64 / node_count as f64;
            let place = Vector3::new(angle_rad.cos(), 0.0, angle_rad.sin()) * 5.0;
            Similarity::new(1.0, so3::exp(&(Vector3::y() * -angle_rad)), place)
        })
        .collect();
    let mut graph = PoseGraph::default();
    for idx in 0..node_count {
        let mut error = Tangent7::from_fn(|_, _| rng.random_range(-0.002..0.002));
        error[6] += 0.3 / node_count as f64;
        let last = idx.checked_sub(1);
        let measured = |first: usize, second: usize, error: &Tangent7| PoseEdge {
            first_idx: first,
            second_idx: second,
            first_from_second: (truth[first].inverse() * truth[second]).perturbed(error),
            information: Matrix7::identity() * 100.0,
        };
        let odometry = last.map(|last| measured(last, idx, &error));
        let reckoned = odometry.map_or(truth[idx], |edge| {
            graph.nodes[edge.first_idx].map_from_camera * edge.first_from_second
        });
        graph.nodes.push(PoseNode {
            map_from_camera: reckoned,
            fixed: idx == 0,
        });
        graph.edges.extend(odometry);
        if idx + 1 == node_count {
            graph.edges.push(measured(idx, 0, &Tangent7::zeros()));
        }
    }
    graph
}

fn pose_graph(criterion: &mut Criterion) {
    let settings = PoseGraphSettings::default();
    for node_count in [100, 600] {
        let graph = drifting_loop(node_count);
        let name = format!("pose_graph/loop/{node_count}");
        criterion.bench_function(&name, |bencher| {
            bencher.iter_batched_ref(
                || graph.clone(),
                |graph| black_box(optimise(graph, &settings)),
                BatchSize::LargeInput,
            );
        });
    }
}

criterion_group!(benches, extract, start, points, pose_graph, frames);
criterion_main!(benches);
