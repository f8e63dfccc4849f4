//! The files that a vehicle leaves behind.
//!
//! A disk that is full or gone costs files, never the flight: what cannot be written is counted,
//! named once, and the summary says that something is lost.

mod lines;

use std::path::{Path, PathBuf};

use anyhow::Context;
use geometry::{Map, Timestamp};
use vslam::MapId;

use super::VehicleSummary;
use super::loss::Loss;
use crate::files::{
    COVARIANCE_HEADER, PointCloud, StampedPose, format_covariance_line, format_tum_line,
    write_cloud, write_tum,
};
use crate::node::{FramePose, GlobalFramePose, Node, Status};
use crate::recorder::{Recorder, RecorderError, Stamp};
pub use lines::Lines;

/// `{id}.tum` and `{id}.cov.csv` grow with each global frame; the rest is written at the end.
pub struct Outputs {
    folder: PathBuf,
    id: String,
    trajectory: Lines,
    covariances: Lines,
    /// Until something could not be recorded.
    recorder: Option<Recorder>,
    own: Vec<(MapId, StampedPose<Map>)>,
    newest: Timestamp,
    status: Option<Status>,
}

impl Outputs {
    pub fn create(folder: &Path, id: &str) -> anyhow::Result<Self> {
        let path = |suffix: &str| folder.join(format!("{id}.{suffix}"));
        let mut covariances = Lines::create(&path("cov.csv"))?;
        covariances.append(COVARIANCE_HEADER)?;
        Ok(Self {
            folder: folder.to_owned(),
            id: id.to_owned(),
            trajectory: Lines::create(&path("tum"))?,
            covariances,
            recorder: Some(Recorder::create(&path("mcap"))?),
            own: Vec::new(),
            newest: Timestamp::default(),
            status: None,
        })
    }

    /// Writes a frame's pose as it was published, and the state if it changed.
    pub fn write(&mut self, pose: &FramePose, status: &Status, loss: &mut Loss) {
        self.newest = pose.captured_at;
        if self.status.as_ref() != Some(status) {
            self.status = Some(status.clone());
            let topic = format!("/{}/state", self.id);
            let text = (status.state.to_string(), status.reason.as_str());
            self.record(loss, |recorder| {
                recorder.record_state(&topic, pose.captured_at, &text)?;
                recorder.flush()
            });
        }
        if let Some(map_from_camera) = pose.map_from_camera {
            let own = StampedPose {
                captured_at: pose.captured_at,
                target_from_camera: map_from_camera,
            };
            self.own.push((pose.map_id, own));
        }
        if let Some(global) = &pose.global {
            self.write_global(pose.captured_at, global, loss);
        }
    }

    fn write_global(&mut self, captured_at: Timestamp, global: &GlobalFramePose, loss: &mut Loss) {
        let stamp = Stamp {
            frame_id: "map",
            captured_at,
        };
        let topic = format!("/{}/pose", self.id);
        let (pose, covariance) = (&global.enu_from_body, &global.body_covariance);
        self.record(loss, |recorder| {
            recorder.record_pose(&topic, stamp, pose, Some(covariance))
        });
        let line = format_tum_line(&StampedPose {
            captured_at,
            target_from_camera: global.enu_from_camera,
        });
        loss.note("the trajectory", self.trajectory.append(&line));
        let line = format_covariance_line(captured_at, &global.position_covariance);
        loss.note("the covariances", self.covariances.append(&line));
    }

    /// A recording that could not be written is whole up to there and ends there.
    fn record(
        &mut self,
        loss: &mut Loss,
        write: impl FnOnce(&mut Recorder) -> Result<(), RecorderError>,
    ) {
        match self.recorder.as_mut().map(write) {
            Some(Ok(())) => {}
            Some(Err(error)) => {
                self.recorder = None;
                loss.note("the recording", Err(error));
            }
            None => loss.count(),
        }
    }

    /// Writes the trajectory after all corrections, the map, and the summary.
    pub fn write_final(mut self, node: &Node, summary: &mut VehicleSummary, loss: &mut Loss) {
        loss.note("the folder", self.check_folder());
        let corrected = write_tum(&self.path("final.tum"), node.corrected_trajectory());
        loss.note("the corrected trajectory", corrected);
        let own = write_tum(&self.path("own.tum"), self.own_of_longest_map());
        loss.note("the own trajectory", own);
        let cloud = PointCloud::from_points(node.points_in_enu());
        let stamp = Stamp {
            frame_id: "map",
            captured_at: self.newest,
        };
        let topic = format!("/{}/map", self.id);
        self.record(loss, |recorder| {
            recorder.record_cloud(&topic, stamp, &cloud)
        });
        loss.note("the map", write_cloud(&self.path("map.ply"), &cloud));
        let landmarks = node.landmarks_in_enu();
        if !landmarks.is_empty() {
            let cloud = PointCloud::from_points(landmarks);
            let written = write_cloud(&self.path("received.ply"), &cloud);
            loss.note("the received map", written);
        }
        if let Some(recorder) = self.recorder.take() {
            loss.note("the recording", recorder.finish());
        }
        let tell = |summary: &mut VehicleSummary, loss: &Loss| {
            summary.unwritten_count = loss.total();
            summary.write_error = loss.first().map(str::to_owned);
        };
        tell(summary, loss);
        loss.note("the summary", self.write_summary(summary));
        tell(summary, loss);
    }

    /// What grew in a folder that has been removed is gone, though every write went well.
    fn check_folder(&self) -> anyhow::Result<()> {
        if self.path("tum").exists() {
            return Ok(());
        }
        // So that at least what follows is kept.
        std::fs::create_dir_all(&self.folder)?;
        anyhow::bail!(
            "it was removed in flight, with what had been written: {}",
            self.folder.display()
        )
    }

    fn write_summary(&self, summary: &VehicleSummary) -> anyhow::Result<()> {
        let path = self.path("json");
        let text = serde_json::to_string_pretty(summary)?;
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    }

    /// The vehicle's poses as they were published in its own map; poses of different maps share
    /// no frame, so those of the map with the most of them.
    fn own_of_longest_map(&self) -> Vec<StampedPose<Map>> {
        let count = |map: MapId| self.own.iter().filter(|(id, _)| *id == map).count();
        let mut maps: Vec<MapId> = self.own.iter().map(|(map, _)| *map).collect();
        maps.dedup();
        let longest = maps.into_iter().max_by_key(|map| count(*map));
        let own = self.own.iter();
        own.filter(|(map, _)| Some(*map) == longest)
            .map(|(_, pose)| *pose)
            .collect()
    }

    fn path(&self, suffix: &str) -> PathBuf {
        self.folder.join(format!("{}.{suffix}", self.id))
    }
}
