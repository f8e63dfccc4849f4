//! Where the camera is, frame by frame, in a map that is taken as exact.

mod keyframe_decision;
mod local_map;
mod match_points;
mod predict;
mod refine;
mod turn;

use geometry::{Camera, Map, Timestamp, Transform};
use nalgebra::Matrix6;
use rand_chacha::ChaCha8Rng;

pub(crate) use keyframe_decision::{KeyframeClock, wants_keyframe};
pub(crate) use local_map::{LocalMap, match_local_map};
pub(crate) use predict::Motion;
pub(crate) use refine::{Whereabouts, refine};

use crate::frame::Frame;
use crate::held::{are_placing, misfit};
use crate::map::Place;
use crate::optics::Optics;
use crate::relocalise::locate_near;
use crate::{KeyframeId, LostReason, Observation, PointId, VslamMap};

/// Fewer points of known range are no pose of a camera that may be anywhere.
const RECOGNISED_INLIERS_MIN: usize = 40;
/// Fewer keypoints that agree with the map are no pose.
pub(crate) const INLIERS_MIN: usize = 25;
/// Fewer keypoints that agree with the last frame's points are no start for the local map.
const FIRST_INLIERS_MIN: usize = 12;

/// A pose is doubtful if the frame misses most of what it should show there. Then few keypoints are
/// a coincidence, and so are many that fit worse than keypoints do in other frames.
const FOUND_SHARE_MIN: f64 = 0.2;
const CERTAIN_INLIERS: usize = 50;

/// A frame whose pose is known, and what the next one needs of it.
#[derive(Clone, Debug)]
pub(crate) struct TrackedFrame {
    pub(crate) captured_at: Timestamp,
    pub(crate) place: Place,
    pub(crate) observations: Vec<Observation>,
}

/// The pose of a frame in the local map.
#[derive(Clone, Debug)]
pub(crate) struct Tracked {
    pub(crate) camera_from_map: Transform<Camera, Map>,
    /// Unknown for the frame with which a map starts.
    pub(crate) covariance: Option<Matrix6<f64>>,
    pub(crate) inlier_count: usize,
    /// Those of which the map knows the range: they tell where it is.
    pub(crate) ranged_count: usize,
    /// Points of known range that the frame should show.
    pub(crate) expected_count: usize,
    /// Whether they tell it well.
    pub(crate) is_placed: bool,
    /// By how much the points miss the keypoints, if the frame misses most of what it should show.
    pub(crate) doubtful_misfit: Option<f64>,
    /// The keyframe that shares most points with the frame.
    pub(crate) reference: KeyframeId,
}

/// What a first guess at the pose of a frame rests on.
#[derive(Clone, Copy, Debug)]
enum Guess {
    /// The camera went on as it did.
    Motion,
    /// It turned as a gyroscope says that nobody confirmed.
    Hint,
    /// It turned as what it still shows of the last frame says.
    Turn,
    /// It is near the last keyframe, wherever.
    Looks,
}

/// What it takes to guess: where the frames are, and where the camera should be.
#[derive(Clone, Copy)]
struct Search<'a> {
    optics: &'a Optics,
    motion: &'a Motion,
    whereabouts: Option<&'a Whereabouts>,
}

/// Finds the pose of a frame that follows a tracked one.
///
/// A pose that does not say where the camera is may be that of a wrong guess, as in a fast turn:
/// then the other guesses are tried, and the best of them counts.
pub(crate) fn track(
    optics: &Optics,
    map: &mut VslamMap,
    motion: &Motion,
    frame: &mut Frame,
    rng: &mut ChaCha8Rng,
) -> Result<Tracked, LostReason> {
    if frame.observations.len() < INLIERS_MIN {
        return Err(LostReason::FewKeypoints);
    }
    let whereabouts = motion.whereabouts(map, frame.captured_at);
    let search = Search {
        optics,
        motion,
        whereabouts: whereabouts.as_ref(),
    };
    let mut best: Option<(Tracked, Vec<Option<PointId>>)> = None;
    for guess in [Guess::Motion, Guess::Hint, Guess::Turn, Guess::Looks] {
        let Some(first) = search.guess(guess, map, frame, rng) else {
            continue;
        };
        let Ok(tracked) = track_local_map(optics, map, frame, &first, search.whereabouts) else {
            continue;
        };
        if motion.is_chance(tracked.doubtful_misfit) {
            continue;
        }
        let suffices = tracked.is_placed || motion.expects_no_more_than(tracked.inlier_count);
        let known = best.as_ref().map(|(best, _)| best.rank());
        if known.is_none_or(|known| tracked.rank() > known) {
            best = Some((tracked, frame.points()));
        }
        if suffices {
            break;
        }
    }
    let (tracked, points) = best.ok_or(LostReason::FewInliers)?;
    frame.show(&points);
    if !tracked.is_placed && motion.is_adrift(frame.captured_at) {
        return Err(LostReason::OnlyDirections);
    }
    Ok(tracked)
}

impl Tracked {
    /// Whether a lost camera may be taken to be there: nothing else speaks for it.
    pub(crate) fn is_certain(&self) -> bool {
        self.is_placed && self.ranged_count >= RECOGNISED_INLIERS_MIN
    }

    /// A pose that says where the camera is counts for more than one by many keypoints.
    fn rank(&self) -> (bool, usize) {
        (self.is_placed, self.inlier_count)
    }
}

impl Search<'_> {
    fn guess(
        &self,
        guess: Guess,
        map: &VslamMap,
        frame: &mut Frame,
        rng: &mut ChaCha8Rng,
    ) -> Option<Transform<Camera, Map>> {
        let (motion, at) = (self.motion, frame.captured_at);
        match guess {
            Guess::Motion => self.from(&motion.predict(map, at)?, map, frame),
            Guess::Hint => {
                let turn = motion.hinted_turn?;
                self.from(&motion.predict_turned(map, at, Some(turn))?, map, frame)
            }
            Guess::Turn => {
                let seen = (&motion.last.observations, &frame.observations);
                let turn = turn::turn_between(seen.0, seen.1, rng)?;
                self.from(&motion.predict_turned(map, at, Some(turn))?, map, frame)
            }
            Guess::Looks => locate_near(map, motion.last.place.keyframe, frame, rng),
        }
    }

    /// The pose from the points of the last frame, searched where this prediction expects them.
    fn from(
        &self,
        predicted: &Transform<Camera, Map>,
        map: &VslamMap,
        frame: &mut Frame,
    ) -> Option<Transform<Camera, Map>> {
        let last = &self.motion.last.observations;
        for window_px in [15.0, 30.0] {
            frame.forget_points();
            let expected = (predicted, window_px);
            match_points::match_last_frame(self.optics, map, last, expected, frame);
            let fit = refine(map, predicted, frame, FIRST_INLIERS_MIN, self.whereabouts);
            if let Some(fit) = fit {
                return Some(fit.camera_from_map);
            }
        }
        frame.forget_points();
        None
    }
}

/// Grows a first pose by all points that should be in view.
pub(crate) fn track_local_map(
    optics: &Optics,
    map: &mut VslamMap,
    frame: &mut Frame,
    first: &Transform<Camera, Map>,
    whereabouts: Option<&Whereabouts>,
) -> Result<Tracked, LostReason> {
    let local = LocalMap::around(map, frame).ok_or(LostReason::FewInliers)?;
    let expected_count = match_local_map(optics, map, &local, first, frame);
    let fit = refine(map, first, frame, INLIERS_MIN, whereabouts).ok_or(LostReason::FewInliers)?;
    let seen = frame
        .observations
        .iter()
        .filter_map(|one| map.point(one.point?));
    let seen_count = seen.filter(|point| point.has_range()).count();
    let doubtful = (seen_count as f64) < FOUND_SHARE_MIN * expected_count as f64;
    if doubtful && fit.inlier_count < CERTAIN_INLIERS {
        return Err(LostReason::FewInliers);
    }
    for point in frame.observations.iter().filter_map(|one| one.point) {
        if let Some(point) = map.point_mut(point) {
            point.found_count += 1;
        }
    }
    let reference = map
        .seen_by(frame.observations.iter().filter_map(|one| one.point))
        .first()
        .map_or(local.reference, |one| one.keyframe);
    Ok(Tracked {
        camera_from_map: fit.camera_from_map,
        covariance: Some(fit.covariance),
        inlier_count: fit.inlier_count,
        ranged_count: seen_count,
        expected_count,
        is_placed: are_placing(map, &fit.camera_from_map, &frame.observations),
        doubtful_misfit: doubtful
            .then(|| misfit(map, &fit.camera_from_map, &frame.observations))
            .flatten(),
        reference,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_points_that_tell_no_place_are_not_enough() {
        let found = |is_placed, ranged_count| Tracked {
            camera_from_map: Transform::identity(),
            covariance: None,
            inlier_count: 300,
            ranged_count,
            expected_count: 300,
            is_placed,
            doubtful_misfit: None,
            reference: KeyframeId(0),
        };
        assert!(found(true, RECOGNISED_INLIERS_MIN).is_certain());
        assert!(!found(false, 5 * RECOGNISED_INLIERS_MIN).is_certain());
        assert!(!found(true, RECOGNISED_INLIERS_MIN - 1).is_certain());
    }
}
