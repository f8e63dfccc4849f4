//! The records of an MCAP file, one by one.

use std::fs::File;
use std::io::{BufReader, Cursor, Read};
use std::path::Path;

use mcap::records::{Record, op};

use super::chunk::{self, ChunkError};

/// What of a file matters here.
#[derive(Debug, PartialEq)]
pub enum McapRecord {
    Schema {
        id: u16,
        name: String,
    },
    Channel {
        id: u16,
        schema_id: u16,
        topic: String,
        message_encoding: String,
    },
    Message {
        channel_id: u16,
        log_time_ns: u64,
        /// As much of it as was asked for.
        bytes: Vec<u8>,
    },
}

/// Why there are no more records though there should be.
#[derive(Debug, thiserror::Error)]
pub enum McapError {
    #[error("no MCAP file: it does not begin as one")]
    NoMcap,
    #[error("cut off or damaged after {offset_bytes} bytes")]
    CutOff { offset_bytes: u64 },
    #[error("cannot read after {offset_bytes} bytes: {error}")]
    Read {
        offset_bytes: u64,
        error: std::io::Error,
    },
    #[error("cannot read chunk {number}, which begins at byte {offset_bytes}: {error}")]
    Chunk {
        /// Counted from one.
        number: usize,
        offset_bytes: u64,
        error: ChunkError,
    },
}

/// Reads a file from its start, with one message or compressed chunk in memory at a time.
pub struct McapReader {
    file: BufReader<File>,
    position: u64,
    length: u64,
    /// What is left of a chunk that was compressed.
    unpacked: Cursor<Vec<u8>>,
    /// The record that is read stands in it.
    is_unpacked: bool,
    /// The chunk that was unpacked did not end as it should.
    broken_chunk: Option<ChunkError>,
    chunk_count: usize,
    /// Where the newest chunk begins.
    chunk_at: u64,
    /// Whether the contents of chunks are held against their checksums.
    checks: bool,
}

/// Longer records than this are taken for damage.
const RECORD_MAX_BYTES: u64 = 1 << 28;
/// Op code and length.
const RECORD_HEAD_BYTES: u64 = 9;
/// Channel, sequence number, log time, publish time.
const MESSAGE_HEAD_BYTES: u64 = 22;

impl McapReader {
    pub fn open(path: &Path) -> Result<Self, McapError> {
        let unreadable = |error| McapError::Read {
            offset_bytes: 0,
            error,
        };
        let mut file = File::open(path).map_err(unreadable)?;
        let length = file.metadata().map_err(unreadable)?.len();
        let mut magic = Vec::new();
        let magic_bytes = mcap::MAGIC.len() as u64;
        let read = Read::by_ref(&mut file)
            .take(magic_bytes)
            .read_to_end(&mut magic);
        read.map_err(unreadable)?;
        if !mcap::MAGIC.starts_with(&magic) {
            return Err(McapError::NoMcap);
        }
        if magic.len() < mcap::MAGIC.len() {
            return Err(McapError::CutOff {
                offset_bytes: length,
            });
        }
        Ok(Self {
            file: BufReader::with_capacity(1 << 16, file),
            position: magic.len() as u64,
            length,
            unpacked: Cursor::default(),
            is_unpacked: false,
            broken_chunk: None,
            chunk_count: 0,
            chunk_at: 0,
            checks: false,
        })
    }

    /// As [`Self::open`], for who does not know yet whether the file is whole: a damaged chunk ends
    /// it, at the price of reading also what is not wanted.
    pub fn open_checking(path: &Path) -> Result<Self, McapError> {
        Ok(Self {
            checks: true,
            ..Self::open(path)?
        })
    }

    /// The next record; `None` at the end of the data.
    ///
    /// - `wanted_bytes`: of each message on a channel; what is not wanted is not read.
    pub fn next_record(
        &mut self,
        wanted_bytes: impl Fn(u16) -> usize,
    ) -> Option<Result<McapRecord, McapError>> {
        loop {
            let (op_code, length) = match self.read_head() {
                Ok(head) => head,
                Err(error) => return Some(Err(error)),
            };
            let record = match op_code {
                // A chunk without compression is read as if its records stood in the file.
                op::CHUNK => self.enter_chunk(length).map(|()| None),
                op::SCHEMA | op::CHANNEL => self.read_description(op_code, length),
                op::MESSAGE => self.read_message(length, &wanted_bytes),
                op::DATA_END | op::FOOTER => return None,
                _ => self.skip(length).map(|()| None),
            };
            match record {
                Ok(Some(record)) => return Some(Ok(record)),
                Ok(None) => {}
                Err(error) => return Some(Err(error)),
            }
        }
    }

    fn read_head(&mut self) -> Result<(u8, u64), McapError> {
        self.is_unpacked = self.unpacked_left() > 0;
        if !self.is_unpacked && self.broken_chunk.is_some() {
            return Err(self.cut_off());
        }
        let head = self.read(RECORD_HEAD_BYTES)?;
        let mut length = [0; 8];
        length.copy_from_slice(&head[1..]);
        Ok((head[0], u64::from_le_bytes(length)))
    }

    fn enter_chunk(&mut self, length: u64) -> Result<(), McapError> {
        if self.is_unpacked {
            // A chunk in a chunk.
            return Err(self.cut_off());
        }
        let position = self.position;
        self.chunk_count += 1;
        self.chunk_at = position - RECORD_HEAD_BYTES;
        // Start and end time, size and checksum when unpacked.
        self.skip(8 + 8)?;
        let unpacked_bytes = self.read_u64()?;
        let checksum = self.read_u32()?;
        let name_bytes = u64::from(self.read_u32()?);
        let name = String::from_utf8_lossy(&self.read(name_bytes)?).into_owned();
        let packed_bytes = self.read_u64()?;
        if (self.position - position).saturating_add(packed_bytes) > length {
            return Err(self.cut_off());
        }
        if name.is_empty() {
            return self.check_unpacked(packed_bytes, checksum);
        }
        let available = packed_bytes.min(self.length - self.position);
        let packed = self.read(available)?;
        let (unpacked, broken) = chunk::unpack(&name, &packed, unpacked_bytes);
        if let Some(error @ ChunkError::Unknown { .. }) = broken {
            return Err(self.in_chunk(error));
        }
        if self.checks && broken.is_none() {
            let checked = chunk::check(crc32fast::hash(&unpacked), checksum);
            checked.map_err(|error| self.in_chunk(error))?;
        }
        self.unpacked = Cursor::new(unpacked);
        self.broken_chunk = broken;
        Ok(())
    }

    /// Reads a chunk that is not compressed and goes back to its start.
    fn check_unpacked(&mut self, size_bytes: u64, checksum: u32) -> Result<(), McapError> {
        if !self.checks || checksum == 0 || size_bytes > self.left() {
            return Ok(());
        }
        let mut hasher = crc32fast::Hasher::new();
        let mut part = vec![0; 1 << 16];
        let mut left = size_bytes;
        while left > 0 {
            let wanted = left.min(part.len() as u64) as usize;
            let read = self.file.read_exact(&mut part[..wanted]);
            read.map_err(|error| self.unreadable(error))?;
            hasher.update(&part[..wanted]);
            left -= wanted as u64;
        }
        // Files of more than 8 EiB do not exist.
        let back = self.file.seek_relative(-(size_bytes as i64));
        back.map_err(|error| self.unreadable(error))?;
        let checked = chunk::check(hasher.finalize(), checksum);
        checked.map_err(|error| self.in_chunk(error))
    }

    fn in_chunk(&self, error: ChunkError) -> McapError {
        McapError::Chunk {
            number: self.chunk_count,
            offset_bytes: self.chunk_at,
            error,
        }
    }

    fn read_description(
        &mut self,
        op_code: u8,
        length: u64,
    ) -> Result<Option<McapRecord>, McapError> {
        let bytes = self.read(length)?;
        Ok(match mcap::parse_record(op_code, &bytes) {
            Ok(Record::Schema { header, .. }) => Some(McapRecord::Schema {
                id: header.id,
                name: header.name,
            }),
            Ok(Record::Channel(channel)) => Some(McapRecord::Channel {
                id: channel.id,
                schema_id: channel.schema_id,
                topic: channel.topic,
                message_encoding: channel.message_encoding,
            }),
            Ok(_) => None,
            Err(_) => return Err(self.cut_off()),
        })
    }

    fn read_message(
        &mut self,
        length: u64,
        wanted_bytes: impl Fn(u16) -> usize,
    ) -> Result<Option<McapRecord>, McapError> {
        if length < MESSAGE_HEAD_BYTES {
            return Err(self.cut_off());
        }
        let head = self.read(MESSAGE_HEAD_BYTES)?;
        let channel_id = u16::from_le_bytes([head[0], head[1]]);
        let mut log_time = [0; 8];
        log_time.copy_from_slice(&head[6..14]);
        let body_bytes = length - MESSAGE_HEAD_BYTES;
        let wanted = body_bytes.min(wanted_bytes(channel_id) as u64);
        let bytes = self.read(wanted)?;
        self.skip(body_bytes - wanted)?;
        Ok((wanted > 0).then_some(McapRecord::Message {
            channel_id,
            log_time_ns: u64::from_le_bytes(log_time),
            bytes,
        }))
    }

    fn unpacked_left(&self) -> u64 {
        self.unpacked.get_ref().len() as u64 - self.unpacked.position()
    }

    /// Bytes left where the record stands.
    fn left(&self) -> u64 {
        if self.is_unpacked {
            self.unpacked_left()
        } else {
            self.length - self.position
        }
    }

    fn read_u32(&mut self) -> Result<u32, McapError> {
        let bytes = self.read(4)?;
        Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }

    fn read_u64(&mut self) -> Result<u64, McapError> {
        let mut number = [0; 8];
        number.copy_from_slice(&self.read(8)?);
        Ok(u64::from_le_bytes(number))
    }

    fn read(&mut self, count: u64) -> Result<Vec<u8>, McapError> {
        if count > self.left() || count > RECORD_MAX_BYTES {
            return Err(self.cut_off());
        }
        let mut bytes = vec![0; count as usize];
        if self.is_unpacked {
            let read = self.unpacked.read_exact(&mut bytes);
            read.map_err(|error| self.unreadable(error))?;
        } else {
            let read = self.file.read_exact(&mut bytes);
            read.map_err(|error| self.unreadable(error))?;
            self.position += count;
        }
        Ok(bytes)
    }

    fn skip(&mut self, count: u64) -> Result<(), McapError> {
        if count > self.left() {
            return Err(self.cut_off());
        }
        if self.is_unpacked {
            self.unpacked.set_position(self.unpacked.position() + count);
            return Ok(());
        }
        // Files of more than 8 EiB do not exist.
        let moved = self.file.seek_relative(count as i64);
        moved.map_err(|error| self.unreadable(error))?;
        self.position += count;
        Ok(())
    }

    fn unreadable(&self, error: std::io::Error) -> McapError {
        McapError::Read {
            offset_bytes: self.position,
            error,
        }
    }

    fn cut_off(&mut self) -> McapError {
        let offset_bytes = self.position;
        match self.broken_chunk.take() {
            Some(error) => self.in_chunk(error),
            None => McapError::CutOff { offset_bytes },
        }
    }
}
