//! Frames found afterwards that no camera can have been at.
//!
//! Where a turn and a step explain an image nearly as well, a frame that is looked for alone may
//! be found several certain-looking centimetres off, and the next one at its place again. A camera
//! has mass: what jumps so, and is not one with frames that were tracked, counts for nothing.

use nalgebra::Vector3;

use super::sureness::{WAY_DEPTHS_MIN, WAY_SHARE_MAX, length};
use crate::trajectory::FrameRecord;
use crate::{TrajectoryEntry, VslamMap};

/// Frames further apart in time are not compared.
const LINK_S_MAX: f64 = 0.25;
/// Steps before and after one that say how fast the camera went.
const NEIGHBOURS: usize = 5;
/// Fewer steps, itself included, say nothing.
const STEPS_MIN: usize = 3;
/// Two standard deviations of the least certain place that counts.
const JUMP_SIGMAS: f64 = 2.0;
/// What a camera may accelerate, in depths that it sees per square second.
const ACCELERATION_MAX: f64 = 2.0;
/// The way is one of steps this long, in depths; smaller ones may be noise.
const STEP_DEPTHS: f64 = 0.02;
/// Keyframes asked for the depth.
const ASKED_MAX: usize = 60;

/// A frame with a pose in the map.
#[derive(Clone, Copy, Debug)]
struct Placed {
    idx: usize,
    at_s: f64,
    centre: Vector3<f64>,
    was_tracked: bool,
}

/// Takes the poses in this map from the frames that cannot have been there.
pub(super) fn clear(map: &VslamMap, trajectory: &[FrameRecord], entries: &mut [TrajectoryEntry]) {
    let Some(first) = entries.first().map(|entry| entry.captured_at) else {
        return;
    };
    let placed: Vec<Placed> = (entries.iter().zip(trajectory).enumerate())
        .filter(|(_, (entry, _))| entry.map_id == map.id())
        .filter_map(|(idx, (entry, record))| {
            Some(Placed {
                idx,
                at_s: entry.captured_at - first,
                centre: *entry.map_from_camera?.translation(),
                was_tracked: record.was_tracked,
            })
        })
        .collect();
    for idx in strays(&placed, depth(map)) {
        entries[idx].map_from_camera = None;
    }
}

/// What cameras of the map see lies about so far away.
fn depth(map: &VslamMap) -> f64 {
    let stride = map.keyframe_count().div_ceil(ASKED_MAX).max(1);
    let ids = map.keyframes().step_by(stride).map(crate::Keyframe::id);
    let mut depths: Vec<f64> = ids.filter_map(|id| map.median_depth(id)).collect();
    depths.sort_by(f64::total_cmp);
    depths.get(depths.len() / 2).copied().unwrap_or(0.0)
}

/// The frames, by `Placed::idx`, that hang together with no tracked one but for a jump.
fn strays(placed: &[Placed], depth: f64) -> Vec<usize> {
    let tracked = placed.iter().filter(|one| one.was_tracked);
    let way = length(tracked.map(|one| one.centre), STEP_DEPTHS * depth);
    let jump_min = JUMP_SIGMAS * WAY_SHARE_MAX * way.max(WAY_DEPTHS_MIN * depth);
    let linked = |one: &Placed, next: &Placed| next.at_s - one.at_s <= LINK_S_MAX;
    let chains = placed.chunk_by(linked);
    chains
        .flat_map(|chain| strays_of(chain, &jumps(chain, depth, jump_min)))
        .collect()
}

/// Which steps of a chain of frames are too long for a camera that goes as it does around them.
fn jumps(chain: &[Placed], depth: f64, jump_min: f64) -> Vec<bool> {
    let steps: Vec<(f64, Vector3<f64>)> = (chain.windows(2))
        .map(|pair| {
            let interval_s = pair[1].at_s - pair[0].at_s;
            (interval_s, (pair[1].centre - pair[0].centre) / interval_s)
        })
        .collect();
    let is_jump = |(idx, (interval_s, velocity)): (usize, &(f64, Vector3<f64>))| {
        let allowed = 0.5 * ACCELERATION_MAX * depth * interval_s * interval_s;
        usual_velocity(&steps, idx)
            .is_some_and(|usual| (velocity - usual).norm() * interval_s > jump_min + allowed)
    };
    steps.iter().enumerate().map(is_jump).collect()
}

/// The frames of the pieces between jumps in which none was tracked.
fn strays_of(chain: &[Placed], jumps: &[bool]) -> Vec<usize> {
    let after = jumps.iter().enumerate().filter(|(_, jump)| **jump);
    let mut borders = vec![0];
    borders.extend(after.map(|(idx, _)| idx + 1));
    borders.push(chain.len());
    if borders.len() == 2 {
        return Vec::new();
    }
    let pieces = borders.windows(2).map(|pair| &chain[pair[0]..pair[1]]);
    pieces
        .filter(|piece| !piece.iter().any(|one| one.was_tracked))
        .flat_map(|piece| piece.iter().map(|one| one.idx))
        .collect()
}

/// The median of the velocities around a step, each axis alone.
fn usual_velocity(steps: &[(f64, Vector3<f64>)], idx: usize) -> Option<Vector3<f64>> {
    let around = idx.saturating_sub(NEIGHBOURS)..(idx + NEIGHBOURS + 1).min(steps.len());
    if around.len() < STEPS_MIN {
        return None;
    }
    Some(Vector3::from_fn(|axis, _| {
        let mut values: Vec<f64> = steps[around.clone()]
            .iter()
            .map(|(_, velocity)| velocity[axis])
            .collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At 30 Hz along x with 0.3 depths per second; `offsets` beside it, `None` where lost.
    fn placed(offsets: &[Option<f64>], was_tracked: impl Fn(usize) -> bool) -> Vec<Placed> {
        let frames = offsets.iter().enumerate();
        let frames = frames.filter_map(|(idx, offset)| Some((idx, (*offset)?)));
        frames
            .map(|(idx, offset)| Placed {
                idx,
                at_s: idx as f64 / 30.0,
                centre: Vector3::new(0.01 * idx as f64, offset, 0.0),
                was_tracked: was_tracked(idx),
            })
            .collect()
    }

    fn with(changes: &[(usize, Option<f64>)]) -> Vec<Option<f64>> {
        let mut offsets = vec![Some(0.0); 40];
        for &(idx, offset) in changes {
            offsets[idx] = offset;
        }
        offsets
    }

    #[test]
    fn what_jumps_to_a_place_and_back_was_not_there() {
        let offsets = with(&[(20, Some(0.05)), (21, Some(0.05)), (25, Some(-0.04))]);
        let found = placed(&offsets, |idx| !(15..30).contains(&idx));
        // Between two jumps nothing speaks for the frames 22 to 24 either.
        assert_eq!(strays(&found, 1.0), [20, 21, 22, 23, 24, 25]);
    }

    #[test]
    fn a_tracked_frame_stays_and_so_does_what_moves_smoothly() {
        let offsets = with(&[(20, Some(0.05)), (21, Some(0.05))]);
        assert!(strays(&placed(&offsets, |_| true), 1.0).is_empty());
        let smooth = with(&[(20, Some(0.004)), (21, Some(-0.004))]);
        assert!(strays(&placed(&smooth, |idx| idx < 10), 1.0).is_empty());
    }

    #[test]
    fn frames_far_apart_in_time_are_not_compared() {
        let mut changes = vec![(30, Some(0.3))];
        changes.extend((20..30).chain(31..40).map(|idx| (idx, None)));
        let offsets = with(&changes);
        assert!(strays(&placed(&offsets, |idx| idx < 20), 1.0).is_empty());
    }

    #[test]
    fn a_fast_camera_does_not_jump() {
        let fast = |scale: f64| {
            let mut frames = placed(&with(&[]), |idx| idx < 10);
            for one in &mut frames {
                one.centre *= scale;
            }
            frames
        };
        assert!(strays(&fast(30.0), 1.0).is_empty());
    }
}
