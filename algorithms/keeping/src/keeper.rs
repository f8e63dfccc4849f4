//! From sightings to a velocity command, frame by frame.

use nalgebra::Vector3;

use crate::gabriel_rule::{self, GabrielSettings, Shell};
use crate::paper_rule::Placed;
use crate::safety::{self, Flight, Limit, Limits, OBSTACLE_COUNT_MAX, Obstacle, SafetySettings};
use crate::sighting::Sighting;
use crate::tracks::{TrackSettings, Tracks};
use crate::turn::Turn;
use crate::view::{Coverage, FieldOfView};

/// What becomes of a vehicle's heading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HeadingRule {
    /// Its heading is held: a compass, or a site, made everybody's the same.
    #[default]
    Held,
    /// Its heading turns with the corrections, from which a common one emerges.
    Aligned,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeeperSettings {
    pub rule: GabrielSettings,
    pub tracks: TrackSettings,
    pub safety: SafetySettings,
    pub heading: HeadingRule,
    /// How much of a correction turns the heading. At one the heading swings, at zero it stays.
    pub alignment: f64,
    /// Time constant of the correction's low-pass. Shorter jerks, longer overshoots.
    pub smoothing_s: f64,
    /// A direction that was not covered for so long is not flown into.
    pub coverage_s: f64,
    /// A neighbour pulls and pushes only after so many sightings; kept clear of from the first.
    pub sighting_count_min: u32,
    /// Obstacles nearer than this are flown around.
    pub detour_m: f64,
}

impl Default for KeeperSettings {
    fn default() -> Self {
        Self {
            rule: GabrielSettings::default(),
            tracks: TrackSettings::default(),
            safety: SafetySettings::default(),
            heading: HeadingRule::default(),
            alignment: 0.2,
            smoothing_s: 0.3,
            coverage_s: 2.0,
            sighting_count_min: 2,
            detour_m: 4.0,
        }
    }
}

/// What a vehicle knows in one step. Vectors are in the heading frame.
#[derive(Clone, Copy, Debug)]
pub struct Perception<'a> {
    pub sightings: &'a [Sighting],
    /// The nearest first.
    pub obstacles: &'a [Obstacle],
    /// What the cameras cover that gave an image this time.
    pub views: &'a [FieldOfView],
    /// From the gyroscope: about the vertical, from axes that do not turn.
    pub heading_rad: f64,
    /// Its own, from its autopilot.
    pub velocity: Vector3<f64>,
    /// The speed common to the swarm, along the heading.
    pub nominal_mps: f64,
}

/// What the autopilot shall fly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// In the heading frame that was perceived.
    pub velocity: Vector3<f64>,
    pub heading_rad: f64,
}

/// Holds a vehicle's place among its neighbours. It allocates nothing.
#[derive(Clone, Debug)]
pub struct Keeper {
    settings: KeeperSettings,
    tracks: Tracks,
    coverage: Coverage,
    shell: Shell,
    limits: Limits,
    /// Smoothed; axes that do not turn.
    correction_in_level: Vector3<f64>,
    lights_shine: bool,
}

impl Keeper {
    pub fn new(settings: KeeperSettings) -> Self {
        Self {
            settings,
            tracks: Tracks::new(settings.tracks),
            coverage: Coverage::new(settings.coverage_s),
            shell: Shell::default(),
            limits: Limits::default(),
            correction_in_level: Vector3::zeros(),
            lights_shine: true,
        }
    }

    /// From now on nobody sees this vehicle: who flies behind leaves no room, so that it must not
    /// back up any more.
    pub fn lose_lights(&mut self) {
        self.lights_shine = false;
    }

    pub fn tracks(&self) -> &Tracks {
        &self.tracks
    }

    /// - `step_s`: since the last step.
    pub fn step(&mut self, perception: &Perception<'_>, step_s: f64) -> Command {
        let heading_rad = perception.heading_rad;
        self.tracks
            .update(perception.sightings, heading_rad, step_s);
        self.coverage.update(perception.views, heading_rad, step_s);
        let flight = Flight {
            nominal: Vector3::x() * perception.nominal_mps,
            velocity: perception.velocity,
        };
        let freedom = Freedom::of(&self.coverage, heading_rad, self.lights_shine);
        let wanted = freedom.part_of(self.correct(heading_rad));
        let correction = freedom.part_of(self.smooth(&wanted, heading_rad, step_s));
        let detour = self.detour(&flight.nominal, perception.obstacles);
        self.collect_limits(perception, &flight, &freedom);
        let limited = safety::limit(&(detour + correction), &self.limits);
        let velocity = self
            .coverage
            .clamp(&self.capped(limited, &flight), heading_rad);
        Command {
            velocity,
            heading_rad: self.turned(heading_rad, &flight.nominal, &correction, step_s),
        }
    }

    /// The rule's correction, heading frame.
    fn correct(&mut self, heading_rad: f64) -> Vector3<f64> {
        let tracks = &self.tracks;
        let sighting_count_min = self.settings.sighting_count_min;
        let far_m_min = FAR_SHARE * self.settings.rule.preferred_m;
        let heading_from_level = Turn::by(-heading_rad);
        let placed = tracks.tracks().iter().filter_map(|track| {
            let is_usable = tracks.is_held(track) && track.sighting_count >= sighting_count_min;
            // Lights that merged because they are far away pull from their smallest range.
            let far_m = Some(track.range.low_m).filter(|low_m| *low_m >= far_m_min);
            Some(Placed {
                direction: heading_from_level.of(&track.direction_in_level),
                range_m: track.range_m.or(far_m).filter(|_| is_usable)?,
            })
        });
        gabriel_rule::select(placed, &mut self.shell);
        gabriel_rule::correction(&self.shell, &self.settings.rule)
    }

    fn smooth(&mut self, wanted: &Vector3<f64>, heading_rad: f64, step_s: f64) -> Vector3<f64> {
        let gain = 1.0 - (-step_s / self.settings.smoothing_s).exp();
        let wanted_in_level = Turn::by(heading_rad).of(wanted);
        self.correction_in_level += (wanted_in_level - self.correction_in_level) * gain;
        Turn::by(-heading_rad).of(&self.correction_in_level)
    }

    /// The nominal velocity, turned aside where an obstacle is ahead.
    fn detour(&self, nominal: &Vector3<f64>, obstacles: &[Obstacle]) -> Vector3<f64> {
        let speed_mps = nominal.norm();
        if speed_mps <= 0.0 {
            return *nominal;
        }
        let ahead = nominal / speed_mps;
        let mut aside = Vector3::zeros();
        for obstacle in obstacles.iter().take(OBSTACLE_COUNT_MAX) {
            let along = obstacle.direction.dot(&ahead);
            let nearness = (1.0 - obstacle.clearance_m / self.settings.detour_m).clamp(0.0, 1.0);
            if along <= 0.0 || nearness <= 0.0 {
                continue;
            }
            let beside = obstacle.direction - ahead * along;
            let side = if beside.norm() > 1e-3 {
                -beside.normalize()
            } else {
                // Dead ahead: everybody passes on the same side.
                Vector3::y()
            };
            let passing_m = obstacle.clearance_m * beside.norm();
            let need = (1.0 - passing_m / PASSING_M).clamp(0.0, 1.0);
            aside += side * (along * need * nearness.sqrt() * DETOUR_GAIN);
        }
        (ahead + aside).normalize() * speed_mps
    }

    fn collect_limits(&mut self, perception: &Perception<'_>, flight: &Flight, freedom: &Freedom) {
        self.limits.clear();
        let safety = &self.settings.safety;
        let heading_from_level = Turn::by(-perception.heading_rad);
        for track in self.tracks.tracks() {
            let direction = heading_from_level.of(&track.direction_in_level);
            let limit = safety.neighbour_limit(direction, track, flight);
            if let Some(limit) = limit.and_then(|limit| freedom.kept_by(&limit)) {
                // Room for all tracks and obstacles is reserved.
                let _ = self.limits.push(limit);
            }
        }
        for obstacle in perception.obstacles.iter().take(OBSTACLE_COUNT_MAX) {
            let _ = self.limits.push(safety.obstacle_limit(obstacle));
        }
    }

    fn capped(&self, velocity: Vector3<f64>, flight: &Flight) -> Vector3<f64> {
        let speed_mps_max = flight.nominal.norm() + self.settings.safety.excess_mps_max;
        let speed_mps = velocity.norm();
        if speed_mps > speed_mps_max {
            velocity * (speed_mps_max / speed_mps)
        } else {
            velocity
        }
    }

    /// The heading after this step.
    fn turned(
        &self,
        heading_rad: f64,
        nominal: &Vector3<f64>,
        correction: &Vector3<f64>,
        step_s: f64,
    ) -> f64 {
        match self.settings.heading {
            HeadingRule::Held => heading_rad,
            HeadingRule::Aligned => {
                let turned = nominal + correction * (self.settings.alignment * step_s);
                if turned.x.hypot(turned.y) > 1e-6 {
                    heading_rad + turned.y.atan2(turned.x)
                } else {
                    heading_rad
                }
            }
        }
    }
}

/// Along which axes of the heading frame the vehicle may move against the swarm.
///
/// A neighbour beside us moves too. If everybody leaves the axes alone along which he does not
/// look, whatever two of them do, one of them looks along their relative motion. Backward is free
/// while our lights shine: who flies behind sees them, and leaves room for the slow backing that
/// the rule allows.
struct Freedom {
    forward: bool,
    backward: bool,
    left: bool,
    right: bool,
    up: bool,
    down: bool,
}

/// What is left of a limit's direction along free axes; with less it cannot be kept.
const FREE_SHARE_MIN: f64 = 0.1;

impl Freedom {
    fn of(coverage: &Coverage, heading_rad: f64, lights_shine: bool) -> Self {
        let covers = |direction: Vector3<f64>| coverage.covers(&direction, heading_rad);
        Self {
            forward: covers(Vector3::x()),
            backward: lights_shine || covers(-Vector3::x()),
            left: covers(Vector3::y()),
            right: covers(-Vector3::y()),
            up: covers(Vector3::z()),
            down: covers(-Vector3::z()),
        }
    }

    fn part_of(&self, motion: Vector3<f64>) -> Vector3<f64> {
        let free = |value: f64, up: bool, down: bool| {
            if if value > 0.0 { up } else { down } {
                value
            } else {
                0.0
            }
        };
        Vector3::new(
            free(motion.x, self.forward, self.backward),
            free(motion.y, self.left, self.right),
            free(motion.z, self.up, self.down),
        )
    }

    /// The limit as motion along free axes keeps it.
    fn kept_by(&self, limit: &Limit) -> Option<Limit> {
        let free = -self.part_of(-limit.direction);
        let share = free.norm();
        (share >= FREE_SHARE_MIN).then(|| Limit {
            direction: free / share,
            speed_mps_max: limit.speed_mps_max / share,
        })
    }
}

/// Merged lights are far if they are farther than this times the preferred distance.
const FAR_SHARE: f64 = 1.5;
/// An obstacle that is passed at this clearance needs no detour.
const PASSING_M: f64 = 1.5;
const DETOUR_GAIN: f64 = 1.5;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sighting::Range;

    fn sighting(direction: Vector3<f64>, range_m: f64) -> Sighting {
        Sighting {
            direction,
            range: Range {
                expected_m: Some(range_m),
                low_m: 0.95 * range_m,
                high_m: 1.05 * range_m,
            },
        }
    }

    fn hover<'a>(sightings: &'a [Sighting], views: &'a [FieldOfView]) -> Perception<'a> {
        Perception {
            sightings,
            obstacles: &[],
            views,
            heading_rad: 0.0,
            velocity: Vector3::zeros(),
            nominal_mps: 0.0,
        }
    }

    #[test]
    fn a_lost_neighbour_lets_the_command_decay() {
        let mut keeper = Keeper::new(KeeperSettings::default());
        let views = [FieldOfView::all_but_rear()];
        let far = [sighting(Vector3::y(), 5.0)];
        for _ in 0..20 {
            keeper.step(&hover(&far, &views), 0.1);
        }
        let seen = keeper.step(&hover(&far, &views), 0.1).velocity.norm();
        assert!(seen > 0.2, "{seen}");
        for _ in 0..15 {
            keeper.step(&hover(&[], &views), 0.1);
        }
        let lost = keeper.step(&hover(&[], &views), 0.1).velocity.norm();
        assert!(lost < 0.02, "{lost}");
    }

    #[test]
    fn one_camera_never_leads_out_of_its_view() {
        let mut keeper = Keeper::new(KeeperSettings::default());
        let camera = FieldOfView {
            azimuth_rad: 0.0,
            half_width_rad: 0.73,
            elevation_rad_max: 0.6,
        };
        // Too near and half left: the way back is to the right, where the camera does not look.
        let near = [sighting(Vector3::new(0.8, 0.6, 0.0), 1.5)];
        for _ in 0..30 {
            let velocity = keeper.step(&hover(&near, &[camera]), 0.1).velocity;
            assert!(camera.contains(&velocity), "{velocity:?}");
        }
    }

    #[test]
    fn without_lights_nobody_backs_up() {
        let views = [FieldOfView::all_but_rear()];
        let near = [sighting(Vector3::new(0.8, 0.6, 0.0), 1.0)];
        for (is_lit, is_backing) in [(true, true), (false, false)] {
            let mut keeper = Keeper::new(KeeperSettings::default());
            if !is_lit {
                keeper.lose_lights();
            }
            let mut velocity = Vector3::zeros();
            for _ in 0..20 {
                velocity = keeper.step(&hover(&near, &views), 0.1).velocity;
            }
            assert_eq!(velocity.x < -0.01, is_backing, "{velocity:?}");
            assert!(velocity.y < -0.1, "{velocity:?}");
        }
    }

    #[test]
    fn a_blinded_vehicle_stops() {
        let mut keeper = Keeper::new(KeeperSettings::default());
        let moving = |views| Perception {
            nominal_mps: 1.0,
            ..hover(&[], views)
        };
        let views = [FieldOfView::all_but_rear()];
        let free = keeper.step(&moving(&views), 0.1).velocity;
        assert_eq!(free, Vector3::x());
        for _ in 0..25 {
            keeper.step(&moving(&[]), 0.1);
        }
        assert_eq!(keeper.step(&moving(&[]), 0.1).velocity, Vector3::zeros());
    }

    #[test]
    fn an_obstacle_ahead_is_flown_around() {
        let mut keeper = Keeper::new(KeeperSettings::default());
        let views = [FieldOfView::all_but_rear()];
        let obstacles = [Obstacle {
            direction: Vector3::x(),
            clearance_m: 1.0,
        }];
        let perception = Perception {
            obstacles: &obstacles,
            nominal_mps: 1.0,
            ..hover(&[], &views)
        };
        let velocity = keeper.step(&perception, 0.1).velocity;
        assert!(
            velocity.x <= 0.6 + 1e-9 && velocity.y.abs() > 0.3,
            "{velocity:?}"
        );
    }

    #[test]
    fn the_same_steps_give_the_same_bits() {
        let run = || {
            let mut keeper = Keeper::new(KeeperSettings::default());
            let views = [FieldOfView::all_but_rear()];
            let mut last = Vector3::zeros();
            for idx in 0..50 {
                let angle_rad = 0.05 * f64::from(idx);
                let others = [
                    sighting(Vector3::new(angle_rad.cos(), angle_rad.sin(), 0.0), 2.0),
                    sighting(Vector3::new(0.0, -1.0, 0.0), 4.0),
                ];
                last = keeper.step(&hover(&others, &views), 0.1).velocity;
            }
            last.map(f64::to_bits)
        };
        assert_eq!(run(), run());
    }
}
