//! Which keyframes see the same points.

use super::{MapPoint, VslamMap};
use crate::{KeyframeId, PointId};

/// Where fewer points tell their range, those count too whose range is only expected.
const MEASURED_MIN: usize = 20;

/// A keyframe and how many of the points in question it sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Covisible {
    pub(crate) keyframe: KeyframeId,
    pub(crate) shared_count: u32,
}

impl VslamMap {
    /// Keyframes that see any of these points, the ones that see most first, the newer at a tie.
    pub(crate) fn seen_by(&self, points: impl Iterator<Item = PointId>) -> Vec<Covisible> {
        let first_id = self.keyframes.first_id();
        let mut counts = vec![0_u32; (self.keyframes.next_id() - first_id) as usize];
        for point in points.filter_map(|point| self.point(point)) {
            for view in &point.views {
                counts[(view.keyframe.0 - first_id) as usize] += 1;
            }
        }
        let mut covisible: Vec<Covisible> = counts
            .into_iter()
            .enumerate()
            .filter(|(_, shared_count)| *shared_count > 0)
            .map(|(slot, shared_count)| Covisible {
                keyframe: KeyframeId(first_id + slot as u32),
                shared_count,
            })
            .collect();
        covisible.sort_by_key(|one| std::cmp::Reverse((one.shared_count, one.keyframe)));
        covisible
    }

    /// Other keyframes that share points with this one, the ones that share most first.
    pub(crate) fn covisible(&self, id: KeyframeId) -> Vec<Covisible> {
        let Some(keyframe) = self.keyframe(id) else {
            return Vec::new();
        };
        let mut covisible = self.seen_by(keyframe.points());
        covisible.retain(|one| one.keyframe != id);
        covisible
    }

    /// The points that any of these keyframes sees, each once, oldest first.
    pub(crate) fn points_of(&self, keyframes: &[KeyframeId]) -> Vec<PointId> {
        let first_id = self.points.first_id();
        let slot_count = (self.points.next_id() - first_id) as usize;
        let mut seen = vec![0_u64; slot_count.div_ceil(64)];
        let points = keyframes
            .iter()
            .filter_map(|&id| self.keyframe(id))
            .flat_map(|keyframe| keyframe.points());
        for point in points {
            let slot = (point.0 - first_id) as usize;
            seen[slot / 64] |= 1 << (slot % 64);
        }
        let mut ids = Vec::new();
        for (word_idx, mut word) in seen.into_iter().enumerate() {
            while word != 0 {
                ids.push(PointId(
                    first_id + word_idx as u32 * 64 + word.trailing_zeros(),
                ));
                word &= word - 1;
            }
        }
        ids
    }

    /// How far before a keyframe its points lie, in the median; `None` if it has none.
    pub(crate) fn median_depth(&self, id: KeyframeId) -> Option<f64> {
        let depths = self.sorted_depths(id);
        depths.get(depths.len() / 2).copied()
    }

    /// How far before a keyframe its points lie, nearest first.
    pub(crate) fn sorted_depths(&self, id: KeyframeId) -> Vec<f64> {
        let Some(keyframe) = self.keyframe(id) else {
            return Vec::new();
        };
        let axis = keyframe
            .camera_from_map
            .rotation_matrix()
            .row(2)
            .into_owned();
        let offset = keyframe.camera_from_map.translation().z;
        let points = || keyframe.points().filter_map(|point| self.point(point));
        let depth = |point: &MapPoint| (axis * point.position_in_map).x + offset;
        let measured = points().filter(|point| point.has_range()).map(depth);
        let mut depths: Vec<f64> = measured.collect();
        if depths.len() < MEASURED_MIN {
            depths = points().map(depth).collect();
        }
        depths.sort_by(f64::total_cmp);
        depths
    }
}
