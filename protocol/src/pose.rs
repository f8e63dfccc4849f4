//! Where a vehicle says it is, how sure it is, and why.

use std::fmt;

use geodesy::{Datum, Geodetic};
use geometry::{Body, Enu, Timestamp, Transform};
use nalgebra::Matrix6;
use serde::{Deserialize, Serialize};

use crate::VehicleId;
use crate::arrays::Float64Array;
use crate::codec::{Message, VERSION};
use crate::wire::{self, DatumWire};

/// Longer reasons are cut: they are for a person's eye.
const REASON_BYTES_MAX: usize = 160;

/// What a vehicle knows of where it is, from nothing to everything.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum VehicleState {
    /// No map of its own yet.
    NoMap,
    /// A map without metric scale.
    LocalUnscaled,
    /// A map in metres that stands nowhere.
    LocalMetric,
    /// It was global, but the newest evidence is too old or too weak.
    GlobalStale,
    /// It knows where on the Earth it is.
    Global,
}

impl fmt::Display for VehicleState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self, f)
    }
}

/// One pose of one vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    /// Whose pose it is.
    pub vehicle: VehicleId,
    /// When the image was taken, on the vehicle's clock.
    pub captured_at: Timestamp,
    /// What the vehicle knows.
    pub state: VehicleState,
    /// Why, for a person to read.
    pub reason: String,
    /// How often the pose has jumped: a change means that the motion in between is none.
    pub jump_count: u32,
    /// Where it is, while it knows.
    pub global: Option<GlobalPose>,
}

/// A pose on the Earth, or in a site.
#[derive(Clone, Debug, PartialEq)]
pub struct GlobalPose {
    /// What ENU is relative to.
    pub datum: Datum,
    /// The vehicle's pose: position and forward, left, up.
    pub enu_from_body: Transform<Enu, Body>,
    /// Its covariance over `[ω; ν]`, right perturbation.
    pub covariance: Matrix6<f64>,
    /// The same position on the ellipsoid; `None` in a site that was not surveyed.
    pub geodetic: Option<Geodetic>,
}

/// The pose's fields in the order in which they are written.
#[derive(Serialize, Deserialize)]
pub struct PoseWire {
    version: [u16; 2],
    vehicle: String,
    captured_at: i64,
    state: VehicleState,
    reason: String,
    jump_count: u32,
    global: Option<GlobalWire>,
}

/// The fields of a pose on the Earth in the order in which they are written.
#[derive(Serialize, Deserialize)]
pub struct GlobalWire {
    datum: DatumWire,
    position_m: [f64; 3],
    rotation_xyzw: [f64; 4],
    covariance: Float64Array,
    wgs84: Option<[f64; 3]>,
}

impl Message for Pose {
    const KIND: &'static str = "pose";
    const SIZE_BYTES_MAX: usize = 2048;
    type Wire = PoseWire;

    fn to_wire(&self) -> PoseWire {
        let mut reason_bytes = self.reason.len().min(REASON_BYTES_MAX);
        while !self.reason.is_char_boundary(reason_bytes) {
            reason_bytes -= 1;
        }
        PoseWire {
            version: VERSION,
            vehicle: self.vehicle.to_string(),
            captured_at: self.captured_at.nanoseconds(),
            state: self.state,
            reason: self.reason[..reason_bytes].to_owned(),
            jump_count: self.jump_count,
            global: self.global.as_ref().map(global_to_wire),
        }
    }

    fn from_wire(wire: PoseWire) -> Result<Self, String> {
        Ok(Self {
            vehicle: VehicleId::new(&wire.vehicle).map_err(|error| error.to_string())?,
            captured_at: Timestamp::from_nanoseconds(wire.captured_at),
            state: wire.state,
            reason: wire.reason,
            jump_count: wire.jump_count,
            global: wire.global.map(global_from_wire).transpose()?,
        })
    }
}

fn global_to_wire(global: &GlobalPose) -> GlobalWire {
    let rotation = global.enu_from_body.rotation();
    GlobalWire {
        datum: wire::datum_to_wire(&global.datum),
        position_m: (*global.enu_from_body.translation()).into(),
        rotation_xyzw: [rotation.i, rotation.j, rotation.k, rotation.w],
        covariance: wire::covariance_to_wire(&global.covariance),
        wgs84: global.geodetic.map(|position| {
            [
                position.latitude_deg(),
                position.longitude_deg(),
                position.height_m(),
            ]
        }),
    }
}

fn global_from_wire(wire: GlobalWire) -> Result<GlobalPose, String> {
    let geodetic = match wire.wgs84 {
        None => None,
        Some([latitude, longitude, height]) => Some(
            Geodetic::from_degrees(latitude, longitude, height)
                .map_err(|error| error.to_string())?,
        ),
    };
    Ok(GlobalPose {
        datum: wire::datum_from_wire(&wire.datum)?,
        enu_from_body: Transform::new(
            wire::rotation_from_wire(wire.rotation_xyzw)?,
            wire::point_from_wire(wire.position_m)?,
        ),
        covariance: wire::covariance6_from_wire(&wire.covariance)?,
        geodetic,
    })
}
