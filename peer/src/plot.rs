//! Pictures of maps and trajectories, seen from above and from the side in metres, and of values
//! over time.

mod annotation;
mod axes;
mod axis;
mod canvas;
mod chart;
mod figure;
mod font;
mod raster;
mod svg;

use std::fs;
use std::path::Path;

use nalgebra::Vector3;

use crate::files::FileError;
use raster::RasterCanvas;
use svg::SvgCanvas;

pub use annotation::{AnnotatedImage, ImageMark, MarkShape};
pub use canvas::{Canvas, Color};
pub use chart::{Chart, ChartPanel, Curve};

/// One cloud or trajectory of a picture.
#[derive(Clone, Debug)]
pub struct Layer {
    /// Stands in the legend, unless it is empty.
    pub name: String,
    pub color: Color,
    pub mark: Mark,
    /// In the common frame, x to the right and z up.
    pub points: Vec<Vector3<f64>>,
}

/// How the points of a layer are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Each by itself. Large clouds are thinned evenly, and far outliers do not set the range.
    Dots,
    /// The same with larger dots, which show around those of a cloud that lies over them.
    LargeDots,
    /// Joined in their order.
    Line,
}

/// A picture with a view from above and one from the side; later layers lie over earlier ones.
#[derive(Clone, Debug)]
pub struct Plot {
    pub title: String,
    pub layers: Vec<Layer>,
}

/// A vehicle's own map and path, before and after they were placed on an anchor's map, all in the
/// global frame: the paper's Fig. 10.
#[derive(Clone, Debug, Default)]
pub struct Realignment {
    pub vehicle: String,
    pub anchor_cloud: Vec<Vector3<f64>>,
    pub cloud_before: Vec<Vector3<f64>>,
    pub path_before: Vec<Vector3<f64>>,
    pub cloud_after: Vec<Vector3<f64>>,
    pub path_after: Vec<Vector3<f64>>,
    pub truth: Vec<Vector3<f64>>,
}

impl Realignment {
    /// Anchor red, before blue, after green, truth purple; what is empty is left out.
    pub fn plot(self, title: impl Into<String>) -> Plot {
        let vehicle = self.vehicle;
        let layers = [
            (
                "anchor's map".to_owned(),
                Color::RED,
                Mark::LargeDots,
                self.anchor_cloud,
            ),
            (
                format!("{vehicle}'s map, before"),
                Color::BLUE,
                Mark::Dots,
                self.cloud_before,
            ),
            (
                format!("{vehicle}'s map, after"),
                Color::GREEN,
                Mark::Dots,
                self.cloud_after,
            ),
            (
                format!("{vehicle}'s path, before"),
                Color::BLUE,
                Mark::Line,
                self.path_before,
            ),
            (
                format!("{vehicle}'s path, after"),
                Color::GREEN,
                Mark::Line,
                self.path_after,
            ),
            (
                format!("{vehicle}'s path, truth"),
                Color::PURPLE,
                Mark::Line,
                self.truth,
            ),
        ];
        Plot {
            title: title.into(),
            layers: layers
                .into_iter()
                .filter(|(_, _, _, points)| !points.is_empty())
                .map(|(name, color, mark, points)| Layer {
                    name,
                    color,
                    mark,
                    points,
                })
                .collect(),
        }
    }
}

/// Something that can be drawn.
pub trait Picture {
    /// Draws everything and gives the width and height in pixels.
    fn draw(&self, canvas: &mut impl Canvas) -> [f64; 2];

    fn to_svg(&self) -> String {
        let mut canvas = SvgCanvas::default();
        let size_px = self.draw(&mut canvas);
        canvas.finish(size_px)
    }

    fn to_png(&self) -> Vec<u8> {
        // The size follows from the content, so the first pass only measures.
        let size_px = self.draw(&mut SvgCanvas::default());
        let mut canvas = RasterCanvas::new(size_px);
        self.draw(&mut canvas);
        canvas.finish()
    }

    /// Writes PNG or SVG, as the name says.
    fn write(&self, path: &Path) -> Result<(), FileError> {
        let bytes = match PictureFormat::of(path)? {
            PictureFormat::Svg => self.to_svg().into_bytes(),
            PictureFormat::Png => self.to_png(),
        };
        write_file(path, &bytes)
    }
}

impl Picture for Plot {
    fn draw(&self, canvas: &mut impl Canvas) -> [f64; 2] {
        figure::draw(self, canvas)
    }
}

/// The formats by the extension of a file's name.
enum PictureFormat {
    Svg,
    Png,
}

impl PictureFormat {
    fn of(path: &Path) -> Result<Self, FileError> {
        let extension = path.extension().unwrap_or_default().to_string_lossy();
        match extension.to_ascii_lowercase().as_str() {
            "svg" => Ok(Self::Svg),
            "png" => Ok(Self::Png),
            _ => Err(FileError::Content {
                reason: "expected a name that ends with .svg or .png".to_owned(),
                path: path.to_owned(),
            }),
        }
    }
}

/// Whether the extension names a format that pictures are written in.
pub fn check_picture_name(path: &Path) -> Result<(), FileError> {
    PictureFormat::of(path).map(drop)
}

fn write_file(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    fs::write(path, bytes).map_err(|error| FileError::Write {
        error,
        path: path.to_owned(),
    })
}

#[cfg(test)]
mod tests;
