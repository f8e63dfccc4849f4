//! `starling markers`: the pairs of marker lights in each image of a folder.

mod annotate;
mod list;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::Context;
use keeping::markers::{
    CameraMarkers, FinderSettings, FramePairs, MarkerTrack, TrackState, TrackerSettings,
};
use serde::Serialize;

use super::{Exit, UsageError, output};
use crate::dataset;
use crate::files::{self, NamedFile};
use list::ListedImage;

#[derive(clap::Args)]
pub struct MarkersArguments {
    /// A folder of PNG, JPEG, PGM or PPM images, or a recording.
    #[arg(value_name = "DIR")]
    pub images: PathBuf,
    /// Where to put a PNG for each image, with what was found in it.
    #[arg(long, value_name = "DIR")]
    pub annotate: Option<PathBuf>,
    /// Direction from one light of a pair to the other in the image, in degrees from its x axis
    /// (right) towards its y axis (down): 90 for lights one above the other, 0 side by side.
    #[arg(long, value_name = "DEGREES", default_value_t = 90.0, value_parser = parse_baseline,
          allow_negative_numbers = true)]
    pub baseline: f64,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// Unknown numbers are `null`.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct MarkersSummary {
    images: Vec<ImageSummary>,
    images_with_pair: usize,
    /// Images with a track that was seen in three of four images as a drone moves.
    images_with_confirmed_track: usize,
    unreadable: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct ImageSummary {
    path: PathBuf,
    /// `null` in a folder without time stamps; tracks then take the images as 20 a second.
    captured_at_s: Option<f64>,
    /// Standard deviation of a pixel, grey levels.
    noise: f64,
    lights: usize,
    /// So much stands out that nothing can be told from it.
    crowded: bool,
    pairs: Vec<PairSummary>,
    merged: Vec<MergedSummary>,
    tracks: Vec<TrackSummary>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct PairSummary {
    u_px: f64,
    v_px: f64,
    separation_px: f64,
    sigma_separation_px: f64,
    /// Column and row of the upper light, then of the lower one.
    lights_px: [[f64; 2]; 2],
    mismatch: f64,
}

/// Lights of a neighbour that are too far away to be told apart.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct MergedSummary {
    u_px: f64,
    v_px: f64,
    separation_px_max: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct TrackSummary {
    id: u32,
    state: &'static str,
    age_s: f64,
    u_px: f64,
    v_px: f64,
    separation_px: f64,
    sigma_separation_px: f64,
}

pub fn run(arguments: &MarkersArguments) -> anyhow::Result<Exit> {
    let listed = list::list_images(&arguments.images)?;
    if let Some(folder) = &arguments.annotate {
        prepare_folder(folder, &arguments.images, &listed)?;
    }
    let finder = finder_settings(arguments.baseline);
    let mut camera = CameraMarkers::new(finder, TrackerSettings::default(), 0);
    let mut summary = MarkersSummary {
        images: Vec::new(),
        images_with_pair: 0,
        images_with_confirmed_track: 0,
        unreadable: Vec::new(),
    };
    let mut names = BTreeSet::new();
    let progress = output::Progress::start("images", listed.len() as u64);
    for entry in &listed {
        match look_at(
            entry,
            &mut camera,
            arguments.annotate.as_deref(),
            &mut names,
        )? {
            Ok(image) => summary.add(image),
            Err(reason) => summary.unreadable.push(reason),
        }
        progress.advance(1);
    }
    progress.finish();
    if let (true, Some(first)) = (summary.images.is_empty(), summary.unreadable.first()) {
        anyhow::bail!(
            "none of {} images can be read; the first: {first}",
            listed.len()
        );
    }
    if arguments.json {
        output::print_json(&summary)?;
    } else {
        print_summary(&summary);
    }
    let Some(first) = summary.unreadable.first() else {
        return Ok(Exit::Done);
    };
    output::diagnose(&format!(
        "warning: skipped {} of {} images; the first: {first}",
        summary.unreadable.len(),
        listed.len()
    ));
    Ok(Exit::DoneWithLoss)
}

fn finder_settings(baseline_degrees: f64) -> FinderSettings {
    FinderSettings {
        baseline_rad: baseline_degrees.to_radians(),
        ..FinderSettings::default()
    }
}

fn parse_baseline(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|degrees: &f64| (-360.0..=360.0).contains(degrees))
        .ok_or_else(|| "expected an angle from -360 to 360 degrees".to_owned())
}

/// Makes the folder for annotated images, which must not replace those that are read.
fn prepare_folder(folder: &Path, images: &Path, listed: &[ListedImage]) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let is_same = match (folder.canonicalize(), images.canonicalize()) {
        (Ok(folder), Ok(images)) => folder == images,
        _ => false,
    };
    if is_same {
        let reason = "--annotate would overwrite the images that are read; give another folder";
        return Err(UsageError(format!("{reason} than {}", images.display())).into());
    }
    // The images of a recording may lie anywhere.
    let mut names = BTreeSet::new();
    let pictures = listed.iter().map(|entry| {
        let path = annotate::path_in(folder, &entry.path, &mut names);
        NamedFile::new("--annotate", path)
    });
    let inputs = listed.iter();
    let inputs = inputs.map(|entry| NamedFile::new("an image", &entry.path));
    files::check_distinct(&pictures.collect::<Vec<_>>(), inputs)?;
    Ok(())
}

/// The outer error ends the command; the inner one is an image that is skipped.
fn look_at(
    entry: &ListedImage,
    camera: &mut CameraMarkers,
    annotate: Option<&Path>,
    names: &mut BTreeSet<PathBuf>,
) -> anyhow::Result<Result<ImageSummary, String>> {
    let unreadable = |reason: dataset::ImageError| format!("{reason}: {}", entry.path.display());
    let image = match dataset::read_grey(&entry.path) {
        Ok(image) => image,
        Err(reason) => return Ok(Err(unreadable(reason))),
    };
    let (frame, tracks) = camera.see(&image, entry.captured_at, None);
    if let Some(folder) = annotate {
        let path = annotate::path_in(folder, &entry.path, names);
        files::check_destination(&path)?;
        annotate::annotate(&image, &frame, tracks).write(&path)?;
    }
    Ok(Ok(ImageSummary::of(entry, &frame, tracks)))
}

impl MarkersSummary {
    fn add(&mut self, image: ImageSummary) {
        self.images_with_pair += usize::from(!image.pairs.is_empty());
        let is_confirmed = |track: &TrackSummary| track.state != "Acquire";
        self.images_with_confirmed_track += usize::from(image.tracks.iter().any(is_confirmed));
        self.images.push(image);
    }
}

impl ImageSummary {
    fn of(entry: &ListedImage, frame: &FramePairs<'_>, tracks: &[MarkerTrack]) -> Self {
        let pairs = frame.pairs.iter().map(|pair| PairSummary {
            u_px: pair.center_px[0],
            v_px: pair.center_px[1],
            separation_px: pair.separation_px,
            sigma_separation_px: pair.sigma_separation_px,
            lights_px: pair.lights.map(|light| light.center_px),
            mismatch: pair.mismatch,
        });
        let merged = frame.merged.iter().map(|merged| MergedSummary {
            u_px: merged.center_px[0],
            v_px: merged.center_px[1],
            separation_px_max: merged.separation_px_max,
        });
        Self {
            path: entry.path.clone(),
            captured_at_s: entry.is_stamped.then(|| entry.captured_at.seconds()),
            noise: frame.noise,
            lights: frame.lights.len(),
            crowded: frame.crowded,
            pairs: pairs.collect(),
            merged: merged.collect(),
            tracks: tracks.iter().map(TrackSummary::of).collect(),
        }
    }
}

impl TrackSummary {
    fn of(track: &MarkerTrack) -> Self {
        Self {
            id: track.id.0,
            state: match track.state {
                TrackState::Acquire => "Acquire",
                TrackState::Track => "Track",
                TrackState::Coast => "Coast",
            },
            age_s: track.age_s,
            u_px: track.u_px,
            v_px: track.v_px,
            separation_px: track.separation_px,
            sigma_separation_px: track.sigma_separation_px,
        }
    }
}

fn print_summary(summary: &MarkersSummary) {
    for image in &summary.images {
        let name = image.path.file_name().unwrap_or_default().to_string_lossy();
        output::print_line(&format!("{name}: {}", describe(image)));
    }
    output::print_line(&format!(
        "{} of {} images show a pair, {} a confirmed track",
        summary.images_with_pair,
        summary.images.len(),
        summary.images_with_confirmed_track
    ));
}

fn describe(image: &ImageSummary) -> String {
    if image.crowded {
        return "too much stands out to tell lights from it".to_owned();
    }
    let pairs = image.pairs.iter().map(|pair| {
        format!(
            "{:.2} ± {:.2} px apart at ({:.1}, {:.1})",
            pair.separation_px, pair.sigma_separation_px, pair.u_px, pair.v_px
        )
    });
    let merged = image.merged.iter().map(|merged| {
        format!(
            "less than {} px apart at ({:.1}, {:.1})",
            merged.separation_px_max, merged.u_px, merged.v_px
        )
    });
    let found: Vec<String> = pairs.chain(merged).collect();
    if found.is_empty() {
        "no pair".to_owned()
    } else {
        found.join("; ")
    }
}

#[cfg(test)]
mod tests;
