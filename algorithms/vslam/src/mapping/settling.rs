//! Whether local adjustments still move the map by far.

use geometry::Timestamp;

use crate::{KeyframeId, VslamMap};

/// An adjustment that moves the newest keyframe by more than this share of the depth that it sees
/// has followed a valley, along which a turn and a step explain what is seen nearly as well: where
/// it ends is decided by noise that keypoints share. In some two thousand adjustments of good maps
/// three went so far.
pub(super) const SHIFT_MAX: f64 = 0.02;
/// The same in a map of a few keyframes, where nothing lies but what a bad start put there.
const YOUNG_SHIFT_MAX: f64 = 0.01;
pub(super) const YOUNG_KEYFRAMES: usize = 5;
/// An adjustment that moves the newest keyframe by less than this is calm.
const CALM_SHIFT: f64 = 0.01;
/// So many of them in a row end the doubt,
const CALM_MIN: u32 = 3;
/// if so many points of known range hold each of them.
const CALM_POINTS_MIN: usize = 60;
/// So does this time without another such adjustment, however little is in sight.
const DOUBT_MAX_S: f64 = 2.0;
/// Of the first keyframes since a doubt in a young map, so many that are not calm mean that it had
/// a wrong start.
const ASKED_KEYFRAMES: u32 = 4;
const RESTLESS_MIN: u32 = 3;

/// What the last local adjustments say of the map around the camera.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Settling {
    doubt: Option<Doubt>,
}

#[derive(Clone, Copy, Debug)]
struct Doubt {
    /// When an adjustment went too far last.
    moved_at: Timestamp,
    began_young: bool,
    /// Since it began.
    keyframe_count: u32,
    restless_count: u32,
    /// In a row, until now.
    calm_count: u32,
}

/// An adjustment, and what it was made of.
#[derive(Clone, Copy, Debug)]
struct Adjusted {
    at: Timestamp,
    /// Of the newest keyframe, as a share of the depth that it sees.
    shift: f64,
    keyframe_count: usize,
    ranged_count: usize,
}

impl Settling {
    /// A map that only began badly has at most so many keyframes when it is given up.
    pub(crate) const HOPELESS_KEYFRAMES_MAX: usize = YOUNG_KEYFRAMES + ASKED_KEYFRAMES as usize;

    /// Takes note of an adjustment that moved the newest keyframe so far, or would have.
    pub(crate) fn note(&mut self, map: &VslamMap, newest: KeyframeId, shift: f64) {
        let Some(keyframe) = map.keyframe(newest) else {
            return;
        };
        let depth = map.median_depth(newest).unwrap_or(1.0).abs();
        let ranged = keyframe.points().filter_map(|point| map.point(point));
        self.take(Adjusted {
            at: keyframe.captured_at,
            shift: shift / depth,
            keyframe_count: map.keyframe_count(),
            ranged_count: ranged.filter(|point| point.has_range()).count(),
        });
    }

    fn take(&mut self, adjusted: Adjusted) {
        let young = adjusted.keyframe_count <= YOUNG_KEYFRAMES;
        let shift_max = if young { YOUNG_SHIFT_MAX } else { SHIFT_MAX };
        let is_far = adjusted.shift > shift_max;
        if is_far && !self.is_in_doubt(adjusted.at) {
            self.doubt = Some(Doubt {
                moved_at: adjusted.at,
                began_young: young,
                keyframe_count: 0,
                restless_count: 0,
                calm_count: 0,
            });
        }
        let Some(doubt) = &mut self.doubt else {
            return;
        };
        if is_far {
            doubt.moved_at = adjusted.at;
        }
        let calm = adjusted.shift < CALM_SHIFT;
        doubt.keyframe_count += 1;
        doubt.restless_count += u32::from(!calm);
        let held = calm && adjusted.ranged_count >= CALM_POINTS_MIN;
        doubt.calm_count = if held { doubt.calm_count + 1 } else { 0 };
        if doubt.calm_count >= CALM_MIN {
            self.doubt = None;
        }
    }

    /// Whether a pose in the map may be wrong although everything in view agrees with it.
    pub(crate) fn is_in_doubt(&self, at: Timestamp) -> bool {
        let recent = |doubt: &Doubt| at - doubt.moved_at <= DOUBT_MAX_S;
        self.doubt.as_ref().is_some_and(recent)
    }

    /// Whether the map should be given up: it began wrong, and nothing in it is worth keeping.
    pub(crate) fn is_hopeless(&self) -> bool {
        self.doubt.is_some_and(|doubt| {
            doubt.began_young
                && doubt.keyframe_count == ASKED_KEYFRAMES
                && doubt.restless_count >= RESTLESS_MIN
        })
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    const INTERVAL_S: f64 = 0.3;

    fn at(keyframe_idx: usize) -> Timestamp {
        Timestamp::default().after(Duration::from_secs_f64(INTERVAL_S * keyframe_idx as f64))
    }

    fn after(shifts: &[f64], keyframe_count: usize, ranged_count: usize) -> Settling {
        let mut settling = Settling::default();
        for (keyframe_idx, &shift) in shifts.iter().enumerate() {
            settling.take(Adjusted {
                at: at(keyframe_idx),
                shift,
                keyframe_count,
                ranged_count,
            });
        }
        settling
    }

    fn doubts(shifts: &[f64], ranged_count: usize) -> bool {
        after(shifts, 20, ranged_count).is_in_doubt(at(shifts.len()))
    }

    #[test]
    fn a_map_is_in_doubt_until_adjustments_leave_it_where_it_is() {
        assert!(!doubts(&[0.001, 0.015, 0.001], 200));
        assert!(doubts(&[0.03], 200));
        assert!(doubts(&[0.03, 0.001, 0.001], 200));
        assert!(doubts(&[0.03, 0.001, 0.012, 0.001, 0.001], 200));
        assert!(!doubts(&[0.03, 0.001, 0.001, 0.001], 200));
    }

    #[test]
    fn a_few_points_end_no_doubt_but_time_does() {
        assert!(doubts(&[0.03, 0.001, 0.001, 0.001, 0.001], 30));
        assert!(!doubts(
            &[0.03, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001],
            30
        ));
        // A camera that stands still makes no keyframes.
        let standing = after(&[0.03], 20, 200);
        assert!(standing.is_in_doubt(at(6)) && !standing.is_in_doubt(at(7)));
        // What goes on moving stays in doubt.
        assert!(doubts(&[0.03; 20], 200));
    }

    #[test]
    fn a_young_map_that_never_rests_is_hopeless() {
        let shifts = [0.015, 0.012, 0.001, 0.013];
        assert!(after(&shifts, 4, 200).is_hopeless());
        assert!(!after(&shifts[..3], 4, 200).is_hopeless());
        assert!(!after(&[0.03; 4], 20, 200).is_hopeless());
        assert!(!after(&[0.015, 0.012, 0.001, 0.001], 4, 200).is_hopeless());
        assert!(!after(&[0.015, 0.001, 0.001, 0.001, 0.001, 0.012], 4, 20).is_hopeless());
    }
}
