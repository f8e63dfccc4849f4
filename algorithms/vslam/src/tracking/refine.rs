//! The pose that fits a frame's matches best.

use geometry::absolute_pose::{
    PointObservation, PositionPrior, RefineSettings, refine_absolute_pose,
};
use geometry::{Camera, Map, Transform};
use nalgebra::{Matrix6, Vector3};

use crate::frame::{Frame, Viewpoint};
use crate::held::are_placing;
use crate::{KeyframeId, PointId, VslamMap};

/// A pose and how well it is known.
#[derive(Clone, Debug)]
pub(crate) struct PoseFit {
    pub(crate) camera_from_map: Transform<Camera, Map>,
    pub(crate) covariance: Matrix6<f64>,
    pub(crate) inlier_count: usize,
}

/// Where a camera should be that went on as it did. It replaces what points of known range would
/// say where there are too few: of the others a camera learns how it turned, and not how it moved.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Whereabouts {
    pub(crate) last_in_map: Vector3<f64>,
    pub(crate) expected_in_map: Vector3<f64>,
    pub(crate) keyframe: KeyframeId,
}

impl Whereabouts {
    fn prior(&self, map: &VslamMap) -> PositionPrior {
        let depth = map.median_depth(self.keyframe).unwrap_or(1.0);
        let step = self.expected_in_map - self.last_in_map;
        PositionPrior {
            centre_in_world: self.last_in_map + step * STEP_KEPT,
            sigma: STEP_DOUBT * step.norm() + DEPTH_DOUBT * depth.abs(),
        }
    }
}

/// A camera that nothing tells how it moves is thought to come to rest.
pub(super) const STEP_KEPT: f64 = 0.7;
/// How uncertain a step is, as shares of itself and of the distance of what is seen.
const STEP_DOUBT: f64 = 0.5;
const DEPTH_DOUBT: f64 = 0.002;

/// Refines a pose by the frame's matches, and forgets the matches that do not agree with it.
pub(crate) fn refine(
    map: &VslamMap,
    start: &Transform<Camera, Map>,
    frame: &mut Frame,
    inlier_count_min: usize,
    whereabouts: Option<&Whereabouts>,
) -> Option<PoseFit> {
    let viewpoint = Viewpoint::new(*start);
    let shown = frame.observations.iter().filter_map(|one| one.point);
    let doubt = doubt(map, shown);
    let mut indices = Vec::with_capacity(frame.observations.len());
    let mut matches = Vec::with_capacity(frame.observations.len());
    for (idx, observation) in frame.observations.iter().enumerate() {
        let Some(point) = observation.point.and_then(|point| map.point(point)) else {
            continue;
        };
        let point_in_camera = viewpoint.transform(&point.position_in_map);
        let blur = point.blur(&viewpoint, &point_in_camera) * doubt;
        indices.push(idx);
        matches.push(PointObservation {
            point_in_world: point.position_in_map,
            position: observation.position,
            sigma: observation.sigma,
            blur,
        });
    }
    let settings = RefineSettings {
        inlier_count_min,
        position_prior: whereabouts
            .filter(|_| !are_placing(map, start, &frame.observations))
            .map(|whereabouts| whereabouts.prior(map)),
        ..RefineSettings::default()
    };
    let fit = refine_absolute_pose(start, &matches, &settings).ok()?;
    for (idx, inlier) in indices.into_iter().zip(&fit.inliers) {
        if !inlier {
            frame.observations[idx].point = None;
        }
    }
    Some(PoseFit {
        camera_from_map: fit.camera_from_world,
        covariance: fit.world_from_camera_covariance,
        inlier_count: fit.inlier_count,
    })
}

/// By how much less certain a point of unknown range counts than it is: what is expected of many
/// points is wrong for all of them alike, so that together they may tell no more of how far a
/// camera moved than one alone.
fn doubt(map: &VslamMap, points: impl Iterator<Item = PointId>) -> f64 {
    let known = points.filter_map(|point| map.point(point));
    let expected_count = known.filter(|point| !point.has_range()).count();
    (expected_count as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use camera::{CameraModel, Distortion, Intrinsics};
    use features::Descriptor;
    use geometry::Timestamp;
    use nalgebra::{Matrix3, Vector2};

    use super::*;
    use crate::map::{ExpectedRange, NewPoint};
    use crate::optics::Optics;
    use crate::plane_grid::PlaneGrid;
    use crate::{MapId, Observation, View};

    const DEPTH: f64 = 4.0;
    const RANGED: usize = 25;
    const ALL: usize = 425;

    /// On the ideal plane: those of known range on the left, the others all over the right.
    fn seen_from_start(idx: usize) -> Vector2<f64> {
        match idx.checked_sub(RANGED) {
            None => Vector2::new(-0.5 + 0.05 * (idx % 5) as f64, 0.2 * (idx / 5) as f64 - 0.4),
            Some(idx) => Vector2::new(0.03 * (idx % 20) as f64, 0.04 * (idx / 20) as f64 - 0.4),
        }
    }

    fn frame(optics: &Optics, centre: Vector3<f64>) -> Frame {
        let observation = |idx| {
            let point_in_camera = seen_from_start(idx).push(1.0) * DEPTH - centre;
            Observation {
                position: point_in_camera.xy() / point_in_camera.z,
                position_px: Vector2::zeros(),
                sigma: 1.0 / 300.0,
                level: 0,
                angle_rad: 0.0,
                descriptor: Descriptor([0; 4]),
                point: None,
            }
        };
        let observations: Vec<Observation> = (0..ALL).map(observation).collect();
        Frame {
            frame_idx: 0,
            captured_at: Timestamp::default(),
            grid: PlaneGrid::new(optics, &observations),
            observations,
        }
    }

    #[test]
    fn a_few_known_ranges_outweigh_hundreds_that_are_expected() {
        // Goal: everything is twice as far away as expected, as far as that is not known. Then
        // what is expected says that a step was half as long as it was.
        let intrinsics = Intrinsics {
            fx: 300.0,
            fy: 300.0,
            cx: 160.0,
            cy: 120.0,
        };
        let camera = CameraModel::new(320, 240, intrinsics, Distortion::None).unwrap();
        let optics = Optics::new(camera, 1.0);
        let mut map = VslamMap::new(MapId(0), KeyframeId(0), PointId(0));
        let keyframe = map.add_keyframe(frame(&optics, Vector3::zeros()), Transform::identity());
        let step = Vector3::new(0.03, 0.0, 0.0);
        let mut moved = frame(&optics, step);
        for (idx, observation) in moved.observations.iter_mut().enumerate() {
            let ray = seen_from_start(idx).push(1.0);
            let expected = (idx >= RANGED).then_some(ExpectedRange {
                inverse_range: 2.0 / DEPTH,
                sigma: 1.0 / DEPTH,
            });
            let along = ray * 0.25 * DEPTH;
            let observation_idx = idx as u32;
            let new = NewPoint {
                position_in_map: ray * DEPTH * if expected.is_some() { 0.5 } else { 1.0 },
                covariance_in_map: expected.map_or(Matrix3::zeros(), |_| along * along.transpose()),
                parallax_rad: 0.1,
                expected_range: expected,
            };
            observation.point = Some(map.add_point(
                new,
                vec![View {
                    keyframe,
                    observation_idx,
                }],
            ));
        }
        let start = Transform::new(Default::default(), -step);
        let fit = refine(&map, &start, &mut moved, 20, None).unwrap();
        let error = fit.camera_from_map.inverse().translation() - step;
        assert!(error.norm() < 0.3 * step.norm(), "{error}");
    }
}
