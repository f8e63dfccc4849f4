//! `--imu`: readings of an inertial sensor, given to the machine before the frames they belong to.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use anyhow::bail;
use geometry::Timestamp;
use vslam::{ImuSample, Vslam};

use crate::dataset::Dataset;
use crate::files::{self, ImuReadings, NamedFile};

/// Readings in the camera's axes that were not given yet.
#[derive(Default)]
pub struct Readings {
    samples: VecDeque<ImuSample>,
    files: Vec<NamedFile>,
    /// What is odd about them, a sentence each.
    pub doubts: Vec<String>,
    pub skipped: Option<Skipped>,
}

/// Lines that are no readings.
pub struct Skipped {
    pub count: usize,
    /// The first of them, for a person to read.
    pub first: String,
}

impl Readings {
    /// - `named`: a file, or `auto` for the one that lies in a EuRoC recording.
    /// - `folder`: of the recording.
    pub fn open(named: &Path, folder: &Path, dataset: &Dataset) -> anyhow::Result<Self> {
        let path = find(named, folder)?;
        let found = files::read_imu(&path)?;
        check_overlap(&found, dataset, &path)?;
        let body_from_camera = &dataset.calibration().body_from_camera;
        let camera_from_body = body_from_camera.rotation().inverse();
        let samples = found
            .readings
            .iter()
            .map(|reading| ImuSample {
                captured_at: reading.captured_at,
                rate_in_camera: camera_from_body * reading.rate_in_body,
                specific_force_in_camera: Some(camera_from_body * reading.specific_force_in_body),
            })
            .collect();
        Ok(Self {
            samples,
            doubts: found
                .doubts
                .iter()
                .map(|doubt| format!("{doubt}: {}", path.display()))
                .collect(),
            files: vec![
                NamedFile::new("the readings", &path),
                NamedFile::new("the sensor's place", files::imu_mounting(&path)),
            ],
            skipped: found.first_skipped.map(|(line, reason)| Skipped {
                count: found.skipped_count,
                first: format!("{reason} at {}:{line}", path.display()),
            }),
        })
    }

    /// Whether there are any.
    pub fn is_given(&self) -> bool {
        !self.files.is_empty()
    }

    /// What was read.
    pub fn files(&self) -> &[NamedFile] {
        &self.files
    }

    /// Gives what was read up to a frame.
    pub fn give_until(&mut self, captured_at: Timestamp, vslam: &mut Vslam) {
        while let Some(sample) = self
            .samples
            .pop_front_if(|sample| sample.captured_at <= captured_at)
        {
            // What the machine cannot use it leaves out by itself.
            vslam.take_imu(sample);
        }
    }
}

fn find(named: &Path, folder: &Path) -> anyhow::Result<PathBuf> {
    if named != Path::new("auto") {
        return Ok(named.to_owned());
    }
    // The folder may be that of the camera alone.
    let places = ["mav0/imu0", "imu0", "../imu0"];
    let places = places.map(|place| folder.join(place).join("data.csv"));
    match places.into_iter().find(|path| path.is_file()) {
        Some(path) => Ok(path),
        None => bail!(
            "--imu auto found no mav0/imu0/data.csv; name the file: {}",
            folder.display()
        ),
    }
}

/// Readings of another recording would be worse than none.
fn check_overlap(found: &ImuReadings, dataset: &Dataset, path: &Path) -> anyhow::Result<()> {
    let (readings, frames) = (&found.readings, dataset.frames());
    let ends = |first: Option<Timestamp>, last: Option<Timestamp>| first.zip(last);
    let read = ends(
        readings.first().map(|one| one.captured_at),
        readings.last().map(|one| one.captured_at),
    );
    let seen = ends(
        frames.first().map(|one| one.captured_at),
        frames.last().map(|one| one.captured_at),
    );
    if let (Some((read_from, read_to)), Some((seen_from, seen_to))) = (read, seen)
        && (read_from > seen_to || read_to < seen_from)
    {
        let units = [
            (1e9, "seconds"),
            (1e6, "milliseconds"),
            (1e3, "microseconds"),
        ];
        let fitting = units.iter().find(|(factor, _)| {
            let scaled = |at: Timestamp| at.seconds() * factor;
            scaled(read_from) <= seen_to.seconds() && scaled(read_to) >= seen_from.seconds()
        });
        let hint = fitting.map_or_else(String::new, |(factor, unit)| {
            format!(" (its stamps look like {unit}: multiply them by {factor:.0})")
        });
        bail!(
            "the readings from {read_from} to {read_to} s lie outside the recording from \
             {seen_from} to {seen_to} s{hint}: {}",
            path.display()
        );
    }
    Ok(())
}
