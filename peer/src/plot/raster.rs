//! Pictures as PNG.

use super::canvas::{Anchor, Canvas, Color, Frame};
use super::font;

/// Pixels that are drawn over.
pub struct RasterCanvas {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 3]>,
}

/// How much of a dot's colour covers what lies below.
const DOT_OPACITY: f64 = 0.7;

impl RasterCanvas {
    pub fn new([width, height]: [f64; 2]) -> Self {
        let (width, height) = (width.ceil() as usize, height.ceil() as usize);
        Self {
            width,
            height,
            pixels: vec![[255; 3]; width * height],
        }
    }

    /// A grey image, each pixel `scale` pixels wide and high, above a blank strip.
    pub fn over_grey(image: &camera::Image, scale: usize, strip_height: usize) -> Self {
        let (width, image_height) = (image.width() * scale, image.height() * scale);
        let mut canvas = Self::new([width as f64, (image_height + strip_height) as f64]);
        for (idx, pixel) in canvas.pixels[..width * image_height].iter_mut().enumerate() {
            let (x, y) = (idx % width, idx / width);
            *pixel = [image.get(x / scale, y / scale); 3];
        }
        canvas
    }

    pub fn finish(self) -> Vec<u8> {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder
            .write_header()
            .and_then(|mut writer| writer.write_image_data(self.pixels.as_flattened()))
            .expect("the buffer has the size of the header, and memory takes every write");
        file
    }

    fn cover(&mut self, x: f64, y: f64, Color(color): Color, opacity: f64) {
        if !(x >= 0.0 && y >= 0.0) || x as usize >= self.width || y as usize >= self.height {
            return;
        }
        let pixel = &mut self.pixels[y as usize * self.width + x as usize];
        for (below, above) in pixel.iter_mut().zip(color) {
            let mixed = f64::from(*below) + (f64::from(above) - f64::from(*below)) * opacity;
            *below = mixed.round() as u8;
        }
    }

    /// Covers the pixels within reach of a segment, softly over the last of them.
    fn segment(&mut self, [a, b]: [[f64; 2]; 2], color: Color, width_px: f64, clip: &Frame) {
        let reach = 0.5 * width_px + 0.5;
        let direction = [b[0] - a[0], b[1] - a[1]];
        let length_squared = direction[0] * direction[0] + direction[1] * direction[1];
        let bound = |low: f64, high: f64, from: f64, to: f64| {
            (
                (low - reach).max(from).floor() as i64,
                (high + reach).min(to).ceil() as i64,
            )
        };
        let (x_start, x_end) = bound(
            a[0].min(b[0]),
            a[0].max(b[0]),
            clip.left,
            clip.left + clip.width,
        );
        let (y_start, y_end) = bound(
            a[1].min(b[1]),
            a[1].max(b[1]),
            clip.top,
            clip.top + clip.height,
        );
        for y in y_start..y_end {
            for x in x_start..x_end {
                let offset = [x as f64 + 0.5 - a[0], y as f64 + 0.5 - a[1]];
                let along = if length_squared > 0.0 {
                    (offset[0] * direction[0] + offset[1] * direction[1]) / length_squared
                } else {
                    0.0
                };
                let along = along.clamp(0.0, 1.0);
                let distance =
                    (offset[0] - along * direction[0]).hypot(offset[1] - along * direction[1]);
                let opacity = (reach - distance).clamp(0.0, 1.0);
                if opacity > 0.0 {
                    self.cover(x as f64, y as f64, color, opacity);
                }
            }
        }
    }

    fn whole(&self) -> Frame {
        Frame {
            left: 0.0,
            top: 0.0,
            width: self.width as f64,
            height: self.height as f64,
        }
    }
}

impl Canvas for RasterCanvas {
    fn line(&mut self, points: &[[f64; 2]], color: Color, width_px: f64, clip: Option<&Frame>) {
        let clip = clip.copied().unwrap_or_else(|| self.whole());
        for pair in points.windows(2) {
            self.segment([pair[0], pair[1]], color, width_px, &clip);
        }
    }

    fn dots(&mut self, points: &[[f64; 2]], color: Color, diameter_px: f64) {
        let side = diameter_px.round().max(1.0) as i32;
        for [x, y] in points {
            for row in 0..side {
                for column in 0..side {
                    let offset = |step: i32| f64::from(step) - 0.5 * f64::from(side - 1);
                    self.cover(x + offset(column), y + offset(row), color, DOT_OPACITY);
                }
            }
        }
    }

    fn text(&mut self, [x, y]: [f64; 2], anchor: Anchor, text: &str) {
        let width = font::width_px(text);
        let left = match anchor {
            Anchor::Start => x,
            Anchor::Middle => x - 0.5 * width,
            Anchor::End => x - width,
        };
        let whole = self.whole();
        for stroke in font::strokes([left, y], text) {
            self.segment(stroke, Color::BLACK, 1.3, &whole);
        }
    }
}
