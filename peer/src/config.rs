//! `vehicle.toml`: what one vehicle needs to know.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use geodesy::Datum;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::dataset::DatasetArgument;

/// A position that is worse than this says nothing.
pub const SIGMA_MAX_M: f64 = 1e3;
const STALE_AFTER_MAX_S: f64 = 1e3;
/// No vehicle carries its antenna farther from its camera.
const LEVER_ARM_MAX_M: f64 = 100.0;

/// One vehicle's configuration. The role follows from it: with a position source the vehicle is
/// an anchor, without one a peer.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleConfig {
    /// The vehicle's name in keys: 1 to 32 letters, digits, `-` or `_`; unique in the team.
    pub id: String,
    pub camera: CameraConfig,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position: Option<PositionConfig>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keeping: Option<KeepingConfig>,
    #[serde(default)]
    pub zenoh: ZenohConfig,
    #[serde(default)]
    pub estimation: EstimationConfig,
    /// Folder for trajectories, the map and the recording.
    pub out: PathBuf,
    /// Folder in which received and own chunks outlive the process; without it they are kept in
    /// memory only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub store: Option<PathBuf>,
}

/// Where images come from: exactly one of `dataset` and `stream`.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// A recording, `PATH` or `PATH@A..B`: a folder in TUM RGB-D, EuRoC or KITTI layout, an MCAP
    /// file, or a video.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dataset: Option<String>,
    /// `HOST:PORT` of a stream driver.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stream: Option<String>,
    /// A calibration by EuRoC, Kalibr, ROS or OpenCV. A stream needs one; for a recording it
    /// stands in for the one that lies beside the images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
    /// The images of an MCAP file, where it has several kinds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
}

/// Where position fixes come from: exactly one of `file` and `stream`.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct PositionConfig {
    /// A TUM trajectory in the site frame, of which only the positions are read, or a CSV
    /// `timestamp,latitude_deg,longitude_deg,altitude_m[,sigma_m]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// Fixes arrive with the camera's stream.
    pub stream: bool,
    /// The name of the site frame, where positions are not geodetic.
    pub site: String,
    /// One sigma of each axis where the source states none. 0.01 to 10; too small lets single
    /// bad fixes bend the map, too large delays the first alignment.
    pub sigma_m: f64,
    /// Noise added to each fix, for rehearsals; drawn from `noise_seed` and the fix's stamp. 0 to
    /// 1000.
    pub noise_m: f64,
    pub noise_seed: u64,
    /// From the body's origin to the antenna, forward, left, up; at most 100 m long.
    pub lever_arm_m: [f64; 3],
}

/// Holds a place among other vehicles by the two lights that each carries, one above the other.
/// Velocities go to the autopilot, which holds the heading, through the camera's stream driver.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeepingConfig {
    pub rule: KeepingRule,
    /// Between the lights. 0.02 to 2.
    pub light_distance_m: f64,
    /// `follow`: how far apart the lights shall be in the picture. Focal length times their
    /// distance over this is how far behind the place is. 3 to 50: less is far away and noisy.
    pub separation_px: f64,
    /// `follow`: where between left and right of the picture they shall be; on the optical axis if
    /// not set.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lateral_px: Option<f64>,
    /// Centres of vehicles stay this far apart, whatever is commanded. 0.2 to 20.
    pub distance_m_min: f64,
    /// `follow`: of what is commanded, in each direction. 0.05 to 10: faster follows a faster
    /// vehicle, and errs farther when the lights are lost.
    pub speed_mps_max: f64,
    /// `gabriel`: between neighbours. 0.5 to 50.
    pub preferred_m: f64,
    /// `gabriel`: the speed common to the swarm, along the heading. 0 to 10.
    pub speed_mps: f64,
    /// Velocities are sent at least so often, also between images. 2 to 200.
    pub rate_hz: f64,
}

/// Which place a vehicle holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum KeepingRule {
    /// Behind one other vehicle, as in the paper's flight test.
    #[default]
    Follow,
    /// Among all that it sees, by the first shell; with one camera it moves only where that looks.
    Gabriel,
}

/// The session's place in the network.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct ZenohConfig {
    pub mode: ZenohMode,
    /// Where others connect to; at least one.
    pub listen: Vec<String>,
    /// Links that are opened, and opened again whenever they break.
    pub connect: Vec<String>,
    /// Find neighbours by multicast and gossip. Such links come back late after an outage, and
    /// with it off nobody finds a way around a link that a rehearsal cuts.
    pub scouting: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ZenohMode {
    /// Hears its direct neighbours; chunks spread hop by hop.
    #[default]
    Peer,
    /// Relays live traffic too.
    Router,
}

/// When a pose counts as global.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct EstimationConfig {
    /// Without an accepted alignment or fix for this long, the pose is stale. 2 to 60: less makes
    /// it stale between two fixes, more calls a drifted pose global.
    pub stale_after_s: f64,
    /// Largest position sigma of a global pose; by default the larger of 0.5 m and twice the
    /// best anchor's stated fix sigma.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub global_sigma_m: Option<f64>,
    /// Threads for decoding and estimation, at least 1. With more, the next images of a recording
    /// are decoded meanwhile, and the results are the same. Link, store, drivers and the
    /// adjustment of the whole map after a loop have threads of their own.
    pub threads: usize,
    /// Seeds the algorithms and the name of the epoch; without it the epoch's name is random.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
}

impl Default for PositionConfig {
    fn default() -> Self {
        Self {
            file: None,
            stream: false,
            site: "site".to_owned(),
            sigma_m: 0.01,
            noise_m: 0.0,
            noise_seed: 0,
            lever_arm_m: [0.0; 3],
        }
    }
}

impl Default for KeepingConfig {
    /// The paper's flight test.
    fn default() -> Self {
        Self {
            rule: KeepingRule::Follow,
            light_distance_m: 0.1,
            separation_px: 10.0,
            lateral_px: None,
            distance_m_min: 0.8,
            speed_mps_max: 0.5,
            preferred_m: 3.0,
            speed_mps: 0.0,
            rate_hz: 20.0,
        }
    }
}

impl Default for ZenohConfig {
    fn default() -> Self {
        Self {
            mode: ZenohMode::Peer,
            listen: vec!["tcp/0.0.0.0:7447".to_owned()],
            connect: Vec::new(),
            scouting: false,
        }
    }
}

impl Default for EstimationConfig {
    fn default() -> Self {
        Self {
            stale_after_s: 10.0,
            global_sigma_m: None,
            threads: 1,
            seed: None,
        }
    }
}

/// Why a configuration is refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error("cannot read the configuration: {error}: {path}")]
    Unreadable {
        error: std::io::Error,
        path: PathBuf,
    },
    #[error("{reason}: {path}")]
    Refused { reason: String, path: PathBuf },
}

impl VehicleConfig {
    /// Reads and checks a file; relative paths in it are relative to its folder.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path).map_err(|error| ConfigError::Unreadable {
            error,
            path: path.to_owned(),
        })?;
        let refused = |reason: String| ConfigError::Refused {
            reason,
            path: path.to_owned(),
        };
        let mut config: Self = toml::from_str(&text)
            .map_err(|error| refused(error.to_string().trim_end().to_owned()))?;
        config.check().map_err(refused)?;
        config.resolve(path.parent().unwrap_or(Path::new("")));
        Ok(config)
    }

    fn check(&self) -> Result<(), String> {
        let legal = |letter: char| letter.is_ascii_alphanumeric() || "-_".contains(letter);
        if self.id.is_empty() || self.id.len() > 32 || !self.id.chars().all(legal) {
            return Err(format!(
                "id is {:?}, expected 1 to 32 letters, digits, - or _",
                self.id
            ));
        }
        self.camera.check()?;
        if let Some(position) = &self.position {
            position.check()?;
            if position.stream && self.camera.stream.is_none() {
                return Err("[position] stream needs a [camera] stream".to_owned());
            }
            if position.file.is_some() && self.camera.dataset.is_none() {
                return Err("[position] file needs a [camera] dataset".to_owned());
            }
        }
        if let Some(keeping) = &self.keeping {
            keeping.check()?;
            if self.camera.stream.is_none() {
                return Err(
                    "[keeping] needs a [camera] stream, whose driver takes its velocities"
                        .to_owned(),
                );
            }
        }
        if self.zenoh.listen.is_empty() {
            return Err(
                "[zenoh] listen is [], expected an endpoint such as \"tcp/0.0.0.0:7447\""
                    .to_owned(),
            );
        }
        self.estimation.check()
    }

    fn resolve(&mut self, folder: &Path) {
        self.out = folder.join(&self.out);
        self.store = self.store.as_ref().map(|path| folder.join(path));
        let camera = &mut self.camera;
        camera.calibration = camera.calibration.as_ref().map(|path| folder.join(path));
        camera.dataset = camera
            .dataset
            .as_ref()
            .map(|dataset| folder.join(dataset).to_string_lossy().into_owned());
        if let Some(position) = &mut self.position {
            position.file = position.file.as_ref().map(|path| folder.join(path));
        }
    }
}

impl CameraConfig {
    fn check(&self) -> Result<(), String> {
        match (&self.dataset, &self.stream) {
            (Some(_), Some(_)) | (None, None) => {
                Err("[camera] needs exactly one of dataset and stream".to_owned())
            }
            (Some(dataset), None) => match dataset.parse::<DatasetArgument>() {
                Ok(argument) if argument.path.as_os_str().is_empty() => Err(format!(
                    "[camera] dataset is {dataset:?}, expected a file or folder"
                )),
                Ok(_) => Ok(()),
                Err(error) => Err(format!("[camera] dataset: {error}")),
            },
            (None, Some(stream)) => {
                let port = stream.rsplit_once(':').map(|(_, port)| port.parse::<u16>());
                if !matches!(port, Some(Ok(_))) {
                    return Err(format!("[camera] stream is {stream:?}, expected HOST:PORT"));
                }
                if self.topic.is_some() {
                    return Err("[camera] topic needs a dataset".to_owned());
                }
                match self.calibration {
                    Some(_) => Ok(()),
                    None => Err("[camera] stream needs a calibration".to_owned()),
                }
            }
        }
    }
}

impl PositionConfig {
    fn check(&self) -> Result<(), String> {
        if self.file.is_some() == self.stream {
            return Err("[position] needs exactly one of file and stream".to_owned());
        }
        Datum::site(&self.site).map_err(|error| format!("[position] site: {error}"))?;
        check_positive("[position] sigma_m", self.sigma_m, SIGMA_MAX_M)?;
        if !(0.0..=SIGMA_MAX_M).contains(&self.noise_m) {
            return Err(format!(
                "[position] noise_m is {}, expected 0 to {SIGMA_MAX_M}",
                self.noise_m
            ));
        }
        // NaN is not at most anything.
        let length_m = Vector3::from(self.lever_arm_m).norm();
        if !(0.0..=LEVER_ARM_MAX_M).contains(&length_m) {
            return Err(format!(
                "[position] lever_arm_m is {:?}, expected three numbers and at most \
                 {LEVER_ARM_MAX_M} m from the body's origin",
                self.lever_arm_m
            ));
        }
        Ok(())
    }
}

impl KeepingConfig {
    fn check(&self) -> Result<(), String> {
        check_within("light_distance_m", self.light_distance_m, 0.02..=2.0)?;
        check_within("separation_px", self.separation_px, 3.0..=50.0)?;
        if let Some(lateral_px) = self.lateral_px {
            check_within("lateral_px", lateral_px, 0.0..=1e4)?;
        }
        check_within("distance_m_min", self.distance_m_min, 0.2..=20.0)?;
        check_within("speed_mps_max", self.speed_mps_max, 0.05..=10.0)?;
        check_within("preferred_m", self.preferred_m, 0.5..=50.0)?;
        check_within("speed_mps", self.speed_mps, 0.0..=10.0)?;
        check_within("rate_hz", self.rate_hz, 2.0..=200.0)
    }
}

/// Of a number of `[keeping]`.
fn check_within(name: &str, value: f64, range: RangeInclusive<f64>) -> Result<(), String> {
    if range.contains(&value) {
        return Ok(());
    }
    let (low, high) = (range.start(), range.end());
    Err(format!(
        "[keeping] {name} is {value}, expected {low} to {high}"
    ))
}

impl EstimationConfig {
    fn check(&self) -> Result<(), String> {
        let stale_after_s = self.stale_after_s;
        check_positive(
            "[estimation] stale_after_s",
            stale_after_s,
            STALE_AFTER_MAX_S,
        )?;
        if let Some(sigma_m) = self.global_sigma_m {
            check_positive("[estimation] global_sigma_m", sigma_m, SIGMA_MAX_M)?;
        }
        if self.threads == 0 {
            return Err("[estimation] threads is 0, expected at least 1".to_owned());
        }
        Ok(())
    }
}

fn check_positive(name: &str, value: f64, max: f64) -> Result<(), String> {
    if value > 0.0 && value <= max {
        return Ok(());
    }
    Err(format!(
        "{name} is {value}, expected more than 0 and at most {max}"
    ))
}

#[cfg(test)]
mod tests;
