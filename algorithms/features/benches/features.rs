//! Time of extraction, matching and flow on generated images and descriptors.

use std::hint::black_box;

use camera::Image;
use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use features::matching::{MatchSettings, match_mutual, nearest_of};
use features::optical_flow::{FlowPyramid, FlowSettings, FlowStart, follow};
use features::{Descriptor, Extractor, ExtractorSettings, FeatureGrid, Features};
use nalgebra::Vector2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Overlapping rectangles of all sizes and some noise, moved by a few pixels.
fn scene(width: usize, height: usize, shift_px: usize) -> Image {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut image = Image::filled(width, height, 120);
    for idx in 0..width * height / 250 {
        let side = 4 + 4000 / (idx + 40);
        let left = rng.random_range(0..width) + shift_px;
        let top = rng.random_range(0..height);
        let (right, bottom) = (left + side, top + rng.random_range(3..side + 4));
        let shade = rng.random_range(20..220);
        for y in top..bottom.min(height) {
            for x in left..right.min(width) {
                image.pixels_mut()[y * width + x] = shade;
            }
        }
    }
    for pixel in image.pixels_mut() {
        *pixel += rng.random_range(0..8);
    }
    image
}

fn extract(criterion: &mut Criterion) {
    for (width, height, feature_count) in [
        (324, 244, 500),
        (640, 360, 1000),
        (640, 480, 1000),
        (752, 480, 1000),
        (1920, 1080, 2000),
    ] {
        let image = scene(width, height, 0);
        let mut extractor = Extractor::new(ExtractorSettings {
            feature_count,
            ..ExtractorSettings::default()
        });
        let mut features = Features::default();
        criterion.bench_function(
            &format!("extract/{width}x{height}/{feature_count}"),
            |bencher| {
                bencher.iter(|| extractor.extract(black_box(&image), &mut features));
            },
        );
        assert_eq!(
            features.len(),
            feature_count,
            "the scene has too few corners"
        );
    }
}

fn descriptors(count: usize, seed: u64) -> Vec<Descriptor> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| Descriptor(std::array::from_fn(|_| rng.random())))
        .collect()
}

fn matching(criterion: &mut Criterion) {
    let (query, train) = (descriptors(1000, 1), descriptors(1000, 2));
    let settings = MatchSettings::default();
    criterion.bench_function("match/mutual/1000x1000", |bencher| {
        bencher.iter(|| match_mutual(black_box(&query), black_box(&train), &settings));
    });
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let candidates: Vec<u32> = (0..20).map(|_| rng.random_range(0..1000)).collect();
    criterion.bench_function("match/candidates/20", |bencher| {
        bencher.iter(|| nearest_of(&query[0], &train, black_box(&candidates).iter().copied()));
    });
}

fn grid(criterion: &mut Criterion) {
    let image = scene(640, 480, 0);
    let mut features = Features::default();
    Extractor::new(ExtractorSettings::default()).extract(&image, &mut features);
    let mut grid = FeatureGrid::default();
    criterion.bench_function("grid/rebuild/1000", |bencher| {
        bencher.iter(|| grid.rebuild(640, 480, 16.0, black_box(&features.keypoints)));
    });
    let mut found = Vec::new();
    criterion.bench_function("grid/query_15px/1000", |bencher| {
        bencher.iter(|| {
            found.clear();
            grid.query(black_box(&Vector2::new(300.0, 200.0)), 15.0, &mut found);
        });
    });
}

fn flow(criterion: &mut Criterion) {
    let (image, next) = (scene(640, 480, 0), scene(640, 480, 3));
    let mut features = Features::default();
    Extractor::new(ExtractorSettings {
        feature_count: 300,
        ..ExtractorSettings::default()
    })
    .extract(&image, &mut features);
    let starts: Vec<FlowStart> = features
        .keypoints
        .iter()
        .map(|one| FlowStart {
            position_px: one.position_px,
            guess_px: one.position_px,
        })
        .collect();
    let first = FlowPyramid::new(&image, 4);
    criterion.bench_function("flow/pyramid/640x480", |bencher| {
        bencher.iter_batched_ref(
            FlowPyramid::default,
            |pyramid| pyramid.rebuild(black_box(&next), 4),
            BatchSize::SmallInput,
        );
    });
    let second = FlowPyramid::new(&next, 4);
    let mut flows = Vec::new();
    criterion.bench_function("flow/follow/300", |bencher| {
        bencher.iter(|| {
            follow(
                &first,
                &second,
                black_box(&starts),
                &FlowSettings::default(),
                &mut flows,
            );
        });
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(30);
    targets = extract, matching, grid, flow
}
criterion_main!(benches);
