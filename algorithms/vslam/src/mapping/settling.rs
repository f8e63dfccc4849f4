//! Whether local adjustments still move the map by far.

use geometry::{Camera, Map, Transform};

use crate::{KeyframeId, VslamMap};

/// An adjustment that moves the newest keyframe by more than this share of the depth that it sees
/// has followed a valley, along which a turn and a step explain what is seen nearly as well: where
/// it ends is decided by noise that keypoints share. In some two thousand adjustments of good maps
/// three went so far.
const SHIFT_MAX: f64 = 0.02;
/// The same in a map of a few keyframes, where nothing lies but what a bad start put there.
const YOUNG_SHIFT_MAX: f64 = 0.01;
const YOUNG_KEYFRAMES: usize = 5;
/// An adjustment that moves the newest keyframe by less than this is calm.
const CALM_SHIFT: f64 = 0.01;
/// So many of them in a row end the doubt,
const CALM_MIN: u32 = 3;
/// if so many points of known range hold each of them.
const CALM_POINTS_MIN: usize = 60;
/// A young map that has not come to rest within so many keyframes had a wrong start.
const UNREST_MAX: u32 = 4;

/// What the last local adjustments say of the map around the camera.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Settling {
    in_doubt: bool,
    /// Since the doubt began.
    began_young: bool,
    keyframe_count: u32,
    /// In a row, until now.
    calm_count: u32,
}

impl Settling {
    /// Takes note of an adjustment that found the newest keyframe here.
    pub(crate) fn note(
        &mut self,
        map: &VslamMap,
        newest: KeyframeId,
        before: &Transform<Camera, Map>,
    ) {
        let Some(keyframe) = map.keyframe(newest) else {
            return;
        };
        let depths = map.sorted_depths(newest);
        let depth = depths.get(depths.len() / 2).copied().unwrap_or(1.0).abs();
        let way = keyframe.centre_in_map() - before.inverse().translation();
        let ranged = keyframe.points().filter_map(|point| map.point(point));
        let ranged_count = ranged.filter(|point| point.has_range()).count();
        self.note_shift(way.norm() / depth, map.keyframe_count(), ranged_count);
    }

    fn note_shift(&mut self, shift: f64, keyframe_count: usize, ranged_count: usize) {
        let young = keyframe_count <= YOUNG_KEYFRAMES;
        let shift_max = if young { YOUNG_SHIFT_MAX } else { SHIFT_MAX };
        if !self.in_doubt && shift > shift_max {
            *self = Self {
                in_doubt: true,
                began_young: young,
                ..Self::default()
            };
        }
        if !self.in_doubt {
            return;
        }
        self.keyframe_count += 1;
        let calm = shift < CALM_SHIFT && ranged_count >= CALM_POINTS_MIN;
        self.calm_count = if calm { self.calm_count + 1 } else { 0 };
        self.in_doubt = self.calm_count < CALM_MIN;
    }

    /// Whether a pose in the map may be wrong although everything in view agrees with it.
    pub(crate) fn is_in_doubt(&self) -> bool {
        self.in_doubt
    }

    /// Whether the map should be given up: it began wrong, and nothing in it is worth keeping.
    pub(crate) fn is_hopeless(&self) -> bool {
        self.in_doubt
            && self.began_young
            && self.keyframe_count >= UNREST_MAX
            && self.calm_count == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(shifts: &[f64], keyframe_count: usize, ranged_count: usize) -> Settling {
        let mut settling = Settling::default();
        for shift in shifts {
            settling.note_shift(*shift, keyframe_count, ranged_count);
        }
        settling
    }

    #[test]
    fn a_map_is_in_doubt_until_adjustments_leave_it_where_it_is() {
        assert!(!after(&[0.001, 0.015, 0.001], 20, 200).is_in_doubt());
        assert!(after(&[0.03], 20, 200).is_in_doubt());
        assert!(after(&[0.03, 0.001, 0.001], 20, 200).is_in_doubt());
        assert!(after(&[0.03, 0.001, 0.012, 0.001, 0.001], 20, 200).is_in_doubt());
        assert!(!after(&[0.03, 0.001, 0.001, 0.001], 20, 200).is_in_doubt());
    }

    #[test]
    fn a_few_points_end_no_doubt() {
        assert!(after(&[0.03, 0.001, 0.001, 0.001, 0.001], 20, 30).is_in_doubt());
    }

    #[test]
    fn a_young_map_that_never_rests_is_hopeless() {
        let shifts = [0.015, 0.012, 0.011, 0.013];
        assert!(after(&shifts, 4, 200).is_hopeless());
        assert!(!after(&shifts[..3], 4, 200).is_hopeless());
        assert!(!after(&shifts, 20, 200).is_in_doubt());
        assert!(!after(&[0.03; 8], 20, 200).is_hopeless());
        assert!(!after(&[0.015, 0.012, 0.001, 0.001, 0.001, 0.001], 4, 200).is_hopeless());
    }
}
