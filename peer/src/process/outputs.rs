//! The files that a vehicle leaves behind.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;
use geometry::{Map, Timestamp};
use vslam::MapId;

use super::VehicleSummary;
use crate::files::{
    COVARIANCE_HEADER, PointCloud, StampedPose, format_covariance_line, format_tum_line,
    write_cloud, write_tum,
};
use crate::node::{FramePose, GlobalFramePose, Node, Status};
use crate::recorder::{Recorder, Stamp};

/// `{id}.tum` and `{id}.cov.csv` grow with each global frame; the rest is written at the end.
pub struct Outputs {
    folder: PathBuf,
    id: String,
    trajectory: BufWriter<File>,
    covariances: BufWriter<File>,
    recorder: Recorder,
    own: Vec<(MapId, StampedPose<Map>)>,
    newest: Timestamp,
    status: Option<Status>,
}

impl Outputs {
    pub fn create(folder: &Path, id: &str) -> anyhow::Result<Self> {
        let mut covariances = create(folder, &format!("{id}.cov.csv"))?;
        writeln!(covariances, "{COVARIANCE_HEADER}")?;
        Ok(Self {
            folder: folder.to_owned(),
            id: id.to_owned(),
            trajectory: create(folder, &format!("{id}.tum"))?,
            covariances,
            recorder: Recorder::create(&folder.join(format!("{id}.mcap")))?,
            own: Vec::new(),
            newest: Timestamp::default(),
            status: None,
        })
    }

    /// Writes a frame's pose as it was published, and the state if it changed.
    pub fn write(&mut self, pose: &FramePose, status: &Status) -> anyhow::Result<()> {
        self.newest = pose.captured_at;
        if self.status.as_ref() != Some(status) {
            self.status = Some(status.clone());
            let topic = format!("/{}/state", self.id);
            let text = (status.state.to_string(), status.reason.as_str());
            self.recorder
                .record_state(&topic, pose.captured_at, &text)?;
            self.recorder.flush()?;
        }
        if let Some(map_from_camera) = pose.map_from_camera {
            let own = StampedPose {
                captured_at: pose.captured_at,
                target_from_camera: map_from_camera,
            };
            self.own.push((pose.map_id, own));
        }
        let Some(global) = &pose.global else {
            return Ok(());
        };
        let GlobalFramePose {
            enu_from_camera,
            position_covariance: covariance,
            enu_from_body,
            body_covariance,
        } = global;
        let stamp = Stamp {
            frame_id: "map",
            captured_at: pose.captured_at,
        };
        let topic = format!("/{}/pose", self.id);
        self.recorder
            .record_pose(&topic, stamp, enu_from_body, Some(body_covariance))?;
        let line = format_tum_line(&StampedPose {
            captured_at: pose.captured_at,
            target_from_camera: *enu_from_camera,
        });
        writeln!(self.trajectory, "{line}")?;
        let line = format_covariance_line(pose.captured_at, covariance);
        writeln!(self.covariances, "{line}")?;
        // Whoever looks on, or finds the files after a crash, sees whole lines.
        self.trajectory.flush()?;
        self.covariances.flush()?;
        Ok(())
    }

    /// Writes the trajectory after all corrections, the map, and the summary.
    pub fn write_final(mut self, node: &Node, summary: &VehicleSummary) -> anyhow::Result<()> {
        write_tum(&self.path("final.tum"), node.corrected_trajectory())?;
        write_tum(&self.path("own.tum"), self.own_of_longest_map())?;
        let cloud = PointCloud::from_points(node.points_in_enu());
        let stamp = Stamp {
            frame_id: "map",
            captured_at: self.newest,
        };
        self.recorder
            .record_cloud(&format!("/{}/map", self.id), stamp, &cloud)?;
        write_cloud(&self.path("map.ply"), &cloud)?;
        let landmarks = node.landmarks_in_enu();
        if !landmarks.is_empty() {
            let cloud = PointCloud::from_points(landmarks);
            write_cloud(&self.path("received.ply"), &cloud)?;
        }
        let path = self.path("json");
        let text = serde_json::to_string_pretty(summary)?;
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
        self.recorder.finish()?;
        Ok(())
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

fn create(folder: &Path, name: &str) -> anyhow::Result<BufWriter<File>> {
    let path = folder.join(name);
    let file = File::create(&path).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(BufWriter::new(file))
}
