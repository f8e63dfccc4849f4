//! Pictures of what was found in an image.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use camera::Image;
use keeping::markers::{FramePairs, MarkerTrack, TrackState};

use crate::plot::{AnnotatedImage, Color, ImageMark, MarkShape};

/// Pairs take these in turn.
const COLORS: [Color; 4] = [Color::GREEN, Color::RED, Color::BLUE, Color::PURPLE];
/// Free pixels between a light and the circle around it.
const GAP_PX: f64 = 2.5;

/// Where the picture of an image goes; images of one name in two formats get two pictures.
pub fn path_in(folder: &Path, image: &Path, taken: &mut BTreeSet<PathBuf>) -> PathBuf {
    let mut name = image.file_stem().unwrap_or_default().to_owned();
    name.push(".png");
    let mut path = folder.join(name);
    if taken.contains(&path) {
        let mut name = image.file_name().unwrap_or_default().to_owned();
        name.push(".png");
        path = folder.join(name);
    }
    taken.insert(path.clone());
    path
}

/// Every light grey, every pair in a colour of its own.
pub fn annotate<'a>(
    image: &'a Image,
    frame: &FramePairs<'_>,
    tracks: &[MarkerTrack],
) -> AnnotatedImage<'a> {
    let circle = |color, center_px, area_px: f64| ImageMark {
        color,
        shape: MarkShape::Circle {
            center_px,
            radius_px: (area_px / std::f64::consts::PI).sqrt() + GAP_PX,
        },
    };
    let mut marks = Vec::new();
    let mut legend = Vec::new();
    for light in frame.lights {
        marks.push(circle(
            Color::GREY,
            light.center_px,
            f64::from(light.area_px),
        ));
    }
    for (pair, color) in frame.pairs.iter().zip(COLORS.iter().cycle()) {
        let ends = pair.lights.map(|light| light.center_px);
        for light in &pair.lights {
            marks.push(circle(*color, light.center_px, f64::from(light.area_px)));
        }
        marks.push(ImageMark {
            color: *color,
            shape: MarkShape::Line(ends),
        });
        legend.push((
            *color,
            describe_pair(pair.center_px, tracks, || {
                format!(
                    "{:.2} +- {:.2} px apart at ({:.1}, {:.1})",
                    pair.separation_px,
                    pair.sigma_separation_px,
                    pair.center_px[0],
                    pair.center_px[1]
                )
            }),
        ));
    }
    for merged in frame.merged {
        let [u, v] = merged.center_px;
        marks.push(circle(Color::BLACK, merged.center_px, 30.0));
        let text = format!(
            "too far: less than {} px at ({u:.1}, {v:.1})",
            merged.separation_px_max
        );
        legend.push((Color::BLACK, text));
    }
    if legend.is_empty() {
        let text = if frame.crowded {
            "too much stands out"
        } else {
            "no pair"
        };
        legend.push((
            Color::GREY,
            format!("{text}, {} lights", frame.lights.len()),
        ));
    }
    AnnotatedImage {
        image,
        marks,
        legend,
    }
}

/// A pair, and the track that has just taken it in.
fn describe_pair(
    center_px: [f64; 2],
    tracks: &[MarkerTrack],
    describe: impl Fn() -> String,
) -> String {
    let is_here = |track: &&MarkerTrack| {
        track.age_s == 0.0 && (track.u_px - center_px[0]).hypot(track.v_px - center_px[1]) < 0.5
    };
    let track = tracks.iter().find(is_here).map(|track| {
        let state = match track.state {
            TrackState::Acquire => "acquire",
            TrackState::Track => "track",
            TrackState::Coast => "coast",
        };
        format!(", {state} {}", track.id.0)
    });
    describe() + &track.unwrap_or_default()
}
