//! Time of one drone's step, by rule and number of neighbours in sight.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use keeping::{
    FieldOfView, Keeper, KeeperSettings, PaperRule, PaperRuleSettings, Perception, Placed, Range,
    Sighting,
};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Neighbours at the density of a settled swarm: one in a cube of three metres.
fn neighbours(count: usize) -> Vec<Placed> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let radius_m = 3.0 * (0.75 / std::f64::consts::PI * count as f64).cbrt() + 1.0;
    let mut neighbours = Vec::new();
    while neighbours.len() < count {
        let offset = Vector3::from_fn(|_, _| rng.random_range(-radius_m..radius_m));
        if (1.0..radius_m).contains(&offset.norm()) {
            neighbours.push(Placed {
                direction: offset.normalize(),
                range_m: offset.norm(),
            });
        }
    }
    neighbours
}

fn paper(criterion: &mut Criterion) {
    let rule = PaperRule::new(PaperRuleSettings::default());
    for count in [3, 16] {
        let neighbours = neighbours(count);
        criterion.bench_function(&format!("paper/correction/{count}"), |bencher| {
            bencher.iter(|| rule.correction(black_box(&neighbours).iter().copied()));
        });
    }
}

fn gabriel(criterion: &mut Criterion) {
    for count in [16, 64] {
        let sightings: Vec<Sighting> = neighbours(count)
            .iter()
            .map(|neighbour| Sighting {
                direction: neighbour.direction,
                range: Range {
                    expected_m: Some(neighbour.range_m),
                    low_m: 0.9 * neighbour.range_m,
                    high_m: 1.1 * neighbour.range_m,
                },
            })
            .collect();
        let views = [FieldOfView::all_but_rear()];
        let mut keeper = Keeper::new(KeeperSettings::default());
        criterion.bench_function(&format!("gabriel/step/{count}"), |bencher| {
            bencher.iter(|| {
                let perception = Perception {
                    sightings: black_box(&sightings),
                    obstacles: &[],
                    views: &views,
                    heading_rad: 0.0,
                    velocity: Vector3::x(),
                    nominal_mps: 1.0,
                };
                keeper.step(&perception, 0.1)
            });
        });
    }
}

criterion_group!(benches, paper, gabriel);
criterion_main!(benches);
