//! Generated correspondences, most of them wrong.

use geometry::Similarity;
use nalgebra::{UnitVector3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use registration::Gravity;
use registration::search::{ConsensusSettings, Correspondence, find_consensus};

use super::{Deviation, Tally, random_normal, random_rotation};

const COUNT: usize = 1000;
/// Of the extent, which is one.
const NOISE: f64 = 0.01;
/// 99 % of normal errors in three dimensions are nearer.
const INLIER_SIGMAS: f64 = 3.4;
const BOUNDS: Deviation = Deviation {
    scale: 0.01,
    rotation_deg: 1.0,
    position: f64::INFINITY,
};

pub(super) struct Case {
    outlier_count: usize,
    knows_gravity: bool,
}

pub(super) fn cases() -> impl Iterator<Item = Case> {
    [500, 800, 950, 990].into_iter().flat_map(|outlier_count| {
        [false, true].map(|knows_gravity| Case {
            outlier_count,
            knows_gravity,
        })
    })
}

impl Case {
    pub fn name(&self) -> String {
        let percent = 100 * self.outlier_count / COUNT;
        let gravity = if self.knows_gravity {
            ", gravity known"
        } else {
            ""
        };
        format!("correspondences, {percent} % outliers{gravity}")
    }

    pub fn run(&self, seed_count: u64) -> Tally {
        let mut tally = Tally::default();
        for seed in 0..seed_count {
            tally.add(seed, self.deviation(seed), &BOUNDS);
        }
        tally
    }

    fn deviation(&self, seed: u64) -> Option<Deviation> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let rotation = random_rotation(&mut rng);
        let scale = (3.0 * rng.random::<f64>() - 1.5).exp();
        let truth = Similarity::new(scale, rotation, random_normal(&mut rng));
        let up_in_source = UnitVector3::new_normalize(random_normal(&mut rng));
        let gravity = Gravity {
            up_in_target: rotation * up_in_source,
            up_in_source,
        };
        let pairs: Vec<Correspondence> = (0..COUNT)
            .map(|idx| {
                let mut inside = || Vector3::from_fn(|_, _| rng.random::<f64>() - 0.5);
                let in_source = inside();
                let place = if idx < self.outlier_count {
                    inside()
                } else {
                    in_source
                };
                Correspondence {
                    in_target: truth * (place + random_normal(&mut rng) * NOISE),
                    in_source,
                }
            })
            .collect();
        let settings = ConsensusSettings {
            inlier_distance: INLIER_SIGMAS * NOISE * scale,
            inlier_share_min: 0.01,
            gravity: self.knows_gravity.then_some(gravity),
            ..ConsensusSettings::default()
        };
        let found = find_consensus(&pairs, &settings, &mut rng);
        let best = found.first()?;
        let middle = truth * Vector3::zeros();
        Some(Deviation::between(
            &best.target_from_source,
            &truth,
            &middle,
            scale,
        ))
    }
}
