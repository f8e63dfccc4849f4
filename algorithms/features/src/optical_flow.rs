//! Where points of one image went in the next.
//!
//! Pyramidal Lucas–Kanade (Lucas and Kanade 1981; Bouguet 2001) in its inverse compositional form
//! (Baker and Matthews 2004): gradients are taken once, in the first image. A change of brightness
//! of the whole window drops out.

mod pyramid;
mod window;

#[cfg(test)]
mod tests;

use nalgebra::{Matrix2, Vector2};

pub use pyramid::FlowPyramid;
use window::Window;

/// How points are followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowSettings {
    /// Levels by factor 2 that are used; each doubles the motion that can be followed, to about
    /// `window radius × 2^(levels - 1)` pixels.
    pub level_count: usize,
    /// Steps on each level at most.
    pub iteration_count_max: usize,
    /// A step shorter than this ends a level.
    pub step_px_min: f64,
    /// Points in windows whose weaker gradient (root mean square, grey values a pixel) is below
    /// this are not followed: they would slide.
    pub gradient_min: f64,
    /// Root mean square of the grey values by which the windows may differ.
    pub residual_max: f64,
    /// Forth and back must end within this of the start.
    pub round_trip_px_max: f64,
}

impl Default for FlowSettings {
    fn default() -> Self {
        Self {
            level_count: 4,
            iteration_count_max: 20,
            step_px_min: 0.01,
            gradient_min: 1.5,
            residual_max: 20.0,
            round_trip_px_max: 0.5,
        }
    }
}

/// What became of a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Flow {
    Found {
        position_px: Vector2<f64>,
        /// Root mean square of the difference of the windows, grey values.
        residual: f64,
    },
    Lost(FlowLoss),
}

/// Why a point could not be followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlowLoss {
    /// Its window reaches over the border of an image.
    OutOfImage,
    /// Its window has too little texture in at least one direction.
    Textureless,
    /// The best place looks different.
    Dissimilar,
    /// Following it back led elsewhere.
    NoReturn,
}

/// A point of the first image and where it is expected in the second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowStart {
    pub position_px: Vector2<f64>,
    /// The same position if nothing is known.
    pub guess_px: Vector2<f64>,
}

/// Follows points from the first image to the second and back.
///
/// Replaces `flows` by one entry for each start. Cost: about 20 µs a point.
pub fn follow(
    first: &FlowPyramid,
    second: &FlowPyramid,
    starts: &[FlowStart],
    settings: &FlowSettings,
    flows: &mut Vec<Flow>,
) {
    flows.clear();
    flows.extend(starts.iter().map(|start| {
        match follow_there_and_back(first, second, start, settings) {
            Ok((position_px, residual)) => Flow::Found {
                position_px,
                residual,
            },
            Err(loss) => Flow::Lost(loss),
        }
    }));
}

fn follow_there_and_back(
    first: &FlowPyramid,
    second: &FlowPyramid,
    start: &FlowStart,
    settings: &FlowSettings,
) -> Result<(Vector2<f64>, f64), FlowLoss> {
    let (there, residual) =
        follow_one(first, second, &start.position_px, &start.guess_px, settings)?;
    // The way back starts where the point came from: it tests the end, not the search.
    let (back, _) = follow_one(second, first, &there, &start.position_px, settings)?;
    if (back - start.position_px).norm() <= settings.round_trip_px_max {
        Ok((there, residual))
    } else {
        Err(FlowLoss::NoReturn)
    }
}

fn follow_one(
    first: &FlowPyramid,
    second: &FlowPyramid,
    position_px: &Vector2<f64>,
    guess_px: &Vector2<f64>,
    settings: &FlowSettings,
) -> Result<(Vector2<f64>, f64), FlowLoss> {
    let level_count = settings
        .level_count
        .min(first.levels().len())
        .min(second.levels().len());
    let mut guess_px = *guess_px;
    let mut last = Err(FlowLoss::OutOfImage);
    for level in (0..level_count).rev() {
        let scale = f64::from(1_u32 << level);
        let down = |position: &Vector2<f64>| position.add_scalar(0.5) / scale;
        let position = down(position_px).add_scalar(-0.5);
        let guess = down(&guess_px).add_scalar(-0.5);
        // Coarse levels only help: windows that do not fit or have no texture there are skipped.
        last = Template::new(first, level, &position, settings)
            .and_then(|template| template.search(second, level, &guess, settings));
        if let Ok((found, _)) = &last {
            guess_px = (found.add_scalar(0.5) * scale).add_scalar(-0.5);
        }
    }
    let (_, residual) = last?;
    if residual > settings.residual_max {
        return Err(FlowLoss::Dissimilar);
    }
    Ok((guess_px, residual))
}

/// A window of the first image with its gradients.
struct Template {
    brightness: Window,
    gradient_x: Window,
    gradient_y: Window,
    inverse_hessian: Matrix2<f64>,
}

impl Template {
    fn new(
        pyramid: &FlowPyramid,
        level: usize,
        position: &Vector2<f64>,
        settings: &FlowSettings,
    ) -> Result<Self, FlowLoss> {
        let plane = &pyramid.levels()[level];
        let sample = |x: f64, y: f64| {
            Window::sample(plane, &(position + Vector2::new(x, y))).ok_or(FlowLoss::OutOfImage)
        };
        let brightness = sample(0.0, 0.0)?;
        let slope = |ahead: Window, behind: Window| ahead.minus(&behind).scaled(0.5).centred();
        let gradient_x = slope(sample(1.0, 0.0)?, sample(-1.0, 0.0)?);
        let gradient_y = slope(sample(0.0, 1.0)?, sample(0.0, -1.0)?);
        let [xx, xy, yy] = [
            gradient_x.dot(&gradient_x),
            gradient_x.dot(&gradient_y),
            gradient_y.dot(&gradient_y),
        ]
        .map(f64::from);
        let spread = (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        let weaker = 0.5 * (xx + yy) - spread;
        let least = settings.gradient_min * settings.gradient_min * Window::PIXEL_COUNT as f64;
        let inverse_hessian = Matrix2::new(xx, xy, xy, yy)
            .try_inverse()
            .filter(|_| weaker >= least)
            .ok_or(FlowLoss::Textureless)?;
        Ok(Self {
            brightness,
            gradient_x,
            gradient_y,
            inverse_hessian,
        })
    }

    /// The place near the guess that looks most alike, and how much it differs.
    fn search(
        &self,
        pyramid: &FlowPyramid,
        level: usize,
        guess: &Vector2<f64>,
        settings: &FlowSettings,
    ) -> Result<(Vector2<f64>, f64), FlowLoss> {
        let plane = &pyramid.levels()[level];
        let mut position = *guess;
        let mut residual = f64::INFINITY;
        for _ in 0..settings.iteration_count_max {
            let seen = Window::sample(plane, &position).ok_or(FlowLoss::OutOfImage)?;
            let error = seen.minus(&self.brightness).centred();
            residual = (f64::from(error.dot(&error)) / Window::PIXEL_COUNT as f64).sqrt();
            let slope = Vector2::new(
                f64::from(self.gradient_x.dot(&error)),
                f64::from(self.gradient_y.dot(&error)),
            );
            let step = self.inverse_hessian * slope;
            position -= step;
            if step.norm() < settings.step_px_min {
                break;
            }
        }
        Ok((position, residual))
    }
}
