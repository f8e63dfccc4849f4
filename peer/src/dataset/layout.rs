//! Where each kind of folder keeps its images, time stamps and calibration.

use std::fs;
use std::path::{Path, PathBuf};

use geometry::Timestamp;

use super::calibration_file::SizelessCalibration;
use super::source::CALIBRATION_NAMES;
use super::{CalibrationFile, DatasetError, FrameEntry};
use crate::files::{FileError, parse_seconds};

/// How a recording's folder is arranged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// `rgb.txt` with lines `timestamp path`, seconds.
    TumRgbd,
    /// `mav0/cam0/data.csv` with lines `timestamp,name`, nanoseconds.
    Euroc,
    /// `image_0/*.png` in the order of `times.txt`, seconds.
    Kitti,
}

impl Layout {
    pub fn detect(folder: &Path) -> Result<Self, DatasetError> {
        let path = || folder.to_owned();
        if !folder.exists() {
            return Err(DatasetError::Nothing { path: path() });
        }
        if !folder.is_dir() {
            let what = "a file, expected a folder of images";
            return Err(DatasetError::UnknownFile { what, path: path() });
        }
        if folder.join("rgb.txt").is_file() {
            Ok(Self::TumRgbd)
        } else if euroc_camera(folder).join("data.csv").is_file() {
            Ok(Self::Euroc)
        } else if folder.join("image_0").is_dir() {
            Ok(Self::Kitti)
        } else {
            Err(DatasetError::UnknownLayout {
                folder: folder.to_owned(),
            })
        }
    }

    /// The file with the time stamps.
    pub fn list(self, folder: &Path) -> PathBuf {
        match self {
            Self::TumRgbd => folder.join("rgb.txt"),
            Self::Euroc => euroc_camera(folder).join("data.csv"),
            Self::Kitti => folder.join("times.txt"),
        }
    }

    /// All frames with strictly increasing time stamps.
    pub fn list_frames(self, folder: &Path) -> Result<Vec<FrameEntry>, DatasetError> {
        let list = self.list(folder);
        let frames = match self {
            Self::TumRgbd => read_list(&list, |line| read_tum_line(folder, line))?,
            Self::Euroc => {
                let images = euroc_camera(folder).join("data");
                read_list(&list, |line| read_euroc_line(&images, line))?
            }
            Self::Kitti => list_kitti(folder, list.clone())?,
        };
        if frames.is_empty() {
            return Err(DatasetError::NoImages { path: list });
        }
        Ok(frames)
    }

    /// The calibration beside the images.
    ///
    /// - `image_size_px`: width and height of an image, which KITTI's `calib.txt` does not say.
    pub fn read_calibration(
        self,
        folder: &Path,
        image_size_px: (usize, usize),
    ) -> Result<CalibrationFile, DatasetError> {
        let camera = (self == Self::Euroc).then(|| euroc_camera(folder).join("sensor.yaml"));
        let names = CALIBRATION_NAMES.map(|name| folder.join(name));
        let mut candidates = camera.into_iter().chain(names);
        if let Some(path) = candidates.find(|path| path.is_file()) {
            return CalibrationFile::read(&path);
        }
        let kitti = folder.join("calib.txt");
        if self == Self::Kitti && kitti.is_file() {
            return SizelessCalibration::read(&kitti)?.for_images(image_size_px);
        }
        let first = match self {
            Self::TumRgbd => "",
            Self::Euroc => "mav0/cam0/sensor.yaml, ",
            Self::Kitti => "calib.txt (with P0), ",
        };
        Err(DatasetError::NoCalibration {
            expected: format!("{first}{}", CALIBRATION_NAMES.join(", ")),
            path: folder.to_owned(),
        })
    }
}

/// The folder of the first camera: users name the recording, its `mav0`, or the camera itself.
fn euroc_camera(folder: &Path) -> PathBuf {
    let nested = folder.join("mav0/cam0");
    if nested.is_dir() {
        nested
    } else if folder.join("data").is_dir() {
        folder.to_owned()
    } else {
        folder.join("cam0")
    }
}

pub fn read_text(path: &Path) -> Result<String, DatasetError> {
    let text = fs::read_to_string(path).map_err(|error| {
        let path = path.to_owned();
        FileError::Read { error, path }
    })?;
    // Spreadsheets begin their files with a byte order mark.
    Ok(match text.strip_prefix('\u{feff}') {
        Some(text) => text.to_owned(),
        None => text,
    })
}

/// Reads a list with one image a line; `#` starts a comment.
fn read_list(
    list: &Path,
    read_line: impl Fn(&str) -> Result<(Timestamp, PathBuf), String>,
) -> Result<Vec<FrameEntry>, DatasetError> {
    let text = read_text(list)?;
    let mut frames: Vec<FrameEntry> = Vec::new();
    for (line_idx, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let previous = frames.last().map(|frame| frame.captured_at);
        let (captured_at, path) = read_line(line)
            .and_then(|(captured_at, path)| {
                check_increasing(previous, captured_at).map(|()| (captured_at, path))
            })
            .map_err(|reason| FileError::Line {
                reason,
                path: list.to_owned(),
                line: line_idx + 1,
            })?;
        frames.push(FrameEntry {
            frame_idx: frames.len(),
            captured_at,
            path,
        });
    }
    Ok(frames)
}

fn check_increasing(previous: Option<Timestamp>, captured_at: Timestamp) -> Result<(), String> {
    match previous {
        Some(previous) if captured_at <= previous => Err(format!(
            "time stamp {captured_at} is not after the one before, {previous}"
        )),
        _ => Ok(()),
    }
}

fn read_tum_line(folder: &Path, line: &str) -> Result<(Timestamp, PathBuf), String> {
    let (stamp, name) = line
        .split_once(char::is_whitespace)
        .ok_or_else(|| format!("expected `timestamp path`, got {line:?}"))?;
    let captured_at =
        parse_seconds(stamp).ok_or_else(|| format!("{stamp:?} is no time stamp in seconds"))?;
    Ok((captured_at, folder.join(name.trim())))
}

fn read_euroc_line(images: &Path, line: &str) -> Result<(Timestamp, PathBuf), String> {
    let (stamp, name) = line
        .split_once(',')
        .ok_or_else(|| format!("expected `timestamp,name`, got {line:?}"))?;
    let nanoseconds = stamp
        .trim()
        .parse()
        .map_err(|_| format!("{stamp:?} is no time stamp in nanoseconds"))?;
    Ok((
        Timestamp::from_nanoseconds(nanoseconds),
        images.join(name.trim()),
    ))
}

const IMAGE_EXTENSIONS: [&str; 5] = ["png", "jpg", "jpeg", "pgm", "ppm"];

fn list_kitti(folder: &Path, times: PathBuf) -> Result<Vec<FrameEntry>, DatasetError> {
    let images = folder.join("image_0");
    let unreadable = |error| FileError::Read {
        error,
        path: images.clone(),
    };
    let mut paths = Vec::new();
    for entry in fs::read_dir(&images).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        // File managers leave files of their own.
        if path
            .extension()
            .is_some_and(|name| IMAGE_EXTENSIONS.iter().any(|one| name == *one))
        {
            paths.push(path);
        }
    }
    paths.sort();
    let mut frames = read_list(&times, |line| {
        let captured_at =
            parse_seconds(line).ok_or_else(|| format!("{line:?} is no time stamp in seconds"))?;
        Ok((captured_at, PathBuf::new()))
    })?;
    if frames.len() != paths.len() {
        return Err(FileError::Line {
            reason: format!(
                "{} time stamps for {} images in image_0",
                frames.len(),
                paths.len()
            ),
            path: times,
            line: frames.len(),
        }
        .into());
    }
    for (frame, path) in frames.iter_mut().zip(paths) {
        frame.path = path;
    }
    Ok(frames)
}
