//! Cost of the parts, on generated and seeded input. Names are `what/how/size`.

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use features::Descriptor;
use geometry::{Camera, Matrix7, Similarity, Timestamp, Transform};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use registration::kd_tree::KdTree;
use registration::{
    AnchorIdx, ChunkIdx, Cloud, Descriptors, KeyframeIdx, KeyframeObservation, Landmark, Localizer,
    LocalizerSettings, Metric, ObservedFeature, ObservedPoint, Outcome, RegisterSettings,
    ShapedCloud, Start, align,
};
use std::hint::black_box;

fn unit(rng: &mut impl Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| 2.0 * rng.random::<f64>() - 1.0)
}

/// Points on the walls of a room of 10 m.
fn room(point_count: usize, rng: &mut impl Rng) -> Vec<Vector3<f64>> {
    (0..point_count)
        .map(|idx| {
            let mut point = unit(rng) * 5.0;
            point[idx % 3] = 5.0 * point[idx % 3].signum();
            point + unit(rng) * 0.01
        })
        .collect()
}

fn nearest(criterion: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let single = |point: &Vector3<f64>| [point.x as f32, point.y as f32, point.z as f32];
    let points: Vec<[f32; 3]> = room(100_000, &mut rng).iter().map(single).collect();
    let queries: Vec<[f32; 3]> = room(1000, &mut rng).iter().map(single).collect();
    let tree = KdTree::new(&points);
    criterion.bench_function("nearest/kd_tree_thousand_queries/100k", |bencher| {
        bencher.iter(|| {
            for query in &queries {
                black_box(tree.nearest(*query, f32::INFINITY));
            }
        });
    });
    criterion.bench_function("build/kd_tree/100k", |bencher| {
        bencher.iter(|| black_box(KdTree::new(&points)));
    });
}

fn alignment(criterion: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let target = Cloud::from_points(room(20_000, &mut rng));
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.02, -0.03, 0.05));
    let moved = |point: Vector3<f64>| turn * point + Vector3::new(0.1, -0.1, 0.05);
    let source = Cloud::from_points(room(20_000, &mut rng).into_iter().map(moved).collect());
    criterion.bench_function("prepare/shapes/20k", |bencher| {
        bencher.iter(|| black_box(ShapedCloud::new(&target, None)));
    });
    let (source, target) = (
        ShapedCloud::new(&source, None),
        ShapedCloud::new(&target, None),
    );
    let metrics = [
        ("point_to_point", Metric::Point),
        ("point_to_plane", Metric::Plane),
        ("generalised", Metric::Gicp),
    ];
    for (name, metric) in metrics {
        let settings = RegisterSettings {
            metric,
            ..RegisterSettings::default()
        };
        criterion.bench_function(&format!("align/{name}/20k"), |bencher| {
            bencher.iter(|| black_box(align(&source, &target, &settings)));
        });
    }
}

/// A keyframe's points by their descriptors in a map of another scale, from nothing: a third of
/// them is not in the map.
fn search(criterion: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let points = room(20_000, &mut rng);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(1.2, -2.0, 0.5));
    let random_binary = |rng: &mut ChaCha8Rng| Descriptor(std::array::from_fn(|_| rng.random()));
    let histogram = |rng: &mut ChaCha8Rng| -> [u8; 128] {
        std::array::from_fn(|_| (rng.random::<f64>().powi(3) * 160.0) as u8)
    };
    let binary: Vec<Descriptor> = points.iter().map(|_| random_binary(&mut rng)).collect();
    let histograms: Vec<[u8; 128]> = points.iter().map(|_| histogram(&mut rng)).collect();
    let (mut seen, mut seen_binary, mut seen_histograms) = (Vec::new(), Vec::new(), Vec::new());
    let nearby = (0..points.len()).filter(|idx| points[*idx].x > 1.0);
    for (count, idx) in nearby.take(1500).enumerate() {
        seen.push(turn * (points[idx] + unit(&mut rng) * 0.02) * 1.7);
        let in_map = count % 3 != 0;
        let mut own = if in_map {
            binary[idx]
        } else {
            random_binary(&mut rng)
        };
        for _ in 0..25 {
            own.0[rng.random_range(0..4)] ^= 1 << rng.random_range(0..64);
        }
        seen_binary.push(own);
        let mut own = if in_map {
            histograms[idx]
        } else {
            histogram(&mut rng)
        };
        for value in &mut own {
            *value = value.saturating_add_signed(rng.random_range(-20..=20));
        }
        seen_histograms.push(own);
    }
    let pairs = [
        (
            "binary",
            Descriptors::Binary(seen_binary),
            Descriptors::Binary(binary),
        ),
        (
            "histogram",
            Descriptors::Histogram(seen_histograms),
            Descriptors::Histogram(histograms),
        ),
    ];
    let settings = RegisterSettings {
        with_scale: true,
        start: Start::Search,
        ..RegisterSettings::default()
    };
    for (name, of_source, of_target) in pairs {
        let cloud = |points: &[Vector3<f64>], descriptors| {
            let cloud = Cloud::new(points.to_vec(), descriptors).expect("one for each point");
            ShapedCloud::new(&cloud, None)
        };
        let (source, target) = (cloud(&seen, of_source), cloud(&points, of_target));
        let found = align(&source, &target, &settings);
        assert!(matches!(found, Outcome::Accepted(_)), "{found:?}");
        criterion.bench_function(&format!("search/{name}/1500_in_20k"), |bencher| {
            bencher.iter(|| black_box(align(&source, &target, &settings)));
        });
    }
}

/// A keyframe's points against a map, from a guess; and the map taking a chunk.
fn keyframe_alignment(criterion: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let map = ShapedCloud::new(&Cloud::from_points(room(20_000, &mut rng)), None);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.02, -0.03, 0.05));
    let moved = |point: Vector3<f64>| turn * point + Vector3::new(0.1, -0.1, 0.05);
    let seen = room(12_000, &mut rng).into_iter().filter(|point| {
        point.z > 1.0 && point.x.abs() < 1.2 * point.z && point.y.abs() < 1.2 * point.z
    });
    let keyframe = Cloud::from_points(seen.take(1500).map(moved).collect());
    assert_eq!(keyframe.points().len(), 1500);
    criterion.bench_function("prepare/shapes/1500", |bencher| {
        bencher.iter(|| black_box(ShapedCloud::new(&keyframe, None)));
    });
    let with_scale = RegisterSettings {
        with_scale: true,
        ..RegisterSettings::default()
    };
    criterion.bench_function("align/keyframe_prepared_anew/1500_in_20k", |bencher| {
        bencher.iter(|| black_box(align(&ShapedCloud::new(&keyframe, None), &map, &with_scale)));
    });
    let keyframe = ShapedCloud::new(&keyframe, None);
    let outcome = align(&keyframe, &map, &with_scale);
    assert!(matches!(outcome, Outcome::Accepted(_)), "{outcome:?}");
    for (name, with_scale) in [("rigid", false), ("with_scale", true)] {
        let settings = RegisterSettings {
            with_scale,
            ..RegisterSettings::default()
        };
        criterion.bench_function(&format!("align/keyframe_{name}/1500_in_20k"), |bencher| {
            bencher.iter(|| black_box(align(&keyframe, &map, &settings)));
        });
    }
    let chunk = Cloud::from_points(room(250, &mut rng));
    criterion.bench_function("prepare/extend_by_chunk/250_to_20k", |bencher| {
        let fresh = || map.clone();
        let extend = |mut map: ShapedCloud| {
            map.extend(&chunk);
            map
        };
        bencher.iter_batched(fresh, extend, BatchSize::LargeInput);
    });
}

/// A keyframe of 800 features in the middle of a map of 20,000 landmarks.
fn localizer_scene() -> (Vec<Vec<Landmark>>, KeyframeObservation) {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let points = room(20_000, &mut rng);
    let descriptors: Vec<Descriptor> = points
        .iter()
        .map(|_| Descriptor(std::array::from_fn(|_| rng.random())))
        .collect();
    let covariance = Matrix3::identity() * 1e-4;
    let landmarks: Vec<Landmark> = points
        .iter()
        .zip(&descriptors)
        .map(|(point, descriptor)| Landmark {
            point_in_chunk: *point,
            covariance_in_chunk: covariance,
            descriptor: *descriptor,
        })
        .collect();
    let visible = points.iter().zip(&descriptors).filter(|(point, _)| {
        point.z > 1.0 && point.x.abs() < 0.8 * point.z && point.y.abs() < 0.6 * point.z
    });
    let features = visible
        .take(800)
        .map(|(point, descriptor)| ObservedFeature {
            position: point.xy() / point.z,
            sigma: 0.003,
            descriptor: *descriptor,
            point: Some(ObservedPoint {
                point_in_map: *point,
                covariance_in_map: covariance,
            }),
        });
    let keyframe = KeyframeObservation {
        id: KeyframeIdx(0),
        captured_at: Timestamp::from_nanoseconds(0),
        map_from_camera: Transform::<geometry::Map, Camera>::identity(),
        features: features.collect(),
    };
    (
        landmarks.chunks(250).map(<[Landmark]>::to_vec).collect(),
        keyframe,
    )
}

/// Shows a keyframe until there is an estimate.
fn begin_to_follow(localizer: &mut Localizer, keyframe: &KeyframeObservation) {
    for id in 0..3 {
        let mut keyframe = keyframe.clone();
        keyframe.id = KeyframeIdx(id);
        let ahead = Vector3::new(0.0, 0.0, 1e-6 * id as f64);
        keyframe.map_from_camera = Transform::new(UnitQuaternion::identity(), ahead);
        localizer.observe_keyframe(&keyframe);
    }
    assert!(localizer.estimate(Timestamp::from_nanoseconds(0)).is_some());
}

fn localization(criterion: &mut Criterion) {
    let (chunks, keyframe) = localizer_scene();
    let anchor = AnchorIdx(0);
    let fresh = || {
        let mut localizer = Localizer::new(LocalizerSettings::default());
        for (idx, landmarks) in chunks.iter().enumerate() {
            localizer.insert_chunk(anchor, ChunkIdx(idx as u64), landmarks.clone());
            localizer.place_chunk(anchor, ChunkIdx(idx as u64), Similarity::identity());
        }
        localizer.place_anchor(
            anchor,
            Similarity::identity(),
            Matrix7::identity() * 1e-6,
            1,
        );
        localizer
    };
    criterion.bench_function("localize/search/800_in_20k", |bencher| {
        let observe = |mut localizer: Localizer| localizer.observe_keyframe(&keyframe);
        bencher.iter_batched(fresh, observe, BatchSize::LargeInput);
    });
    let mut localizer = fresh();
    begin_to_follow(&mut localizer, &keyframe);
    criterion.bench_function("localize/predicted/800_in_20k", |bencher| {
        bencher.iter(|| black_box(localizer.observe_keyframe(&keyframe)));
    });
}

/// The same keyframe in maps that are larger by chunks which stand elsewhere: the time stays.
fn localization_in_large_maps(criterion: &mut Criterion) {
    let (chunks, keyframe) = localizer_scene();
    let anchor = AnchorIdx(0);
    for elsewhere_count in [10, 100, 1000] {
        let mut localizer = Localizer::new(LocalizerSettings::default());
        let here = chunks
            .iter()
            .enumerate()
            .map(|(idx, chunk)| (idx, chunk, 0.0));
        let elsewhere = (0..elsewhere_count).map(|idx| {
            let away = 100.0 * (idx + 1) as f64;
            (chunks.len() + idx, &chunks[idx % chunks.len()], away)
        });
        for (idx, landmarks, away) in here.chain(elsewhere) {
            let place = Vector3::new(away, 0.0, 0.0);
            let map_from_chunk = Similarity::new(1.0, UnitQuaternion::identity(), place);
            let chunk = ChunkIdx(idx as u64);
            localizer.insert_chunk(anchor, chunk, landmarks.clone());
            localizer.place_chunk(anchor, chunk, map_from_chunk);
        }
        let covariance = Matrix7::identity() * 1e-6;
        localizer.place_anchor(anchor, Similarity::identity(), covariance, 1);
        begin_to_follow(&mut localizer, &keyframe);
        let name = format!("localize/predicted_with_chunks_elsewhere/{elsewhere_count}");
        criterion.bench_function(&name, |bencher| {
            bencher.iter(|| black_box(localizer.observe_keyframe(&keyframe)));
        });
    }
}

criterion_group!(
    benches,
    nearest,
    alignment,
    keyframe_alignment,
    search,
    localization,
    localization_in_large_maps
);
criterion_main!(benches);
