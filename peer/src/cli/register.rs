//! `starling register`: one registration of two clouds.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use clap::ValueEnum;
use geometry::{Matrix7, Similarity};
use nalgebra::{Matrix3, Matrix4, UnitQuaternion, Vector3};
use registration::{
    Alignment, Cloud, Gravity, Metric, Outcome, RegisterSettings, ShapedCloud, Source, Start,
    Target, is_usable,
};
use serde::Serialize;

use super::{Exit, UsageError, output};
use crate::files::{self, NamedFile};
use crate::plot::{Color, Layer, Mark, Picture, Plot, check_picture_name};

#[derive(clap::Args)]
pub struct RegisterArguments {
    /// The cloud that is moved: PLY, PCD, NPZ, XYZ or CSV; PLY and NPZ may carry descriptors.
    pub source: PathBuf,
    /// The cloud that it is moved onto.
    pub target: PathBuf,
    #[arg(long, value_enum, default_value = "gicp")]
    pub metric: MetricArgument,
    /// Estimate the scale too.
    #[arg(long)]
    pub with_scale: bool,
    /// Where to start: `identity`, `search`, or a file with a 4×4 matrix.
    #[arg(long, default_value = "identity", value_name = "identity|FILE|search")]
    pub init: String,
    /// The z axes of both clouds point up: a search only turns about them.
    #[arg(long)]
    pub z_up: bool,
    /// Thin both clouds to one point per cube of this edge; without it, clouds of more than
    /// 30000 points are thinned to about 5000, two such alike unless the scale is free.
    #[arg(long, value_name = "M", value_parser = parse_positive)]
    pub voxel: Option<f64>,
    /// Points farther apart are not paired.
    #[arg(long, value_name = "M", value_parser = parse_positive)]
    pub max_distance: Option<f64>,
    /// The result does not depend on it; more than one prepares both clouds at once.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: u16,
    /// Do it all so often, for times that are medians; the first time in a process is slower.
    #[arg(long, value_name = "N", default_value_t = 1)]
    #[arg(value_parser = clap::value_parser!(u16).range(1..))]
    pub repeat: u16,
    /// A picture of both clouds before and after, PNG or SVG.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// What pairs of points are measured by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MetricArgument {
    /// The distance of the points.
    Point,
    /// The distance to the plane through the target point.
    Plane,
    /// The distance weighted by the local shape of both.
    Gicp,
}

/// The names are those of the command line's contract; unknown numbers are `null`.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct RegisterSummary {
    accepted: bool,
    reason: String,
    /// Row by row, `s R` in the upper left.
    target_from_source: Option<[[f64; 4]; 4]>,
    scale: Option<f64>,
    rmse_m: Option<f64>,
    overlap: Option<f64>,
    iterations: Option<usize>,
    /// Of a search: points that may be the same, those of them that the alignment brings together,
    /// and those that the best other alignment would.
    correspondences: Option<usize>,
    consistent: Option<usize>,
    runner_up: Option<usize>,
    /// Points of both clouds that are not finite, or beyond 10⁹ m.
    dropped_points: usize,
    /// What the target was thinned to.
    voxel_m: Option<f64>,
    ms_preprocess: f64,
    ms_align: f64,
    /// Over `[ω; ν; ln s]`, row by row.
    covariance: Option<[[f64; 7]; 7]>,
}

pub fn run(arguments: &RegisterArguments) -> anyhow::Result<Exit> {
    let settings = RegisterSettings {
        metric: settings_metric(arguments.metric),
        with_scale: arguments.with_scale,
        start: read_start(&arguments.init)?,
        voxel_m: arguments.voxel,
        max_distance_m: arguments.max_distance,
        gravity: arguments.z_up.then_some(Gravity {
            up_in_target: Vector3::z_axis(),
            up_in_source: Vector3::z_axis(),
        }),
        ..RegisterSettings::default()
    };
    if let Some(path) = &arguments.plot {
        check_picture_name(path).map_err(UsageError::because)?;
        files::check_destination(path)?;
        let mut inputs = vec![
            NamedFile::new("SOURCE", &arguments.source),
            NamedFile::new("TARGET", &arguments.target),
        ];
        if matches!(settings.start, Start::Given(_)) {
            inputs.push(NamedFile::new("the start of --init", &arguments.init));
        }
        files::check_distinct(&[NamedFile::new("--plot", path)], inputs)?;
    }
    let (source, source_dropped) = read_usable(&arguments.source)?;
    let (target, target_dropped) = read_usable(&arguments.target)?;

    let Timed {
        outcome,
        voxel_m,
        ms_preprocess,
        ms_align,
    } = align_repeatedly(&source, &target, &settings, arguments);
    if let Some(path) = &arguments.plot {
        plot_of(&source, &target, &settings.start, &outcome).write(path)?;
    }
    let summary = RegisterSummary {
        dropped_points: source_dropped + target_dropped,
        voxel_m,
        ..summarise(&outcome, ms_preprocess, ms_align)
    };
    if arguments.json {
        output::print_json(&summary)?;
    } else {
        print_summary(&summary);
    }
    Ok(match outcome {
        Outcome::Accepted(_) => Exit::Done,
        Outcome::Refused { .. } => Exit::Refused,
    })
}

/// What a registration gave, and the medians of how long its parts took.
struct Timed {
    outcome: Outcome,
    /// What the target was thinned to.
    voxel_m: Option<f64>,
    ms_preprocess: f64,
    ms_align: f64,
}

fn align_repeatedly(
    source: &Cloud,
    target: &Cloud,
    settings: &RegisterSettings,
    arguments: &RegisterArguments,
) -> Timed {
    let mut times_ms = [Vec::new(), Vec::new()];
    let once = |times_ms: &mut [Vec<f64>; 2]| {
        let started = Instant::now();
        let voxels_m = choose_voxels(source, target, arguments);
        let (source, target) = prepare_both(source, target, voxels_m, arguments.threads);
        times_ms[0].push(started.elapsed().as_secs_f64() * 1e3);
        let started = Instant::now();
        let outcome = registration::register::align(&source, &target, settings);
        times_ms[1].push(started.elapsed().as_secs_f64() * 1e3);
        (outcome, voxels_m[1])
    };
    let (outcome, voxel_m) = once(&mut times_ms);
    for _ in 1..arguments.repeat {
        once(&mut times_ms);
    }
    let [ms_preprocess, ms_align] = times_ms.map(|mut times_ms| {
        times_ms.sort_by(f64::total_cmp);
        times_ms[times_ms.len() / 2]
    });
    Timed {
        outcome,
        voxel_m,
        ms_preprocess,
        ms_align,
    }
}

fn settings_metric(metric: MetricArgument) -> Metric {
    match metric {
        MetricArgument::Point => Metric::Point,
        MetricArgument::Plane => Metric::Plane,
        MetricArgument::Gicp => Metric::Gicp,
    }
}

/// The cloud without points that no cloud can have, and how many those were.
fn read_usable(path: &Path) -> anyhow::Result<(Cloud, usize)> {
    let cloud = files::read_cloud(path)?;
    let first_idx = cloud.points.iter().position(|point| !is_usable(point));
    let point_count = cloud.points.len();
    let cloud = cloud.into_cloud();
    let dropped_count = cloud.dropped_count();
    if let Some(first_idx) = first_idx {
        output::diagnose(&format!(
            "warning: {dropped_count} of {point_count} points are not finite, or beyond 10⁹ m, \
             and were left out, the first is point {first_idx}, counted from zero: {}",
            path.display()
        ));
    }
    Ok((cloud, dropped_count))
}

/// Scans with more points than this are dense where it does not help, and slow.
const POINT_COUNT_MAX: usize = 30_000;
/// What such scans are thinned to.
const POINT_COUNT_THINNED: usize = 5000;
/// Cubes are at most so many times as large as the smaller of two clouds needs.
const VOXEL_RATIO_MAX: f64 = 2.0;

/// The cubes that source and target are thinned by: those asked for, else those that large clouds
/// need. Two large clouds of one scale get the same, so that their points are equally dense; a
/// cloud of far less extent than the other decides, as there would be little left of it.
fn choose_voxels(
    source: &Cloud,
    target: &Cloud,
    arguments: &RegisterArguments,
) -> [Option<f64>; 2] {
    if arguments.voxel.is_some() {
        return [arguments.voxel; 2];
    }
    let needed = [source, target].map(|cloud| {
        let is_large = cloud.points().len() > POINT_COUNT_MAX;
        is_large.then(|| cloud.voxel_leaving(POINT_COUNT_THINNED))?
    });
    match needed {
        [Some(first), Some(second)] if !arguments.with_scale => {
            let shared_m = first.max(second).min(VOXEL_RATIO_MAX * first.min(second));
            [Some(shared_m); 2]
        }
        needed => needed,
    }
}

/// Thins and shapes both clouds, at once if there are threads for it.
fn prepare_both(
    source: &Cloud,
    target: &Cloud,
    voxels_m: [Option<f64>; 2],
    thread_count: u16,
) -> (ShapedCloud, ShapedCloud) {
    let [source_voxel_m, target_voxel_m] = voxels_m;
    if thread_count == 1 {
        return (
            ShapedCloud::new(source, source_voxel_m),
            ShapedCloud::new(target, target_voxel_m),
        );
    }
    std::thread::scope(|scope| {
        let ahead = scope.spawn(|| ShapedCloud::new(source, source_voxel_m));
        let target = ShapedCloud::new(target, target_voxel_m);
        let source = ahead
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        (source, target)
    })
}

fn parse_positive(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|value: &f64| value.is_finite() && *value > 0.0)
        .ok_or_else(|| "expected a positive number of metres".to_owned())
}

fn read_start(init: &str) -> anyhow::Result<Start> {
    Ok(match init {
        "identity" => Start::Identity,
        "search" => Start::Search,
        path => Start::Given(read_similarity(Path::new(path))?),
    })
}

/// Reads 16 numbers, row by row, as a similarity.
fn read_similarity(path: &Path) -> anyhow::Result<Similarity<Target, Source>> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("cannot read the start: {}", path.display()))?;
    let numbers: Vec<f64> = text
        .split(|letter: char| letter.is_whitespace() || ",;[]".contains(letter))
        .filter(|word| !word.is_empty())
        .map(|word| {
            word.parse()
                .with_context(|| format!("{word:?} is no number: {}", path.display()))
        })
        .collect::<anyhow::Result<_>>()?;
    anyhow::ensure!(
        numbers.len() == 16,
        "{} numbers, expected 16 of a 4×4 matrix: {}",
        numbers.len(),
        path.display()
    );
    similarity_from(&Matrix4::from_row_slice(&numbers))
        .with_context(|| format!("not a similarity `[s R, t; 0 1]`: {}", path.display()))
}

/// Matrices in files are rounded; more than this is another kind of transform.
const SIMILARITY_ERROR_MAX: f64 = 1e-2;

fn similarity_from(matrix: &Matrix4<f64>) -> Option<Similarity<Target, Source>> {
    let linear: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    let translation: Vector3<f64> = matrix.fixed_view::<3, 1>(0, 3).into_owned();
    let scale = linear.determinant().cbrt();
    let is_usable = scale > 0.0 && matrix.iter().all(|value| value.is_finite());
    if !is_usable || matrix.row(3) != nalgebra::RowVector4::new(0.0, 0.0, 0.0, 1.0) {
        return None;
    }
    let rotation = linear / scale;
    let error = (rotation * rotation.transpose() - Matrix3::identity()).norm();
    (error < SIMILARITY_ERROR_MAX)
        .then(|| Similarity::new(scale, UnitQuaternion::from_matrix(&rotation), translation))
}

fn summarise(outcome: &Outcome, ms_preprocess: f64, ms_align: f64) -> RegisterSummary {
    let (reason, quality, alignment) = match outcome {
        Outcome::Accepted(alignment) => (
            "the clouds agree".to_owned(),
            Some(&alignment.quality),
            Some(alignment),
        ),
        Outcome::Refused { reason, quality } => (reason.to_string(), quality.as_deref(), None),
    };
    let evidence = quality.and_then(|quality| quality.evidence);
    let known = |value: f64| Some(value).filter(|value| value.is_finite());
    RegisterSummary {
        accepted: alignment.is_some(),
        reason,
        target_from_source: alignment.map(|alignment| matrix_rows(&alignment.target_from_source)),
        scale: alignment.map(|alignment| alignment.target_from_source.scale()),
        rmse_m: quality.and_then(|quality| known(quality.rmse_m)),
        overlap: quality.and_then(|quality| known(quality.overlap_source)),
        iterations: quality.map(|quality| quality.iteration_count),
        correspondences: evidence.map(|evidence| evidence.offered_count),
        consistent: evidence.map(|evidence| evidence.consistent_count),
        runner_up: evidence.map(|evidence| evidence.runner_up_count),
        dropped_points: 0,
        voxel_m: None,
        ms_preprocess,
        ms_align,
        covariance: alignment.and_then(|alignment| covariance_rows(alignment)),
    }
}

fn matrix_rows(similarity: &Similarity<Target, Source>) -> [[f64; 4]; 4] {
    let matrix = similarity.to_matrix();
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
}

fn covariance_rows(alignment: &Alignment) -> Option<[[f64; 7]; 7]> {
    let covariance: &Matrix7 = &alignment.covariance;
    let is_known = covariance.iter().all(|value| value.is_finite());
    is_known
        .then(|| std::array::from_fn(|row| std::array::from_fn(|column| covariance[(row, column)])))
}

fn print_summary(summary: &RegisterSummary) {
    let verdict = if summary.accepted {
        "accepted"
    } else {
        "refused"
    };
    output::print_line(&format!("{verdict}: {}", summary.reason));
    for row in summary.target_from_source.iter().flatten() {
        let numbers: Vec<String> = row.iter().map(|value| format!("{value:12.6}")).collect();
        output::print_line(&numbers.join(" "));
    }
    if let (Some(offered), Some(consistent), Some(runner_up)) = (
        summary.correspondences,
        summary.consistent,
        summary.runner_up,
    ) {
        output::print_line(&format!(
            "{consistent} of {offered} correspondences agree, {runner_up} with the runner-up"
        ));
    }
    let metres = |value: Option<f64>| value.map_or("unknown".to_owned(), |m| format!("{m:.4} m"));
    let share = |value: Option<f64>| value.map_or("unknown".to_owned(), |o| format!("{o:.2}"));
    if let Some(voxel_m) = summary.voxel_m {
        output::print_line(&format!("thinned to one point per cube of {voxel_m:.3} m"));
    }
    output::print_line(&format!(
        "rmse {}, overlap {}, {:.0} ms to prepare, {:.0} ms to align",
        metres(summary.rmse_m),
        share(summary.overlap),
        summary.ms_preprocess,
        summary.ms_align
    ));
}

/// The target, the source where it started, and where it ended if that was accepted.
fn plot_of(source: &Cloud, target: &Cloud, start: &Start, outcome: &Outcome) -> Plot {
    let moved = |by: &Similarity<Target, Source>| -> Vec<Vector3<f64>> {
        source.points().iter().map(|point| *by * *point).collect()
    };
    let before = match start {
        Start::Given(guess) => moved(guess),
        Start::Identity | Start::Search => moved(&Similarity::identity()),
    };
    let dots = |name: &str, color, mark, points| Layer {
        name: name.to_owned(),
        color,
        mark,
        points,
    };
    let mut layers = vec![
        dots(
            "target",
            Color::RED,
            Mark::LargeDots,
            target.points().to_vec(),
        ),
        dots("source before", Color::BLUE, Mark::Dots, before),
    ];
    let title = match outcome {
        Outcome::Accepted(alignment) => {
            let after = moved(&alignment.target_from_source);
            layers.push(dots("source after", Color::GREEN, Mark::Dots, after));
            let scale = alignment.target_from_source.scale();
            format!("Registration accepted, scale {scale:.4}")
        }
        Outcome::Refused { reason, .. } => format!("Registration refused: {reason}"),
    };
    Plot { title, layers }
}

#[cfg(test)]
mod tests;
