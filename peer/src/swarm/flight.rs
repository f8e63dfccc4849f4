//! One flight of a swarm.

use nalgebra::Vector3;
use sim::swarm::{STEP_S, Steering, Swarm};

use super::graph;
use super::metrics::{Meter, Totals};
use super::pilot::{Cockpit, Pilot};
use super::scenario::Scenario;

/// One moment of a flight, for those who plot or record it.
pub struct Moment<'a> {
    pub time_s: f64,
    pub swarm: &'a Swarm,
    /// What everybody is told next.
    pub steering: &'a [Steering],
}

/// What came of a flight.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightRecord {
    pub seed: u64,
    pub totals: Totals,
    /// Distances over time, one value a step: between all pairs of up to three drones, else one
    /// curve, the mean over drones of the distance to the nearest.
    pub curves: Vec<Vec<f32>>,
    /// Each curve's mean over the last seconds.
    pub final_m: Vec<f64>,
    /// From when on every curve stays near its end.
    pub settle_s: Option<f64>,
    /// λ₂ / N at the end.
    pub connectivity: f64,
    pub drone_seconds: f64,
}

/// All pairs are followed up to this number of drones.
const PAIRS_COUNT_MAX: usize = 3;
/// Curves have settled when they stay this near to their end.
pub const SETTLED_M: f64 = 0.1;
/// Their end is the mean over this time.
const END_S: f64 = 5.0;
/// Spacing is averaged over this time before the end.
const TAIL_S: f64 = 20.0;

/// Flies a scenario once. Deterministic: the same seed gives the same bits.
pub fn fly(scenario: &Scenario, seed: u64, mut watch: impl FnMut(&Moment<'_>)) -> FlightRecord {
    let mut swarm = Swarm::new(scenario.swarm.clone(), seed);
    let drone_count = swarm.positions().len();
    let mut cockpit = Cockpit::new(scenario, seed);
    let is_dark = |drone| scenario.swarm.sensing.unlit_known && swarm.is_unlit(drone);
    let mut pilots: Vec<Pilot> = (0..drone_count)
        .map(|drone| Pilot::new(scenario, !is_dark(drone)))
        .collect();
    let step_count = (scenario.duration_s / STEP_S).round() as usize;
    let tail_steps = (TAIL_S / STEP_S).round() as usize;
    let mut meter = Meter::new(&swarm, step_count.saturating_sub(tail_steps));
    let mut curves = Curves::new(drone_count);
    let mut steering = vec![Steering::default(); drone_count];
    for step in 0..=step_count {
        for (drone, pilot) in pilots.iter_mut().enumerate() {
            let glimpses = cockpit.look(&mut swarm, drone);
            meter.saw(drone, glimpses);
            if meter.is_sampled() {
                meter.could_see(swarm.in_view_count(drone));
            }
            steering[drone] = cockpit.steer(pilot, &swarm, drone);
        }
        let report = meter.measure(&swarm, &steering);
        curves.add(swarm.positions(), report.nearest_m_mean);
        watch(&Moment {
            time_s: step as f64 * STEP_S,
            swarm: &swarm,
            steering: &steering,
        });
        if step < step_count {
            swarm.advance(&steering);
        }
    }
    let reach_m = scenario.swarm.sensing.bright_m;
    let curves = curves.0;
    let positions = swarm.positions().iter().enumerate();
    let aloft: Vec<Vector3<f64>> = positions
        .filter(|(drone, _)| swarm.is_aloft(*drone))
        .map(|(_, position)| *position)
        .collect();
    let final_m: Vec<f64> = curves.iter().map(|curve| end_of(curve)).collect();
    FlightRecord {
        seed,
        totals: meter.totals,
        settle_s: settle_s(&curves, &final_m),
        final_m,
        curves,
        connectivity: graph::connectivity(&aloft, reach_m),
        drone_seconds: scenario.duration_s * drone_count as f64,
    }
}

struct Curves(Vec<Vec<f32>>);

impl Curves {
    fn new(drone_count: usize) -> Self {
        let curve_count = if drone_count <= PAIRS_COUNT_MAX {
            drone_count * drone_count.saturating_sub(1) / 2
        } else {
            1
        };
        Self(vec![Vec::new(); curve_count])
    }

    fn add(&mut self, positions: &[Vector3<f64>], nearest_m_mean: f64) {
        if positions.len() > PAIRS_COUNT_MAX {
            self.0[0].push(nearest_m_mean as f32);
            return;
        }
        let pairs = (0..positions.len())
            .flat_map(|left| (left + 1..positions.len()).map(move |right| (left, right)));
        for (curve, (left, right)) in self.0.iter_mut().zip(pairs) {
            curve.push((positions[left] - positions[right]).norm() as f32);
        }
    }
}

fn end_of(curve: &[f32]) -> f64 {
    let end_steps = ((END_S / STEP_S).round() as usize).min(curve.len());
    let sum: f64 = curve[curve.len() - end_steps..]
        .iter()
        .map(|value| f64::from(*value))
        .sum();
    sum / end_steps.max(1) as f64
}

/// `None` if a curve still moves in the time over which its end is averaged.
fn settle_s(curves: &[Vec<f32>], final_m: &[f64]) -> Option<f64> {
    let mut settled_at = 0;
    let mut length = 0;
    for (curve, end) in curves.iter().zip(final_m) {
        let is_away = |value: &f32| (f64::from(*value) - end).abs() >= SETTLED_M;
        let last_away = curve.iter().rposition(is_away);
        settled_at = settled_at.max(last_away.map_or(0, |idx| idx + 1));
        length = curve.len();
    }
    let end_steps = (END_S / STEP_S).round() as usize;
    (settled_at + end_steps < length || length == 0).then_some(settled_at as f64 * STEP_S)
}

#[cfg(test)]
mod degraded;
#[cfg(test)]
mod tests;
