//! `vehicle.toml`: what one vehicle needs to know.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

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
    /// A recording, `FOLDER` or `FOLDER@A..B`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dataset: Option<String>,
    /// `HOST:PORT` of a stream driver.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stream: Option<String>,
    /// A file with the fields of EuRoC's `sensor.yaml`. Recordings bring their own; a stream
    /// needs one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
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
    /// Noise added to each fix, for rehearsals; drawn from `noise_seed` and the fix's stamp.
    pub noise_m: f64,
    pub noise_seed: u64,
    /// From the body's origin to the antenna, forward, left, up.
    pub lever_arm_m: [f64; 3],
}

/// The session's place in the network.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct ZenohConfig {
    pub mode: ZenohMode,
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
    /// Without an accepted alignment or fix for this long, the pose is stale. 2 to 60.
    pub stale_after_s: f64,
    /// Largest position sigma of a global pose; by default the larger of 0.5 m and twice the
    /// best anchor's stated fix sigma.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub global_sigma_m: Option<f64>,
    /// Threads for the vehicle's algorithms; with one, results are deterministic.
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
        let mut config: Self = toml::from_str(&text).map_err(|error| refused(error.to_string()))?;
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
        match (&self.camera.dataset, &self.camera.stream) {
            (Some(_), Some(_)) | (None, None) => {
                return Err("[camera] needs exactly one of dataset and stream".to_owned());
            }
            (None, Some(_)) if self.camera.calibration.is_none() => {
                return Err("[camera] stream needs a calibration".to_owned());
            }
            _ => {}
        }
        if let Some(position) = &self.position {
            position.check()?;
            if position.stream && self.camera.stream.is_none() {
                return Err("[position] stream needs a [camera] stream".to_owned());
            }
        }
        positive("[estimation] stale_after_s", self.estimation.stale_after_s)?;
        if let Some(sigma_m) = self.estimation.global_sigma_m {
            positive("[estimation] global_sigma_m", sigma_m)?;
        }
        Ok(())
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

impl PositionConfig {
    fn check(&self) -> Result<(), String> {
        if self.file.is_some() == self.stream {
            return Err("[position] needs exactly one of file and stream".to_owned());
        }
        positive("[position] sigma_m", self.sigma_m)?;
        if !(self.noise_m >= 0.0 && self.noise_m.is_finite()) {
            return Err(format!(
                "[position] noise_m is {}, expected at least 0",
                self.noise_m
            ));
        }
        Ok(())
    }
}

fn positive(name: &str, value: f64) -> Result<(), String> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(format!("{name} is {value}, expected a positive number"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_example_in_deploy_loads() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy");
        let mut example_count = 0;
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path
                .extension()
                .is_some_and(|extension| extension == "toml")
            {
                VehicleConfig::load(&path).unwrap();
                example_count += 1;
            }
        }
        assert!(example_count >= 2);
    }

    #[test]
    fn refuses_what_makes_no_sense_and_names_it() {
        let check = |text: &str, expected: &str| {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("vehicle.toml");
            std::fs::write(&path, text).unwrap();
            let error = VehicleConfig::load(&path).unwrap_err().to_string();
            assert!(error.contains(expected), "{error:?} lacks {expected:?}");
        };
        check(
            "id = 'a'\nout = 'o'\n[camera]\n",
            "exactly one of dataset and stream",
        );
        check(
            "id = 'a/b'\nout = 'o'\n[camera]\ndataset = 'd'\n",
            "letters",
        );
        check(
            "id = 'a'\nout = 'o'\n[camera]\nstream = '127.0.0.1:1'\n",
            "needs a calibration",
        );
        check(
            "id = 'a'\nout = 'o'\n[camera]\ndataset = 'd'\ncolour = 1\n",
            "unknown field",
        );
        check(
            "id = 'a'\nout = 'o'\n[camera]\ndataset = 'd'\n[position]\n",
            "exactly one of file and stream",
        );
        check(
            "id = 'a'\nout = 'o'\n[camera]\ndataset = 'd'\n[position]\nfile = 'f'\nsigma_m = nan",
            "sigma_m is NaN",
        );
    }
}
