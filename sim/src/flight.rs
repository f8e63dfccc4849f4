//! What the vehicles of a scenario really fly: their routes, and what they command on the way.

use nalgebra::{Vector2, Vector3};

use crate::route::{Motion, Route};
use crate::scenario::Scenario;

/// All vehicles of a scenario, flown from frame to frame.
///
/// A vehicle that keeps its place is carried away from its route by the velocities that it
/// commands; its autopilot holds the route's heading and height. The motion is a function of the
/// commands, and of the frames at which they were known, alone.
#[derive(Clone)]
pub struct Flight<'a> {
    scenario: &'a Scenario,
    frame_idx: Option<usize>,
    autopilots: Vec<Autopilot>,
}

/// Commands are capped to this speed along each axis.
const SPEED_MAX_M_PER_S: f64 = 1.0;
const ACCELERATION_MAX_M_PER_S2: f64 = 1.5;
/// In this time the velocity comes nearer to the commanded one by a factor of e.
const LAG_S: f64 = 0.3;
/// Older commands are not flown any more.
const COMMAND_AGE_MAX_S: f64 = 0.5;
const STEP_S: f64 = 0.005;
/// Bumpers keep vehicles this far from the walls of the room.
const BUMPER_M: f64 = 0.3;

impl<'a> Flight<'a> {
    /// Before the first frame.
    pub fn new(scenario: &'a Scenario) -> Self {
        Self {
            scenario,
            frame_idx: None,
            autopilots: vec![Autopilot::default(); scenario.vehicles.len()],
        }
    }

    /// Flies on to the next frame, the first one to begin with: how every vehicle moves there.
    pub fn advance(&mut self) -> Vec<Motion> {
        let frame_idx = self.frame_idx.map_or(0, |last| last + 1);
        self.frame_idx = Some(frame_idx);
        let scenario = self.scenario;
        let to_s = scenario.frame_time_s(frame_idx);
        let from_s = scenario.frame_time_s(frame_idx.saturating_sub(1));
        let half_m = scenario.world.size_m.xy() * 0.5;
        let vehicles = scenario.vehicles.iter().zip(&mut self.autopilots);
        vehicles
            .map(|(vehicle, autopilot)| {
                if vehicle.description.keeps_place {
                    autopilot.fly(&vehicle.route, [from_s, to_s], &half_m);
                }
                autopilot.carried(vehicle.route.motion(to_s))
            })
            .collect()
    }

    /// From the frame flown last on, a vehicle wants to fly with a velocity along the axes of its
    /// heading: forward, left and up. It had dealt with the frame at `frame_idx` when it said so.
    /// The autopilot holds the height, so the part upwards is not flown; and those who do not
    /// keep their place follow their routes.
    pub fn command(&mut self, vehicle_idx: usize, velocity: &Vector3<f64>, frame_idx: usize) {
        let capped = |speed: f64| speed.clamp(-SPEED_MAX_M_PER_S, SPEED_MAX_M_PER_S);
        self.autopilots[vehicle_idx].command = Some(Command {
            since_s: self.scenario.frame_time_s(frame_idx),
            velocity_in_heading: velocity.xy().map(capped),
        });
    }
}

/// Horizontal flight by velocity.
#[derive(Clone, Debug, Default)]
struct Autopilot {
    command: Option<Command>,
    velocity_in_site: Vector2<f64>,
    /// How far it has been carried from its route.
    way_in_site: Vector2<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Command {
    since_s: f64,
    velocity_in_heading: Vector2<f64>,
}

impl Autopilot {
    fn fly(&mut self, route: &Route, [from_s, to_s]: [f64; 2], half_m: &Vector2<f64>) {
        let count = ((to_s - from_s) / STEP_S).ceil();
        for idx in 0..count as usize {
            let step_s = (to_s - from_s) / count;
            self.step(route, from_s + step_s * (idx as f64 + 0.5), step_s, half_m);
        }
    }

    /// A lag of the first order, exact over the step, with limited acceleration.
    fn step(&mut self, route: &Route, time_s: f64, step_s: f64, half_m: &Vector2<f64>) {
        let pose = route.pose(time_s);
        let wanted = self.wanted_in_site(&(pose.rotation() * Vector3::x()), time_s);
        let closing = -(-step_s / LAG_S).exp_m1();
        let change = (wanted - self.velocity_in_site) * closing;
        let change = change.cap_magnitude(ACCELERATION_MAX_M_PER_S2 * step_s);
        self.way_in_site += (self.velocity_in_site + 0.5 * change) * step_s;
        self.velocity_in_site += change;
        for axis in 0..2 {
            let limit_m = half_m[axis] - BUMPER_M;
            let here_m = pose.translation()[axis] + self.way_in_site[axis];
            if here_m.abs() > limit_m {
                self.way_in_site[axis] += here_m.clamp(-limit_m, limit_m) - here_m;
                self.velocity_in_site[axis] = 0.0;
            }
        }
    }

    fn wanted_in_site(&self, forward: &Vector3<f64>, time_s: f64) -> Vector2<f64> {
        let is_fresh = |command: &Command| time_s - command.since_s <= COMMAND_AGE_MAX_S;
        let Some(command) = self.command.filter(is_fresh) else {
            return Vector2::zeros();
        };
        let forward = forward.xy().normalize();
        let left = Vector2::new(-forward.y, forward.x);
        let velocity = command.velocity_in_heading;
        forward * velocity.x + left * velocity.y
    }

    fn carried(&self, planned: Motion) -> Motion {
        let pose = planned.site_from_body;
        let way = self.way_in_site.push(0.0);
        Motion {
            site_from_body: geometry::Transform::new(*pose.rotation(), pose.translation() + way),
            velocity_in_site: planned.velocity_in_site + self.velocity_in_site.push(0.0),
            ..planned
        }
    }
}

#[cfg(test)]
mod tests;
