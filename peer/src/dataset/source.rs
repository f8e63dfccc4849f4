//! The kinds of recordings, told apart by what is in them.

use std::path::{Path, PathBuf};

use super::decode::{self, Raster};
use super::mcap::{McapImages, McapRecording};
use super::video::{self, Video, VideoImages};
use super::{
    CalibrationFile, DatasetError, FrameEntry, ImageError, Layout, RecordingOptions, read_bytes,
};
use crate::files::NamedFile;

/// Where the images of a recording are.
#[derive(Clone, Debug)]
pub enum Source {
    Folder(Layout),
    Mcap(McapRecording),
    Video(Video),
}

/// Reads images in the order of their frames.
pub enum ImageReader {
    Files,
    Mcap(McapImages),
    Video(VideoImages),
}

impl Source {
    /// Also gives the path of the recording, which may be a file in the folder that is named.
    pub fn open(path: &Path, options: &RecordingOptions) -> Result<(Self, PathBuf), DatasetError> {
        if path.is_dir() {
            return match (Layout::detect(path), only_mcap(path)) {
                (Err(DatasetError::UnknownLayout { .. }), Some(file)) => {
                    Self::open_file(&file, options).map(|source| (source, file))
                }
                (layout, _) => {
                    let layout = layout?;
                    check_no_topic(path, options)?;
                    Ok((Self::Folder(layout), path.to_owned()))
                }
            };
        }
        if !path.exists() {
            return Err(DatasetError::Nothing {
                path: path.to_owned(),
            });
        }
        Ok((Self::open_file(path, options)?, path.to_owned()))
    }

    fn open_file(path: &Path, options: &RecordingOptions) -> Result<Self, DatasetError> {
        let extension = path.extension().unwrap_or_default().to_string_lossy();
        let refused = |what| {
            let path = path.to_owned();
            Err(DatasetError::UnknownFile { what, path })
        };
        if !path.is_file() {
            return refused("a pipe or device; recordings are read more than once");
        }
        match extension.to_ascii_lowercase().as_str() {
            "mcap" => {
                let recording = McapRecording::open(path, options.topic.as_deref());
                return recording
                    .map(Self::Mcap)
                    .map_err(|error| DatasetError::Mcap {
                        error,
                        path: path.to_owned(),
                    });
            }
            "bag" => {
                return refused("ROS 1 bags are not read; `mcap convert` makes an MCAP of one");
            }
            "db3" => {
                return refused(
                    "SQLite bags are not read; `ros2 bag convert` makes an MCAP of one",
                );
            }
            _ => check_no_topic(path, options)?,
        }
        let video = if video::is_y4m(path) {
            Video::open_y4m(path)
        } else if video::is_video(path) {
            Video::open(path, &options.ffmpeg)
        } else {
            return refused(
                "no recording that is known; expected a folder, an MCAP file (.mcap), or a video \
                 (.mp4, .mkv, .mov, .avi, .webm, .y4m)",
            );
        };
        video.map(Self::Video).map_err(|error| DatasetError::Video {
            error,
            path: path.to_owned(),
        })
    }

    /// The file that says which images there are, or the one that holds them.
    ///
    /// - `path`: of the recording.
    pub fn list(&self, path: &Path) -> NamedFile {
        match self {
            Self::Folder(layout) => {
                NamedFile::new("the recording's list of images", layout.list(path))
            }
            Self::Mcap(_) | Self::Video(_) => NamedFile::new("the recording", path),
        }
    }

    /// All frames, with increasing time stamps.
    ///
    /// - `path`: of the recording.
    pub fn list_frames(&self, path: &Path) -> Result<Vec<FrameEntry>, DatasetError> {
        let inside = |(frame_idx, captured_at)| FrameEntry {
            frame_idx,
            captured_at,
            path: path.to_owned(),
        };
        let frames: Vec<FrameEntry> = match self {
            Self::Folder(layout) => return layout.list_frames(path),
            Self::Mcap(recording) => recording.stamped().iter().copied().map(inside).collect(),
            Self::Video(video) => {
                let stamps = video.stamps().iter().copied().enumerate();
                stamps.map(inside).collect()
            }
        };
        if frames.is_empty() {
            let path = path.to_owned();
            return Err(DatasetError::NoImages { path });
        }
        Ok(frames)
    }

    /// The calibration in the recording or beside it.
    ///
    /// - `image_size_px`: width and height of an image, which KITTI's `calib.txt` does not say.
    pub fn read_calibration(
        &self,
        path: &Path,
        image_size_px: (usize, usize),
    ) -> Result<CalibrationFile, DatasetError> {
        let mut note = "";
        match self {
            Self::Folder(layout) => return layout.read_calibration(path, image_size_px),
            Self::Mcap(recording) => match recording.calibration() {
                Some(found) if found.info.is_calibrated() => {
                    return CalibrationFile::from_topic(found, path);
                }
                Some(_) => note = ", camera_info in the file (that which is there is empty)",
                None => note = ", camera_info in the file",
            },
            Self::Video(_) => {}
        }
        let beside = path.with_extension("yaml");
        let folder = path.parent().unwrap_or(Path::new(""));
        let others = CALIBRATION_NAMES.map(|name| folder.join(name));
        let mut candidates = std::iter::once(beside.clone()).chain(others);
        match candidates.find(|candidate| candidate.is_file()) {
            Some(file) => CalibrationFile::read(&file),
            None => Err(DatasetError::NoCalibration {
                expected: format!(
                    "{}{note}, {}",
                    beside.file_name().unwrap_or_default().to_string_lossy(),
                    CALIBRATION_NAMES.join(", ")
                ),
                path: path.to_owned(),
            }),
        }
    }

    pub fn images(&self) -> ImageReader {
        match self {
            Self::Folder(_) => ImageReader::Files,
            Self::Mcap(recording) => ImageReader::Mcap(recording.images()),
            Self::Video(video) => ImageReader::Video(video.images()),
        }
    }

    /// Whether an image is named by its own path.
    pub fn has_image_files(&self) -> bool {
        matches!(self, Self::Folder(_))
    }

    /// What of the recording cannot be used, though it should be there.
    pub fn losses(&self) -> Vec<String> {
        let (cut, count, disordered) = match self {
            Self::Folder(_) => return Vec::new(),
            Self::Mcap(recording) => (
                recording.cut(),
                recording.stamped().len(),
                recording.out_of_order_count(),
            ),
            Self::Video(video) => (video.cut(), video.stamps().len(), 0),
        };
        let cut = cut.map(|reason| format!("the recording ends after {count} images: {reason}"));
        let disordered = (disordered > 0).then(|| {
            format!("{disordered} images are left out, whose stamps are not after those before")
        });
        cut.into_iter().chain(disordered).collect()
    }
}

/// Calibrations are looked for under these names.
pub const CALIBRATION_NAMES: [&str; 5] = [
    "camera.yaml",
    "sensor.yaml",
    "camera_info.yaml",
    "camchain.yaml",
    "calibration.yaml",
];

impl ImageReader {
    /// - `entry`: not before the last one.
    pub fn read(&mut self, entry: &FrameEntry) -> Result<Raster, ImageError> {
        match self {
            Self::Files => decode::decode(&read_bytes(&entry.path)?),
            Self::Mcap(images) => images.read(entry.frame_idx),
            Self::Video(images) => images.read(entry.frame_idx),
        }
    }
}

fn check_no_topic(path: &Path, options: &RecordingOptions) -> Result<(), DatasetError> {
    match &options.topic {
        None => Ok(()),
        Some(topic) => Err(DatasetError::NoTopics {
            topic: topic.clone(),
            path: path.to_owned(),
        }),
    }
}

/// The one MCAP file of a folder, as `ros2 bag record` makes it.
fn only_mcap(folder: &Path) -> Option<PathBuf> {
    let entries = std::fs::read_dir(folder).ok()?;
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut files = paths.filter(|path| path.extension().is_some_and(|name| name == "mcap"));
    match (files.next(), files.next()) {
        (Some(only), None) => Some(only),
        _ => None,
    }
}
