//! Numbers out of bytes, none beyond their end.

use crate::files::error::Refused;

/// Bytes that were not read yet.
pub struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    pub fn take(&mut self, byte_count: usize) -> Result<&'a [u8], Refused> {
        let (taken, rest) = self
            .rest
            .split_at_checked(byte_count)
            .ok_or_else(too_short)?;
        self.rest = rest;
        Ok(taken)
    }

    pub fn array<const BYTES: usize>(&mut self) -> Result<[u8; BYTES], Refused> {
        let (taken, rest) = self.rest.split_first_chunk().ok_or_else(too_short)?;
        self.rest = rest;
        Ok(*taken)
    }

    pub fn u32(&mut self) -> Result<u32, Refused> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    pub fn numbers<const COUNT: usize>(&mut self) -> Result<[f64; COUNT], Refused> {
        let mut numbers = [0.0; COUNT];
        for number in &mut numbers {
            *number = f64::from_le_bytes(self.array()?);
        }
        Ok(numbers)
    }

    /// How many things of at least this size follow; no more than there is room for.
    pub fn count(&mut self, size_bytes_min: usize) -> Result<usize, Refused> {
        let count = self.u32()? as usize;
        if count > self.rest.len() / size_bytes_min {
            return Err(too_short());
        }
        Ok(count)
    }

    /// All that is left.
    pub fn rest(self) -> &'a [u8] {
        self.rest
    }

    pub fn end(self) -> Result<(), Refused> {
        if self.rest.is_empty() {
            return Ok(());
        }
        let reason = format!("the map is damaged: {} bytes too many", self.rest.len());
        Err(Refused::whole(reason))
    }
}

fn too_short() -> Refused {
    Refused::whole("the map is damaged: it ends too soon")
}
