//! Messages to bytes and back: CBOR with a version, a size limit, and reasons for refusals.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// The version that is written: `[major, minor]`. A reader accepts its own major only; a higher
/// minor has fields that it may ignore.
pub const VERSION: [u16; 2] = [1, 0];

/// Nesting beyond this is refused: no message of ours is deeper than four.
const NESTING_MAX: usize = 16;

/// A message of the protocol. The bytes are those of the CDDL schema in `protocol/starling.cddl`.
pub trait Message: Sized {
    /// What the message is called in errors and in the schema.
    const KIND: &'static str;
    /// The largest encoding that is accepted (bytes).
    const SIZE_BYTES_MAX: usize;
    /// The serialised form.
    #[doc(hidden)]
    type Wire: Serialize + DeserializeOwned;
    /// Converts to the serialised form.
    #[doc(hidden)]
    fn to_wire(&self) -> Self::Wire;
    /// Validates the serialised form, or says what is wrong with it.
    #[doc(hidden)]
    fn from_wire(wire: Self::Wire) -> Result<Self, String>;
}

/// Why bytes are no message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// More bytes than such a message may have.
    #[error("{kind}: {size_bytes} bytes, at most {size_bytes_max} are accepted")]
    TooLarge {
        /// The message that was expected.
        kind: &'static str,
        /// How many bytes came.
        size_bytes: usize,
        /// How many may come.
        size_bytes_max: usize,
    },
    /// The major version is not ours.
    #[error("{kind}: version {}.{}, this vehicle speaks {}", got[0], got[1], VERSION[0])]
    UnknownVersion {
        /// The message that was expected.
        kind: &'static str,
        /// The version that came.
        got: [u16; 2],
    },
    /// The bytes are not CBOR of the message's shape.
    #[error("{kind}: malformed: {reason}")]
    Malformed {
        /// The message that was expected.
        kind: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// The shape fits, but a value is impossible.
    #[error("{kind}: invalid: {reason}")]
    Invalid {
        /// The message that was expected.
        kind: &'static str,
        /// What is wrong.
        reason: String,
    },
}

/// The message as bytes. Equal messages give equal bytes.
pub fn encode<M: Message>(message: &M) -> Vec<u8> {
    let mut bytes = Vec::new();
    ciborium::into_writer(&message.to_wire(), &mut bytes)
        .expect("a Vec takes every write, and no wire form has a map that CBOR cannot hold");
    bytes
}

/// The message in these bytes, valid in every field, or why there is none.
///
/// Never panics, and allocates no more than a small multiple of the bytes that came.
pub fn decode<M: Message>(bytes: &[u8]) -> Result<M, DecodeError> {
    let kind = M::KIND;
    if bytes.len() > M::SIZE_BYTES_MAX {
        return Err(DecodeError::TooLarge {
            kind,
            size_bytes: bytes.len(),
            size_bytes_max: M::SIZE_BYTES_MAX,
        });
    }
    // The version is read by itself first: another major may have another shape.
    let probe: VersionProbe = read(kind, bytes)?;
    if probe.version[0] != VERSION[0] {
        return Err(DecodeError::UnknownVersion {
            kind,
            got: probe.version,
        });
    }
    M::from_wire(read(kind, bytes)?).map_err(|reason| DecodeError::Invalid { kind, reason })
}

#[derive(Deserialize)]
struct VersionProbe {
    version: [u16; 2],
}

fn read<T: DeserializeOwned>(kind: &'static str, bytes: &[u8]) -> Result<T, DecodeError> {
    let malformed = |reason: String| DecodeError::Malformed { kind, reason };
    let mut rest = bytes;
    let value = ciborium::de::from_reader_with_recursion_limit(&mut rest, NESTING_MAX)
        .map_err(|error| malformed(describe(&error)))?;
    if !rest.is_empty() {
        return Err(malformed(format!("{} bytes after the message", rest.len())));
    }
    Ok(value)
}

/// The error without what came in: that may be long and is foreign.
fn describe<E>(error: &ciborium::de::Error<E>) -> String {
    match error {
        ciborium::de::Error::Io(_) => "the bytes end in mid-message".to_owned(),
        ciborium::de::Error::Syntax(offset) => format!("no CBOR at byte {offset}"),
        ciborium::de::Error::Semantic(_, reason) => reason.chars().take(120).collect(),
        ciborium::de::Error::RecursionLimitExceeded => "nested too deeply".to_owned(),
    }
}
