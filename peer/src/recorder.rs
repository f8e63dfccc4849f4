//! Recordings of what a vehicle knew: MCAP files that ROS 2 tools and Foxglove open.
//!
//! `profile=ros2`, CDR and ros2msg schemas, one topic per kind of message and vehicle. A file that
//! was cut off loses at most what was recorded since the last [`Recorder::flush`].

mod cdr;
mod schema;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use geometry::{Timestamp, Transform};
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use nalgebra::{Matrix3, Matrix6};
use registration::Descriptors;
use serde::Serialize;

use crate::files::PointCloud;
use cdr::CdrWriter;
use schema::Schema;

/// An MCAP file that is being written.
pub struct Recorder {
    writer: Writer<BufWriter<File>>,
    path: PathBuf,
    channels: BTreeMap<String, Channel>,
}

struct Channel {
    id: u16,
    next_sequence: u32,
}

/// Why something was not recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    #[error("cannot create the recording: {error}: {path}")]
    Create {
        error: std::io::Error,
        path: PathBuf,
    },
    #[error("cannot record: {}: {path}", mcap_reason(error))]
    Write { error: McapError, path: PathBuf },
    #[error("cannot record on {topic}: {error}")]
    Json {
        error: serde_json::Error,
        topic: String,
    },
}

/// Where and when something was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp<'a> {
    /// The name of the frame in the sense of ROS, such as `map`.
    pub frame_id: &'a str,
    pub captured_at: Timestamp,
}

/// Messages are compressed and checked in blocks of this size.
const CHUNK_SIZE_BYTES: u64 = 1 << 20;

impl Recorder {
    pub fn create(path: &Path) -> Result<Self, RecorderError> {
        let path = path.to_owned();
        let file = match File::create(&path) {
            Ok(file) => BufWriter::new(file),
            Err(error) => return Err(RecorderError::Create { error, path }),
        };
        let options = WriteOptions::new()
            .compression(None)
            .profile("ros2")
            .library("starling")
            .chunk_size(Some(CHUNK_SIZE_BYTES));
        match options.create(file) {
            Ok(writer) => Ok(Self {
                writer,
                path,
                channels: BTreeMap::new(),
            }),
            Err(error) => Err(RecorderError::Write { error, path }),
        }
    }

    /// Records a pose as `geometry_msgs/PoseWithCovarianceStamped`.
    ///
    /// - `covariance`: over `[ω; ν]`, right perturbation; ROS wants `[x y z; rotation]` about the
    ///   axes of the frame, so it is turned. Without one the entries are zero, "unknown" in ROS.
    pub fn record_pose<Target, Source>(
        &mut self,
        topic: &str,
        stamp: Stamp<'_>,
        pose: &Transform<Target, Source>,
        covariance: Option<&Matrix6<f64>>,
    ) -> Result<(), RecorderError> {
        let mut body = CdrWriter::new();
        write_header(&mut body, stamp);
        for coordinate in pose.translation().iter() {
            body.write_f64(*coordinate);
        }
        let rotation = pose.rotation();
        for coordinate in [rotation.i, rotation.j, rotation.k, rotation.w] {
            body.write_f64(coordinate);
        }
        let covariance = covariance.map_or_else(Matrix6::zeros, |covariance| {
            position_first(&pose.rotation_matrix(), covariance)
        });
        // Row by row; a covariance is symmetric, so columns do as well.
        for entry in covariance.iter() {
            body.write_f64(*entry);
        }
        self.write(topic, &schema::POSE, stamp.captured_at, &body.finish())
    }

    /// Records a cloud as `sensor_msgs/PointCloud2`, with colours if it has them.
    pub fn record_cloud(
        &mut self,
        topic: &str,
        stamp: Stamp<'_>,
        cloud: &PointCloud,
    ) -> Result<(), RecorderError> {
        let body = encode_cloud(stamp, cloud);
        self.write(topic, &schema::CLOUD, stamp.captured_at, &body)
    }

    /// Records any state or report as JSON in a `std_msgs/String`.
    pub fn record_state(
        &mut self,
        topic: &str,
        captured_at: Timestamp,
        state: &impl Serialize,
    ) -> Result<(), RecorderError> {
        let text = serde_json::to_string(state).map_err(|error| RecorderError::Json {
            error,
            topic: topic.to_owned(),
        })?;
        let mut body = CdrWriter::new();
        body.write_text(&text);
        self.write(topic, &schema::TEXT, captured_at, &body.finish())
    }

    /// Makes everything recorded so far survive a crash of this process.
    pub fn flush(&mut self) -> Result<(), RecorderError> {
        self.writer
            .flush()
            .map_err(|error| write_error(error, &self.path))
    }

    /// Writes the index, without which tools have to search the whole file.
    pub fn finish(mut self) -> Result<(), RecorderError> {
        match self.writer.finish() {
            Ok(_summary) => Ok(()),
            Err(error) => Err(write_error(error, &self.path)),
        }
    }

    fn write(
        &mut self,
        topic: &str,
        schema: &Schema,
        captured_at: Timestamp,
        body: &[u8],
    ) -> Result<(), RecorderError> {
        if !self.channels.contains_key(topic) {
            let id = self
                .add_channel(topic, schema)
                .map_err(|error| write_error(error, &self.path))?;
            let channel = Channel {
                id,
                next_sequence: 0,
            };
            self.channels.insert(topic.to_owned(), channel);
        }
        let channel = self
            .channels
            .get_mut(topic)
            .expect("the channel was added above");
        // Clocks that start at zero have no time before it.
        let time = u64::try_from(captured_at.nanoseconds()).unwrap_or(0);
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.next_sequence,
            log_time: time,
            publish_time: time,
        };
        channel.next_sequence = channel.next_sequence.wrapping_add(1);
        self.writer
            .write_to_known_channel(&header, body)
            .map_err(|error| write_error(error, &self.path))
    }

    fn add_channel(&mut self, topic: &str, schema: &Schema) -> Result<u16, McapError> {
        let schema_id =
            self.writer
                .add_schema(schema.name, "ros2msg", schema.definition.as_bytes())?;
        let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), String::new())]);
        self.writer.add_channel(schema_id, topic, "cdr", &metadata)
    }
}

/// What failed, for a person: MCAP's words for an error of the disk do not say which.
pub fn mcap_reason(error: &McapError) -> String {
    match error {
        McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}

fn write_error(error: McapError, path: &Path) -> RecorderError {
    RecorderError::Write {
        error,
        path: path.to_owned(),
    }
}

/// `std_msgs/Header`.
fn write_header(body: &mut CdrWriter, stamp: Stamp<'_>) {
    let nanoseconds = stamp.captured_at.nanoseconds();
    let seconds = nanoseconds.div_euclid(1_000_000_000);
    body.write_i32(i32::try_from(seconds).unwrap_or(i32::MAX));
    body.write_u32(nanoseconds.rem_euclid(1_000_000_000) as u32);
    body.write_text(stamp.frame_id);
}

/// Turns a covariance over `[ω; ν]` in the moving frame into one over position and rotation in
/// the fixed frame.
fn position_first(rotation: &Matrix3<f64>, covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let mut turn = Matrix6::zeros();
    turn.fixed_view_mut::<3, 3>(0, 3).copy_from(rotation);
    turn.fixed_view_mut::<3, 3>(3, 0).copy_from(rotation);
    turn * covariance * turn.transpose()
}

const FLOAT32: u8 = 7;
const UINT32: u8 = 6;

fn encode_cloud(stamp: Stamp<'_>, cloud: &PointCloud) -> Vec<u8> {
    let has_descriptors = matches!(cloud.descriptors, Descriptors::Binary(_));
    let mut fields = vec![("x", FLOAT32, 1), ("y", FLOAT32, 1), ("z", FLOAT32, 1)];
    if cloud.colors.is_some() {
        fields.push(("rgb", FLOAT32, 1));
    }
    if has_descriptors {
        fields.push(("descriptor", UINT32, 8));
    }
    let mut body = CdrWriter::new();
    write_header(&mut body, stamp);
    let point_count = cloud.points.len() as u32;
    body.write_u32(1);
    body.write_u32(point_count);
    body.write_u32(fields.len() as u32);
    let mut point_size_bytes = 0;
    for (name, kind, count) in fields {
        body.write_text(name);
        body.write_u32(point_size_bytes);
        body.write_u8(kind);
        body.write_u32(count);
        point_size_bytes += 4 * count;
    }
    let is_big_endian = 0;
    body.write_u8(is_big_endian);
    body.write_u32(point_size_bytes);
    body.write_u32(point_size_bytes * point_count);
    let mut data = Vec::with_capacity((point_size_bytes * point_count) as usize);
    for (point_idx, point) in cloud.points.iter().enumerate() {
        for coordinate in point.iter() {
            data.extend_from_slice(&(*coordinate as f32).to_le_bytes());
        }
        if let Some(colors) = &cloud.colors {
            let [red, green, blue] = colors[point_idx];
            data.extend_from_slice(&[blue, green, red, 0]);
        }
        if let Descriptors::Binary(descriptors) = &cloud.descriptors {
            data.extend_from_slice(&descriptors[point_idx].to_bytes());
        }
    }
    body.write_bytes(&data);
    let is_dense = 1;
    body.write_u8(is_dense);
    body.finish()
}

#[cfg(test)]
mod tests;
