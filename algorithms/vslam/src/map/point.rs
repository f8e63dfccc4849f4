//! Landmarks.

use features::Descriptor;
use nalgebra::{Matrix3, Vector2, Vector3};

use crate::frame::Viewpoint;
use crate::optics::{LEVEL_FACTOR, Optics, level_scale};
use crate::triangulation::d_position_d_point;
use crate::{KeyframeId, PointId};

/// A place in the map that several keyframes see.
#[derive(Clone, Debug)]
pub struct MapPoint {
    pub(crate) id: PointId,
    pub(crate) position_in_map: Vector3<f64>,
    pub(crate) covariance_in_map: Matrix3<f64>,
    pub(crate) descriptor: Descriptor,
    pub(crate) first_keyframe: KeyframeId,
    /// The newest keyframe when it was made.
    pub(crate) made_at: KeyframeId,
    pub(crate) parallax_rad: f64,
    /// Only while its views do not tell how far away it is.
    pub(crate) expected_range: Option<ExpectedRange>,
    /// Keyframes that see it and the index of the observation in each, by keyframe.
    pub(crate) views: Vec<View>,
    /// Mean direction from the cameras that see it.
    pub(crate) viewing_direction: Vector3<f64>,
    /// The distance at which it would be found on the finest level.
    pub(crate) finest_distance: f64,
    /// Frames in which it should have been seen.
    pub(crate) visible_count: u32,
    /// Frames in which it was.
    pub(crate) found_count: u32,
}

/// What the surroundings say of a point's distance from the keyframe that saw it first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ExpectedRange {
    /// Per unit of the map.
    pub(crate) inverse_range: f64,
    pub(crate) sigma: f64,
}

/// Where a keyframe shows a map point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct View {
    pub keyframe: KeyframeId,
    /// Index into [`crate::Keyframe::observations`].
    pub observation_idx: u32,
}

impl MapPoint {
    pub fn id(&self) -> PointId {
        self.id
    }

    pub fn position_in_map(&self) -> &Vector3<f64> {
        &self.position_in_map
    }

    /// What the noise of its views leaves uncertain, the keyframes' poses taken as exact.
    pub fn covariance_in_map(&self) -> &Matrix3<f64> {
        &self.covariance_in_map
    }

    /// The most typical descriptor of its views.
    pub fn descriptor(&self) -> &Descriptor {
        &self.descriptor
    }

    /// The oldest keyframe that saw it when it was made; that keyframe may have been culled since.
    pub fn first_keyframe(&self) -> KeyframeId {
        self.first_keyframe
    }

    /// The observation of a keyframe that shows it.
    pub(crate) fn observation_idx(&self, keyframe: KeyframeId) -> Option<usize> {
        let position = self
            .views
            .binary_search_by_key(&keyframe, |view| view.keyframe);
        Some(self.views[position.ok()?].observation_idx as usize)
    }

    /// How far one standard deviation of its range moves where a camera shows it, on the ideal
    /// plane; nothing where its range is known.
    pub(crate) fn blur(
        &self,
        viewpoint: &Viewpoint,
        point_in_camera: &Vector3<f64>,
    ) -> Vector2<f64> {
        if self.has_range() || point_in_camera.z <= 0.0 {
            return Vector2::zeros();
        }
        // The covariance of such a point is that of its range: of rank one.
        let axis = self.covariance_in_map.diagonal().imax();
        let sigma = self.covariance_in_map[(axis, axis)].sqrt();
        let along_ray = self.covariance_in_map.column(axis) / sigma.max(f64::MIN_POSITIVE);
        let inverse_depth = 1.0 / point_in_camera.z;
        let position = point_in_camera.xy() * inverse_depth;
        let [first, second] = d_position_d_point(viewpoint.rotation(), &position, inverse_depth);
        Vector2::new((first * along_ray).x, (second * along_ray).x)
    }

    /// The pyramid level on which it should be found from this distance.
    pub(crate) fn predicted_level(&self, optics: &Optics, distance: f64) -> u8 {
        let level = (self.finest_distance / distance).ln() / LEVEL_FACTOR.ln();
        // A cast from float saturates: negative and NaN become 0.
        (level.round() as u8).min(optics.level_count as u8 - 1)
    }

    /// Whether the pyramid can show it at this distance as its views did.
    pub(crate) fn in_distance_range(&self, optics: &Optics, distance: f64) -> bool {
        let coarsest = level_scale(optics.level_count as u8 - 1);
        distance < 1.2 * self.finest_distance && distance > 0.8 * self.finest_distance / coarsest
    }

    pub fn view_count(&self) -> usize {
        self.views.len()
    }

    /// Whether its views tell how far away it is. Otherwise only its direction is known, and the
    /// position is a guess within `covariance_in_map`.
    pub fn has_range(&self) -> bool {
        self.expected_range.is_none()
    }

    /// The keyframes that see it, oldest first.
    pub fn views(&self) -> &[View] {
        &self.views
    }

    /// The widest angle between two of its views.
    pub fn parallax_rad(&self) -> f64 {
        self.parallax_rad
    }
}
