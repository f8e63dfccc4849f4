//! Time to find marker pairs in one 324×244 image.

use std::hint::black_box;

use camera::Image;
use criterion::{Criterion, criterion_group, criterion_main};
use geometry::Timestamp;
use keeping::markers::{FinderSettings, PairFinder, PaperPipeline, PaperPipelineSettings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::marker_light::MarkerScene;

const WIDTH: usize = 324;
const HEIGHT: usize = 244;

/// Pictures by name: what a flight brings, and what nothing can be found in.
fn pictures() -> Vec<(&'static str, Image)> {
    let named = |name: &str| {
        let mut rows = MarkerScene::matrix().into_iter();
        let (_, scene) = rows.find(|row| row.0 == name).expect("a row of the matrix");
        scene.draw(1).image
    };
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut random = |pixel: fn(u8) -> u8| {
        let pixels = (0..WIDTH * HEIGHT).map(|_| pixel(rng.random())).collect();
        Image::from_pixels(WIDTH, HEIGHT, pixels).expect("one byte for each pixel")
    };
    vec![
        ("lab", named("lab")),
        ("bright", named("bright")),
        ("noise_15", named("noise 15")),
        ("8_distractors", named("8 distractors")),
        ("full_noise", random(|byte| byte)),
        ("salt_30", random(|byte| if byte < 77 { 255 } else { 0 })),
        ("salt_1", random(|byte| if byte < 3 { 255 } else { 0 })),
        ("faint_noise", random(|byte| byte % 24)),
    ]
}

fn find(criterion: &mut Criterion) {
    let mut finder = PairFinder::new(FinderSettings::default(), WIDTH);
    let mut paper = PaperPipeline::new(PaperPipelineSettings::default());
    for (name, image) in pictures() {
        criterion.bench_function(&format!("find/{name}/{WIDTH}x{HEIGHT}"), |bencher| {
            bencher.iter(|| finder.find(black_box(&image)).pairs.len());
        });
        criterion.bench_function(&format!("find_paper/{name}/{WIDTH}x{HEIGHT}"), |bencher| {
            let stamp = Timestamp::from_nanoseconds(0);
            bencher.iter(|| paper.find(black_box(&image), stamp));
        });
    }
}

criterion_group!(benches, find);
criterion_main!(benches);
