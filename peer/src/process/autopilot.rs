//! What the station-keeping loop says goes to the autopilot, into a file, and into the summary.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, bail};
use geometry::Timestamp;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::input::{Source, VelocitySink};
use super::loss::Loss;
use super::outputs::Lines;
use crate::config::{KeepingConfig, KeepingRule, VehicleConfig};
use crate::station::{
    Outlet, StationKeeper, StationLoop, StationMoment, StationRule, StationSettings,
};

/// How station-keeping went.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct KeepingSummary {
    /// Images that the loop looked at.
    pub frame_count: u64,
    /// Those that showed the lights that are followed; of a rule that follows nobody, any.
    pub seen_count: u64,
    /// Those after which the safety filter changed what a follower wanted.
    pub withheld_count: u64,
    /// Velocities that the driver took, after images and between them.
    pub velocity_count: u64,
    /// Images that made the loop fail.
    #[serde(default)]
    pub fault_count: u64,
}

/// Takes the loop's velocities.
pub struct Autopilot {
    sink: VelocitySink,
    lines: Lines,
    follows: bool,
    pub loss: Loss,
    pub summary: KeepingSummary,
}

const HEADER: &str =
    "timestamp,neighbours,separation_px,lateral_px,forward_mps,left_mps,up_mps,withheld_mps";
/// Less than the filter's own rounding is no intervention.
const WITHHELD_MPS_MIN: f64 = 1e-3;

/// Starts the loop if the configuration asks for it.
pub fn start(
    config: &VehicleConfig,
    source: &dyn Source,
) -> anyhow::Result<Option<StationLoop<Autopilot>>> {
    let Some(keeping) = &config.keeping else {
        return Ok(None);
    };
    let Some(sink) = source.velocity_sink() else {
        bail!("[keeping] needs a [camera] stream, whose driver takes its velocities");
    };
    let keeper =
        StationKeeper::new(&keeping.settings(), source.calibration()).context("[keeping]")?;
    let path = config.out.join(format!("{}.keeping.csv", config.id));
    let autopilot = Autopilot::create(sink, &path, keeping.rule == KeepingRule::Follow)?;
    let period = Duration::from_secs_f64(1.0 / keeping.rate_hz);
    Ok(Some(StationLoop::start(keeper, period, autopilot)))
}

impl Autopilot {
    fn create(sink: VelocitySink, path: &Path, follows: bool) -> anyhow::Result<Self> {
        let mut lines = Lines::create(path)?;
        lines.append(HEADER)?;
        Ok(Self {
            sink,
            lines,
            follows,
            loss: Loss::default(),
            summary: KeepingSummary::default(),
        })
    }
}

impl Outlet for Autopilot {
    fn fly(&mut self, now: Timestamp, velocity_in_heading: &Vector3<f64>) {
        let is_taken = (self.sink)(now, velocity_in_heading);
        self.summary.velocity_count += u64::from(is_taken);
    }

    fn fault(&mut self, captured_at: Timestamp) {
        self.summary.fault_count += 1;
        let error = format!("the image of {captured_at} made it fail");
        self.loss.note("station-keeping", Err(error));
    }

    fn note(&mut self, moment: &StationMoment) {
        let is_seen = moment.followed.is_some() || (!self.follows && moment.neighbour_count > 0);
        self.summary.frame_count += 1;
        self.summary.seen_count += u64::from(is_seen);
        self.summary.withheld_count += u64::from(moment.withheld_mps > WITHHELD_MPS_MIN);
        let lights = moment.followed.map_or_else(
            || ",".to_owned(),
            |lights| format!("{:.3},{:.2}", lights.separation_px, lights.lateral_px),
        );
        let velocity = &moment.velocity;
        let line = format!(
            "{},{},{lights},{:.4},{:.4},{:.4},{:.4}",
            moment.captured_at,
            moment.neighbour_count,
            velocity.x,
            velocity.y,
            velocity.z,
            moment.withheld_mps
        );
        self.loss
            .note("the log of station-keeping", self.lines.append(&line));
    }
}

impl KeepingConfig {
    fn settings(&self) -> StationSettings {
        StationSettings {
            light_distance_m: self.light_distance_m,
            distance_m_min: self.distance_m_min,
            rule: match self.rule {
                KeepingRule::Follow => StationRule::Follow {
                    separation_px: self.separation_px,
                    lateral_px: self.lateral_px,
                    speed_mps_max: self.speed_mps_max,
                },
                KeepingRule::Gabriel => StationRule::Gabriel {
                    preferred_m: self.preferred_m,
                    speed_mps: self.speed_mps,
                },
            },
        }
    }
}
