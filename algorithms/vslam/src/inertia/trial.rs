//! Whether a gyroscope tells of turns what the pictures show.

use std::collections::VecDeque;
use std::fmt;

use nalgebra::{Matrix3, Vector3};

use super::{BIAS_MAX, median};

/// What the pictures say about the gyroscope.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum GyroState {
    /// The camera has not turned enough to tell. What the gyroscope tells is tried where the
    /// pictures alone find nothing, and nothing is refused because of it.
    #[default]
    Untested,
    /// It tells what the pictures show.
    Confirmed,
    /// The pictures contradicted it again and again: it is not listened to any more.
    Refuted(GyroFault),
}

/// What is wrong with a gyroscope, most likely.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GyroFault {
    /// It tells turns about the right axes, so many times as large as they are.
    Scale { factor: f64 },
    /// It tells turns of the right size about other axes.
    Axes,
    /// It tells no turns.
    Silent,
    /// What it tells has nothing to do with what is seen.
    Unrelated,
}

/// A turn over a short time, as both tell it: rotation vectors (rad) in the camera's axes.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    pub seconds: f64,
    pub seen: Vector3<f64>,
    /// With the bias of the gyroscope in it.
    pub told: Vector3<f64>,
}

/// The newest comparisons and what came of them.
#[derive(Clone, Debug, Default)]
pub struct Trial {
    state: GyroState,
    spans: VecDeque<Span>,
}

/// Comparisons that count, the oldest are forgotten first: some seconds.
const SPANS_MAX: usize = 16;
/// Fewer do not tell the bias from a turn.
const SPANS_MIN: usize = 3;
/// A turn is seen if it is larger than what a pose errs by: with 25 keypoints or more, less than
/// one of them does.
const SEEN_SIGMAS: f64 = 1.0;
/// A smaller disagreement may be the pictures', and does no harm where points are looked for.
const HARMFUL_SIGMAS: f64 = 3.0;
/// It is right if it leaves so little of a turn unexplained, and wrong if it leaves so much: no
/// better than one that is silent.
const RIGHT_SHARE_MAX: f64 = 0.5;
const WRONG_SHARE_MIN: f64 = 0.8;
/// So often it must be right, and that many times as often as wrong, to be confirmed.
const RIGHT_MIN: usize = 3;
const RIGHT_MAJORITY: usize = 3;
/// So often it must be wrong, and more often than right, to be refuted: more than a second of
/// turns. With swapped axes it is right about those that are not.
const WRONG_MIN: usize = 6;
/// A factor between what is told and what was seen that is no error of axes alone.
const FACTOR_MAX: f64 = 2.0;

impl Trial {
    pub fn state(&self) -> GyroState {
        self.state
    }

    /// Forgets what spoke for it.
    pub fn begin_anew(&mut self) {
        if self.state == GyroState::Confirmed {
            *self = Self::default();
        }
    }

    /// - `sigma`: of a keypoint, on the plane at depth one.
    pub fn judge(&mut self, span: Span, sigma: f64) {
        if matches!(self.state, GyroState::Refuted(_)) {
            return;
        }
        if self.spans.len() == SPANS_MAX {
            self.spans.pop_front();
        }
        self.spans.push_back(span);
        if self.spans.len() < SPANS_MIN {
            return;
        }
        let votes = self.votes(sigma);
        let count = |wanted| votes.iter().filter(|vote| **vote == wanted).count();
        let (right_count, wrong_count) = (count(Vote::Right), count(Vote::Wrong));
        if wrong_count >= WRONG_MIN && wrong_count > right_count {
            let spans = self.spans.iter().zip(votes);
            let wrong = spans.filter(|(_, vote)| *vote == Vote::Wrong);
            let wrong: Vec<Span> = wrong.map(|(span, _)| *span).collect();
            self.state = GyroState::Refuted(fault(&wrong));
            self.spans.clear();
        } else if right_count >= RIGHT_MIN && right_count >= RIGHT_MAJORITY * wrong_count {
            self.state = GyroState::Confirmed;
        } else if wrong_count > right_count {
            self.state = GyroState::Untested;
        }
    }

    /// What each span says of the gyroscope; most of a camera that hardly turns say nothing.
    fn votes(&self, sigma: f64) -> Vec<Vote> {
        let bias = self.median_rate(|span| span.told - span.seen);
        // What one that is silent would leave, whatever constant its readings are.
        let silent_bias = self.median_rate(|span| -span.seen);
        let vote = |span: &Span| {
            let turned = (span.seen + silent_bias * span.seconds).norm();
            let missed = (span.seen - span.told + bias * span.seconds).norm();
            let is_seen = turned > SEEN_SIGMAS * sigma;
            let is_harmful = missed > HARMFUL_SIGMAS * sigma;
            if is_seen && missed <= RIGHT_SHARE_MAX * turned {
                Vote::Right
            } else if is_harmful && missed >= WRONG_SHARE_MIN * turned {
                Vote::Wrong
            } else {
                Vote::Neither
            }
        };
        self.spans.iter().map(vote).collect()
    }

    /// The median of a turn per second, axis by axis; no more than a bias can be.
    fn median_rate(&self, turn: impl Fn(&Span) -> Vector3<f64>) -> Vector3<f64> {
        let rates = self.spans.iter().map(|span| turn(span) / span.seconds);
        median(&rates.collect::<Vec<_>>()).cap_magnitude(BIAS_MAX)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Vote {
    Right,
    Wrong,
    Neither,
}

/// What explains turns that were told wrong, once as they are and once about their means, since a
/// constant may have been added to what is told.
fn fault(wrong: &[Span]) -> GyroFault {
    let seconds: f64 = wrong.iter().map(|span| span.seconds).sum();
    let seen_rate = wrong.iter().map(|span| span.seen).sum::<Vector3<f64>>() / seconds;
    let told_rate = wrong.iter().map(|span| span.told).sum::<Vector3<f64>>() / seconds;
    let about_mean = wrong.iter().map(|span| Span {
        seconds: span.seconds,
        seen: span.seen - seen_rate * span.seconds,
        told: span.told - told_rate * span.seconds,
    });
    let about_mean: Vec<Span> = about_mean.collect();
    let told_varies = about_mean
        .iter()
        .any(|span| span.told.norm() > SILENT_RAD_MAX);
    if !told_varies && told_rate.norm() < BIAS_MAX {
        return GyroFault::Silent;
    }
    let kinships = [Kinship::of(wrong), Kinship::of(&about_mean)];
    let scaled = kinships
        .iter()
        .find(|one| one.is_scaled && one.as_it_is > RELATED_MIN);
    let turned = kinships
        .iter()
        .find(|one| !one.is_scaled && one.with_other_axes > RELATED_MIN);
    match (scaled, turned) {
        (Some(Kinship { factor, .. }), _) => GyroFault::Scale { factor: *factor },
        (None, Some(_)) => GyroFault::Axes,
        (None, None) => GyroFault::Unrelated,
    }
}

/// How much turns that are told have in common with those that were seen.
struct Kinship {
    /// The length of what is told, over that of what was seen.
    factor: f64,
    /// Whether that is no error of axes alone.
    is_scaled: bool,
    /// Correlation, 1 where the turns are the same but for the factor.
    as_it_is: f64,
    /// The same with the best turn or mirror of the axes (orthogonal Procrustes, Schönemann 1966).
    with_other_axes: f64,
}

impl Kinship {
    fn of(spans: &[Span]) -> Self {
        let cross = spans.iter().map(|span| span.told * span.seen.transpose());
        let cross: Matrix3<f64> = cross.sum();
        let seen_squared: f64 = spans.iter().map(|span| span.seen.norm_squared()).sum();
        let told_squared: f64 = spans.iter().map(|span| span.told.norm_squared()).sum();
        let factor = (told_squared / seen_squared).sqrt();
        let norms = (seen_squared * told_squared).sqrt();
        Self {
            factor,
            is_scaled: !(FACTOR_MAX.recip()..FACTOR_MAX).contains(&factor),
            as_it_is: cross.trace() / norms,
            with_other_axes: cross.singular_values().sum() / norms,
        }
    }
}

/// Less than the noise of any gyroscope (rad).
const SILENT_RAD_MAX: f64 = 1e-6;
/// Turns that correlate less are not the same turns.
const RELATED_MIN: f64 = 0.8;

impl fmt::Display for GyroFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let degrees = 1_f64.to_degrees();
        let near =
            |wanted: f64, factor: f64| (wanted / FACTOR_MAX..wanted * FACTOR_MAX).contains(&factor);
        match *self {
            Self::Scale { factor } if near(degrees, factor) => write!(
                f,
                "it tells turns {factor:.0} times as large as they are: degrees per second instead \
                 of radians"
            ),
            Self::Scale { factor } => write!(
                f,
                "it tells turns {factor:.3} times as large as they are: another unit than rad/s"
            ),
            Self::Axes => f.write_str(
                "it tells turns of the right size about other axes: swapped, mirrored, or mounted \
                 otherwise than is said",
            ),
            Self::Silent => f.write_str("it tells no turns, and the camera turns"),
            Self::Unrelated => f.write_str(
                "what it tells has nothing to do with the turns that are seen: of another \
                 recording, or on another clock",
            ),
        }
    }
}

#[cfg(test)]
mod tests;
