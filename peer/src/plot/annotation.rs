//! An image with what was found in it, enlarged, and a legend below.

use std::f64::consts::TAU;
use std::path::Path;

use camera::Image;

use super::canvas::{Anchor, Canvas, Color};
use super::raster::RasterCanvas;
use crate::files::FileError;

/// Something to show in an image; places are its pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageMark {
    pub color: Color,
    pub shape: MarkShape,
}

#[derive(Clone, Debug, PartialEq)]
pub enum MarkShape {
    Circle { center_px: [f64; 2], radius_px: f64 },
    Line([[f64; 2]; 2]),
}

/// An image, its marks, and one line of legend for each thing found.
#[derive(Clone, Debug)]
pub struct AnnotatedImage<'a> {
    pub image: &'a Image,
    pub marks: Vec<ImageMark>,
    pub legend: Vec<(Color, String)>,
}

/// Screen pixels for each of the image.
const SCALE: usize = 3;
const LINE_PX: f64 = 22.0;
const STROKE_PX: f64 = 1.5;
const CIRCLE_STEPS: usize = 24;

impl AnnotatedImage<'_> {
    /// Writes a PNG.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        super::write_file(path, &self.draw())
    }

    fn draw(&self) -> Vec<u8> {
        let legend_px = LINE_PX * (self.legend.len() as f64 + 0.5);
        let mut canvas = RasterCanvas::over_grey(self.image, SCALE, legend_px.ceil() as usize);
        // The centre of a pixel is half a pixel from its corner.
        let on_canvas = |at: [f64; 2]| at.map(|value| (value + 0.5) * SCALE as f64);
        for mark in &self.marks {
            let points: Vec<[f64; 2]> = match &mark.shape {
                MarkShape::Line(ends) => ends.to_vec(),
                MarkShape::Circle {
                    center_px: [x, y],
                    radius_px,
                } => (0..=CIRCLE_STEPS)
                    .map(|step| (step as f64 / CIRCLE_STEPS as f64 * TAU).sin_cos())
                    .map(|(sin, cos)| [x + radius_px * cos, y + radius_px * sin])
                    .collect(),
            };
            let points: Vec<[f64; 2]> = points.into_iter().map(on_canvas).collect();
            canvas.line(&points, mark.color, STROKE_PX, None);
        }
        let top = (self.image.height() * SCALE) as f64;
        for (idx, (color, text)) in self.legend.iter().enumerate() {
            let baseline = top + LINE_PX * (idx as f64 + 1.0) - 2.0;
            canvas.dots(&[[14.0, baseline - 5.0]], *color, 10.0);
            canvas.text([28.0, baseline], Anchor::Start, text);
        }
        canvas.finish()
    }
}
