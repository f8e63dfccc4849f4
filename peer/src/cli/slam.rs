//! `starling slam`: monocular vSLAM over a recording.

mod inertia;
mod intake;
mod maps;
mod timing;

use std::path::PathBuf;
use std::time::Instant;

use camera::CameraModel;
use geometry::Map;
use nalgebra::{Unit, Vector3};
use serde::Serialize;
use vslam::{Background, GyroState, MapId, TrackingState, Vslam, VslamMap, VslamSettings};

use super::output::{self, Progress};
use super::{Exit, UsageError};
use crate::dataset::{
    Camera, Dataset, DatasetArgument, DatasetCamera, FrameRange, RecordingOptions,
};
use crate::files::{self, NamedFile, PointCloud, StampedPose};
use inertia::Readings;
use intake::{Arrival, Intake, IntakeCounts, Pace};
use maps::{MapFrames, frames_by_map};
use timing::{Times, Timing};

#[derive(clap::Args)]
pub struct SlamArguments {
    /// A recording, `DATASET[@A..B]`: a folder in TUM RGB-D, EuRoC or KITTI layout, an MCAP file,
    /// or a video.
    pub dataset: DatasetArgument,
    /// Instead of the calibration that lies beside the images, or in the MCAP file: EuRoC, Kalibr,
    /// ROS camera_info, OpenCV or KITTI.
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// The images of an MCAP file, where it has several kinds.
    #[arg(long)]
    pub topic: Option<String>,
    /// The trajectory after all corrections (TUM: map_from_camera).
    #[arg(long)]
    pub out: PathBuf,
    /// The map's points; the extension chooses the format: ply (with descriptors), pcd, xyz, csv
    /// or txt.
    #[arg(long)]
    pub map: Option<PathBuf>,
    /// The whole map, to be continued later with the same camera.
    #[arg(long, value_name = "FILE")]
    pub save_map: Option<PathBuf>,
    /// Goes on in a map of --save-map: the camera is looked for in it, and the trajectory is in
    /// its frame.
    #[arg(long = "continue", value_name = "FILE")]
    pub continued: Option<PathBuf>,
    /// Readings of an inertial sensor as priors (`ns,wx,wy,wz,ax,ay,az`, rad/s and m/s², on the
    /// camera's clock; `T_BS` in a sensor.yaml beside it); `auto`: those of a EuRoC recording.
    #[arg(long, value_name = "FILE")]
    pub imu: Option<PathBuf>,
    /// Half-open range of frame numbers.
    #[arg(long, value_name = "A..B")]
    pub frames: Option<FrameRange>,
    /// Pace by the stamps and drop late frames.
    #[arg(long)]
    pub realtime: bool,
    /// With more than one, the next image is decoded and searched for keypoints while the map
    /// grows by the last one, and the whole map is adjusted beside them. The result does not
    /// depend on it.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: u16,
    /// Print one JSON object. Without a single tracked frame `tracked` is 0, the reason is on
    /// stderr and the exit code is 1; with skipped images it is 3.
    #[arg(long)]
    pub json: bool,
}

/// What a run did; the names are those of the command line's contract.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct SlamSummary {
    frames: usize,
    tracked: usize,
    tracked_live: usize,
    dropped: usize,
    keyframes: usize,
    points: usize,
    lost: usize,
    /// From a decoded image to its pose; at real time from when the image is due, and all of it,
    /// else without what is in `ms_waiting`.
    ms_per_frame_p50: Option<f64>,
    ms_per_frame_p99: Option<f64>,
    /// How long a frame that was looked at ahead, by another thread, waited for the map to grow by
    /// the ones before it.
    ms_waiting_p50: Option<f64>,
    ms_waiting_p99: Option<f64>,
    peak_rss_bytes: Option<u64>,
    /// Those that were never joined, the one of the trajectory first.
    maps: Vec<MapFrames>,
    /// Frames that had a pose when they came, in a map that was given up or never joined to that
    /// of the trajectory.
    live_left_out: usize,
    /// With readings of one: `untested`, `confirmed` or `refuted` by the pictures.
    #[serde(skip_serializing_if = "Option::is_none")]
    gyroscope: Option<&'static str>,
    /// Away from the ground, in the frame of the trajectory, if an accelerometer told.
    #[serde(skip_serializing_if = "Option::is_none")]
    up_in_map: Option<[f64; 3]>,
}

pub fn run(arguments: &SlamArguments) -> anyhow::Result<Exit> {
    let chosen = chosen_frames(arguments)?;
    let results = check_destinations(arguments)?;
    let options = RecordingOptions {
        calibration: arguments.calibration.clone(),
        topic: arguments.topic.clone(),
        ..RecordingOptions::default()
    };
    let dataset = Dataset::open_with(&chosen, &options)?;
    let losses = dataset.losses().to_vec();
    let frame_count = dataset.frames().len();
    let vslam = begin(arguments, &dataset.calibration().camera)?;
    let readings = match &arguments.imu {
        Some(named) => Readings::open(named, &chosen.path, &dataset)?,
        None => Readings::default(),
    };
    let inputs = dataset.files().chain(readings.files().iter().cloned());
    files::check_distinct(&results, inputs)?;
    check_continued_is_kept(arguments, &results)?;
    let camera = if arguments.threads > 1 {
        DatasetCamera::decoding_ahead(dataset)
    } else {
        DatasetCamera::inline(dataset)
    };
    let progress = Progress::start("slam", frame_count as u64);
    let plan = Plan {
        thread_count: arguments.threads,
        pace: arguments.realtime.then(Pace::default),
    };
    let mut drive = Drive::new(vslam, readings);
    drive.losses = losses;
    drive.run_through(camera, plan, &progress);
    drive.vslam.finish();
    progress.finish();

    let map = drive.vslam.largest_map();
    let trajectory = trajectory_in(&drive.vslam, map.id());
    let tracked = trajectory.len();
    files::write_tum(&arguments.out, trajectory)?;
    if let Some(path) = &arguments.map {
        files::write_cloud(path, &map_points(map))?;
    }
    if let Some(path) = &arguments.save_map {
        files::write_slam_map(path, map, drive.vslam.camera())?;
    }
    let summary = drive.summarise(frame_count, tracked);
    if arguments.json {
        output::print_json(&summary)?;
    } else {
        print_summary(&summary);
    }
    if let Some(warning) = maps::warning(&summary.maps, summary.live_left_out, &arguments.out) {
        output::diagnose(&format!("warning: {warning}"));
    }
    Ok(drive.exit(frame_count, tracked))
}

/// Looks where results will go before the work that makes them.
fn check_destinations(arguments: &SlamArguments) -> anyhow::Result<Vec<NamedFile>> {
    if let Some(path) = &arguments.map {
        files::check_cloud_name(path).map_err(UsageError::because)?;
    }
    let named = [
        ("--out", Some(&arguments.out)),
        ("--map", arguments.map.as_ref()),
        ("--save-map", arguments.save_map.as_ref()),
    ];
    let results = named.into_iter();
    let results: Vec<NamedFile> = results
        .filter_map(|(name, path)| Some(NamedFile::new(name, path?)))
        .collect();
    for result in &results {
        files::check_destination(&result.path)?;
    }
    files::check_distinct(&results, [])?;
    Ok(results)
}

/// Only the map itself may go where the one that is continued was: it is replaced as a whole.
fn check_continued_is_kept(
    arguments: &SlamArguments,
    results: &[NamedFile],
) -> Result<(), files::Clash> {
    let saved = arguments.save_map.as_ref();
    let others = results.iter().filter(|one| Some(&one.path) != saved);
    let others: Vec<NamedFile> = others.cloned().collect();
    let continued = arguments.continued.iter();
    let continued = continued.map(|path| NamedFile::new("the map that is continued", path));
    files::check_distinct(&others, continued)
}

/// A machine without a map, or with the one that is to be continued.
fn begin(arguments: &SlamArguments, camera: &CameraModel) -> anyhow::Result<Vslam> {
    let settings = VslamSettings {
        background: (arguments.threads > 1).then_some(crate::background::spawn as Background),
        ..VslamSettings::default()
    };
    Ok(match &arguments.continued {
        None => Vslam::new(camera.clone(), settings),
        Some(path) => {
            let map = files::read_slam_map(path, camera, &settings)?;
            Vslam::continuing(camera.clone(), settings, map)
        }
    })
}

/// The dataset with the range of either form; giving both is a contradiction.
fn chosen_frames(arguments: &SlamArguments) -> Result<DatasetArgument, UsageError> {
    let mut dataset = arguments.dataset.clone();
    if dataset.range.is_some() && arguments.frames.is_some() {
        return Err(UsageError(
            "give the frames once: DATASET@A..B or --frames A..B".to_owned(),
        ));
    }
    dataset.range = dataset.range.or(arguments.frames);
    Ok(dataset)
}

/// How a recording is run through.
#[derive(Default)]
struct Plan {
    thread_count: u16,
    /// At real time.
    pace: Option<Pace>,
}

/// The machine, fed by a camera, and what is counted on the way.
struct Drive {
    vslam: Vslam,
    readings: Readings,
    times: Times,
    /// Numbers of the frames that had a pose when they came.
    live: Vec<u64>,
    lost: usize,
    intake: IntakeCounts,
    /// What should have been in the recording.
    losses: Vec<String>,
    /// Of the newest frame without a pose.
    untracked: Option<TrackingState>,
}

impl Drive {
    fn new(vslam: Vslam, readings: Readings) -> Self {
        Self {
            vslam,
            readings,
            times: Times::default(),
            live: Vec::new(),
            lost: 0,
            intake: IntakeCounts::default(),
            losses: Vec::new(),
            untracked: None,
        }
    }

    fn run_through(&mut self, camera: impl Camera, plan: Plan, progress: &Progress) {
        self.times.is_ahead = plan.thread_count > 1 && plan.pace.is_none();
        let intake = Intake::new(camera, self.vslam.front_end(), plan.pace, progress);
        self.intake = if plan.thread_count > 1 {
            intake.run_ahead(|arrival| self.take(arrival))
        } else {
            intake.run_inline(|arrival| self.take(arrival))
        };
    }

    fn take(&mut self, arrival: Arrival) {
        let captured_at = arrival.frame.captured_at();
        self.readings.give_until(captured_at, &mut self.vslam);
        let taken_at = Instant::now();
        let report = self.vslam.track(arrival.frame);
        self.times.push(&Timing {
            came_at: arrival.came_at,
            found_at: arrival.found_at,
            taken_at,
            posed_at: Instant::now(),
        });
        if report.map_from_camera.is_some() {
            self.live.push(report.frame_idx);
        }
        self.lost += usize::from(matches!(report.state, TrackingState::Lost { .. }));
        if report.map_from_camera.is_none() {
            self.untracked = Some(report.state);
        }
        self.vslam.map_frame();
    }

    fn up_in_map(&self) -> Option<Unit<Vector3<f64>>> {
        let tracked_in = self.vslam.map().id();
        (self.vslam.largest_map().id() == tracked_in)
            .then(|| self.vslam.up_in_map())
            .flatten()
    }

    fn summarise(&self, frame_count: usize, tracked: usize) -> SlamSummary {
        let map = self.vslam.largest_map();
        let trajectory = self.vslam.trajectory();
        let kept = |frame_idx: &&u64| {
            let entry = &trajectory[**frame_idx as usize];
            entry.map_id == map.id() && entry.map_from_camera.is_some()
        };
        let listened = self.readings.is_given();
        SlamSummary {
            frames: frame_count,
            tracked,
            tracked_live: self.live.len(),
            dropped: self.intake.dropped,
            keyframes: map.keyframe_count(),
            points: map.point_count(),
            lost: self.lost,
            ms_per_frame_p50: self.times.per_frame_ms(0.50),
            ms_per_frame_p99: self.times.per_frame_ms(0.99),
            ms_waiting_p50: self.times.waiting_ms(0.50),
            ms_waiting_p99: self.times.waiting_ms(0.99),
            peak_rss_bytes: peak_rss_bytes(),
            maps: frames_by_map(&trajectory, map.id()),
            live_left_out: self.live.len() - self.live.iter().filter(kept).count(),
            gyroscope: listened.then(|| match self.vslam.gyro_state() {
                GyroState::Untested => "untested",
                GyroState::Confirmed => "confirmed",
                GyroState::Refuted(_) => "refuted",
            }),
            up_in_map: self.up_in_map().map(|up| (*up).into()),
        }
    }

    /// Tells what was lost on the way. Without a single pose there is no trajectory, and the
    /// command has failed.
    fn exit(&self, frame_count: usize, tracked: usize) -> Exit {
        if let Some(first) = &self.intake.first_unreadable {
            output::diagnose(&format!(
                "warning: skipped {} of {frame_count} images; the first: {first}",
                self.intake.unreadable_count
            ));
        }
        for loss in &self.losses {
            output::diagnose(&format!("warning: {loss}"));
        }
        if let Some(skipped) = &self.readings.skipped {
            output::diagnose(&format!(
                "warning: skipped {} lines without readings; the first: {}",
                skipped.count, skipped.first
            ));
        }
        for doubt in &self.readings.doubts {
            output::diagnose(&format!("warning: {doubt}"));
        }
        let refuted = match self.vslam.gyro_state() {
            GyroState::Refuted(fault) => Some(fault),
            GyroState::Untested | GyroState::Confirmed => None,
        };
        if let Some(fault) = refuted {
            output::diagnose(&format!(
                "warning: the pictures contradict the gyroscope of --imu, so it was left alone: \
                 {fault}"
            ));
        }
        if tracked == 0 {
            let reason = self.untracked.map_or_else(
                || "no image came to be looked at".to_owned(),
                |state| state.to_string(),
            );
            output::diagnose(&format!(
                "error: none of {frame_count} frames was tracked; in the end: {reason}"
            ));
            return Exit::Refused;
        }
        let without_readings = self.readings.skipped.is_some() || refuted.is_some();
        let lossy = !self.losses.is_empty() || without_readings;
        if self.intake.first_unreadable.is_some() || lossy {
            Exit::DoneWithLoss
        } else {
            Exit::Done
        }
    }
}

/// The poses in one map: others have another scale and origin.
fn trajectory_in(vslam: &Vslam, map_id: MapId) -> Vec<StampedPose<Map>> {
    let entries = vslam.trajectory().into_iter();
    let posed = entries.filter(|entry| entry.map_id == map_id);
    posed
        .filter_map(|entry| {
            Some(StampedPose {
                captured_at: entry.captured_at,
                target_from_camera: entry.map_from_camera?,
            })
        })
        .collect()
}

fn map_points(map: &VslamMap) -> PointCloud {
    let ranged = || map.points().filter(|point| point.has_range());
    let points = ranged().map(|point| *point.position_in_map()).collect();
    let descriptors = ranged().map(|point| *point.descriptor()).collect();
    PointCloud {
        points,
        colors: None,
        descriptors: registration::Descriptors::Binary(descriptors),
    }
}

/// The most memory that this process ever held, where the system tells.
fn peak_rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}

fn print_summary(summary: &SlamSummary) {
    let SlamSummary {
        frames,
        tracked,
        tracked_live,
        dropped,
        keyframes,
        points,
        lost,
        ..
    } = summary;
    output::print_line(&format!(
        "{tracked} of {frames} frames tracked ({tracked_live} live, {lost} lost, \
         {dropped} dropped), {keyframes} keyframes, {points} points"
    ));
    if let (Some(p50), Some(p99)) = (summary.ms_per_frame_p50, summary.ms_per_frame_p99) {
        output::print_line(&format!(
            "{p50:.1} ms per frame, {p99:.1} ms at the 99th percentile"
        ));
    }
    if let (Some(p50), Some(p99)) = (summary.ms_waiting_p50, summary.ms_waiting_p99) {
        output::print_line(&format!(
            "{p50:.1} ms waited for the map besides, {p99:.1} ms at the 99th percentile"
        ));
    }
    if let Some(state) = summary.gyroscope {
        output::print_line(&format!("gyroscope: {state}"));
    }
    if let Some([x, y, z]) = summary.up_in_map {
        output::print_line(&format!("up in the map: {x:.3} {y:.3} {z:.3}"));
    }
}

#[cfg(test)]
mod tests;
