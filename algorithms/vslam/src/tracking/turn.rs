//! How a camera turned between two frames, by what both show.

use features::matching::{MatchSettings, match_mutual};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::Observation;

/// Descriptors of one thing in two frames differ by at most this many bits.
const SETTINGS: MatchSettings = MatchSettings {
    distance_max: 64,
    ratio_max: 0.8,
};
/// Rays that the turn brings this near to each other agree with it: the camera also moved.
const ANGLE_RAD_MAX: f64 = 0.03;
/// Fewer that agree are a coincidence, and so is a smaller share of all.
const AGREEING_MIN: usize = 20;
const AGREEING_SHARE_MIN: f64 = 0.3;
const DRAWS: usize = 100;
/// Two rays nearer to each other than this do not tell a turn about themselves.
const SPREAD_RAD_MIN: f64 = 0.05;

/// The rays of one thing in the earlier and in the later frame.
type Pair = (Vector3<f64>, Vector3<f64>);

/// The turn `later_from_earlier` that most keypoints agree with, whatever the map knows of them.
///
/// It presumes that what is seen is far away compared with how far the camera moved.
pub(crate) fn turn_between(
    earlier: &[Observation],
    later: &[Observation],
    rng: &mut ChaCha8Rng,
) -> Option<UnitQuaternion<f64>> {
    let pairs = pairs(earlier, later);
    if pairs.len() < AGREEING_MIN {
        return None;
    }
    let (mut best, mut best_count) = (None, 0);
    for _ in 0..DRAWS {
        let drawn = [0, 1].map(|_| pairs[rng.random_range(0..pairs.len())]);
        if drawn[0].0.angle(&drawn[1].0) < SPREAD_RAD_MIN {
            continue;
        }
        let turn = align(drawn.iter());
        let count = pairs.iter().filter(|pair| agrees(&turn, pair)).count();
        if count > best_count {
            (best, best_count) = (Some(turn), count);
        }
    }
    let share = best_count as f64 / pairs.len() as f64;
    let turn = best.filter(|_| best_count >= AGREEING_MIN && share >= AGREEING_SHARE_MIN)?;
    let refined = align(pairs.iter().filter(|pair| agrees(&turn, pair)));
    Some(UnitQuaternion::from_rotation_matrix(&refined))
}

fn pairs(earlier: &[Observation], later: &[Observation]) -> Vec<Pair> {
    let descriptors = |all: &[Observation]| -> Vec<_> {
        let descriptors = all.iter().map(|one| one.descriptor);
        descriptors.collect()
    };
    let ray = |one: &Observation| one.position.push(1.0).normalize();
    match_mutual(&descriptors(earlier), &descriptors(later), &SETTINGS)
        .into_iter()
        .map(|found| {
            let first = &earlier[found.query_idx as usize];
            let second = &later[found.train_idx as usize];
            (ray(first), ray(second))
        })
        .collect()
}

fn agrees(turn: &Rotation3<f64>, (earlier, later): &Pair) -> bool {
    (turn * earlier).dot(later) > ANGLE_RAD_MAX.cos()
}

/// The rotation that brings the rays closest together (Kabsch).
fn align<'a>(pairs: impl Iterator<Item = &'a Pair>) -> Rotation3<f64> {
    let cross: Matrix3<f64> = pairs
        .map(|(earlier, later)| later * earlier.transpose())
        .sum();
    let svd = cross.svd(true, true);
    let (u, v_transposed) = (svd.u.unwrap_or_default(), svd.v_t.unwrap_or_default());
    let sign = (u * v_transposed).determinant().signum();
    let proper = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_transposed;
    Rotation3::from_matrix_unchecked(proper)
}

#[cfg(test)]
mod tests;
