//! Rows of bytes with a stride.

/// A grey image whose rows may be longer than its width, so that all levels of a pyramid can
/// share one stride.
#[derive(Clone, Debug, Default)]
pub(crate) struct Plane {
    width: usize,
    height: usize,
    stride: usize,
    pixels: Vec<u8>,
}

impl Plane {
    /// Takes on a new size; the contents are left over from before. Allocates only to grow.
    pub(crate) fn resize(&mut self, width: usize, height: usize, stride: usize) {
        assert!(stride >= width, "stride {stride} under width {width}");
        self.width = width;
        self.height = height;
        self.stride = stride;
        self.pixels.resize(stride * height, 0);
    }

    pub(crate) fn width(&self) -> usize {
        self.width
    }

    pub(crate) fn height(&self) -> usize {
        self.height
    }

    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    pub(crate) fn row(&self, y: usize) -> &[u8] {
        &self.pixels[y * self.stride..][..self.width]
    }

    pub(crate) fn row_mut(&mut self, y: usize) -> &mut [u8] {
        &mut self.pixels[y * self.stride..][..self.width]
    }

    /// All rows with what lies between them.
    pub(crate) fn pixels(&self) -> &[u8] {
        &self.pixels
    }
}
