//! Two independent maps of one castle, disturbed: `cloud/sceaux_two_maps`.

use std::path::Path;

use anyhow::Result;
use geometry::Similarity;
use nalgebra::{Matrix4, Vector3};
use peer::files::read_cloud;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use registration::{
    Cloud, Descriptors, Outcome, RegisterSettings, Source, Start, Target, register,
};

use super::{Deviation, Tally, random_normal, random_rotation, read_numbers, similarity};

const BOUNDS: Deviation = Deviation {
    scale: 0.01,
    rotation_deg: 0.5,
    position: 0.005,
};
/// The extent is the width of the ball about the middle that holds this share of the points: a
/// few points lie very far behind the castle.
const EXTENT_SHARE: f64 = 0.9;

/// How the second map is disturbed before it is sought in the first.
pub(super) struct Case {
    pub name: &'static str,
    with_descriptors: bool,
    /// Of both maps, at random.
    kept_share: f64,
    /// Scales are drawn from its inverse to it, evenly in the logarithm.
    scale_factor: f64,
    shape: Shape,
}

/// What is left of the maps.
#[derive(Clone, Copy, PartialEq)]
enum Shape {
    Whole,
    /// The second map as in a mirror, so that nothing is right.
    Mirrored,
    /// Two parts that have nothing in common, on either side of a plane in a random direction.
    Disjoint,
    /// The nearer 70 % of the second map along a random direction.
    Part,
}

pub(super) fn cases() -> [Case; 6] {
    let by_shape = |name, shape| Case {
        name,
        with_descriptors: false,
        kept_share: 1.0,
        scale_factor: 2.0,
        shape,
    };
    let by_appearance = |name, kept_share| Case {
        name,
        with_descriptors: true,
        kept_share,
        scale_factor: 5.0,
        shape: Shape::Whole,
    };
    [
        by_appearance("two maps, half of the points", 0.5),
        by_appearance("two maps, a fifth of the points", 0.2),
        by_shape("two maps without descriptors", Shape::Whole),
        by_shape("two maps without descriptors, 70 % of one", Shape::Part),
        by_shape("no overlap: parts without descriptors", Shape::Disjoint),
        by_shape("no overlap: mirrored, without descriptors", Shape::Mirrored),
    ]
}

pub(super) struct TwoMaps {
    target: Half,
    source: Half,
    target_from_source: Similarity<Target, Source>,
    middle: Vector3<f64>,
    extent: f64,
}

#[derive(Clone)]
struct Half {
    points: Vec<Vector3<f64>>,
    descriptors: Vec<[u8; 128]>,
}

impl TwoMaps {
    /// - `data`: the folder with all recordings.
    pub fn read(data: &Path) -> Result<Self> {
        let folder = data.join("cloud/sceaux_two_maps");
        let target = Half::read(&folder.join("A_even.npz"))?;
        let middle = target.points.iter().sum::<Vector3<f64>>() / target.points.len() as f64;
        let from_middle = target.points.iter().map(|point| (point - middle).norm());
        let mut distances: Vec<f64> = from_middle.collect();
        distances.sort_by(f64::total_cmp);
        let rank = (EXTENT_SHARE * distances.len() as f64) as usize;
        Ok(Self {
            source: Half::read(&folder.join("B_odd.npz"))?,
            target_from_source: read_similarity(&folder.join("S_A_B.txt"))?,
            extent: 2.0 * distances[rank.min(distances.len() - 1)],
            middle,
            target,
        })
    }

    pub fn run(&self, case: &Case, seed_count: u64) -> Tally {
        // Where there is nothing to find, whatever is accepted is wrong.
        let nothing = Deviation {
            scale: -1.0,
            ..BOUNDS
        };
        let bounds = match case.shape {
            Shape::Whole | Shape::Part => BOUNDS,
            Shape::Mirrored | Shape::Disjoint => nothing,
        };
        let mut tally = Tally::default();
        for seed in 0..seed_count {
            tally.add(seed, self.deviation(case, seed), &bounds);
        }
        tally
    }

    fn deviation(&self, case: &Case, seed: u64) -> Option<Deviation> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let exponent = 2.0 * rng.random::<f64>() - 1.0;
        let scale = case.scale_factor.powf(exponent);
        let rotation = random_rotation(&mut rng);
        let shift = random_normal(&mut rng) * self.extent;
        let disturb: Similarity<Source, Source> = Similarity::new(scale, rotation, shift);
        let (mut source, mut target) = (self.source.clone(), self.target.clone());
        self.reshape(case.shape, &mut source, &mut target, &mut rng);
        for half in [&mut source, &mut target] {
            half.keep(|_| rng.random::<f64>() < case.kept_share);
        }
        for point in &mut source.points {
            *point = disturb * *point;
        }
        let settings = RegisterSettings {
            with_scale: true,
            start: Start::Search,
            seed,
            ..RegisterSettings::default()
        };
        let clouds = [source, target].map(|half| half.into_cloud(case.with_descriptors));
        let Outcome::Accepted(found) = register(&clouds[0], &clouds[1], &settings) else {
            return None;
        };
        let truth = self.target_from_source * disturb.inverse();
        let found = found.target_from_source;
        Some(Deviation::between(
            &found,
            &truth,
            &self.middle,
            self.extent,
        ))
    }

    fn reshape(&self, shape: Shape, source: &mut Half, target: &mut Half, rng: &mut ChaCha8Rng) {
        let direction = random_normal(rng).normalize();
        let along = |point: &Vector3<f64>| direction.dot(point);
        let mut places: Vec<f64> = self.target.points.iter().map(along).collect();
        places.sort_by(f64::total_cmp);
        let rank = |share: f64| places[(share * (places.len() - 1) as f64) as usize];
        let in_target = |point: &Vector3<f64>| along(&(self.target_from_source * *point));
        match shape {
            Shape::Whole => {}
            Shape::Part => source.keep(|point| in_target(point) < rank(0.7)),
            Shape::Disjoint => {
                source.keep(|point| in_target(point) > rank(0.55));
                target.keep(|point| along(point) < rank(0.45));
            }
            Shape::Mirrored => source
                .points
                .iter_mut()
                .for_each(|point| point.x = -point.x),
        }
    }
}

impl Half {
    fn read(path: &Path) -> Result<Self> {
        let cloud = read_cloud(path)?;
        let Descriptors::Histogram(descriptors) = cloud.descriptors else {
            anyhow::bail!("no descriptors of 128 bytes: {}", path.display());
        };
        Ok(Self {
            points: cloud.points,
            descriptors,
        })
    }

    fn keep(&mut self, mut wanted: impl FnMut(&Vector3<f64>) -> bool) {
        let kept: Vec<bool> = self.points.iter().map(&mut wanted).collect();
        let mut flags = kept.iter();
        self.points.retain(|_| *flags.next().expect("one for each"));
        let mut flags = kept.iter();
        self.descriptors
            .retain(|_| *flags.next().expect("one for each"));
    }

    fn into_cloud(self, with_descriptors: bool) -> Cloud {
        if with_descriptors {
            let descriptors = Descriptors::Histogram(self.descriptors);
            Cloud::new(self.points, descriptors).expect("both are kept alike")
        } else {
            Cloud::from_points(self.points)
        }
    }
}

fn read_similarity(path: &Path) -> Result<Similarity<Target, Source>> {
    let matrix = Matrix4::from_row_slice(&read_numbers::<16>(path)?);
    let linear = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    Ok(similarity(
        &linear,
        matrix.fixed_view::<3, 1>(0, 3).into_owned(),
    ))
}
