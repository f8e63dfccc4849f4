//! Video through an installed `ffmpeg`, in a process of its own.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::thread::JoinHandle;

use geometry::Timestamp;

/// The program, as it is found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ffmpeg {
    pub program: PathBuf,
}

/// Why a video cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FfmpegError {
    #[error(
        "video is decoded by ffmpeg, which cannot be run as {program:?}: {error}; install it \
         (Debian and Ubuntu: apt install ffmpeg) or export the images with an rgb.txt"
    )]
    NotRunnable {
        program: PathBuf,
        error: std::io::Error,
    },
    #[error("ffmpeg says: {0}")]
    Failed(String),
    #[error("ffmpeg's list of frames has {0:?}, expected stream, time stamps, length and size")]
    Malformed(String),
    #[error("frame {frame_idx} has no time stamp")]
    NoStamp { frame_idx: usize },
}

/// A running decoder; stopped when it is dropped.
pub struct Decoder {
    child: Child,
    pub frames: BufReader<ChildStdout>,
    last_words: Option<JoinHandle<String>>,
}

/// What ffmpeg's readers say of files that end too early, though they read what is there.
const CUT_OFF: [&str; 3] = ["ended prematurely", "partial file", "truncat"];
/// What libavformat says where there is no time stamp.
const NO_STAMP: i64 = i64::MIN;
/// The flag of a packet that is decoded but not shown.
const DISCARDED: u64 = 4;

impl Default for Ffmpeg {
    fn default() -> Self {
        Self {
            program: "ffmpeg".into(),
        }
    }
}

impl Ffmpeg {
    /// When each frame is shown, in order, from the container: nothing is decoded. And what is
    /// said of a file that was cut off.
    pub fn list_stamps(
        &self,
        path: &Path,
    ) -> Result<(Vec<Timestamp>, Option<String>), FfmpegError> {
        let arguments = ["-map", "0:v:0", "-c", "copy", "-f", "framecrc", "-"];
        let mut decoder = self.start(path, &["-copyts"], &arguments)?;
        let mut list = String::new();
        let read = decoder.frames.read_to_string(&mut list);
        let last_words = decoder.last_words();
        let has_failed = !decoder.child.wait().is_ok_and(|status| status.success());
        read.map_err(|error| FfmpegError::Failed(error.to_string()))?;
        if has_failed && !list.lines().any(|line| !line.starts_with('#')) {
            return Err(FfmpegError::Failed(last_words));
        }
        let is_cut = CUT_OFF.iter().any(|words| last_words.contains(words));
        let cut = is_cut.then(|| FfmpegError::Failed(last_words).to_string());
        Ok((parse_stamps(&list)?, cut))
    }

    /// The frames as grey YUV4MPEG2, each once.
    pub fn decode(&self, path: &Path) -> Result<Decoder, FfmpegError> {
        let each_once = each_frame_once(self.version()?);
        let format = [
            "-pix_fmt",
            "gray",
            // The format knows no grey, officially.
            "-strict",
            "-1",
            "-f",
            "yuv4mpegpipe",
            "-",
        ];
        let arguments = [&["-map", "0:v:0"], &each_once[..], &format].concat();
        self.start(path, &[], &arguments)
    }

    /// `None` if it has no numbers.
    fn version(&self) -> Result<Option<(u32, u32)>, FfmpegError> {
        let said = Command::new(&self.program).arg("-version").output();
        let said = said.map_err(|error| self.not_runnable(error))?;
        Ok(parse_version(&String::from_utf8_lossy(&said.stdout)))
    }

    fn start(&self, path: &Path, before: &[&str], after: &[&str]) -> Result<Decoder, FfmpegError> {
        let mut command = Command::new(&self.program);
        command.args(["-nostdin", "-v", "error"]).args(before);
        // Without the prefix a name with a colon would be taken for a protocol.
        let mut input = OsString::from("file:");
        input.push(path);
        command.arg("-i").arg(input).args(after);
        let pipes = command.stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = pipes
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| self.not_runnable(error))?;
        let (Some(stdout), Some(stderr)) = (child.stdout.take(), child.stderr.take()) else {
            unreachable!("both were asked for as pipes");
        };
        Ok(Decoder {
            child,
            frames: BufReader::with_capacity(1 << 16, stdout),
            last_words: Some(std::thread::spawn(|| last_line(BufReader::new(stderr)))),
        })
    }

    fn not_runnable(&self, error: std::io::Error) -> FfmpegError {
        FfmpegError::NotRunnable {
            program: self.program.clone(),
            error,
        }
    }
}

impl Decoder {
    /// The last line that it said on stderr, waited for. If it has more frames, it is stopped.
    pub fn last_words(&mut self) -> String {
        let has_ended = self.frames.fill_buf().is_ok_and(<[u8]>::is_empty);
        if !has_ended {
            // Nobody reads on, and it would wait for that.
            let _ = self.child.kill();
        }
        let said = self.last_words.take().and_then(|thread| thread.join().ok());
        let said = said.filter(|line| !line.is_empty());
        said.unwrap_or_else(|| "nothing".to_owned())
    }
}

impl Drop for Decoder {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads to the end, so that the program never waits for its reader.
fn last_line(stderr: impl BufRead) -> String {
    let lines = stderr.split(b'\n').map_while(Result::ok);
    let lines = lines.map(|line| String::from_utf8_lossy(&line).trim().to_owned());
    let last = lines.filter(|line| !line.is_empty()).last();
    last.unwrap_or_default()
}

/// The option that keeps ffmpeg from doubling and dropping frames; it was renamed in 5.1.
fn each_frame_once(version: Option<(u32, u32)>) -> [&'static str; 2] {
    match version {
        Some(version) if version < (5, 1) => ["-vsync", "passthrough"],
        _ => ["-fps_mode", "passthrough"],
    }
}

/// `ffmpeg version 4.4.2-0ubuntu0 …` or `n7.1`; `None` of a version that has no numbers, as those
/// built from the newest sources.
fn parse_version(said: &str) -> Option<(u32, u32)> {
    let version = said
        .strip_prefix("ffmpeg version ")?
        .split_whitespace()
        .next()?;
    let mut numbers = version.trim_start_matches('n').split(['.', '-']);
    let major = numbers.next()?.parse().ok()?;
    let minor = numbers.next().and_then(|minor| minor.parse().ok());
    Some((major, minor.unwrap_or(0)))
}

/// Reads ffmpeg's list `stream, decoded at, shown at, duration, size, checksum[, F=flags]`, in
/// which packets are in the order of decoding.
fn parse_stamps(list: &str) -> Result<Vec<Timestamp>, FfmpegError> {
    let mut unit = None;
    let mut shown = Vec::new();
    for line in list.lines() {
        if let Some(header) = line.strip_prefix('#') {
            unit = unit.or_else(|| parse_unit(header));
            continue;
        }
        let malformed = || FfmpegError::Malformed(line.to_owned());
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let &[_, decoded_at, shown_at, _, _, _, ref rest @ ..] = fields.as_slice() else {
            return Err(malformed());
        };
        let flags = rest.iter().find_map(|field| field.strip_prefix("F=0x"));
        let flags = flags.and_then(|flags| u64::from_str_radix(flags, 16).ok());
        if flags.is_some_and(|flags| flags & DISCARDED != 0) {
            continue;
        }
        let number = |text: &str| text.parse::<i64>().map_err(|_| malformed());
        let (decoded_at, shown_at) = (number(decoded_at)?, number(shown_at)?);
        // Without reordering both are the same, and some containers have only one.
        let ticks = if shown_at == NO_STAMP {
            decoded_at
        } else {
            shown_at
        };
        if ticks == NO_STAMP {
            let frame_idx = shown.len();
            return Err(FfmpegError::NoStamp { frame_idx });
        }
        let (numerator, denominator) = unit.ok_or_else(malformed)?;
        let ns =
            i128::from(ticks) * 1_000_000_000 * i128::from(numerator) / i128::from(denominator);
        let ns = i64::try_from(ns).map_err(|_| malformed())?;
        shown.push(Timestamp::from_nanoseconds(ns));
    }
    shown.sort();
    Ok(shown)
}

/// `tb 0: 1/15360`.
fn parse_unit(header: &str) -> Option<(u32, u32)> {
    let (_, unit) = header.strip_prefix("tb ")?.split_once(": ")?;
    let (numerator, denominator) = unit.trim().split_once('/')?;
    let denominator: u32 = denominator.parse().ok()?;
    Some((numerator.parse().ok()?, denominator)).filter(|_| denominator > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_listed_in_the_order_in_which_they_are_shown() {
        let list = "#software: Lavf60\n#tb 0: 1/15360\n#codec_id 0: h264\n\
                    0, -1024, -512, 512, 2611, 0x6ba4a8d3, F=0x5\n\
                    0, -512, 0, 512, 134, 0x86a73d7f\n\
                    0, 0, 1536, 512, 111, 0xc119327c, F=0x0\n\
                    0, 512, 512, 512, 108, 0xabdf336b, F=0x0\n\
                    0, 1024, -9223372036854775808, 512, 108, 0xabdf336b, S=1, 8, 0x0\n";
        let stamps = parse_stamps(list).unwrap();
        let ns: Vec<i64> = stamps.iter().map(|stamp| stamp.nanoseconds()).collect();
        assert_eq!(ns, [0, 33_333_333, 66_666_666, 100_000_000]);
    }

    #[test]
    fn lists_that_cannot_be_used_are_named() {
        let check = |list: &str, expected: &str| {
            let error = parse_stamps(list).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        };
        check("0, 1, 2, 3, 4, 0x5\n", "has \"0, 1, 2");
        check("#tb 0: 1/0\n0, 1, 2, 3, 4, 0x5\n", "has \"0, 1, 2");
        check("#tb 0: 1/5\n0, 1, x, 3, 4, 0x5\n", "has \"0, 1, x");
        check("#tb 0: 1/5\n0, 1\n", "has \"0, 1\"");
        let none = format!("#tb 0: 1/5\n0, {NO_STAMP}, {NO_STAMP}, 3, 4, 0x5\n");
        check(&none, "frame 0 has no time stamp");
    }

    #[test]
    fn versions_are_numbers_or_unknown() {
        let check = |said: &str, expected: Option<(u32, u32)>| {
            assert_eq!(parse_version(said), expected, "{said}");
        };
        check(
            "ffmpeg version 4.4.2-0ubuntu0.22.04.1 Copyright",
            Some((4, 4)),
        );
        check(
            "ffmpeg version n9.0.2-17-g2a571b6068 Copyright",
            Some((9, 0)),
        );
        check("ffmpeg version 5.1.6-0+deb12u1 Copyright", Some((5, 1)));
        check("ffmpeg version 7 Copyright", Some((7, 0)));
        check("ffmpeg version N-109542-g2a571b Copyright", None);
        check("", None);
        assert_eq!(each_frame_once(Some((4, 4)))[0], "-vsync");
        assert_eq!(each_frame_once(Some((5, 1)))[0], "-fps_mode");
        assert_eq!(each_frame_once(None)[0], "-fps_mode");
    }
}
