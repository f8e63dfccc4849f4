//! What can be set, each with its default beside it.

use geodesy::{Datum, SiteSurvey};
use geometry::{Body, Camera, Transform};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use protocol::{ChunkCamera, VehicleId};

#[derive(Clone, Debug)]
pub struct AnchorSettings {
    pub vehicle: VehicleId,
    pub camera: ChunkCamera,
    /// What ENU is relative to. `None`: about the first geodetic fix.
    pub datum: Option<Datum>,
    pub surveys: Vec<SiteSurvey>,
    pub cut: CutSettings,
    pub georeference: GeoreferenceSettings,
    /// Without an accepted fix for longer, the anchor's position is stale (s); 5 to 60.
    pub stale_after_s: f64,
    /// The georeference is renewed this often (s): what the anchor's own pose rests on.
    pub solve_interval_s: f64,
    /// Placements are published at most this often (s).
    pub placement_interval_s: f64,
    /// A chunk's or map's place is published again when it moved by more than this many of its
    /// standard deviations; less costs bandwidth, more costs accuracy.
    pub republish_sigma: f64,
}

impl AnchorSettings {
    pub fn new(vehicle: VehicleId, camera: ChunkCamera) -> Self {
        Self {
            vehicle,
            camera,
            datum: None,
            surveys: Vec::new(),
            cut: CutSettings::default(),
            georeference: GeoreferenceSettings::default(),
            stale_after_s: 10.0,
            solve_interval_s: 0.25,
            placement_interval_s: 1.0,
            republish_sigma: 0.25,
        }
    }
}

/// When a keyframe becomes a chunk, and with which points.
#[derive(Clone, Debug)]
pub struct CutSettings {
    /// A keyframe that has not settled is cut anyway after this long (s).
    pub delay_max_s: f64,
    /// ... or after this many newer keyframes.
    pub keyframe_count_max: usize,
    /// A point needs this many views,
    pub view_count_min: usize,
    /// ... or two views this far apart (rad).
    pub parallax_min_rad: f64,
    /// Points whose depth is less certain than this share of it are left out.
    pub relative_sigma_max: f64,
    /// Fewer points are no chunk: they wait for the next keyframe that sees them.
    pub point_count_min: usize,
    /// Points that moved by more than this many standard deviations make a new chunk.
    pub replace_sigma: f64,
}

impl Default for CutSettings {
    fn default() -> Self {
        Self {
            delay_max_s: 1.5,
            keyframe_count_max: 10,
            view_count_min: 3,
            parallax_min_rad: 0.03,
            relative_sigma_max: 0.3,
            point_count_min: 12,
            replace_sigma: 3.0,
        }
    }
}

/// How the map is tied to the fixes.
#[derive(Clone, Debug)]
pub struct GeoreferenceSettings {
    /// How the camera is mounted.
    pub body_from_camera: Transform<Body, Camera>,
    /// The lever arm: where the antenna is (m).
    pub antenna_in_body: Vector3<f64>,
    /// Fewer fixes tell nothing.
    pub fix_count_min: usize,
    /// A fix further in time from the frames around it is not used (s).
    pub frame_gap_max_s: f64,
    /// Keyframes beyond this many, the oldest first, keep the place that they had.
    pub node_count_max: usize,
    /// Fixes beyond this many, the oldest first, are forgotten.
    pub fix_count_max: usize,
    /// Observable means: the rotation is known to this (rad), one standard deviation,
    pub rotation_sigma_max_rad: f64,
    /// ... and the logarithm of the scale to this.
    pub scale_sigma_max: f64,
    pub drift: DriftModel,
}

impl Default for GeoreferenceSettings {
    fn default() -> Self {
        Self {
            body_from_camera: Transform::new(forward_left_up_from_optical(), Vector3::zeros()),
            antenna_in_body: Vector3::zeros(),
            fix_count_min: 8,
            frame_gap_max_s: 0.5,
            node_count_max: 400,
            fix_count_max: 4096,
            rotation_sigma_max_rad: 0.06,
            scale_sigma_max: 0.05,
            drift: DriftModel::default(),
        }
    }
}

/// How a monocular map errs along its path, as random walks: what makes the covariance honest and
/// lets the fixes bend the map. Larger values follow the fixes more closely.
///
/// Standard deviations after a way as long as the scene is deep, growing with the root of the
/// way. A camera that mistakes a turn for a shift keeps what it looks at in place: the map turns
/// about the scene ahead, not about the camera.
#[derive(Clone, Copy, Debug)]
pub struct DriftModel {
    pub rotation_rad: f64,
    /// Per radian turned.
    pub rotation_per_rad: f64,
    /// Of the scene ahead, as a share of its depth.
    pub translation: f64,
    /// Of ln s.
    pub log_scale: f64,
    /// Of ln s, per radian turned.
    pub log_scale_per_rad: f64,
}

impl Default for DriftModel {
    fn default() -> Self {
        Self {
            rotation_rad: 0.009,
            rotation_per_rad: 0.01,
            translation: 0.003,
            log_scale: 0.01,
            log_scale_per_rad: 0.01,
        }
    }
}

/// A camera that looks ahead: its z is the body's x, its x the body's −y, its y the body's −z.
fn forward_left_up_from_optical() -> UnitQuaternion<f64> {
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}
