//! Positions as three 16-bit numbers on a grid of the ideal plane and the logarithm of depth.
//!
//! A step of the grid moves a point across its ray by `step · z` and along it by `step · |p|`:
//! the error is relative to the distance, as the noise of a camera's points is.

use nalgebra::Vector3;

use super::{ChunkPoint, CutRefusal};

/// The largest |x/z| and |y/z|: 75.6° from the axis. Four would need a coarser step.
const PLANE_LIMIT: f64 = 3.9;
/// ln z may spread over this much: e¹⁴ = 1.2 million.
const LOG_DEPTH_SPREAD_MAX: f64 = 14.0;
const LOG_DEPTH_LIMIT: f64 = 30.0;
/// The coarsest step that the limits above lead to.
const STEP_MAX: f64 = 1.0 / 4096.0;
/// Starts are multiples of this, and steps are powers of two, so that half-precision floats hold
/// both exactly: three bytes each.
const START_UNIT: f64 = 1.0 / 64.0;
const STEP_EXPONENT_MIN: i32 = -20;

/// The grid of one chunk over `x/z`, `y/z` and `ln z`: `value = start + step · number`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Grid {
    pub(super) start: [f64; 3],
    pub(super) step: [f64; 3],
}

impl Grid {
    /// The finest grid that holds all points, or which point no grid holds.
    pub(super) fn around(points: &[ChunkPoint]) -> Result<Self, CutRefusal> {
        let mut min = [f64::INFINITY; 3];
        let mut max = [f64::NEG_INFINITY; 3];
        for (point_idx, point) in points.iter().enumerate() {
            let position = &point.position_in_chunk;
            let refusal = CutRefusal::Point {
                point_idx,
                position: (*position).into(),
            };
            let values = logarithmic(position).ok_or(refusal)?;
            for axis in 0..3 {
                min[axis] = min[axis].min(values[axis]);
                max[axis] = max[axis].max(values[axis]);
            }
        }
        if points.is_empty() {
            return Err(CutRefusal::Empty);
        }
        if max[2] - min[2] > LOG_DEPTH_SPREAD_MAX {
            return Err(CutRefusal::DepthSpread {
                nearest: min[2].exp(),
                farthest: max[2].exp(),
            });
        }
        let start = min.map(|value| (value / START_UNIT).floor() * START_UNIT);
        let step =
            std::array::from_fn(|axis| power_of_two_above((max[axis] - start[axis]) / 65535.0));
        Ok(Self { start, step })
    }

    /// A grid that came in, or what is wrong with it.
    pub(super) fn new(start: [f64; 3], step: [f64; 3]) -> Result<Self, String> {
        let start_legal = start
            .iter()
            .all(|value| value.abs() <= LOG_DEPTH_LIMIT + 1.0);
        let step_legal = step.iter().all(|value| *value > 0.0 && *value <= STEP_MAX);
        if start_legal && step_legal {
            return Ok(Self { start, step });
        }
        Err(format!("a grid from {start:?} in steps of {step:?}"))
    }

    pub(super) fn quantise(&self, position: &Vector3<f64>) -> [u16; 3] {
        let values = logarithmic(position).expect("the grid was laid around this point");
        std::array::from_fn(|axis| {
            let number = (values[axis] - self.start[axis]) / self.step[axis];
            number.round().clamp(0.0, 65535.0) as u16
        })
    }

    pub(super) fn position(&self, numbers: [u16; 3]) -> Vector3<f64> {
        let value = |axis: usize| self.start[axis] + self.step[axis] * f64::from(numbers[axis]);
        Vector3::new(value(0), value(1), 1.0) * value(2).exp()
    }
}

/// `x/z`, `y/z`, `ln z`, if the point is in front of the camera and within the limits.
pub(super) fn logarithmic(position: &Vector3<f64>) -> Option<[f64; 3]> {
    let depth = position.z;
    if !(depth > 0.0 && depth.is_finite()) {
        return None;
    }
    let values = [position.x / depth, position.y / depth, depth.ln()];
    let plane = values[0].abs() <= PLANE_LIMIT && values[1].abs() <= PLANE_LIMIT;
    (plane && values[2].abs() <= LOG_DEPTH_LIMIT).then_some(values)
}

/// The number of the standard deviation of ln z: `σ = 2^(number/16 − 14)`, rounded up so that a
/// point never looks better than it is. Unknown is the worst.
pub(super) fn sigma(point: &ChunkPoint) -> u8 {
    let relative = point.depth_sigma / point.position_in_chunk.z;
    if relative.is_nan() {
        return u8::MAX;
    }
    let number = (relative.max(1e-9).log2() + 14.0) * 16.0;
    (number - 1e-6).ceil().clamp(0.0, 255.0) as u8
}

pub(super) fn relative_sigma(number: u8) -> f64 {
    (f64::from(number) / 16.0 - 14.0).exp2()
}

fn power_of_two_above(value: f64) -> f64 {
    let mut step = f64::from(STEP_EXPONENT_MIN).exp2();
    while step < value {
        step *= 2.0;
    }
    step
}
