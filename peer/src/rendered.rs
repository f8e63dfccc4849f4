//! Rendered recordings as folders in TUM RGB-D layout, with the truth and the calibration.

use std::fs;
use std::io::{BufWriter, Write};
use std::path::Path;

use camera::Image;
use sim::Recording;

use crate::demo::sensor_yaml;
use crate::files::{FileError, StampedPose, create_folder, write_tum};

/// Renders a recording into `rgb.txt`, `rgb/*.png`, `camera.yaml` and `groundtruth.txt`, which
/// has the pose of every frame, also of dropped ones. Calls `advance` after each image, and
/// returns how many were written.
pub fn write_folder(
    recording: &Recording,
    folder: &Path,
    mut advance: impl FnMut(),
) -> Result<usize, FileError> {
    create_folder(&folder.join("rgb"))?;
    let calibration = sensor_yaml(recording.camera(), recording.body_from_camera());
    write_text(&folder.join("camera.yaml"), &calibration)?;
    let truth = recording.truth().map(|(captured_at, pose)| StampedPose {
        captured_at,
        target_from_camera: pose,
    });
    write_tum(&folder.join("groundtruth.txt"), truth)?;
    let mut list = String::from("# timestamp filename\n");
    let mut written = 0;
    for frame in recording.frames() {
        let name = format!("rgb/{}.png", frame.captured_at);
        write_png(&folder.join(&name), &frame.image)?;
        list.push_str(&format!("{} {name}\n", frame.captured_at));
        written += 1;
        advance();
    }
    write_text(&folder.join("rgb.txt"), &list)?;
    Ok(written)
}

fn write_text(path: &Path, text: &str) -> Result<(), FileError> {
    fs::write(path, text).map_err(|error| FileError::Write {
        error,
        path: path.to_owned(),
    })
}

/// Writes a grey image. Quickly: files of rendered noise hardly shrink.
fn write_png(path: &Path, image: &Image) -> Result<(), FileError> {
    let write = || -> std::io::Result<()> {
        let mut file = BufWriter::new(fs::File::create(path)?);
        let (width, height) = (image.width() as u32, image.height() as u32);
        let mut encoder = png::Encoder::new(&mut file, width, height);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Fast);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(image.pixels())?;
        writer.finish()?;
        file.flush()
    };
    write().map_err(|error| FileError::Write {
        error,
        path: path.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use sim::{Condition, RecordingSettings, RecordingWorld};

    use super::*;
    use crate::dataset::{Camera, CameraEvent, Dataset, DatasetCamera};
    use crate::files::read_tum;

    #[test]
    fn a_written_recording_reads_back_as_it_was_rendered() {
        let recording = Recording::new(RecordingSettings {
            world: RecordingWorld::Board,
            seed: 3,
            conditions: vec![Condition::Drops],
            frame_count_max: Some(40),
        });
        let folder = tempfile::tempdir().unwrap();
        let written = write_folder(&recording, folder.path(), || ()).unwrap();
        assert!((1..40).contains(&written), "{written}");
        let argument = folder.path().to_str().unwrap().parse().unwrap();
        let dataset = Dataset::open(&argument).unwrap();
        assert_eq!(dataset.calibration().camera, *recording.camera());
        let truth = read_tum::<geometry::Enu>(&folder.path().join("groundtruth.txt")).unwrap();
        assert_eq!(truth.len(), 40);
        let mut camera = DatasetCamera::inline(dataset);
        for expected in recording.frames() {
            let Some(CameraEvent::Frame(frame)) = camera.next_event() else {
                panic!("a frame is missing");
            };
            assert_eq!(frame.image, expected.image);
            assert_eq!(frame.captured_at, expected.captured_at);
            let pose = truth
                .iter()
                .find(|pose| pose.captured_at == frame.captured_at);
            let error = pose.unwrap().target_from_camera.inverse() * expected.site_from_camera;
            assert!(error.log().norm() < 1e-6);
        }
        assert!(camera.next_event().is_none());
    }
}
