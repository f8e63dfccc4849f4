//! MCAP files as recordings: one topic with images, and the calibration published beside it.

mod cdr;
mod chunk;
mod message;
mod protobuf;
mod records;
mod topics;
mod zstd;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use camera::CameraInfo;
use geometry::Timestamp;

use super::decode::{ImageError, Raster};
use message::{HEAD_BYTES, MessageType, PublishedCamera};
pub use records::McapError;
use records::{McapReader, McapRecord};
pub use topics::TopicRefusal;

/// The images of one topic, listed but not read.
#[derive(Clone, Debug)]
pub struct McapRecording {
    path: PathBuf,
    /// The channels of the topic, and what is in them.
    channels: BTreeMap<u16, MessageType>,
    images: TopicImages,
    calibration: Option<TopicCalibration>,
    cut: Option<String>,
}

/// Which images a topic has.
#[derive(Clone, Debug, Default)]
struct TopicImages {
    message_count: usize,
    /// Numbers of messages among those of the topic, with stamps that increase.
    stamped: Vec<(usize, Timestamp)>,
    /// The first message has no stamp of its own, so all count as taken when they were logged.
    is_stamped_by_log: bool,
}

/// The calibration on a topic beside that of the images.
#[derive(Clone, Debug, PartialEq)]
pub struct TopicCalibration {
    pub topic: String,
    pub info: CameraInfo,
}

/// Why a file is refused.
#[derive(Debug, thiserror::Error)]
pub enum McapRefusal {
    #[error(transparent)]
    File(#[from] McapError),
    #[error(transparent)]
    Topic(#[from] TopicRefusal),
}

impl McapRecording {
    /// Reads through the whole file, past the images themselves.
    ///
    /// - `topic`: which images, if there are several kinds.
    pub fn open(path: &Path, topic: Option<&str>) -> Result<Self, McapRefusal> {
        let mut contents = Contents::default();
        let cut = contents.read(path)?;
        let (topic, cut) = match (contents.choose(topic), cut) {
            // What is missing may be all that matters.
            (Err(_), Some(cut)) if contents.images.is_empty() => return Err(cut.into()),
            (topic, cut) => (topic?, cut.map(|error| error.to_string())),
        };
        let calibration = contents.calibration_beside(&topic);
        let channels = contents.channels.iter();
        let channels = channels.filter(|(_, channel)| channel.topic == topic);
        Ok(Self {
            path: path.to_owned(),
            channels: channels
                .filter_map(|(id, channel)| Some((*id, channel.message_type?)))
                .collect(),
            images: contents.images.remove(&topic).unwrap_or_default(),
            calibration,
            cut,
        })
    }

    /// Numbers and stamps of the images, in order.
    pub fn stamped(&self) -> &[(usize, Timestamp)] {
        &self.images.stamped
    }

    pub fn calibration(&self) -> Option<&TopicCalibration> {
        self.calibration.as_ref()
    }

    /// Where and why the file ends too early.
    pub fn cut(&self) -> Option<&str> {
        self.cut.as_deref()
    }

    /// How many images have stamps that are not after the ones before.
    pub fn out_of_order_count(&self) -> usize {
        self.images.message_count - self.images.stamped.len()
    }

    pub fn images(&self) -> McapImages {
        McapImages {
            channels: self.channels.clone(),
            reader: McapReader::open(&self.path),
            next_idx: 0,
        }
    }
}

/// Reads images in the order of their numbers.
pub struct McapImages {
    channels: BTreeMap<u16, MessageType>,
    reader: Result<McapReader, McapError>,
    next_idx: usize,
}

impl McapImages {
    /// - `message_idx`: the number of the message among those of the topic; not before the last
    ///   one.
    pub fn read(&mut self, message_idx: usize) -> Result<Raster, ImageError> {
        let ended = |error: &dyn ToString| ImageError::Ended(error.to_string());
        let reader = self.reader.as_mut().map_err(|error| ended(error))?;
        loop {
            let is_wanted = self.next_idx == message_idx;
            let record =
                reader.next_record(|channel_id| match self.channels.contains_key(&channel_id) {
                    true if is_wanted => usize::MAX,
                    true => 1,
                    false => 0,
                });
            let record = record.ok_or(ImageError::Ended("end of file".to_owned()))?;
            if let McapRecord::Message {
                channel_id, bytes, ..
            } = record.map_err(|error| ended(&error))?
            {
                self.next_idx += 1;
                if is_wanted {
                    return self.channels[&channel_id].image(&bytes);
                }
            }
        }
    }
}

/// What a file has on its topics.
#[derive(Default)]
struct Contents {
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Channel>,
    images: BTreeMap<String, TopicImages>,
    cameras: BTreeMap<String, PublishedCamera>,
}

struct Channel {
    topic: String,
    schema: String,
    message_encoding: String,
    /// `None` if it has neither images nor calibrations that can be read.
    message_type: Option<MessageType>,
}

impl Contents {
    /// `Some` says why the file ends too early; what came before is kept.
    fn read(&mut self, path: &Path) -> Result<Option<McapError>, McapError> {
        let mut reader = McapReader::open_checking(path)?;
        loop {
            let channels = &self.channels;
            let record = reader.next_record(|channel_id| {
                let channel = channels.get(&channel_id);
                match channel.and_then(|channel| channel.message_type) {
                    Some(message_type) if message_type.is_image() => HEAD_BYTES,
                    Some(_) => usize::MAX,
                    None => 0,
                }
            });
            match record {
                None => return Ok(None),
                Some(Ok(record)) => self.add(record),
                Some(Err(error @ McapError::Chunk { .. })) if self.images.is_empty() => {
                    return Err(error);
                }
                Some(Err(error)) => return Ok(Some(error)),
            }
        }
    }

    fn add(&mut self, record: McapRecord) {
        match record {
            McapRecord::Schema { id, name } => {
                self.schemas.insert(id, name);
            }
            McapRecord::Channel {
                id,
                schema_id,
                topic,
                message_encoding,
            } => {
                let schema = self.schemas.get(&schema_id).cloned().unwrap_or_default();
                let message_type = MessageType::of(&schema, &message_encoding);
                let channel = Channel {
                    topic,
                    schema,
                    message_encoding,
                    message_type,
                };
                self.channels.insert(id, channel);
            }
            McapRecord::Message {
                channel_id,
                log_time_ns,
                bytes,
            } => self.add_message(channel_id, log_time_ns, &bytes),
        }
    }

    fn add_message(&mut self, channel_id: u16, log_time_ns: u64, bytes: &[u8]) {
        let Some(channel) = self.channels.get(&channel_id) else {
            return;
        };
        let Some(message_type) = channel.message_type else {
            return;
        };
        if message_type.is_image() {
            let images = self.images.entry(channel.topic.clone()).or_default();
            images.add(message_type.stamp_ns(bytes), log_time_ns);
        } else if !self.cameras.contains_key(&channel.topic)
            && let Some(camera) = message_type.camera(bytes)
        {
            self.cameras.insert(channel.topic.clone(), camera);
        }
    }
}

impl TopicImages {
    fn add(&mut self, stamp_ns: Option<i64>, log_time_ns: u64) {
        if self.message_count == 0 {
            self.is_stamped_by_log = stamp_ns.is_none();
        }
        let message_idx = self.message_count;
        self.message_count += 1;
        let stamp_ns = if self.is_stamped_by_log {
            i64::try_from(log_time_ns).ok()
        } else {
            stamp_ns
        };
        let Some(captured_at) = stamp_ns.map(Timestamp::from_nanoseconds) else {
            return;
        };
        let last = self.stamped.last();
        if last.is_none_or(|(_, before)| *before < captured_at) {
            self.stamped.push((message_idx, captured_at));
        }
    }
}

#[cfg(test)]
mod tests;
