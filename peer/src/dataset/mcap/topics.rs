//! Which topic is meant, and which calibration belongs to it.

use super::{Channel, Contents, TopicCalibration};

/// Why no topic is chosen.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum TopicRefusal {
    #[error(
        "no topic with images; expected sensor_msgs/msg/CompressedImage or Image, or \
         foxglove.CompressedImage or RawImage, got {topics}"
    )]
    None { topics: String },
    #[error("images on several topics, choose one with --topic: {topics}")]
    Several { topics: String },
    #[error("no images on topic {topic:?}; the topics are {topics}")]
    Unknown { topic: String, topics: String },
}

impl Contents {
    pub(super) fn choose(&self, topic: Option<&str>) -> Result<String, TopicRefusal> {
        let with_images: Vec<&String> = self.images.keys().collect();
        if let Some(topic) = topic {
            let is_this =
                |name: &&&String| name.as_str() == topic || name.strip_prefix('/') == Some(topic);
            return match with_images.iter().find(is_this) {
                Some(name) => Ok(name.to_string()),
                None => Err(TopicRefusal::Unknown {
                    topic: topic.to_owned(),
                    topics: self.describe(|_| true),
                }),
            };
        }
        match with_images.as_slice() {
            [] => Err(TopicRefusal::None {
                topics: self.describe(|_| true),
            }),
            [only] => Ok(only.to_string()),
            _ => Err(TopicRefusal::Several {
                topics: self.describe(|channel| self.images.contains_key(&channel.topic)),
            }),
        }
    }

    /// The calibration on `camera_info` in the topic's own namespace or the nearest above it; else
    /// the only one there is, if there is only one kind of images too.
    ///
    /// On topics of rectified images it is the camera that remains after rectification.
    pub(super) fn calibration_beside(&self, topic: &str) -> Option<TopicCalibration> {
        let mut namespace = topic;
        let beside = loop {
            let name = format!("{namespace}/camera_info");
            if let Some(found) = self.cameras.get_key_value(&name) {
                break Some(found);
            }
            match namespace.rsplit_once('/') {
                Some((parent, _)) => namespace = parent,
                None => break None,
            }
        };
        let only = || {
            let is_clear = self.cameras.len() == 1 && self.images.len() == 1;
            self.cameras.first_key_value().filter(|_| is_clear)
        };
        let (name, camera) = beside.or_else(only)?;
        let is_rectified = topic.split('/').any(|part| part.contains("rect"));
        let info = if is_rectified {
            camera.rectified()
        } else {
            camera.info.clone()
        };
        Some(TopicCalibration {
            topic: name.clone(),
            info,
        })
    }

    fn describe(&self, is_meant: impl Fn(&Channel) -> bool) -> String {
        let channels = self.channels.values().filter(|channel| is_meant(channel));
        let mut topics: Vec<String> = channels
            .map(|channel| {
                let Channel {
                    topic,
                    schema,
                    message_encoding,
                    ..
                } = channel;
                format!("{topic} ({schema}, {message_encoding})")
            })
            .collect();
        topics.sort();
        topics.dedup();
        if topics.is_empty() {
            return "none".to_owned();
        }
        topics.join(", ")
    }
}
