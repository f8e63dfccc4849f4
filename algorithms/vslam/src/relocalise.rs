//! Where a camera is in a map, without knowing where it was.

use features::matching::{MatchSettings, match_mutual};
use geometry::absolute_pose::{PointObservation, RansacSettings, ransac_absolute_pose};
use geometry::{Camera, Map, Transform};
use nalgebra::Vector2;
use rand_chacha::ChaCha8Rng;

use crate::frame::Frame;
use crate::optics::Optics;
use crate::places::{LookAlike, Places, rank};
use crate::tracking::{LocalMap, Tracked, match_local_map, refine, track_local_map};
use crate::{KeyframeId, MapPoint, PointId, VslamMap};

/// Neighbours of a keyframe whose points are searched along with its own.
const NEIGHBOURS: usize = 3;
/// A pose that fewer descriptors agree on may be a coincidence.
const INLIERS_MIN: usize = 12;
/// Keyframes tried per frame because they look alike.
const RANKED_CANDIDATES: usize = 4;
/// The pose of a frame that looks at much the same as a keyframe, by descriptors alone. Names the
/// points that agree in `frame`.
pub(crate) fn locate_near(
    map: &VslamMap,
    keyframe: KeyframeId,
    frame: &mut Frame,
    rng: &mut ChaCha8Rng,
) -> Option<Transform<Camera, Map>> {
    let holder = map.holder(keyframe)?;
    let mut places = vec![holder];
    places.extend(map.keyframe(holder)?.neighbours.iter().take(NEIGHBOURS));
    let points = map.points_of(&places);
    frame.forget_points();
    let matches = match_points(map, &points, frame);
    let observations: Vec<PointObservation> = matches
        .iter()
        .filter_map(|&(idx, point)| {
            Some(PointObservation {
                point_in_world: map.point(point)?.position_in_map,
                position: frame.observations[idx].position,
                sigma: frame.observations[idx].sigma,
                blur: Vector2::zeros(),
            })
        })
        .collect();
    let settings = RansacSettings {
        inlier_count_min: INLIERS_MIN,
        iteration_count_max: 200,
        ..RansacSettings::default()
    };
    let pose = ransac_absolute_pose(&observations, &settings, rng).ok()?;
    for (&(idx, point), inlier) in matches.iter().zip(&pose.inliers) {
        if *inlier {
            frame.observations[idx].point = Some(point);
        }
    }
    Some(pose.camera_from_world)
}

/// Observations of the frame and the points that their descriptors fit best.
fn match_points(map: &VslamMap, points: &[PointId], frame: &Frame) -> Vec<(usize, PointId)> {
    let ranged = |point: &&PointId| map.point(**point).is_some_and(MapPoint::has_range);
    let points: Vec<PointId> = points.iter().filter(ranged).copied().collect();
    let wanted: Vec<_> = points
        .iter()
        .filter_map(|&point| Some(*map.point(point)?.descriptor()))
        .collect();
    let seen: Vec<_> = frame
        .observations
        .iter()
        .map(|one| one.descriptor)
        .collect();
    let settings = MatchSettings {
        distance_max: 64,
        ratio_max: 0.85,
    };
    match_mutual(&seen, &wanted, &settings)
        .into_iter()
        .map(|found| (found.query_idx as usize, points[found.train_idx as usize]))
        .collect()
}

/// Remembers where it looked, so that all places get their turn.
#[derive(Clone, Debug, Default)]
pub(crate) struct Relocaliser {
    next: u32,
}

impl Relocaliser {
    /// Looks for the frame in the whole map.
    pub(crate) fn locate(
        &mut self,
        (optics, places): (&Optics, &Places),
        map: &mut VslamMap,
        frame: &mut Frame,
        rng: &mut ChaCha8Rng,
    ) -> Option<Tracked> {
        for candidate in self.candidates(places, map, frame) {
            let Some(pose) = locate_near(map, candidate, frame, rng) else {
                continue;
            };
            if let Some(tracked) = confirm(optics, map, frame, &pose) {
                return Some(tracked);
            }
        }
        None
    }

    /// The keyframes that look most like the frame, the newest one, and one after the other of all.
    fn candidates(&mut self, places: &Places, map: &VslamMap, frame: &Frame) -> Vec<KeyframeId> {
        let all: Vec<KeyframeId> = map.keyframes().map(crate::Keyframe::id).collect();
        if all.is_empty() {
            return all;
        }
        self.next = self.next.wrapping_add(1);
        let alike = look_alikes(places, frame);
        let mut candidates: Vec<KeyframeId> = rank(map, &alike, |_| true)
            .iter()
            .take(RANKED_CANDIDATES)
            .map(|one| one.keyframe)
            .collect();
        let newest = all.last().copied();
        let next = all.get(self.next as usize % all.len()).copied();
        for other in newest.into_iter().chain(next) {
            if !candidates.contains(&other) {
                candidates.push(other);
            }
        }
        candidates
    }
}

fn look_alikes(places: &Places, frame: &Frame) -> Vec<LookAlike> {
    places.look_alikes(frame.observations.iter().map(|one| &one.descriptor))
}

/// Grows a pose from a few descriptors to all that should be in view.
fn confirm(
    optics: &Optics,
    map: &mut VslamMap,
    frame: &mut Frame,
    pose: &Transform<Camera, Map>,
) -> Option<Tracked> {
    let local = LocalMap::around(map, frame)?;
    match_local_map(optics, map, &local, pose, frame);
    let fit = refine(map, pose, frame, INLIERS_MIN, None)?;
    let tracked = track_local_map(optics, map, frame, &fit.camera_from_map, None).ok()?;
    tracked.is_certain().then_some(tracked)
}
