//! Ties a monocular map to the Earth: one similarity, and what drift bends beyond it.
//!
//! [`Georeferencer`] associates fixes with camera poses ([`association`]), finds a similarity
//! that most fixes agree with ([`start`]), and refines a chain of similarities, one per keyframe
//! ([`chain`]), of which [`outcome`] judges whether it is observable.

mod association;
mod chain;
mod outcome;
mod start;

use std::collections::BTreeMap;

use geometry::{Camera, Enu, Map, Matrix7, Similarity, Timestamp, Transform};
use nalgebra::{Matrix3, Vector3};
use vslam::KeyframeId;

pub use outcome::NotObservable;
pub(crate) use outcome::{d_point_d_tangent, probes};

use crate::{FrameInput, GeoreferenceSettings, Heading, KeyframePose};
use association::{Association, Tie};

/// A fix in the coordinates of the datum.
#[derive(Clone, Debug, PartialEq)]
pub struct LocalFix {
    pub captured_at: Timestamp,
    pub antenna_in_enu: Vector3<f64>,
    pub covariance: Matrix3<f64>,
    pub heading: Option<Heading>,
}

/// A map that stands on the Earth.
#[derive(Clone, Debug)]
pub struct Georeference {
    /// The one similarity that fits all keyframes best.
    pub enu_from_map: Similarity<Enu, Map>,
    /// Of `enu_from_map`, such that the map's positions are as uncertain as those of its
    /// keyframes are on average.
    pub covariance: Matrix7,
    /// Where each keyframe's camera stands, its unit that of the map.
    pub keyframes: BTreeMap<KeyframeId, PlacedKeyframe>,
    /// The typical standard deviation of a fix (m), horizontally.
    pub fix_sigma_m: f64,
    pub outlier_count: usize,
    pub fix_count: usize,
    /// How many times stronger than the drift model says the map bends.
    pub drift_factor: f64,
    /// When the newest accepted fix was captured.
    pub newest_fix_at: Timestamp,
}

#[derive(Clone, Copy, Debug)]
pub struct PlacedKeyframe {
    pub enu_from_camera: Similarity<Enu, Camera>,
    /// Over `[ω; ν; ln s]`, right perturbation.
    pub covariance: Matrix7,
}

impl Georeference {
    /// The similarity that holds near a keyframe, and its covariance.
    pub fn enu_from_map_near(
        &self,
        keyframe: KeyframeId,
        map_from_camera: &Transform<Map, Camera>,
    ) -> Option<(Similarity<Enu, Map>, Matrix7)> {
        let placed = self.keyframes.get(&keyframe)?;
        let map_from_camera: Similarity<Map, Camera> = (*map_from_camera).into();
        let adjoint = map_from_camera.adjoint();
        let covariance = adjoint * placed.covariance * adjoint.transpose();
        Some((
            placed.enu_from_camera * map_from_camera.inverse(),
            covariance,
        ))
    }
}

/// Collects fixes and poses, and solves on demand.
#[derive(Debug)]
pub struct Georeferencer {
    settings: GeoreferenceSettings,
    keyframes: BTreeMap<KeyframeId, KeyframePose>,
    depths: Depths,
    association: Association,
}

impl Georeferencer {
    pub fn new(settings: GeoreferenceSettings) -> Self {
        Self {
            association: Association::new(&settings),
            keyframes: BTreeMap::new(),
            depths: Depths::default(),
            settings,
        }
    }

    /// Takes a new keyframe.
    pub fn insert_keyframe(&mut self, pose: KeyframePose) {
        self.keyframes.insert(pose.id, pose);
        while self.keyframes.len() > self.settings.node_count_max {
            self.keyframes.pop_first();
        }
    }

    /// Takes the median depth of what a keyframe sees, in the unit of the map.
    pub fn insert_depth(&mut self, keyframe: KeyframeId, depth: f64) {
        if depth > 0.0 && depth.is_finite() {
            self.depths.0.insert(keyframe, depth);
        }
        while self.depths.0.len() > self.settings.node_count_max {
            self.depths.0.pop_first();
        }
    }

    /// Takes the places to which keyframes were moved. Those that are not named (they were
    /// culled) move with the nearest named one.
    pub fn move_keyframes(&mut self, poses: &[KeyframePose]) {
        move_keyframes(&mut self.keyframes, poses);
    }

    /// Takes a tracked frame, in the order of time.
    pub fn insert_frame(&mut self, frame: &FrameInput) {
        self.association.insert_frame(frame, &self.keyframes);
    }

    /// Takes a fix, in the order of time; it is used once the frames around it are known.
    pub fn insert_fix(&mut self, fix: LocalFix) {
        self.association.insert_fix(fix, &self.keyframes);
    }

    /// Fixes tied to a pose so far, and fixes at times without a pose.
    pub fn fix_counts(&self) -> (u64, u64) {
        (
            self.association.tied_count(),
            self.association.unmatched_count(),
        )
    }

    pub fn keyframe(&self, id: KeyframeId) -> Option<&KeyframePose> {
        self.keyframes.get(&id)
    }

    /// The newest keyframe.
    pub fn newest_keyframe(&self) -> Option<&KeyframePose> {
        self.keyframes.values().next_back()
    }

    /// Where the map stands, as far as fixes and path tell.
    pub fn solve(&self) -> Result<Georeference, NotObservable> {
        let ties: Vec<Tie> = self
            .association
            .ties()
            .filter_map(|tie| Some(tie.in_unit(self.keyframes.get(&tie.keyframe)?.unit)))
            .collect();
        let ties: Vec<&Tie> = ties.iter().collect();
        if ties.len() < self.settings.fix_count_min {
            return Err(NotObservable::TooFewFixes { count: ties.len() });
        }
        let start = start::find(&ties, &self.keyframes)?;
        let solution = chain::solve(&ties, &self.keyframes, &self.depths, &start, &self.settings)
            .ok_or(NotObservable::Unstable)?;
        outcome::judge(
            &ties,
            &self.keyframes,
            solution,
            &self.depths,
            &self.settings,
        )
    }
}

/// The depth of what keyframes see, in the unit of the map, as far as it was told.
#[derive(Debug, Default)]
struct Depths(BTreeMap<KeyframeId, f64>);

/// Of the scene, while nobody has told (m).
const DEPTH_UNTOLD_M: f64 = 3.0;

impl Depths {
    /// The depth that was told for the nearest keyframe before, or after.
    ///
    /// - `scale_m`: metres per unit of the map, for when nothing was told.
    fn near(&self, keyframe: KeyframeId, scale_m: f64) -> f64 {
        let before = self.0.range(..=keyframe).next_back();
        let nearest = before.or_else(|| self.0.range(keyframe..).next());
        nearest.map_or(DEPTH_UNTOLD_M / scale_m, |(_, depth)| *depth)
    }
}

/// Moves the named keyframes, and the others with the nearest named one.
pub(crate) fn move_keyframes(
    keyframes: &mut BTreeMap<KeyframeId, KeyframePose>,
    poses: &[KeyframePose],
) {
    let named: BTreeMap<KeyframeId, &KeyframePose> =
        poses.iter().map(|pose| (pose.id, pose)).collect();
    let moves: BTreeMap<KeyframeId, (Transform<Map, Map>, f64)> = named
        .iter()
        .filter_map(|(id, pose)| {
            let old = keyframes.get(id)?;
            let motion = pose.map_from_camera * old.map_from_camera.inverse();
            Some((*id, (motion, pose.unit / old.unit)))
        })
        .collect();
    for (id, keyframe) in keyframes.iter_mut() {
        if let Some(pose) = named.get(id) {
            keyframe.map_from_camera = pose.map_from_camera;
            keyframe.unit = pose.unit;
            continue;
        }
        let before = moves.range(..*id).next_back();
        let after = moves.range(*id..).next();
        let nearest = match (before, after) {
            (Some((a, motion_a)), Some((b, motion_b))) => Some(if id.0 - a.0 <= b.0 - id.0 {
                motion_a
            } else {
                motion_b
            }),
            (one, other) => one.or(other).map(|(_, motion)| motion),
        };
        if let Some((motion, stretch)) = nearest {
            keyframe.map_from_camera = *motion * keyframe.map_from_camera;
            keyframe.unit *= stretch;
        }
    }
}

#[cfg(test)]
mod tests;
