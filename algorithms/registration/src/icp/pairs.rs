//! Which point of the one cloud belongs to which of the other.

use geometry::Similarity;
use nalgebra::Vector3;

use crate::alignment::{Source, Target};
use crate::cloud::{ShapedCloud, bounds, to_single};
use crate::kd_tree::KdTree;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    pub source_idx: u32,
    pub target_idx: u32,
    /// In the target's unit.
    pub distance_squared: f32,
}

/// Points whose partners are sought again and again while they move little.
///
/// A partner stays the nearest as long as the way since the last search does not exceed what the
/// second nearest was farther away; only then the index is asked again. So the pairs are exactly
/// those of a search from scratch.
#[derive(Clone, Debug)]
struct Seekers {
    /// The indices of the points that seek.
    members: Vec<u32>,
    states: Vec<Seeker>,
}

#[derive(Clone, Copy, Debug)]
struct Seeker {
    /// Where the index was last asked.
    asked_at: [f32; 3],
    /// The nearest two, or `u32::MAX`.
    nearest: [u32; 2],
    /// Every other point than the nearest was at least so far away.
    others_distance: f32,
}

impl Seekers {
    fn new(members: Vec<u32>) -> Self {
        let state = Seeker {
            asked_at: [f32::INFINITY; 3],
            nearest: [u32::MAX; 2],
            others_distance: 0.0,
        };
        Self {
            states: vec![state; members.len()],
            members,
        }
    }

    fn stride(&self, count: usize) -> usize {
        self.members.len().div_ceil(count).max(1)
    }

    /// About so many of them, evenly, with what they know.
    fn sampled(&self, count: usize) -> Self {
        let stride = self.stride(count);
        Self {
            members: self.members.iter().copied().step_by(stride).collect(),
            states: self.states.iter().copied().step_by(stride).collect(),
        }
    }

    /// Takes over what so many of them have learned.
    fn learn_from(&mut self, sampled: &Self, count: usize) {
        let stride = self.stride(count);
        let states = self.states.iter_mut().step_by(stride);
        for (state, learned) in states.zip(&sampled.states) {
            *state = *learned;
        }
    }

    /// Calls `found` with each point that has a partner within `gate`, the partner, and their
    /// squared distance.
    fn seek(
        &mut self,
        tree: &KdTree,
        gate: f32,
        place: impl Fn(usize) -> Vector3<f64>,
        mut found: impl FnMut(u32, u32, f32),
    ) {
        for (member, state) in self.members.iter().zip(&mut self.states) {
            let query = to_single(&place(*member as usize));
            if let Some((partner, distance_squared)) = state.nearest(tree, query, gate) {
                found(*member, partner, distance_squared);
            }
        }
    }
}

impl Seeker {
    fn nearest(&mut self, tree: &KdTree, query: [f32; 3], gate: f32) -> Option<(u32, f32)> {
        let way = squared(self.asked_at, query).sqrt();
        let slack = self.others_distance - way;
        let [first, second] = self.nearest;
        if first == u32::MAX && gate <= slack {
            return None;
        }
        if first != u32::MAX {
            let distance_squared = squared(tree.point(first), query);
            if slack > 0.0 && distance_squared <= slack * slack {
                return (distance_squared < gate * gate).then_some((first, distance_squared));
            }
        }
        let mut limit = gate * gate;
        if second != u32::MAX {
            // Both are still within this distance, so that the nearest two are.
            let farther = squared(tree.point(first), query).max(squared(tree.point(second), query));
            limit = limit.min(farther * (1.0 + 1e-5) + f32::MIN_POSITIVE);
        }
        let two = tree.nearest_two(query, limit);
        *self = Self {
            asked_at: query,
            nearest: [two.first.idx, two.second.idx],
            others_distance: two.second.distance_squared.sqrt() * (1.0 - 1e-6),
        };
        (two.first.idx != u32::MAX).then_some((two.first.idx, two.first.distance_squared))
    }
}

fn squared(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
}

/// The pairs of two clouds, renewed as they move; nothing is allocated after the first time.
#[derive(Clone, Debug)]
pub(crate) struct Pairing {
    of_source: Seekers,
    of_target: Option<Seekers>,
    pub pairs: Vec<Pair>,
}

impl Pairing {
    /// Every source point seeks.
    ///
    /// - `reach`: target points within this of the source at the start seek too, evenly and no
    ///   more of them than of the source's.
    pub fn new(
        source: &ShapedCloud,
        target: &ShapedCloud,
        target_from_source: &Similarity<Target, Source>,
        reach: Option<f64>,
    ) -> Self {
        let of_source = Seekers::new((0..source.points.len() as u32).collect());
        let of_target = reach.map(|reach| {
            let (lowest, highest) = bounds_of_aligned(source, target_from_source, reach);
            let members = (0..target.points.len() as u32)
                .filter(|idx| is_between(&target.points[*idx as usize], &lowest, &highest));
            Seekers::new(members.collect()).sampled(source.points.len())
        });
        Self::with(of_source, of_target)
    }

    fn with(of_source: Seekers, of_target: Option<Seekers>) -> Self {
        let count = of_source.members.len();
        let target_count = of_target
            .as_ref()
            .map_or(0, |seekers| seekers.members.len());
        Self {
            of_source,
            of_target,
            pairs: Vec::with_capacity(count + target_count),
        }
    }

    /// From now on only source points seek.
    pub fn keep_source_alone(&mut self) {
        self.of_target = None;
    }

    /// The same of about so many points of each cloud.
    pub fn sampled(&self, count: usize) -> Self {
        let of_target = self.of_target.as_ref();
        Self::with(
            self.of_source.sampled(count),
            of_target.map(|seekers| seekers.sampled(count)),
        )
    }

    /// Spares those that were sampled to search again.
    pub fn learn_from(&mut self, sampled: &Self, count: usize) {
        self.of_source.learn_from(&sampled.of_source, count);
        if let (Some(of_target), Some(sampled)) = (&mut self.of_target, &sampled.of_target) {
            of_target.learn_from(sampled, count);
        }
    }

    /// How many points seek a partner.
    pub fn seeking_count(&self) -> usize {
        let of_target = self.of_target.as_ref();
        self.of_source.members.len() + of_target.map_or(0, |seekers| seekers.members.len())
    }

    /// The nearest target point of each source point within `gate`, and both ways the nearest
    /// source point of each target point.
    pub fn renew(
        &mut self,
        source: &ShapedCloud,
        target: &ShapedCloud,
        target_from_source: &Similarity<Target, Source>,
        gate: f64,
    ) {
        let pairs = &mut self.pairs;
        pairs.clear();
        let linear = target_from_source.linear_matrix();
        let translation = target_from_source.translation();
        self.of_source.seek(
            &target.tree,
            gate as f32,
            |idx| linear * source.points[idx] + translation,
            |source_idx, target_idx, distance_squared| {
                pairs.push(Pair {
                    source_idx,
                    target_idx,
                    distance_squared,
                });
            },
        );
        let Some(of_target) = &mut self.of_target else {
            return;
        };
        let back = target_from_source.inverse();
        let linear = back.linear_matrix();
        let scale = target_from_source.scale();
        let scale_squared = (scale * scale) as f32;
        of_target.seek(
            &source.tree,
            (gate / scale) as f32,
            |idx| linear * target.points[idx] + back.translation(),
            |target_idx, source_idx, distance_squared| {
                pairs.push(Pair {
                    source_idx,
                    target_idx,
                    distance_squared: distance_squared * scale_squared,
                });
            },
        );
    }
}

/// Points of a cloud at most that are asked whether they have a partner.
const OVERLAP_POINT_COUNT: usize = 500;

/// The share of the target in the box around the aligned source that has a partner within
/// `distance`.
pub(crate) fn overlap_of_target(
    source: &ShapedCloud,
    target: &ShapedCloud,
    target_from_source: &Similarity<Target, Source>,
    distance: f64,
) -> f64 {
    let (lowest, highest) = bounds_of_aligned(source, target_from_source, 0.0);
    let back = target_from_source.inverse();
    let limit = ((distance * back.scale()) as f32).powi(2);
    let (mut near_count, mut boxed_count) = (0_usize, 0_usize);
    let boxed = |point: &&Vector3<f64>| is_between(point, &lowest, &highest);
    let in_box = target.points.iter().filter(boxed).count();
    let stride = in_box.div_ceil(OVERLAP_POINT_COUNT).max(1);
    for point in target.points.iter().filter(boxed).step_by(stride) {
        boxed_count += 1;
        let query = to_single(&(back * *point));
        near_count += usize::from(source.tree.nearest(query, limit).is_some());
    }
    near_count as f64 / boxed_count.max(1) as f64
}

/// The corners of the box around the aligned source, `margin` larger on each side.
fn bounds_of_aligned(
    source: &ShapedCloud,
    target_from_source: &Similarity<Target, Source>,
    margin: f64,
) -> (Vector3<f64>, Vector3<f64>) {
    let linear = target_from_source.linear_matrix();
    let points = source.points.iter();
    let (lowest, highest) =
        bounds(points.map(|point| linear * point + target_from_source.translation()));
    (lowest.add_scalar(-margin), highest.add_scalar(margin))
}

fn is_between(point: &Vector3<f64>, lowest: &Vector3<f64>, highest: &Vector3<f64>) -> bool {
    (0..3).all(|axis| lowest[axis] <= point[axis] && point[axis] <= highest[axis])
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::cloud::Cloud;

    /// Goal: what was learned spares searches and changes nothing. Method: a sample follows the
    /// clouds for some steps and teaches the rest; the pairs are those of a search from scratch.
    #[test]
    fn pairs_are_the_same_whoever_has_searched_before() {
        let wall = |idx: u32, shift: f64| {
            let (x, y) = (f64::from(idx % 40) + shift, f64::from(idx / 40));
            Vector3::new(0.1 * x, 0.1 * y, 0.2 * (0.3 * x).sin() * (0.2 * y).cos())
        };
        let cloud = |shift| Cloud::from_points((0..1200).map(|idx| wall(idx, shift)).collect());
        let source = ShapedCloud::new(&cloud(0.0), None);
        let target = ShapedCloud::new(&cloud(0.37), None);
        let at = |step: f64| -> Similarity<Target, Source> {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.01, 0.03) * step);
            Similarity::new(
                1.0 + 0.01 * step,
                turn,
                Vector3::new(0.02, -0.01, 0.0) * step,
            )
        };
        let new = || Pairing::new(&source, &target, &at(3.0), Some(1.0));
        let mut taught = new();
        let mut sampled = taught.sampled(100);
        for step in [3.0, 2.0, 1.2] {
            sampled.renew(&source, &target, &at(step), 0.3);
        }
        taught.learn_from(&sampled, 100);
        let mut fresh = new();
        for (step, gate) in [(1.0, 0.3), (0.9, 0.15), (0.0, 0.4)] {
            let pairs = [&mut taught, &mut fresh].map(|pairing| {
                pairing.renew(&source, &target, &at(step), gate);
                let pairs = pairing.pairs.iter();
                let pairs = pairs.map(|one| (one.source_idx, one.target_idx));
                pairs.collect::<Vec<_>>()
            });
            assert!(pairs[0].len() > 1000 && pairs[0] == pairs[1], "{step}");
            fresh = new();
        }
    }
}
