//! What is measured in a flight, step by step; names as SwarmLab defines them.

use nalgebra::Vector3;
use sim::swarm::{Glimpse, STEP_S, Steering, Swarm};

use super::graph;

/// Two drones nearer than this have collided.
pub const COLLISION_M: f64 = 0.5;
/// A drone that was in view within this time could be kept clear of.
const SEEN_S: f64 = 2.0;
/// Costly numbers are taken every so many steps.
const SAMPLE_STEPS: usize = 10;
/// A command that changes by more than this from one step to the next switches.
const SWITCH_MPS: f64 = 0.05;

/// Sums over a flight so far.
pub struct Meter {
    drone_count: usize,
    reach_m: f64,
    nominal_mps: f64,
    step_count: usize,
    tail_start: usize,
    /// Row by row: the step in which the row's drone last saw the column's, from one; zero never.
    last_seen: Vec<u32>,
    has_collided: Vec<bool>,
    has_hit: Vec<bool>,
    nearest_m: Vec<f64>,
    commands: Vec<Vector3<f64>>,
    /// Drones in the air, and where they are.
    aloft: Vec<usize>,
    places: Vec<Vector3<f64>>,
    pub totals: Totals,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Totals {
    pub min_distance_m: f64,
    /// Pairs that came under [`COLLISION_M`], by whether either saw the other shortly before.
    pub seen_collisions: usize,
    pub unseen_collisions: usize,
    /// Drones that touched an obstacle.
    pub hits: usize,
    pub clearance_m_min: f64,
    pub order: Mean,
    pub order_of_neighbours: Mean,
    pub union: Mean,
    pub safety: Mean,
    /// Over drones, in the last seconds.
    pub nearest_m: Mean,
    /// Of the velocity beside the nominal one, in the last seconds.
    pub residual_squared: Mean,
    /// In sampled steps: others in view, those of them that were seen, and sightings of nobody.
    pub in_view: usize,
    pub seen: usize,
    pub false_sightings: usize,
    pub switches: usize,
    pub command_step_mps_max: f64,
}

/// A mean and a standard deviation that grow.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mean {
    count: f64,
    sum: f64,
    sum_squared: f64,
}

impl Mean {
    pub fn add(&mut self, value: f64) {
        self.count += 1.0;
        self.sum += value;
        self.sum_squared += value * value;
    }

    pub fn join(&mut self, other: &Self) {
        self.count += other.count;
        self.sum += other.sum;
        self.sum_squared += other.sum_squared;
    }

    pub fn mean(&self) -> Option<f64> {
        (self.count > 0.0).then(|| self.sum / self.count)
    }

    pub fn standard_deviation(&self) -> Option<f64> {
        let mean = self.mean()?;
        Some(
            (self.sum_squared / self.count - mean * mean)
                .max(0.0)
                .sqrt(),
        )
    }
}

/// What one step showed.
pub struct StepReport {
    /// Over all drones, to each one's nearest.
    pub nearest_m_mean: f64,
}

impl Meter {
    /// - `tail_start`: the step from which on spacing is averaged.
    pub fn new(swarm: &Swarm, tail_start: usize) -> Self {
        let drone_count = swarm.positions().len();
        Self {
            drone_count,
            reach_m: swarm.settings().sensing.bright_m,
            nominal_mps: swarm.settings().speed_mps,
            step_count: 0,
            tail_start,
            last_seen: vec![0; drone_count * drone_count],
            has_collided: vec![false; drone_count * drone_count],
            has_hit: vec![false; drone_count],
            nearest_m: vec![f64::INFINITY; drone_count],
            commands: Vec::new(),
            aloft: Vec::new(),
            places: Vec::new(),
            totals: Totals {
                min_distance_m: f64::INFINITY,
                clearance_m_min: f64::INFINITY,
                ..Totals::default()
            },
        }
    }

    pub fn saw(&mut self, observer: usize, glimpses: &[Glimpse]) {
        let row = observer * self.drone_count;
        let now = self.step_count as u32 + 1;
        let is_sampled = self.is_sampled();
        for glimpse in glimpses {
            let Some(target) = glimpse.target else {
                self.totals.false_sightings += usize::from(is_sampled);
                continue;
            };
            let last_seen = std::mem::replace(&mut self.last_seen[row + target], now);
            self.totals.seen += usize::from(is_sampled && last_seen != now);
        }
    }

    /// Whether costly numbers are taken in this step.
    pub fn is_sampled(&self) -> bool {
        self.step_count.is_multiple_of(SAMPLE_STEPS)
    }

    /// How many others were in view of a drone, in a sampled step.
    pub fn could_see(&mut self, in_view_count: usize) {
        self.totals.in_view += in_view_count;
    }

    /// Takes the places before the step and the commands for it.
    pub fn measure(&mut self, swarm: &Swarm, steering: &[Steering]) -> StepReport {
        self.aloft.clear();
        self.aloft
            .extend((0..self.drone_count).filter(|drone| swarm.is_aloft(*drone)));
        self.places.clear();
        let positions = swarm.positions();
        self.places
            .extend(self.aloft.iter().map(|drone| positions[*drone]));
        self.measure_pairs();
        self.measure_obstacles(swarm);
        self.measure_commands(steering);
        let is_sampled = self.is_sampled();
        if is_sampled {
            self.measure_cohesion();
        }
        self.measure_order(swarm, is_sampled);
        let mut nearest = Mean::default();
        for nearest_m in self.nearest_m.iter().filter(|value| value.is_finite()) {
            nearest.add(*nearest_m);
        }
        if self.step_count >= self.tail_start {
            self.measure_tail(swarm, &nearest);
        }
        self.step_count += 1;
        StepReport {
            nearest_m_mean: nearest.mean().unwrap_or(0.0),
        }
    }

    /// The nearest to each drone in the air; to the others nothing is near.
    fn measure_pairs(&mut self) {
        self.nearest_m.fill(f64::INFINITY);
        let mut near_count = 0;
        let count = self.aloft.len();
        for left in 0..count {
            let mut nearest_squared = f64::INFINITY;
            for right in left + 1..count {
                let squared = (self.places[left] - self.places[right]).norm_squared();
                nearest_squared = nearest_squared.min(squared);
                let right_m = &mut self.nearest_m[self.aloft[right]];
                *right_m = right_m.min(squared);
                if squared < COLLISION_M * COLLISION_M {
                    near_count += 1;
                    self.collide(self.aloft[left], self.aloft[right]);
                }
            }
            let left_m = &mut self.nearest_m[self.aloft[left]];
            *left_m = left_m.min(nearest_squared).sqrt();
            self.totals.min_distance_m = self.totals.min_distance_m.min(*left_m);
        }
        let pair_count = count * count.saturating_sub(1) / 2;
        if pair_count > 0 {
            let share = near_count as f64 / pair_count as f64;
            self.totals.safety.add(1.0 - share);
        }
    }

    fn collide(&mut self, left: usize, right: usize) {
        let cell = left * self.drone_count + right;
        if std::mem::replace(&mut self.has_collided[cell], true) {
            return;
        }
        let mirrored = right * self.drone_count + left;
        let last_seen = self.last_seen[cell].max(self.last_seen[mirrored]) as usize;
        let is_seen = last_seen > 0
            && (self.step_count + 1 - last_seen) as f64 * STEP_S <= SEEN_S + 0.5 * STEP_S;
        if is_seen {
            self.totals.seen_collisions += 1;
        } else {
            self.totals.unseen_collisions += 1;
        }
    }

    fn measure_obstacles(&mut self, swarm: &Swarm) {
        for cylinder in swarm.cylinders() {
            for (drone, position) in self.aloft.iter().zip(&self.places) {
                let clearance_m = cylinder.clearance_m(position);
                self.totals.clearance_m_min = self.totals.clearance_m_min.min(clearance_m);
                if cylinder.is_hit_by(position)
                    && !std::mem::replace(&mut self.has_hit[*drone], true)
                {
                    self.totals.hits += 1;
                }
            }
        }
    }

    fn measure_commands(&mut self, steering: &[Steering]) {
        for (before, now) in self.commands.iter().zip(steering) {
            let change_mps = (now.velocity - before).norm();
            self.totals.switches += usize::from(change_mps > SWITCH_MPS);
            if self.step_count >= self.tail_start {
                let largest = &mut self.totals.command_step_mps_max;
                *largest = largest.max(change_mps);
            }
        }
        self.commands.clear();
        self.commands
            .extend(steering.iter().map(|steering| steering.velocity));
    }

    /// The mean cosine between all pairs of velocities, without looking at pairs: the square of
    /// the sum of unit vectors is N and twice the sum over pairs.
    fn measure_order(&mut self, swarm: &Swarm, is_sampled: bool) {
        if self.nominal_mps <= 0.0 || self.aloft.len() < 2 {
            return;
        }
        let velocities = self.aloft.iter().map(|drone| swarm.velocities()[*drone]);
        let units: Vec<Vector3<f64>> = velocities
            .map(|velocity| velocity.try_normalize(1e-9).unwrap_or_default())
            .collect();
        let sum: Vector3<f64> = units.iter().sum();
        let own: f64 = units.iter().map(Vector3::norm_squared).sum();
        let count = units.len() as f64;
        let order = (sum.norm_squared() - own) / (count * (count - 1.0));
        self.totals.order.add(order);
        if !is_sampled {
            return;
        }
        for (drone, position) in self.places.iter().enumerate() {
            let mut of_neighbours = Mean::default();
            for (other, other_position) in self.places.iter().enumerate() {
                if other != drone && graph::is_near(position, other_position, self.reach_m) {
                    of_neighbours.add(units[drone].dot(&units[other]));
                }
            }
            if let Some(order) = of_neighbours.mean() {
                self.totals.order_of_neighbours.add(order);
            }
        }
    }

    fn measure_cohesion(&mut self) {
        let component_count = graph::component_count(&self.places, self.reach_m);
        if self.places.len() > 1 {
            let apart = (component_count - 1) as f64 / (self.places.len() - 1) as f64;
            self.totals.union.add(1.0 - apart);
        }
    }

    fn measure_tail(&mut self, swarm: &Swarm, nearest: &Mean) {
        self.totals.nearest_m.join(nearest);
        for drone in &self.aloft {
            let heading_rad = swarm.headings_rad()[*drone];
            let nominal =
                Vector3::new(heading_rad.cos(), heading_rad.sin(), 0.0) * self.nominal_mps;
            let residual = (swarm.velocities()[*drone] - nominal).norm_squared();
            self.totals.residual_squared.add(residual);
        }
    }
}
