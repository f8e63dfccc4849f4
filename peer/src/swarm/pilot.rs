//! A drone's mind: from what it sees to how it flies.

use keeping::{
    Baseline, FieldOfView, Keeper, MarkerModel, Obstacle, PaperRule, Perception, Placed,
    Separation, Sighting,
};
use nalgebra::Vector3;
use sim::swarm::{Glimpse, LightBaseline, STEP_S, SensingSettings, Steering, Surface, Swarm};

use super::eyes::Eyes;
use super::scenario::{RuleName, Scenario};

/// One drone's rule, with what it remembers.
pub enum Pilot {
    Paper(Box<PaperRule>),
    Gabriel(Box<Keeper>),
}

/// What all drones share: their lights, their cameras, and room for one drone's senses.
pub struct Cockpit {
    markers: MarkerModel,
    focal_px: f64,
    noise_px: f64,
    separation_px_min: f64,
    view: FieldOfView,
    nominal_mps: f64,
    glimpses: Vec<Glimpse>,
    surfaces: Vec<Surface>,
    sightings: Vec<Sighting>,
    obstacles: Vec<Obstacle>,
    eyes: Option<Eyes>,
}

impl Pilot {
    /// - `has_lights`: as far as the drone knows.
    pub fn new(scenario: &Scenario, has_lights: bool) -> Self {
        match scenario.rule {
            RuleName::Paper => Self::Paper(Box::new(PaperRule::new(scenario.paper))),
            RuleName::Gabriel => {
                let mut keeper = Keeper::new(scenario.keeper);
                if !has_lights {
                    keeper.lose_lights();
                }
                Self::Gabriel(Box::new(keeper))
            }
        }
    }
}

/// Without a compass headings differ by more than the lights' own mounting.
const HEADING_DIFFERENCE_SIGMA: f64 = 1.5;

impl Cockpit {
    pub fn new(scenario: &Scenario, seed: u64) -> Self {
        let sensing: &SensingSettings = &scenario.swarm.sensing;
        let ideal = MarkerModel::default();
        let spread_rad = scenario.swarm.heading_spread_rad;
        let markers = MarkerModel {
            baseline: match sensing.baseline {
                LightBaseline::AllRound => Baseline::AllRound,
                LightBaseline::Vertical => Baseline::Vertical,
                LightBaseline::Horizontal => Baseline::Horizontal,
            },
            length_m: sensing.light_distance_m,
            heading_difference_rad_max: ideal.heading_difference_rad_max
                + HEADING_DIFFERENCE_SIGMA * spread_rad,
            ..ideal
        };
        let view = FieldOfView {
            azimuth_rad: 0.0,
            half_width_rad: sensing.azimuth_rad_max,
            elevation_rad_max: sensing.elevation_rad_max,
        };
        let drone_count = scenario.swarm.drone_count;
        let eyes = scenario
            .pictures
            .map(|settings| Eyes::new(&settings, view, &markers, drone_count, seed));
        Self {
            markers,
            focal_px: sensing.focal_px,
            noise_px: sensing.noise_px,
            separation_px_min: sensing.separation_px_min,
            view,
            nominal_mps: scenario.swarm.speed_mps,
            glimpses: Vec::new(),
            surfaces: Vec::new(),
            sightings: Vec::new(),
            obstacles: Vec::new(),
            eyes,
        }
    }

    /// Lets a drone look, and gives what it saw for those who check.
    pub fn look(&mut self, swarm: &mut Swarm, drone: usize) -> &[Glimpse] {
        self.sightings.clear();
        if let Some(eyes) = &mut self.eyes {
            let seen = eyes.look(swarm, drone, &mut self.glimpses);
            self.sightings.extend(seen);
        } else {
            self.look_without_pictures(swarm, drone);
        }
        swarm.surfaces(drone, &mut self.surfaces);
        self.obstacles.clear();
        self.obstacles
            .extend(self.surfaces.iter().map(|surface| Obstacle {
                direction: surface.direction,
                clearance_m: surface.clearance_m,
            }));
        &self.glimpses
    }

    fn look_without_pictures(&mut self, swarm: &mut Swarm, drone: usize) {
        swarm.glimpses(drone, &mut self.glimpses);
        for glimpse in &self.glimpses {
            let separation = match glimpse.separation_px {
                Some(separation_px) => Separation::Resolved {
                    angle_rad: separation_px / self.focal_px,
                    sigma_rad: self.noise_px / self.focal_px,
                },
                None => Separation::Merged {
                    angle_rad_max: (self.separation_px_min + 3.0 * self.noise_px) / self.focal_px,
                },
            };
            self.sightings.push(Sighting {
                direction: glimpse.direction,
                range: self.markers.range(&glimpse.direction, separation),
            });
        }
    }

    /// What the pilot makes of what [`Self::look`] saw.
    pub fn steer(&self, pilot: &mut Pilot, swarm: &Swarm, drone: usize) -> Steering {
        let heading_rad = swarm.headings_rad()[drone];
        match pilot {
            Pilot::Paper(rule) => {
                let placed = self.sightings.iter().filter_map(|sighting| {
                    Some(Placed {
                        direction: sighting.direction,
                        range_m: sighting.range.expected_m?,
                    })
                });
                Steering {
                    velocity: Vector3::x() * self.nominal_mps + rule.correction(placed),
                    heading_rad,
                }
            }
            Pilot::Gabriel(keeper) => {
                let views = [self.view];
                let perception = Perception {
                    sightings: &self.sightings,
                    obstacles: &self.obstacles,
                    views: if swarm.is_blinded(drone) { &[] } else { &views },
                    heading_rad,
                    velocity: swarm.own_velocity(drone),
                    nominal_mps: self.nominal_mps,
                };
                let command = keeper.step(&perception, STEP_S);
                Steering {
                    velocity: command.velocity,
                    heading_rad: command.heading_rad,
                }
            }
        }
    }
}
