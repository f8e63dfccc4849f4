//! Images without compression, as ROS messages carry them, to grey.

use super::colour::luma;
use super::{ImageError, Raster, RasterKind, SIDE_MAX_PX, Samples};

/// What a message says about its pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct RawImage<'a> {
    pub width: usize,
    pub height: usize,
    /// Bytes from the start of a row to that of the next.
    pub step: usize,
    pub encoding: &'a str,
    pub is_big_endian: bool,
    pub pixels: &'a [u8],
}

/// How a pixel is laid out.
struct Layout {
    /// Values from one pixel to the next.
    stride: usize,
    /// Where in it red, green and blue are, or thrice the only value.
    channels: [usize; 3],
    is_wide: bool,
    kind: RasterKind,
}

impl Layout {
    /// By the names of `sensor_msgs/image_encodings.hpp` and of OpenCV's types.
    fn of(encoding: &str) -> Option<Self> {
        let layout = |stride, channels, is_wide, kind| {
            Some(Self {
                stride,
                channels,
                is_wide,
                kind,
            })
        };
        let colour =
            |stride, channels, is_wide| layout(stride, channels, is_wide, RasterKind::Colour);
        if let Some(pattern) = encoding.strip_prefix("bayer_") {
            let is_wide = pattern.ends_with("16");
            return match pattern.trim_end_matches("16").trim_end_matches('8') {
                "rggb" | "bggr" | "gbrg" | "grbg" => layout(1, [0; 3], is_wide, RasterKind::Mosaic),
                _ => None,
            };
        }
        match encoding {
            "mono8" | "8UC1" => layout(1, [0; 3], false, RasterKind::Grey),
            "mono16" | "16UC1" => layout(1, [0; 3], true, RasterKind::Grey),
            "rgb8" => colour(3, [0, 1, 2], false),
            "bgr8" | "8UC3" => colour(3, [2, 1, 0], false),
            "rgba8" => colour(4, [0, 1, 2], false),
            "bgra8" | "8UC4" => colour(4, [2, 1, 0], false),
            "rgb16" => colour(3, [0, 1, 2], true),
            "bgr16" | "16UC3" => colour(3, [2, 1, 0], true),
            // Two pixels share their colours and each has a brightness of its own.
            "yuv422" | "uyvy" => colour(2, [1; 3], false),
            "yuv422_yuy2" | "yuyv" | "yuv422_yuyv" => colour(2, [0; 3], false),
            // All brightnesses come first.
            "nv12" | "nv21" | "nv24" => colour(1, [0; 3], false),
            _ => None,
        }
    }
}

pub fn decode(image: &RawImage) -> Result<Raster, ImageError> {
    let RawImage { width, height, .. } = *image;
    let Some(layout) = Layout::of(image.encoding) else {
        return Err(ImageError::Encoding {
            got: image.encoding.to_owned(),
        });
    };
    let sides = 1..=SIDE_MAX_PX;
    if !sides.contains(&width) || !sides.contains(&height) {
        return Err(ImageError::Raw(format!("a size of {width}×{height}")));
    }
    let value_bytes = if layout.is_wide { 2 } else { 1 };
    let row_bytes = width * layout.stride * value_bytes;
    let needed_bytes = image
        .step
        .saturating_mul(height - 1)
        .saturating_add(row_bytes);
    if image.step < row_bytes || image.pixels.len() < needed_bytes {
        return Err(ImageError::Raw(format!(
            "{} bytes in rows of {}, expected {height} rows of {row_bytes}",
            image.pixels.len(),
            image.step
        )));
    }
    let rows = (0..height).map(|y| &image.pixels[y * image.step..y * image.step + row_bytes]);
    let samples = if layout.is_wide {
        let value = if image.is_big_endian {
            u16::from_be_bytes
        } else {
            u16::from_le_bytes
        };
        let mut values = Vec::with_capacity(width * height);
        for row in rows {
            let row: Vec<u16> = row.as_chunks().0.iter().copied().map(value).collect();
            values.extend(
                row.chunks_exact(layout.stride)
                    .map(|pixel| layout.grey(pixel)),
            );
        }
        Samples::Sixteen {
            values,
            bit_count: None,
        }
    } else {
        let mut values = Vec::with_capacity(width * height);
        for row in rows {
            let pixels = row.chunks_exact(layout.stride);
            values.extend(pixels.map(|pixel| layout.grey(pixel) as u8));
        }
        Samples::Eight(values)
    };
    Ok(Raster {
        width,
        height,
        samples,
        kind: layout.kind,
    })
}

impl Layout {
    fn grey<Value: Copy + Into<u16>>(&self, pixel: &[Value]) -> u16 {
        let [red, green, blue] = self.channels.map(|place| pixel[place].into());
        if self.channels[0] == self.channels[1] {
            red
        } else {
            luma([red, green, blue])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image<'a>(encoding: &'a str, step: usize, pixels: &'a [u8]) -> RawImage<'a> {
        RawImage {
            width: 2,
            height: 2,
            step,
            encoding,
            is_big_endian: false,
            pixels,
        }
    }

    #[test]
    fn every_encoding_becomes_grey() {
        let check = |encoding: &str, row: &[u8], expected: [u8; 2]| {
            // Two rows, the first one padded.
            let pixels = [row, &[99, 99], row].concat();
            let raster = decode(&image(encoding, row.len() + 2, &pixels)).unwrap();
            let expected = Samples::Eight([expected, expected].concat());
            assert_eq!(raster.samples, expected, "{encoding}");
        };
        check("mono8", &[7, 200], [7, 200]);
        check("8UC1", &[7, 200], [7, 200]);
        check("rgb8", &[255, 0, 0, 0, 0, 255], [77, 29]);
        check("bgr8", &[255, 0, 0, 0, 0, 255], [29, 77]);
        check("rgba8", &[255, 0, 0, 1, 9, 9, 9, 1], [77, 9]);
        check("bgra8", &[255, 0, 0, 1, 9, 9, 9, 1], [29, 9]);
        check("yuv422", &[128, 10, 128, 20], [10, 20]);
        check("yuv422_yuy2", &[10, 128, 20, 128], [10, 20]);
        check("nv12", &[10, 20], [10, 20]);
        check("bayer_grbg8", &[10, 20], [10, 20]);
        let raster = decode(&image("bayer_rggb8", 2, &[1, 2, 3, 4])).unwrap();
        assert_eq!(raster.kind, RasterKind::Mosaic);
    }

    #[test]
    fn sixteen_bits_come_in_both_orders() {
        let pixels = [1, 2, 3, 4, 5, 6, 7, 8];
        let mut wide = image("mono16", 4, &pixels);
        let values = |raster: Raster| match raster.samples {
            Samples::Sixteen { values, .. } => values,
            Samples::Eight(_) => Vec::new(),
        };
        let little = values(decode(&wide).unwrap());
        assert_eq!(little, [0x0201, 0x0403, 0x0605, 0x0807]);
        wide.is_big_endian = true;
        let big = values(decode(&wide).unwrap());
        assert_eq!(big, [0x0102, 0x0304, 0x0506, 0x0708]);
        wide.encoding = "bayer_gbrg16";
        assert_eq!(decode(&wide).unwrap().kind, RasterKind::Mosaic);
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let check = |image: &RawImage, expected: &str| {
            let error = decode(image).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        };
        check(&image("32FC1", 8, &[0; 16]), "encoding \"32FC1\"");
        check(&image("bayer_odd8", 2, &[0; 4]), "encoding \"bayer_odd8\"");
        check(&image("rgb8", 6, &[0; 11]), "11 bytes in rows of 6");
        check(&image("rgb8", 5, &[0; 11]), "expected 2 rows of 6");
        let mut huge = image("mono8", 2, &[0; 4]);
        huge.width = 1 << 40;
        check(&huge, "a size of 1099511627776×2");
    }
}
