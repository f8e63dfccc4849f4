use std::fs;

use super::*;
use crate::dataset::decode::Samples;

fn film(frame_count: u8) -> Vec<u8> {
    let mut bytes = b"YUV4MPEG2 W32 H24 F20:1 Ip C420jpeg\n".to_vec();
    for frame in 0..frame_count {
        bytes.extend_from_slice(b"FRAME\n");
        bytes.resize(bytes.len() + 32 * 24, 10 * frame);
        bytes.resize(bytes.len() + 2 * 16 * 12, 128);
    }
    bytes
}

fn shade(raster: Raster) -> u8 {
    match raster.samples {
        Samples::Eight(values) => values[17],
        Samples::Sixteen { .. } => 0,
    }
}

#[test]
fn y4m_is_read_without_help_and_frames_may_be_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("film.y4m");
    fs::write(&path, film(5)).unwrap();
    assert!(is_y4m(&path));
    let video = Video::open_y4m(&path).unwrap();
    let stamps: Vec<i64> = video
        .stamps()
        .iter()
        .map(|stamp| stamp.nanoseconds())
        .collect();
    assert_eq!(
        stamps,
        [0, 50_000_000, 100_000_000, 150_000_000, 200_000_000]
    );
    assert_eq!(video.cut(), None);
    let mut images = video.images();
    assert_eq!(shade(images.read(1).unwrap()), 10);
    assert_eq!(shade(images.read(4).unwrap()), 40);
    let error = images.read(5).unwrap_err().to_string();
    assert!(error.ends_with("this image: end of file"), "{error}");
}

#[test]
fn a_film_that_is_cut_off_has_the_frames_before() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("film.y4m");
    let whole = film(5);
    fs::write(&path, &whole[..whole.len() - 100]).unwrap();
    let video = Video::open_y4m(&path).unwrap();
    assert_eq!(video.stamps().len(), 4);
    let cut = video.cut().unwrap();
    assert_eq!(cut, "damaged after frame 4: it ends in a frame");
    fs::write(&path, "YUV4MPEG2 W32 H24\n").unwrap();
    let error = Video::open_y4m(&path).unwrap_err();
    assert!(matches!(error, VideoRefusal::NoRate), "{error}");
}

/// A program that answers as ffmpeg does. It is not written by the tests: a file that any thread
/// has open for writing cannot be run.
#[cfg(unix)]
struct FakeFfmpeg {
    folder: tempfile::TempDir,
}

#[cfg(unix)]
impl FakeFfmpeg {
    /// - `list`, `frames`: what a shell does when asked for them.
    fn new(list: &str, frames: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let write = |name, bytes: &[u8]| fs::write(folder.path().join(name), bytes).unwrap();
        write("film.y4m", &film(3));
        write("list.sh", list.as_bytes());
        write("frames.sh", frames.as_bytes());
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn open(&self) -> Video {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let program = here.join("src/dataset/video/tests/fake_ffmpeg.sh");
        Video::open(&self.path("a: b.mp4"), &Ffmpeg { program }).unwrap()
    }
}

#[cfg(unix)]
const LIST: &str = r"printf '#tb 0: 1/1000\n0,0,100,1,9,0x1\n0,1,0,1,9,0x1\n0,2,40,1,9,0x1\n'";
#[cfg(unix)]
const FRAMES: &str = "cat \"$folder/film.y4m\"";

#[cfg(unix)]
#[test]
fn other_videos_come_through_ffmpeg_with_their_own_stamps() {
    let fake = FakeFfmpeg::new(LIST, FRAMES);
    let video = fake.open();
    let stamps: Vec<i64> = video.stamps().iter().map(|one| one.nanoseconds()).collect();
    assert_eq!(stamps, [0, 40_000_000, 100_000_000]);
    assert_eq!(video.cut(), None);
    let mut images = video.images();
    assert_eq!(shade(images.read(0).unwrap()), 0);
    assert_eq!(shade(images.read(2).unwrap()), 20);
    let calls = fs::read_to_string(fake.path("calls")).unwrap();
    let input = format!("-i file:{}", fake.path("a: b.mp4").display());
    assert_eq!(calls.matches(&input).count(), 2, "{calls}");
    assert!(
        calls.contains("-fps_mode passthrough -pix_fmt gray"),
        "{calls}"
    );
}

#[cfg(unix)]
#[test]
fn ffmpegs_last_words_are_in_the_error() {
    let cut = "head -c 3000 \"$folder/film.y4m\"; echo a >&2; echo 'moov atom' >&2; exit 1";
    let fake = FakeFfmpeg::new(LIST, cut);
    let mut images = fake.open().images();
    assert!(images.read(1).is_ok());
    let error = images.read(2).unwrap_err().to_string();
    assert!(error.contains("fewer frames"), "{error}");
    assert!(error.ends_with("and says: moov atom"), "{error}");
    let fake = FakeFfmpeg::new(LIST, "echo 'no decoder' >&2; exit 1");
    let error = fake.open().images().read(0).unwrap_err().to_string();
    assert!(error.ends_with("ffmpeg says: no decoder"), "{error}");
    // What is no video at all is not read to its end.
    let endless = "echo 'odd' >&2; while :; do echo 'no frames'; done";
    let fake = FakeFfmpeg::new(LIST, endless);
    let error = fake.open().images().read(0).unwrap_err().to_string();
    assert!(error.ends_with("ffmpeg says: odd"), "{error}");
}

#[cfg(unix)]
#[test]
fn a_video_that_ffmpeg_finds_cut_off_is_told() {
    let said = "[in#0/matroska] File ended prematurely";
    let fake = FakeFfmpeg::new(&format!("echo '{said}' >&2; {LIST}"), FRAMES);
    let video = fake.open();
    assert_eq!(video.stamps().len(), 3);
    assert_eq!(video.cut(), Some(format!("ffmpeg says: {said}").as_str()));
}

#[test]
fn without_ffmpeg_the_error_says_what_to_install() {
    let program = PathBuf::from("/no/such/ffmpeg");
    let error = Video::open(Path::new("film.mp4"), &Ffmpeg { program }).unwrap_err();
    let error = error.to_string();
    assert!(error.contains("apt install ffmpeg"), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_decoder_that_is_no_longer_needed_is_stopped() {
    // It tells its process, gives its frames, and then never ends.
    let endless = format!("echo $$ > \"$folder/id\"; {FRAMES}; exec sleep 600");
    let fake = FakeFfmpeg::new(LIST, &endless);
    let mut images = fake.open().images();
    assert!(images.read(2).is_ok());
    let id = fs::read_to_string(fake.path("id")).unwrap();
    let process = PathBuf::from(format!("/proc/{}", id.trim()));
    assert!(process.exists(), "{process:?}");
    drop(images);
    assert!(!process.exists(), "{process:?}");
}
