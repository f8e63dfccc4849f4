//! Video files: YUV4MPEG2 read here, all others through ffmpeg.

mod ffmpeg;
mod y4m;

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};

use geometry::Timestamp;

use super::decode::{ImageError, Raster};
use ffmpeg::Decoder;
pub use ffmpeg::{Ffmpeg, FfmpegError};
use y4m::Y4mHeader;

/// A video whose frames are listed but not decoded.
#[derive(Clone, Debug)]
pub struct Video {
    path: PathBuf,
    /// `None` if the file is read here.
    ffmpeg: Option<Ffmpeg>,
    stamps: Vec<Timestamp>,
    cut: Option<String>,
}

/// Why a video is refused.
#[derive(Debug, thiserror::Error)]
pub enum VideoRefusal {
    #[error(transparent)]
    Ffmpeg(#[from] FfmpegError),
    #[error("cannot read: {0}")]
    File(#[from] std::io::Error),
    #[error("no YUV4MPEG2 that can be read: {0}")]
    Y4m(String),
    #[error("the header states no frame rate")]
    NoRate,
}

/// What the names of video files end with.
const EXTENSIONS: [&str; 15] = [
    "mp4", "m4v", "mov", "mkv", "webm", "avi", "mpg", "mpeg", "ts", "mts", "m2ts", "wmv", "flv",
    "ogv", "3gp",
];

/// Whether the name says that this is a video.
pub fn is_video(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    EXTENSIONS.contains(&extension.to_ascii_lowercase().as_str())
}

/// Whether the file begins as YUV4MPEG2 does.
pub fn is_y4m(path: &Path) -> bool {
    let mut begin = [0; y4m::SIGNATURE.len()];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut begin));
    read.is_ok() && begin == y4m::SIGNATURE
}

impl Video {
    /// Through ffmpeg.
    pub fn open(path: &Path, ffmpeg: &Ffmpeg) -> Result<Self, VideoRefusal> {
        let (mut stamps, cut) = ffmpeg.list_stamps(path)?;
        // Two frames at one time are one frame that is shown and one that was repaired.
        stamps.dedup();
        Ok(Self {
            path: path.to_owned(),
            ffmpeg: Some(ffmpeg.clone()),
            stamps,
            cut,
        })
    }

    pub fn open_y4m(path: &Path) -> Result<Self, VideoRefusal> {
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        let mut input = BufReader::new(file);
        let header = Y4mHeader::read(&mut input).map_err(VideoRefusal::Y4m)?;
        let (frames, seconds) = header.rate;
        if frames == 0 || seconds == 0 {
            return Err(VideoRefusal::NoRate);
        }
        let mut stamps = Vec::new();
        let frame_bytes = header.frame_bytes() as u64;
        let cut = loop {
            match y4m::read_frame_line(&mut input) {
                Ok(true) => {}
                Ok(false) => break None,
                Err(reason) => break Some(reason),
            }
            let position = input.stream_position()?;
            if position + frame_bytes > length {
                break Some("it ends in a frame".to_owned());
            }
            input.seek_relative(frame_bytes as i64)?;
            let frame_idx = stamps.len() as u128;
            let ns = frame_idx * 1_000_000_000 * u128::from(seconds) / u128::from(frames);
            stamps.push(Timestamp::from_nanoseconds(ns as i64));
        };
        let cut = cut.map(|reason| format!("damaged after frame {}: {reason}", stamps.len()));
        Ok(Self {
            path: path.to_owned(),
            ffmpeg: None,
            stamps,
            cut,
        })
    }

    /// When each frame is shown.
    pub fn stamps(&self) -> &[Timestamp] {
        &self.stamps
    }

    /// Where and why the file ends too early.
    pub fn cut(&self) -> Option<&str> {
        self.cut.as_deref()
    }

    pub fn images(&self) -> VideoImages {
        VideoImages {
            frames: self.start(),
            next_idx: 0,
        }
    }

    fn start(&self) -> Result<Frames, String> {
        let mut source = match &self.ffmpeg {
            Some(ffmpeg) => {
                let decoder = ffmpeg.decode(&self.path);
                FrameSource::Ffmpeg(decoder.map_err(|error| error.to_string())?)
            }
            None => {
                let file = File::open(&self.path).map_err(|error| error.to_string())?;
                FrameSource::File(BufReader::new(file))
            }
        };
        let header = match &mut source {
            FrameSource::File(file) => Y4mHeader::read(file)?,
            FrameSource::Ffmpeg(decoder) => Y4mHeader::read(&mut decoder.frames)
                .map_err(|_| format!("ffmpeg says: {}", decoder.last_words()))?,
        };
        Ok(Frames { header, source })
    }
}

/// Reads frames in order.
pub struct VideoImages {
    frames: Result<Frames, String>,
    next_idx: usize,
}

struct Frames {
    header: Y4mHeader,
    source: FrameSource,
}

enum FrameSource {
    File(BufReader<File>),
    Ffmpeg(Decoder),
}

impl VideoImages {
    /// - `frame_idx`: not before the last one.
    pub fn read(&mut self, frame_idx: usize) -> Result<Raster, ImageError> {
        loop {
            let frames = self.frames.as_mut();
            let frames = frames.map_err(|reason| ImageError::Ended(reason.clone()))?;
            match frames.next() {
                Ok(raster) => {
                    self.next_idx += 1;
                    if self.next_idx > frame_idx {
                        return Ok(raster);
                    }
                }
                Err(reason) => self.frames = Err(reason),
            }
        }
    }
}

impl Frames {
    fn next(&mut self) -> Result<Raster, String> {
        let next = match &mut self.source {
            FrameSource::File(file) => self.header.read_frame(file),
            FrameSource::Ffmpeg(decoder) => self.header.read_frame(&mut decoder.frames),
        };
        match (next, &mut self.source) {
            (Ok(Some(raster)), _) => Ok(raster),
            (Ok(None) | Err(_), FrameSource::Ffmpeg(decoder)) => {
                let frames = "ffmpeg gave fewer frames than the file lists, and says";
                Err(format!("{frames}: {}", decoder.last_words()))
            }
            (Ok(None), FrameSource::File(_)) => Err("end of file".to_owned()),
            (Err(reason), FrameSource::File(_)) => Err(reason),
        }
    }
}

#[cfg(test)]
mod tests;
