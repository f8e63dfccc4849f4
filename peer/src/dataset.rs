//! Recordings as cameras: folders in TUM RGB-D, EuRoC or KITTI layout.

mod argument;
mod decode;
mod layout;
mod reader;

use std::path::{Path, PathBuf};

use camera::{Calibration, CalibrationError, Image};
use geometry::Timestamp;

pub use argument::{DatasetArgument, FrameRange, MalformedRange};
pub use decode::{ImageError, decode_grey, image_size};
pub use layout::Layout;
pub use reader::{Camera, CameraEvent, DatasetCamera, Frame};

/// A recording that can be read: its list of images and its calibration were checked.
#[derive(Clone, Debug)]
pub struct Dataset {
    folder: PathBuf,
    layout: Layout,
    calibration: Calibration,
    frames: Vec<FrameEntry>,
}

/// One image of a recording, not read yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameEntry {
    /// The number of the frame in the whole recording, from zero.
    pub frame_idx: usize,
    pub captured_at: Timestamp,
    pub path: PathBuf,
}

/// Why a recording is refused as a whole.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    #[error("no such folder: {folder}")]
    NoFolder { folder: PathBuf },
    #[error(
        "found none of rgb.txt (TUM RGB-D), mav0/cam0/data.csv (EuRoC), image_0 (KITTI); \
         images need a list with their time stamps, in {folder}"
    )]
    UnknownLayout { folder: PathBuf },
    #[error("{what} is not supported yet; export the images with an rgb.txt: {path}")]
    NotSupported { what: &'static str, path: PathBuf },
    #[error("cannot read: {error}: {path}")]
    Unreadable {
        error: std::io::Error,
        path: PathBuf,
    },
    #[error("{reason} at {path}:{line}")]
    Line {
        reason: String,
        path: PathBuf,
        line: usize,
    },
    #[error("lists no images: {path}")]
    NoImages { path: PathBuf },
    #[error("frames {range} of a recording of {frame_count}: {folder}")]
    EmptyRange {
        range: FrameRange,
        frame_count: usize,
        folder: PathBuf,
    },
    #[error("no calibration; expected one of {expected} in {folder}")]
    NoCalibration {
        expected: &'static str,
        folder: PathBuf,
    },
    #[error("calibration refused: {error}: {path}")]
    Calibration {
        error: CalibrationError,
        path: PathBuf,
    },
    #[error(
        "the calibration is for {expected_width}×{expected_height}, the image has \
         {got_width}×{got_height}: {path}"
    )]
    CalibrationSize {
        expected_width: usize,
        expected_height: usize,
        got_width: usize,
        got_height: usize,
        path: PathBuf,
    },
    #[error("none of the {frame_count} images can be decoded; the first: {first}")]
    NoImageDecodes {
        frame_count: usize,
        first: UnreadableImage,
    },
}

/// One image that is skipped, and why.
#[derive(Debug, thiserror::Error)]
#[error("{reason}: {path}")]
pub struct UnreadableImage {
    pub reason: ImageError,
    pub path: PathBuf,
}

impl Dataset {
    /// Opens a recording and checks that the calibration fits its images.
    pub fn open(argument: &DatasetArgument) -> Result<Self, DatasetError> {
        let folder = argument.folder.clone();
        let layout = Layout::detect(&folder)?;
        let all_frames = layout.list_frames(&folder)?;
        let frame_count = all_frames.len();
        let frames: Vec<FrameEntry> = match &argument.range {
            Some(range) => all_frames
                .into_iter()
                .filter(|frame| range.contains(frame.frame_idx))
                .collect(),
            None => all_frames,
        };
        if let Some(range) = argument.range.filter(|_| frames.is_empty()) {
            return Err(DatasetError::EmptyRange {
                range,
                frame_count,
                folder,
            });
        }
        let size = first_image_size(&frames)?;
        let calibration = layout.read_calibration(&folder, (size.width, size.height))?;
        let (width, height) = (calibration.camera.width(), calibration.camera.height());
        if (width, height) != (size.width, size.height) {
            return Err(DatasetError::CalibrationSize {
                expected_width: width,
                expected_height: height,
                got_width: size.width,
                got_height: size.height,
                path: size.path,
            });
        }
        Ok(Self {
            folder,
            layout,
            calibration,
            frames,
        })
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    pub fn layout(&self) -> Layout {
        self.layout
    }

    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// The frames of the chosen range, in the order of their strictly increasing time stamps.
    pub fn frames(&self) -> &[FrameEntry] {
        &self.frames
    }

    /// Reads and decodes one frame, and checks its size against the calibration.
    pub fn read_image(&self, entry: &FrameEntry) -> Result<Image, UnreadableImage> {
        let camera = &self.calibration.camera;
        read_image(&entry.path, (camera.width(), camera.height())).map_err(|reason| {
            UnreadableImage {
                reason,
                path: entry.path.clone(),
            }
        })
    }
}

struct FirstImage {
    width: usize,
    height: usize,
    path: PathBuf,
}

/// The size of the first image whose header can be read.
fn first_image_size(frames: &[FrameEntry]) -> Result<FirstImage, DatasetError> {
    let mut first_failure = None;
    for frame in frames {
        match read_bytes(&frame.path).and_then(|bytes| image_size(&bytes)) {
            Ok((width, height)) => {
                return Ok(FirstImage {
                    width,
                    height,
                    path: frame.path.clone(),
                });
            }
            Err(reason) => {
                first_failure.get_or_insert(UnreadableImage {
                    reason,
                    path: frame.path.clone(),
                });
            }
        }
    }
    Err(DatasetError::NoImageDecodes {
        frame_count: frames.len(),
        first: first_failure.expect("a range of frames is checked not to be empty"),
    })
}

fn read_image(path: &Path, expected: (usize, usize)) -> Result<Image, ImageError> {
    let bytes = read_bytes(path)?;
    let (got_width, got_height) = image_size(&bytes)?;
    if (got_width, got_height) != expected {
        return Err(ImageError::Size {
            got_width,
            got_height,
            expected_width: expected.0,
            expected_height: expected.1,
        });
    }
    decode_grey(&bytes)
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, ImageError> {
    std::fs::read(path).map_err(ImageError::File)
}

#[cfg(test)]
mod tests;
