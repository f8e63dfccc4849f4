//! Recordings as cameras: folders in TUM RGB-D, EuRoC or KITTI layout.

mod argument;
mod calibration_file;
mod decode;
mod layout;
mod reader;

use std::path::{Path, PathBuf};

use camera::{Calibration, CalibrationError, Image};
use geometry::Timestamp;

use crate::files::FileError;

pub use argument::{DatasetArgument, FrameRange, MalformedRange};
pub use calibration_file::CalibrationFile;
use decode::IMAGE_BYTES_MAX;
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
    /// A list or a calibration beside the images.
    #[error(transparent)]
    File(#[from] FileError),
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
        "the calibration is for {}×{}, the images have {}×{}: {calibration} and {image}",
        expected_px.0, expected_px.1, got_px.0, got_px.1
    )]
    CalibrationSize {
        expected_px: (usize, usize),
        got_px: (usize, usize),
        calibration: PathBuf,
        image: PathBuf,
    },
    #[error("no image could be decoded, of {frame_count}; the first: {first}")]
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
    /// Opens a recording with the calibration that lies beside its images.
    pub fn open(argument: &DatasetArgument) -> Result<Self, DatasetError> {
        Self::open_calibrated(argument, None)
    }

    /// Opens a recording and checks that an image can be decoded and has the calibration's size.
    ///
    /// - `given`: instead of the calibration beside the images, which then need not be there.
    pub fn open_calibrated(
        argument: &DatasetArgument,
        given: Option<CalibrationFile>,
    ) -> Result<Self, DatasetError> {
        let folder = argument.folder.clone();
        let layout = Layout::detect(&folder)?;
        let frames = choose_frames(layout.list_frames(&folder)?, argument)?;
        let (first_idx, first_size_px) = first_image(&frames)?;
        let file = match given {
            Some(file) => file,
            None => layout.read_calibration(&folder, first_size_px)?,
        };
        if !has_size_soon(&frames[first_idx..], file.size_px()) {
            return Err(DatasetError::CalibrationSize {
                expected_px: file.size_px(),
                got_px: first_size_px,
                calibration: file.path,
                image: frames[first_idx].path.clone(),
            });
        }
        Ok(Self {
            folder,
            layout,
            calibration: file.calibration,
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

fn choose_frames(
    all_frames: Vec<FrameEntry>,
    argument: &DatasetArgument,
) -> Result<Vec<FrameEntry>, DatasetError> {
    let Some(range) = argument.range else {
        return Ok(all_frames);
    };
    let frame_count = all_frames.len();
    let frames: Vec<FrameEntry> = all_frames
        .into_iter()
        .filter(|frame| range.contains(frame.frame_idx))
        .collect();
    if frames.is_empty() {
        return Err(DatasetError::EmptyRange {
            range,
            frame_count,
            folder: argument.folder.clone(),
        });
    }
    Ok(frames)
}

/// The first image that can be decoded, and its width and height.
fn first_image(frames: &[FrameEntry]) -> Result<(usize, (usize, usize)), DatasetError> {
    let mut first_failure = None;
    for (idx, frame) in frames.iter().enumerate() {
        match read_bytes(&frame.path).and_then(|bytes| decode_grey(&bytes)) {
            Ok(image) => return Ok((idx, (image.width(), image.height()))),
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

/// A recording may begin with images of another size; with more than these, it is the calibration
/// that is wrong.
const ODD_IMAGE_COUNT_MAX: usize = 10;

fn has_size_soon(frames: &[FrameEntry], size_px: (usize, usize)) -> bool {
    frames.iter().take(1 + ODD_IMAGE_COUNT_MAX).any(|frame| {
        let size = read_bytes(&frame.path).and_then(|bytes| image_size(&bytes));
        size.is_ok_and(|got_px| got_px == size_px)
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

/// Reads and decodes an image of any size.
pub fn read_grey(path: &Path) -> Result<Image, ImageError> {
    decode_grey(&read_bytes(path)?)
}

/// A pipe would be waited for, and a device read without end.
fn read_bytes(path: &Path) -> Result<Vec<u8>, ImageError> {
    let metadata = std::fs::metadata(path).map_err(ImageError::File)?;
    if !metadata.is_file() {
        return Err(ImageError::NoFile);
    }
    if metadata.len() > IMAGE_BYTES_MAX {
        return Err(ImageError::TooLarge {
            got_bytes: metadata.len(),
        });
    }
    std::fs::read(path).map_err(ImageError::File)
}

#[cfg(test)]
mod tests;
