//! Somebody walks along straight lines with rounded corners, looking where they go.

use nalgebra::{Vector2, Vector3};

use crate::route::Waypoint;

/// How somebody walks.
#[derive(Clone, Copy, Debug)]
pub struct Gait {
    pub speed_m_per_s: f64,
    pub height_m: f64,
    /// Corners are rounded over about this length.
    pub rounding_m: f64,
    /// The heading looks this far ahead.
    pub foresight_m: f64,
}

const STEP_M: f64 = 0.02;
/// Speed is lost in corners, down to this share where the way turns back within a metre.
const CORNER_SPEED_SHARE: f64 = 0.45;

/// Waypoints at equal times along a polyline, until its end.
pub fn walk(corners: &[Vector2<f64>], gait: &Gait, interval_s: f64) -> Vec<Waypoint> {
    let way = rounded(&finely(corners), gait.rounding_m);
    let ahead = (gait.foresight_m / STEP_M) as usize;
    let headings = headings(&way, ahead);
    let mut waypoints = Vec::new();
    let mut step = 0.0;
    while (step as usize) + 1 < way.len() {
        let idx = step as usize;
        waypoints.push(Waypoint {
            position: Vector3::new(way[idx].x, way[idx].y, gait.height_m),
            yaw_rad: headings[idx],
        });
        let next = (idx + 2 * ahead).min(headings.len() - 1);
        let turn_rad: f64 = (headings[next] - headings[idx]).abs();
        let slow = (turn_rad / std::f64::consts::FRAC_PI_2).min(1.0);
        let speed = gait.speed_m_per_s * (1.0 - (1.0 - CORNER_SPEED_SHARE) * slow);
        step += speed * interval_s / STEP_M;
    }
    waypoints
}

fn finely(corners: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let mut points = Vec::new();
    for pair in corners.windows(2) {
        let count = ((pair[1] - pair[0]).norm() / STEP_M).ceil() as usize;
        points.extend((0..count).map(|step| pair[0].lerp(&pair[1], step as f64 / count as f64)));
    }
    points.extend(corners.last());
    points
}

/// The mean over a window that shrinks towards the ends; twice, so that curvature is continuous.
fn rounded(points: &[Vector2<f64>], rounding_m: f64) -> Vec<Vector2<f64>> {
    let reach = (0.5 * rounding_m / STEP_M) as usize;
    let mean = |points: &[Vector2<f64>]| -> Vec<Vector2<f64>> {
        (0..points.len())
            .map(|idx| {
                let reach = reach.min(idx).min(points.len() - 1 - idx);
                let window = &points[idx - reach..=idx + reach];
                window.iter().sum::<Vector2<f64>>() / window.len() as f64
            })
            .collect()
    };
    mean(&mean(points))
}

/// Unwrapped headings towards what lies ahead.
fn headings(way: &[Vector2<f64>], ahead: usize) -> Vec<f64> {
    let mut headings: Vec<f64> = Vec::with_capacity(way.len());
    for idx in 0..way.len() {
        let last = headings.last().copied();
        let step = way[(idx + ahead).min(way.len() - 1)] - way[idx];
        let heading = if step.norm() > STEP_M {
            step.y.atan2(step.x)
        } else {
            last.unwrap_or(0.0)
        };
        let near = last.unwrap_or(heading);
        let turns = ((near - heading) / std::f64::consts::TAU).round();
        headings.push(heading + turns * std::f64::consts::TAU);
    }
    headings
}
