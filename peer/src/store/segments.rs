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

use super::Kept;
use crate::recorder::mcap_reason;

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
    #[error("store: {}: {path}", mcap_reason(error))]
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
    /// Up to here the file is written, synced and whole.
    whole_bytes: u64,
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

    /// Writes and syncs one message; beacons are not kept. After an error everything before it
    /// can still be read, and the next message begins a new segment.
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
            // It may have been removed; then what follows is kept at least.
            std::fs::create_dir_all(&self.folder).map_err(|error| StoreError::File {
                error,
                path: self.folder.clone(),
            })?;
            self.open = Some(Segment::create(segment_path(
                &self.folder,
                self.next_number,
            ))?);
            self.next_number += 1;
        }
        let Some(open) = &mut self.open else {
            return Ok(());
        };
        let appended = open.append(topic, &payload);
        if appended.is_err()
            && let Some(broken) = self.open.take()
            && broken.abandon()
        {
            self.next_number -= 1;
        }
        appended
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
                whole_bytes: 0,
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
        let synced = self.file.sync_data().and_then(|()| self.file.metadata());
        match synced {
            Ok(metadata) => {
                self.whole_bytes = metadata.len();
                Ok(())
            }
            Err(error) => Err(StoreError::File {
                error,
                path: self.path.clone(),
            }),
        }
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
        if let Err(error) = self.writer.finish() {
            let path = self.path.clone();
            self.abandon();
            return Err(StoreError::Mcap { error, path });
        }
        // A file that was removed takes what is written to it all the same.
        match self.path.metadata() {
            Ok(_) => Ok(()),
            Err(error) => Err(StoreError::File {
                error,
                path: self.path,
            }),
        }
    }

    /// Cuts off what was written in part; whether nothing was left and the file is gone.
    fn abandon(self) -> bool {
        // The writer tries to end the file, which has to be over before the cut.
        drop(self.writer);
        // A tail that cannot be cut off is a tear like any other; the reader stops there.
        let _ = self.file.set_len(self.whole_bytes);
        self.whole_bytes == 0 && std::fs::remove_file(&self.path).is_ok()
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
                let path = path.display();
                tracing::warn!(%path, %error, "a segment of the store has no end; read up to it");
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

#[cfg(test)]
mod tests {
    use tempfile::TempDir;

    use super::*;
    use crate::test_support::{self, map};

    fn placement(revision: u32) -> Kept {
        Kept::Placement(Box::new(test_support::placement(map(), revision)))
    }

    fn revisions(folder: &Path) -> Vec<u32> {
        let (_, reloaded) = Segments::open(folder).unwrap();
        let revision = |one: &Reloaded| decode::<Placement>(&one.payload).unwrap().revision;
        reloaded.iter().map(revision).collect()
    }

    /// A writer onto a file that takes nothing, as on a full disk.
    fn full(path: &Path) -> Writer<BufWriter<File>> {
        let options = WriteOptions::new().compression(None).use_chunks(false);
        let file = File::open(path).unwrap();
        options.create(BufWriter::new(file)).unwrap()
    }

    #[test]
    fn a_full_disk_loses_nothing_that_is_stored_and_only_what_comes_meanwhile() {
        let folder = TempDir::new().unwrap();
        let (mut segments, _) = Segments::open(folder.path()).unwrap();
        segments.append(&placement(1)).unwrap();
        let open = segments.open.as_mut().unwrap();
        open.writer = full(&open.path);
        open.channels.clear();
        // What a write that broke off has left behind.
        std::io::Write::write_all(&mut open.file, b"half a message").unwrap();
        assert!(segments.append(&placement(2)).is_err());
        assert_eq!(revisions(folder.path()), [1]);
        // There is room again.
        segments.append(&placement(3)).unwrap();
        segments.close().unwrap();
        assert_eq!(revisions(folder.path()), [1, 3]);
    }

    #[test]
    fn a_segment_without_anything_whole_is_removed() {
        let folder = TempDir::new().unwrap();
        let (mut segments, _) = Segments::open(folder.path()).unwrap();
        for _ in 0..3 {
            let path = segment_path(folder.path(), segments.next_number);
            let mut segment = Segment::create(path.clone()).unwrap();
            segment.writer = full(&path);
            segments.open = Some(segment);
            segments.next_number += 1;
            assert!(segments.append(&placement(1)).is_err());
        }
        assert_eq!(folder.path().read_dir().unwrap().count(), 0);
        assert_eq!(segments.next_number, 0);
    }

    #[test]
    fn a_folder_that_was_removed_is_no_success() {
        let folder = TempDir::new().unwrap();
        let (mut segments, _) = Segments::open(folder.path()).unwrap();
        segments.append(&placement(1)).unwrap();
        std::fs::remove_dir_all(folder.path()).unwrap();
        assert!(segments.close().is_err());
        segments.append(&placement(2)).unwrap();
        segments.close().unwrap();
        assert_eq!(revisions(folder.path()), [2]);
    }
}
