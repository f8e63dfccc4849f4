//! Recordings as cameras: folders in TUM RGB-D, EuRoC or KITTI layout, MCAP files, videos.

mod argument;
mod calibration_file;
mod decode;
mod error;
mod layout;
mod mcap;
mod reader;
mod source;
mod video;

use std::path::{Path, PathBuf};

use camera::{Calibration, Image};
use geometry::Timestamp;

use crate::files::NamedFile;
pub use argument::{DatasetArgument, FrameRange, MalformedRange};
pub use calibration_file::CalibrationFile;
use calibration_file::GivenCalibration;
use decode::{BitDepth, IMAGE_BYTES_MAX};
pub use decode::{ImageError, decode_grey};
pub use error::{DatasetError, UnreadableImage};
pub use layout::Layout;
pub use reader::{Camera, CameraEvent, DatasetCamera, Frame};
use source::{ImageReader, Source};
pub use video::Ffmpeg;

/// A recording that can be read: its list of images and its calibration were checked.
#[derive(Clone, Debug)]
pub struct Dataset {
    source: Source,
    calibration: Calibration,
    frames: Vec<FrameEntry>,
    /// Of images with 16 bits.
    depth: BitDepth,
    losses: Vec<String>,
    /// What was read beside the images.
    files: Vec<NamedFile>,
}

/// One image of a recording, not read yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameEntry {
    /// The number of the frame in the whole recording, from zero.
    pub frame_idx: usize,
    pub captured_at: Timestamp,
    /// Of the image, or of the recording that it is in.
    pub path: PathBuf,
}

/// What a recording does not say itself.
#[derive(Clone, Debug, Default)]
pub struct RecordingOptions {
    /// Instead of the calibration in the recording or beside it, which then need not be there.
    pub calibration: Option<PathBuf>,
    /// Which images of an MCAP file, where there are several kinds.
    pub topic: Option<String>,
    pub ffmpeg: Ffmpeg,
}

impl Dataset {
    /// Opens a recording with the calibration in it or beside it.
    pub fn open(argument: &DatasetArgument) -> Result<Self, DatasetError> {
        Self::open_with(argument, &RecordingOptions::default())
    }

    /// Opens a recording and checks that an image can be decoded and has the calibration's size.
    pub fn open_with(
        argument: &DatasetArgument,
        options: &RecordingOptions,
    ) -> Result<Self, DatasetError> {
        let given = options.calibration.as_deref().map(GivenCalibration::read);
        let given = given.transpose()?;
        let (source, path) = Source::open(&argument.path, options)?;
        let all_frames = source.list_frames(&path)?;
        let frame_count = all_frames.len();
        let frames = choose_frames(all_frames, argument)?;
        let mut first = FirstImages::new(&source, &frames)?;
        let file = match given {
            Some(given) => given.for_images(first.size_px)?,
            None => source.read_calibration(&path, first.size_px)?,
        };
        let files = vec![
            source.list(&path),
            NamedFile::new("the calibration", &file.path),
        ];
        let Some(depth) = first.look_further(file.size_px()) else {
            return Err(DatasetError::CalibrationSize {
                expected_px: file.size_px(),
                got_px: first.size_px,
                calibration: file.path,
                image: first.path,
            });
        };
        // What is lost behind the chosen frames is not missed.
        let range_end = argument.range.and_then(|range| range.end);
        let losses = match range_end {
            Some(end) if end <= frame_count => Vec::new(),
            _ => {
                let losses = source.losses().into_iter();
                losses
                    .map(|loss| format!("{loss}: {}", path.display()))
                    .collect()
            }
        };
        Ok(Self {
            source,
            calibration: file.calibration,
            frames,
            depth,
            losses,
            files,
        })
    }

    /// `None` of a recording in one file.
    pub fn layout(&self) -> Option<Layout> {
        match self.source {
            Source::Folder(layout) => Some(layout),
            Source::Mcap(_) | Source::Video(_) => None,
        }
    }

    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// The frames of the chosen range, in the order of their strictly increasing time stamps.
    pub fn frames(&self) -> &[FrameEntry] {
        &self.frames
    }

    /// What should be in the recording and is not, a sentence each.
    pub fn losses(&self) -> &[String] {
        &self.losses
    }

    /// All files that are read, or were.
    pub fn files(&self) -> impl Iterator<Item = NamedFile> {
        let frames = self.frames.iter();
        let is_file_each = self.source.has_image_files();
        let images = frames.filter(move |_| is_file_each);
        let images = images.map(|entry| NamedFile::new("an image of the recording", &entry.path));
        self.files.iter().cloned().chain(images)
    }

    /// Reads the frames one after the other.
    pub fn images(&self) -> DatasetImages {
        DatasetImages {
            reader: self.source.images(),
            is_file_each: self.source.has_image_files(),
            expected_px: (
                self.calibration.camera.width(),
                self.calibration.camera.height(),
            ),
            depth: self.depth,
            is_mosaic: self.calibration.is_mosaic,
        }
    }
}

/// Images of a dataset as its camera sees them.
pub struct DatasetImages {
    reader: ImageReader,
    is_file_each: bool,
    expected_px: (usize, usize),
    depth: BitDepth,
    is_mosaic: bool,
}

impl DatasetImages {
    /// Reads and decodes one frame, and checks its size against the calibration.
    ///
    /// - `entry`: not before the last one.
    pub fn read(&mut self, entry: &FrameEntry) -> Result<Image, UnreadableImage> {
        let raster = self.reader.read(entry).and_then(|raster| {
            let (expected_width, expected_height) = self.expected_px;
            if raster.size_px() == self.expected_px {
                return Ok(raster);
            }
            Err(ImageError::Size {
                got_width: raster.width,
                got_height: raster.height,
                expected_width,
                expected_height,
            })
        });
        match raster {
            Ok(raster) => Ok(raster.into_image(self.depth, self.is_mosaic)),
            Err(reason) => Err(unreadable(reason, entry, self.is_file_each)),
        }
    }
}

fn unreadable(reason: ImageError, entry: &FrameEntry, is_file_each: bool) -> UnreadableImage {
    UnreadableImage {
        reason,
        path: entry.path.clone(),
        frame_idx: (!is_file_each).then_some(entry.frame_idx),
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
            path: argument.path.clone(),
        });
    }
    Ok(frames)
}

/// What the first images of a recording say about all of them.
struct FirstImages<'a> {
    reader: ImageReader,
    rest: &'a [FrameEntry],
    /// Of the first one that can be decoded.
    size_px: (usize, usize),
    path: PathBuf,
    bits_needed: Option<u32>,
}

/// A recording may begin with images of another size; with more than these, it is the calibration
/// that is wrong. So many also say how many bits there are.
const FIRST_IMAGES_MAX: usize = 10;

impl<'a> FirstImages<'a> {
    fn new(source: &Source, frames: &'a [FrameEntry]) -> Result<Self, DatasetError> {
        let mut reader = source.images();
        let mut first_failure = None;
        for (idx, entry) in frames.iter().enumerate() {
            match reader.read(entry) {
                Ok(raster) => {
                    return Ok(Self {
                        reader,
                        rest: &frames[idx + 1..],
                        size_px: raster.size_px(),
                        path: entry.path.clone(),
                        bits_needed: raster.bits_needed(),
                    });
                }
                Err(reason) => {
                    let is_file_each = source.has_image_files();
                    first_failure.get_or_insert_with(|| unreadable(reason, entry, is_file_each));
                }
            }
        }
        Err(DatasetError::NoImageDecodes {
            frame_count: frames.len(),
            first: first_failure.expect("a range of frames is checked not to be empty"),
        })
    }

    /// How many bits the images have; `None` if none of the first ones has this size.
    fn look_further(&mut self, expected_px: (usize, usize)) -> Option<BitDepth> {
        let mut has_size = self.size_px == expected_px;
        for entry in self.rest.iter().take(FIRST_IMAGES_MAX) {
            if has_size && self.bits_needed.is_none() {
                break;
            }
            if let Ok(raster) = self.reader.read(entry) {
                has_size |= raster.size_px() == expected_px;
                self.bits_needed = self.bits_needed.max(raster.bits_needed());
            }
        }
        has_size.then(|| BitDepth::of(self.bits_needed))
    }
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
