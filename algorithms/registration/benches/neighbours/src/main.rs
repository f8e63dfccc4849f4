//! Our k-d tree beside other structures, on the same points and questions, in one run: how long
//! one takes to build, and to find the nearest point within a gate.

mod hashed_cubes;

use std::hint::black_box;
use std::num::NonZero;
use std::time::Instant;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use parry3d::bounding_volume::Aabb;
use parry3d::math::Vector;
use parry3d::partitioning::{Bvh, BvhBuildStrategy};
use parry3d::query::PointProjection;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use registration::kd_tree::KdTree;

use hashed_cubes::HashedCubes;

type Point = [f32; 3];

const RUN_COUNT: usize = 9;

struct Scene {
    name: &'static str,
    points: Vec<Point>,
    queries: Vec<Point>,
    gate: f32,
}

fn main() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let scenes = [
        Scene {
            name: "room of 10 m, walls alone",
            points: room(20_000, &mut rng),
            queries: room(1500, &mut rng),
            gate: 0.5,
        },
        Scene {
            name: "room of 10 m, walls alone",
            points: room(100_000, &mut rng),
            queries: room(10_000, &mut rng),
            gate: 0.5,
        },
        Scene {
            name: "street of 100 m, denser near by",
            points: street(6000, &mut rng),
            queries: street(6000, &mut rng),
            gate: 1.0,
        },
        Scene {
            name: "street of 100 m, denser near by",
            points: street(70_000, &mut rng),
            queries: street(10_000, &mut rng),
            gate: 1.0,
        },
    ];
    println!("| points, queries, gate | structure | build | query | found |");
    println!("|---|---|---|---|---|");
    scenes.iter().for_each(compare);
}

fn compare(scene: &Scene) {
    let Scene {
        points,
        queries,
        gate,
        ..
    } = scene;
    let gate_squared = gate * gate;
    let tree = KdTree::new(points);
    scene.print(
        "ours, grows",
        || KdTree::new(points),
        |query| tree.nearest(query, gate_squared).is_some(),
    );
    let kiddo = |points: &[Point]| {
        ImmutableKdTree::<f32, 3>::new_from_slice(points).expect("all points are finite")
    };
    let tree = kiddo(points);
    let one = NonZero::new(1).expect("one is not zero");
    scene.print(
        "kiddo, does not grow",
        || kiddo(points),
        |query| {
            let search = tree.query(&query).nearest_n::<SquaredEuclidean<f32>>(one);
            !search.within(gate_squared).execute().is_empty()
        },
    );
    let boxes: Vec<Aabb> = points
        .iter()
        .map(|[x, y, z]| {
            let corner = Vector::new(*x, *y, *z);
            Aabb::new(corner, corner)
        })
        .collect();
    let build = || Bvh::from_leaves(BvhBuildStrategy::default(), &boxes);
    let tree = build();
    scene.print("parry3d, boxes", build, |[x, y, z]| {
        let projected = |idx: u32, _| {
            let corner = boxes[idx as usize].mins;
            Some(PointProjection::new(false, corner))
        };
        tree.project_point(Vector::new(x, y, z), *gate, projected)
            .is_some()
    });
    let cubes = HashedCubes::new(points, *gate);
    scene.print(
        "hashed cubes of the gate",
        || HashedCubes::new(points, *gate),
        |query| cubes.has_near(query),
    );
    assert!(!queries.is_empty());
}

impl Scene {
    fn print<T>(&self, name: &str, build: impl Fn() -> T, mut ask: impl FnMut(Point) -> bool) {
        let built_s = median_s(|| {
            black_box(build());
        });
        let mut found_count = 0;
        let asked_s = median_s(|| {
            found_count = 0;
            for query in &self.queries {
                found_count += usize::from(black_box(ask(black_box(*query))));
            }
        });
        println!(
            "| {}: {}, {}, {} m | {name} | {:.2} ms | {:.2} µs | {found_count} |",
            self.name,
            self.points.len(),
            self.queries.len(),
            self.gate,
            built_s * 1e3,
            asked_s / self.queries.len() as f64 * 1e6,
        );
    }
}

fn median_s(mut once: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..RUN_COUNT)
        .map(|_| {
            let started = Instant::now();
            once();
            started.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[RUN_COUNT / 2]
}

fn unit(rng: &mut impl Rng) -> f32 {
    2.0 * rng.random::<f32>() - 1.0
}

/// Points on the walls of a room of 10 m, with noise of 1 cm.
fn room(point_count: usize, rng: &mut impl Rng) -> Vec<Point> {
    (0..point_count)
        .map(|idx| {
            let mut point: Point = std::array::from_fn(|_| 5.0 * unit(rng));
            point[idx % 3] = 5.0 * point[idx % 3].signum();
            point.map(|value| value + 0.01 * unit(rng))
        })
        .collect()
}

/// Ground and two fronts as a turning scanner sees them: half of all within a tenth of the way.
fn street(point_count: usize, rng: &mut impl Rng) -> Vec<Point> {
    (0..point_count)
        .map(|idx| {
            let along = 50.0 * unit(rng).powi(3);
            let across = 8.0 * unit(rng);
            let height = 4.0 * rng.random::<f32>();
            let point = match idx % 3 {
                0 => [along, across, 0.0],
                1 => [along, -8.0, height],
                _ => [along, 8.0, height],
            };
            point.map(|value| value + 0.02 * unit(rng))
        })
        .collect()
}
