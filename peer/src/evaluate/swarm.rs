//! How vehicles held together, by the truth.

use geometry::Enu;
use serde::Serialize;

use super::association::associate;
use crate::files::StampedPose;
use crate::swarm::{COLLISION_M, Mean};

/// `swarm` in the JSON of `demo`; `None` where there is no answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SwarmScore {
    /// Between the centres of any two, at any frame.
    pub min_distance_m: Option<f64>,
    /// To each one's nearest, over vehicles and frames.
    pub nn_mean_m: Option<f64>,
    /// Pairs that came nearer than half a metre.
    pub collisions: usize,
    /// Images that showed the lights that are followed, of all that a follower took.
    pub marker_seen_share: Option<f64>,
    /// How far from its leader a follower was told to be.
    #[serde(skip)]
    pub place_m: Option<f64>,
}

/// The mean distance may differ by this share from the commanded one.
const SPACING_SHARE_MAX: f64 = 0.15;

impl SwarmScore {
    /// Whether nobody collided, and the commanded distance was kept, if there is one.
    pub fn holds(&self) -> bool {
        let is_kept = match self.place_m.zip(self.nn_mean_m) {
            Some((place_m, nn_mean_m)) => (nn_mean_m / place_m - 1.0).abs() <= SPACING_SHARE_MAX,
            None => self.place_m.is_none(),
        };
        self.collisions == 0 && is_kept
    }

    /// - `truths`: of each vehicle; frames of the same moment have the same stamp.
    pub fn of(truths: &[Vec<StampedPose<Enu>>], marker_seen_share: Option<f64>) -> Self {
        let mut score = Self {
            marker_seen_share,
            ..Self::default()
        };
        let mut nearest_mean = Mean::default();
        for (idx, truth) in truths.iter().enumerate() {
            let mut nearest_m = vec![f64::INFINITY; truth.len()];
            for (other_idx, other) in truths.iter().enumerate() {
                if other_idx == idx {
                    continue;
                }
                let mut least_m = f64::INFINITY;
                for pair in associate(truth, other) {
                    let here = truth[pair.truth_idx].target_from_camera.translation();
                    let there = other[pair.estimate_idx].target_from_camera.translation();
                    let apart_m = (here - there).norm();
                    least_m = least_m.min(apart_m);
                    nearest_m[pair.truth_idx] = nearest_m[pair.truth_idx].min(apart_m);
                }
                // Each pair once.
                score.collisions += usize::from(other_idx > idx && least_m < COLLISION_M);
            }
            for apart_m in nearest_m.into_iter().filter(|apart_m| apart_m.is_finite()) {
                nearest_mean.add(apart_m);
                let least_m = score.min_distance_m.get_or_insert(apart_m);
                *least_m = least_m.min(apart_m);
            }
        }
        score.nn_mean_m = nearest_mean.mean();
        score
    }
}

#[cfg(test)]
mod tests {
    use geometry::{Camera, Timestamp, Transform};
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    fn along_x(places_m: &[f64]) -> Vec<StampedPose<Enu>> {
        let pose = |(idx, x): (usize, &f64)| {
            let target_from_camera: Transform<Enu, Camera> =
                Transform::new(UnitQuaternion::identity(), Vector3::new(*x, 0.0, 0.0));
            StampedPose {
                captured_at: Timestamp::from_nanoseconds(100_000_000 * idx as i64),
                target_from_camera,
            }
        };
        places_m.iter().enumerate().map(pose).collect()
    }

    #[test]
    fn distances_are_those_between_the_same_frames() {
        let truths = [
            along_x(&[0.0, 0.0, 0.0]),
            along_x(&[2.0, 0.4, 2.0]),
            along_x(&[5.0, 5.0]),
        ];
        let score = SwarmScore::of(&truths, Some(0.9));
        assert_eq!(score.min_distance_m, Some(0.4));
        assert_eq!(score.collisions, 1);
        // The first two are each other's nearest; the third has the second as its own.
        let nearest_m = [2.0, 0.4, 2.0, 2.0, 0.4, 2.0, 3.0, 4.6];
        let mean_m = nearest_m.iter().sum::<f64>() / 8.0;
        assert!((score.nn_mean_m.unwrap() - mean_m).abs() < 1e-12);
    }

    #[test]
    fn a_swarm_holds_near_its_place_without_collision() {
        let at = |apart_m: f64, place_m: Option<f64>| SwarmScore {
            place_m,
            ..SwarmScore::of(&[along_x(&[0.0]), along_x(&[apart_m])], None)
        };
        assert!(at(2.0, None).holds() && at(2.0, Some(1.8)).holds());
        assert!(!at(2.2, Some(1.8)).holds() && !at(1.5, Some(1.8)).holds());
        assert!(!at(0.4, None).holds());
        assert!(
            !SwarmScore {
                place_m: Some(1.8),
                ..SwarmScore::default()
            }
            .holds()
        );
    }

    #[test]
    fn one_vehicle_alone_has_no_distance() {
        let score = SwarmScore::of(&[along_x(&[1.0])], None);
        assert_eq!(score, SwarmScore::default());
    }
}
