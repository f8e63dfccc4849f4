//! Typed arrays of RFC 8746: a tag and the little-endian bytes, so that numpy reads them in place.

use ciborium::tag::Required;
use serde_bytes::ByteBuf;

/// Unsigned bytes.
pub(crate) type Uint8Array = Required<ByteBuf, 64>;
/// Unsigned 16-bit numbers, little-endian.
pub(crate) type Uint16Array = Required<ByteBuf, 69>;
/// Single-precision floats, little-endian.
pub(crate) type Float32Array = Required<ByteBuf, 85>;
/// Double-precision floats, little-endian.
pub(crate) type Float64Array = Required<ByteBuf, 86>;

pub(crate) fn bytes(values: Vec<u8>) -> Uint8Array {
    Required(ByteBuf::from(values))
}

pub(crate) fn from_u16(values: impl Iterator<Item = u16>) -> Uint16Array {
    Required(ByteBuf::from(
        values.flat_map(u16::to_le_bytes).collect::<Vec<u8>>(),
    ))
}

pub(crate) fn from_f32(values: impl Iterator<Item = f32>) -> Float32Array {
    Required(ByteBuf::from(
        values.flat_map(f32::to_le_bytes).collect::<Vec<u8>>(),
    ))
}

pub(crate) fn from_f64(values: impl Iterator<Item = f64>) -> Float64Array {
    Required(ByteBuf::from(
        values.flat_map(f64::to_le_bytes).collect::<Vec<u8>>(),
    ))
}

/// The numbers of an array; bytes that do not fill a number are an error.
pub(crate) fn to_u16(array: &Uint16Array) -> Result<Vec<u16>, String> {
    numbers(&array.0, u16::from_le_bytes)
}

pub(crate) fn to_f32(array: &Float32Array) -> Result<Vec<f32>, String> {
    numbers(&array.0, f32::from_le_bytes)
}

pub(crate) fn to_f64(array: &Float64Array) -> Result<Vec<f64>, String> {
    numbers(&array.0, f64::from_le_bytes)
}

fn numbers<T, const SIZE: usize>(
    bytes: &[u8],
    read: impl Fn([u8; SIZE]) -> T,
) -> Result<Vec<T>, String> {
    let (whole, rest) = bytes.as_chunks::<SIZE>();
    if !rest.is_empty() {
        let count = bytes.len();
        return Err(format!(
            "a typed array of {count} bytes, expected a multiple of {SIZE}"
        ));
    }
    Ok(whole.iter().map(|number| read(*number)).collect())
}
