//! The members of a ZIP archive, as `numpy` writes it: stored or deflated, in one part.

use miniz_oxide::inflate::decompress_to_vec_with_limit;

const END_SIGNATURE: &[u8] = b"PK\x05\x06";
const ENTRY_SIGNATURE: &[u8] = b"PK\x01\x02";
const LOCAL_SIGNATURE: &[u8] = b"PK\x03\x04";
const END_SIZE_BYTES: usize = 22;
/// The comment after the end is no longer.
const COMMENT_SIZE_BYTES_MAX: usize = 65_535;
/// Larger members are not read: a cloud of ten million points has 1.3 GB of descriptors.
const MEMBER_SIZE_BYTES_MAX: usize = 2 << 30;
/// Nor are archives whose members are larger together: members may share their packed bytes, so
/// that a small file would fill the memory.
const ARCHIVE_SIZE_BYTES_MAX: u64 = 4 << 30;
/// Stands for a number that only fits in the 64-bit fields.
const IN_ZIP64: usize = u32::MAX as usize;

/// A file within the archive.
pub struct Member {
    pub name: String,
    method: u16,
    checksum: u32,
    packed_size_bytes: usize,
    size_bytes: usize,
    header_offset_bytes: usize,
}

/// Lists the archive.
pub fn members(bytes: &[u8]) -> Result<Vec<Member>, String> {
    let end = find_end(bytes).ok_or("not an NPZ file: no end of a ZIP archive, or truncated")?;
    let count = usize::from(u16_at(bytes, end + 10)?);
    let mut offset = u32_at(bytes, end + 16)?;
    let mut members = Vec::with_capacity(count);
    for member_idx in 0..count {
        if !starts_with(bytes, offset, ENTRY_SIGNATURE) {
            return Err(format!("damaged: entry {member_idx} of {count} is none"));
        }
        let name_size = usize::from(u16_at(bytes, offset + 28)?);
        let extra_size = usize::from(u16_at(bytes, offset + 30)?);
        let comment_size = usize::from(u16_at(bytes, offset + 32)?);
        let name = slice(bytes, offset + 46, name_size)?;
        members.push(Member {
            name: String::from_utf8_lossy(name).into_owned(),
            method: u16_at(bytes, offset + 10)?,
            checksum: u32_at(bytes, offset + 16)? as u32,
            packed_size_bytes: u32_at(bytes, offset + 20)?,
            size_bytes: u32_at(bytes, offset + 24)?,
            header_offset_bytes: u32_at(bytes, offset + 42)?,
        });
        offset += 46 + name_size + extra_size + comment_size;
    }
    let sizes = members.iter().map(|member| member.size_bytes as u64);
    let size_bytes: u64 = sizes.sum();
    if size_bytes > ARCHIVE_SIZE_BYTES_MAX {
        return Err(format!("unpacks to {size_bytes} bytes, which are too many"));
    }
    Ok(members)
}

impl Member {
    /// - `archive`: the bytes that it was listed from.
    pub fn content(&self, archive: &[u8]) -> Result<Vec<u8>, String> {
        let start = self.header_offset_bytes;
        if self.size_bytes == IN_ZIP64 || self.packed_size_bytes == IN_ZIP64 || start == IN_ZIP64 {
            return Err("archives of 4 GiB and more are not supported".to_owned());
        }
        if self.size_bytes > MEMBER_SIZE_BYTES_MAX {
            return Err(format!("{} bytes are too many", self.size_bytes));
        }
        if !starts_with(archive, start, LOCAL_SIGNATURE) {
            return Err("damaged: no content where the archive says".to_owned());
        }
        if u16_at(archive, start + 6)? & 1 != 0 {
            return Err("encrypted".to_owned());
        }
        let name_size = usize::from(u16_at(archive, start + 26)?);
        let extra_size = usize::from(u16_at(archive, start + 28)?);
        let packed = slice(
            archive,
            start + 30 + name_size + extra_size,
            self.packed_size_bytes,
        )?;
        let content = match self.method {
            0 => packed.to_vec(),
            8 => decompress_to_vec_with_limit(packed, self.size_bytes)
                .map_err(|error| format!("damaged: {error}"))?,
            other => return Err(format!("compression method {other} is not supported")),
        };
        if content.len() != self.size_bytes {
            return Err(format!(
                "damaged: {} bytes, expected {}",
                content.len(),
                self.size_bytes
            ));
        }
        let got = crc32fast::hash(&content);
        if got != self.checksum {
            return Err(format!(
                "damaged: checksum {got:08x}, expected {:08x}",
                self.checksum
            ));
        }
        Ok(content)
    }
}

fn find_end(bytes: &[u8]) -> Option<usize> {
    let last = bytes.len().checked_sub(END_SIZE_BYTES)?;
    let first = last.saturating_sub(COMMENT_SIZE_BYTES_MAX);
    (first..=last)
        .rev()
        .find(|offset| starts_with(bytes, *offset, END_SIGNATURE))
}

fn starts_with(bytes: &[u8], offset: usize, signature: &[u8]) -> bool {
    bytes
        .get(offset..)
        .is_some_and(|rest| rest.starts_with(signature))
}

fn slice(bytes: &[u8], offset: usize, size: usize) -> Result<&[u8], String> {
    let end = offset.checked_add(size);
    end.and_then(|end| bytes.get(offset..end))
        .ok_or_else(|| "truncated".to_owned())
}

fn u16_at(bytes: &[u8], offset: usize) -> Result<u16, String> {
    let raw = slice(bytes, offset, 2)?;
    Ok(u16::from_le_bytes([raw[0], raw[1]]))
}

fn u32_at(bytes: &[u8], offset: usize) -> Result<usize, String> {
    let raw = slice(bytes, offset, 4)?;
    Ok(u32::from_le_bytes([raw[0], raw[1], raw[2], raw[3]]) as usize)
}
