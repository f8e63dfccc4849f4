//! Common Data Representation, little-endian: how ROS 2 writes messages.

/// Four bytes that name the encoding, then the body: numbers aligned to their size from its start.
pub struct CdrWriter {
    bytes: Vec<u8>,
}

const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

impl CdrWriter {
    pub fn new() -> Self {
        Self {
            bytes: ENCAPSULATION.to_vec(),
        }
    }

    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }

    fn align(&mut self, size_bytes: usize) {
        while !(self.bytes.len() - ENCAPSULATION.len()).is_multiple_of(size_bytes) {
            self.bytes.push(0);
        }
    }

    pub fn write_u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    pub fn write_i32(&mut self, value: i32) {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    pub fn write_u32(&mut self, value: u32) {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    pub fn write_f64(&mut self, value: f64) {
        self.align(8);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// A string: its length with the closing zero, then both.
    pub fn write_text(&mut self, text: &str) {
        self.write_u32(text.len() as u32 + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
    }

    /// A sequence of bytes: their number, then themselves.
    pub fn write_bytes(&mut self, bytes: &[u8]) {
        self.write_u32(bytes.len() as u32);
        self.bytes.extend_from_slice(bytes);
    }
}
