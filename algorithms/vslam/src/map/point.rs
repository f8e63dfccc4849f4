//! Landmarks.

use features::Descriptor;
use nalgebra::{Matrix3, Vector3};

use crate::{KeyframeId, PointId};

/// A place in the map that several keyframes see.
#[derive(Clone, Debug)]
pub struct MapPoint {
    pub(crate) id: PointId,
    pub(crate) position_in_map: Vector3<f64>,
    pub(crate) covariance_in_map: Matrix3<f64>,
    pub(crate) descriptor: Descriptor,
    pub(crate) first_keyframe: KeyframeId,
    pub(crate) parallax_rad: f64,
    /// Keyframes that see it and the index of the observation in each, by keyframe.
    pub(crate) views: Vec<View>,
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

    pub fn view_count(&self) -> usize {
        self.views.len()
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
