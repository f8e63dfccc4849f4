//! Chunks as they were before they were compressed.

use std::io::Read;

use super::zstd;

/// Why a chunk could not be unpacked, or only in part.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum ChunkError {
    #[error(
        "its compression {name:?} is not known, expected zstd or lz4; \
         `mcap compress --compression none` rewrites the file"
    )]
    Unknown { name: String },
    #[error(
        "unpacked it should have {expected_bytes} bytes, at most {UNPACKED_MAX_BYTES} are read"
    )]
    TooLarge { expected_bytes: u64 },
    #[error("its contents are damaged: checksum {got:08x}, expected {expected:08x}")]
    Checksum { got: u32, expected: u32 },
    #[error("{got_bytes} of {expected_bytes} bytes could be unpacked: {reason}")]
    Damaged {
        got_bytes: usize,
        expected_bytes: u64,
        reason: String,
    },
}

/// A chunk is held in memory as a whole.
const UNPACKED_MAX_BYTES: u64 = 1 << 28;

/// As much as can be unpacked, and what went wrong then.
pub fn unpack(name: &str, packed: &[u8], expected_bytes: u64) -> (Vec<u8>, Option<ChunkError>) {
    if expected_bytes > UNPACKED_MAX_BYTES {
        return (Vec::new(), Some(ChunkError::TooLarge { expected_bytes }));
    }
    let mut unpacked = Vec::new();
    let result = match name {
        "lz4" => {
            let decoder = lz4_flex::frame::FrameDecoder::new(packed);
            read_all(decoder, expected_bytes, &mut unpacked)
        }
        "zstd" => zstd::unpack(packed, expected_bytes, &mut unpacked),
        _ => {
            let name = name.to_owned();
            return (unpacked, Some(ChunkError::Unknown { name }));
        }
    };
    let damaged = |reason, unpacked: &Vec<u8>| ChunkError::Damaged {
        got_bytes: unpacked.len(),
        expected_bytes,
        reason,
    };
    let broken = match result {
        Err(reason) => Some(damaged(reason, &unpacked)),
        Ok(()) if (unpacked.len() as u64) < expected_bytes => {
            Some(damaged("it ends early".to_owned(), &unpacked))
        }
        Ok(()) => None,
    };
    (unpacked, broken)
}

/// Of a file without checksums the expected one is zero.
pub fn check(got: u32, expected: u32) -> Result<(), ChunkError> {
    if expected == 0 || got == expected {
        Ok(())
    } else {
        Err(ChunkError::Checksum { got, expected })
    }
}

/// Keeps what was read before an error, and reads no more than was promised.
pub fn read_all(
    reader: impl Read,
    expected_bytes: u64,
    unpacked: &mut Vec<u8>,
) -> Result<(), String> {
    let mut reader = reader.take(expected_bytes);
    let mut part = vec![0; 1 << 16];
    loop {
        match reader.read(&mut part) {
            Ok(0) => return Ok(()),
            Ok(count) => unpacked.extend_from_slice(&part[..count]),
            Err(error) => return Err(error.to_string()),
        }
    }
}
