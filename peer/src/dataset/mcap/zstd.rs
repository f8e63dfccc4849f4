//! Zstandard, also of a frame that was cut off.

use ruzstd::decoding::StreamingDecoder;

use super::chunk::read_all;

/// As [`read_all`]; of a frame that was cut off all that its whole blocks hold.
pub fn unpack(packed: &[u8], expected_bytes: u64, unpacked: &mut Vec<u8>) -> Result<(), String> {
    let unpack = |packed: &[u8], unpacked: &mut Vec<u8>| match StreamingDecoder::new(packed) {
        Ok(decoder) => read_all(decoder, expected_bytes, unpacked),
        Err(error) => Err(error.to_string()),
    };
    let result = unpack(packed, unpacked);
    if result.is_err()
        && let Some(ended) = with_an_end(packed)
    {
        // The decoder keeps back what later blocks may refer to, until the last one.
        unpacked.clear();
        let _ = unpack(&ended, unpacked);
    }
    result
}

/// A frame's whole blocks and an empty last one (RFC 8878, 3.1.1); `None` if nothing is missing.
fn with_an_end(packed: &[u8]) -> Option<Vec<u8>> {
    const DESCRIPTOR: usize = 4;
    const HAS_CHECKSUM: u8 = 1 << 2;
    let descriptor = *packed.get(DESCRIPTOR)?;
    let is_single_segment = descriptor & (1 << 5) != 0;
    let window_bytes = usize::from(!is_single_segment);
    let dictionary_bytes = [0, 1, 2, 4][usize::from(descriptor & 3)];
    let size_bytes = match descriptor >> 6 {
        0 => usize::from(is_single_segment),
        power => 1 << power,
    };
    let mut end = DESCRIPTOR + 1 + window_bytes + dictionary_bytes + size_bytes;
    while let Some(head) = packed.get(end..end + 3) {
        let head = u32::from_le_bytes([head[0], head[1], head[2], 0]);
        let (is_last, kind, size) = (head & 1 != 0, head >> 1 & 3, head >> 3);
        // One byte repeated stands once.
        let size_bytes = if kind == 1 { 1 } else { size as usize };
        if end + 3 + size_bytes > packed.len() {
            break;
        }
        if is_last {
            return None;
        }
        end += 3 + size_bytes;
    }
    let mut ended = packed.get(..end)?.to_vec();
    ended[DESCRIPTOR] &= !HAS_CHECKSUM;
    ended.extend([1, 0, 0]);
    Some(ended)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_that_was_cut_off_gives_its_whole_blocks() {
        // Blocks hold at most 128 KiB: five of numbers that are alike but do not repeat.
        let whole: Vec<u8> = (0..600_000_u32)
            .map(|number| (number.wrapping_mul(number) >> 7) as u8)
            .collect();
        let level = ruzstd::encoding::CompressionLevel::Fastest;
        let packed = ruzstd::encoding::compress_to_vec(whole.as_slice(), level);
        let mut counts = Vec::new();
        for length in (0..=packed.len())
            .step_by(packed.len() / 40)
            .chain([packed.len()])
        {
            let mut unpacked = Vec::new();
            let result = unpack(&packed[..length], 600_000, &mut unpacked);
            assert_eq!(result.is_ok(), length == packed.len(), "{length}");
            assert_eq!(unpacked, whole[..unpacked.len()], "{length}");
            counts.push(unpacked.len());
        }
        assert!(counts.is_sorted(), "{counts:?}");
        counts.dedup();
        assert!(counts.len() >= 4, "{counts:?}");
        assert_eq!(counts.last(), Some(&600_000));
    }
}
