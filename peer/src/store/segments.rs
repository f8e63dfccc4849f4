//! Holdings that outlive the process: MCAP segments, appended and synced message by message.
//!
//! Each start begins a new segment, so that only the last one of an earlier run can be torn; what
//! is whole in it is read up to the tear.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{McapError, MessageStream, WriteOptions, Writer};
use protocol::keys::Key;
use protocol::{Chunk, Manifest, Placement, PlacementPage, decode, encode};

use crate::node::Kept;

/// A segment is closed at this size, so that old ones can be dropped whole.
const SEGMENT_SIZE_BYTES_MAX: u64 = 64 << 20;

/// Why holdings are not kept on disk.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    #[error("store: {error}: {path}")]
    File {
        error: std::io::Error,
        path: PathBuf,
    },
    #[error("store: {error}: {path}")]
    Mcap { error: McapError, path: PathBuf },
}

/// A message that was kept in an earlier run, under the key that it was published with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reloaded {
    pub key: Key,
    pub payload: Vec<u8>,
}

/// The open segment of a folder.
pub struct Segments {
    folder: PathBuf,
    next_number: u32,
    open: Option<Segment>,
}

struct Segment {
    writer: Writer<BufWriter<File>>,
    file: File,
    path: PathBuf,
    channels: BTreeMap<&'static str, u16>,
    sequence: u32,
    size_bytes: u64,
}

impl Segments {
    /// Opens a folder, created if need be, and reads what it holds in the order of writing.
    pub fn open(folder: &Path) -> Result<(Self, Vec<Reloaded>), StoreError> {
        let failed = |error| StoreError::File {
            error,
            path: folder.to_owned(),
        };
        std::fs::create_dir_all(folder).map_err(failed)?;
        let mut numbers: Vec<u32> = std::fs::read_dir(folder)
            .map_err(failed)?
            .filter_map(|entry| segment_number(&entry.ok()?.path()))
            .collect();
        numbers.sort_unstable();
        let mut reloaded = Vec::new();
        for number in &numbers {
            read_segment(&segment_path(folder, *number), &mut reloaded)?;
        }
        let segments = Self {
            folder: folder.to_owned(),
            next_number: numbers.last().map_or(0, |last| last + 1),
            open: None,
        };
        Ok((segments, reloaded))
    }

    /// Writes and syncs one message; beacons are not kept.
    pub fn append(&mut self, kept: &Kept) -> Result<(), StoreError> {
        let (topic, payload) = match kept {
            Kept::Chunk(_, payload) => ("chunk", payload.to_vec()),
            Kept::Manifest(manifest) => ("manifest", encode(manifest)),
            Kept::Placement(placement) => ("placement", encode(placement.as_ref())),
            Kept::Page(page) => ("placement_page", encode(page)),
            Kept::Beacon(_) => return Ok(()),
        };
        if let Some(full) = self
            .open
            .take_if(|open| open.size_bytes >= SEGMENT_SIZE_BYTES_MAX)
        {
            full.close()?;
        }
        if self.open.is_none() {
            self.open = Some(Segment::create(segment_path(
                &self.folder,
                self.next_number,
            ))?);
            self.next_number += 1;
        }
        match &mut self.open {
            Some(open) => open.append(topic, &payload),
            None => Ok(()),
        }
    }

    /// Closes the open segment, so that tools find its index.
    pub fn close(&mut self) -> Result<(), StoreError> {
        self.open.take().map_or(Ok(()), Segment::close)
    }
}

impl Segment {
    fn create(path: PathBuf) -> Result<Self, StoreError> {
        let open = || -> std::io::Result<(File, File)> {
            let file = File::create_new(&path)?;
            Ok((file.try_clone()?, file))
        };
        let (file, written) = open().map_err(|error| StoreError::File {
            error,
            path: path.clone(),
        })?;
        // Without blocks every message is on its own, and a tear costs the last one only.
        let options = WriteOptions::new()
            .compression(None)
            .use_chunks(false)
            .library("starling");
        match options.create(BufWriter::new(written)) {
            Ok(writer) => Ok(Self {
                writer,
                file,
                path,
                channels: BTreeMap::new(),
                sequence: 0,
                size_bytes: 0,
            }),
            Err(error) => Err(StoreError::Mcap { error, path }),
        }
    }

    fn append(&mut self, topic: &'static str, payload: &[u8]) -> Result<(), StoreError> {
        self.write(topic, payload)
            .map_err(|error| StoreError::Mcap {
                error,
                path: self.path.clone(),
            })?;
        self.file.sync_data().map_err(|error| StoreError::File {
            error,
            path: self.path.clone(),
        })
    }

    fn write(&mut self, topic: &'static str, payload: &[u8]) -> Result<(), McapError> {
        let channel_id = match self.channels.get(topic) {
            Some(id) => *id,
            None => {
                let id = self
                    .writer
                    .add_channel(0, topic, "cbor", &BTreeMap::new())?;
                self.channels.insert(topic, id);
                id
            }
        };
        let header = MessageHeader {
            channel_id,
            sequence: self.sequence,
            log_time: 0,
            publish_time: 0,
        };
        self.sequence = self.sequence.wrapping_add(1);
        self.size_bytes += payload.len() as u64;
        self.writer.write_to_known_channel(&header, payload)?;
        self.writer.flush()
    }

    fn close(mut self) -> Result<(), StoreError> {
        match self.writer.finish() {
            Ok(_summary) => Ok(()),
            Err(error) => Err(StoreError::Mcap {
                error,
                path: self.path,
            }),
        }
    }
}

/// Reads up to the end or the tear; messages that are none any more are left out.
fn read_segment(path: &Path, reloaded: &mut Vec<Reloaded>) -> Result<(), StoreError> {
    let bytes = std::fs::read(path).map_err(|error| StoreError::File {
        error,
        path: path.to_owned(),
    })?;
    let Ok(messages) = MessageStream::new(&bytes) else {
        tracing::warn!(path = %path.display(), "a segment of the store has no beginning");
        return Ok(());
    };
    for message in messages {
        match message {
            Ok(message) => match key(&message.channel.topic, &message.data) {
                Some(key) => reloaded.push(Reloaded {
                    key,
                    payload: message.data.to_vec(),
                }),
                None => tracing::warn!(path = %path.display(), "a stored message is none"),
            },
            Err(error) => {
                tracing::warn!(path = %path.display(), %error, "a segment of the store is torn");
                return Ok(());
            }
        }
    }
    Ok(())
}

fn key(topic: &str, payload: &[u8]) -> Option<Key> {
    Some(match topic {
        "chunk" => Key::Chunk(decode::<Chunk>(payload).ok()?.id().clone()),
        "manifest" => Key::Manifest(decode::<Manifest>(payload).ok()?.map.anchor),
        "placement" => Key::Placement(decode::<Placement>(payload).ok()?.map),
        "placement_page" => {
            let page: PlacementPage = decode(payload).ok()?;
            Key::PlacementPage(page.map().clone(), page.page())
        }
        _ => return None,
    })
}

fn segment_path(folder: &Path, number: u32) -> PathBuf {
    folder.join(format!("{number:06}.mcap"))
}

fn segment_number(path: &Path) -> Option<u32> {
    (path.extension()? == "mcap").then_some(())?;
    path.file_stem()?.to_str()?.parse().ok()
}
