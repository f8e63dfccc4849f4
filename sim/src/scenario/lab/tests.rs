use super::*;
use crate::Flight;
use crate::route::Motion;
use crate::scenario::Scenario;
use crate::world::Surroundings;

/// Positions nearer than this to the ground vehicle's path count as places where it has been.
const BEEN_THERE_M: f64 = 0.75;
/// A frame's time over its index.
const PERIOD_S: f64 = 0.1;

/// How all vehicles move at every frame when the second drone keeps its place as well as it can
/// be kept: it knows where the first one is and how it moves. The next frame is flown before one
/// is answered, as the simulator does.
struct Flown {
    scenario: Scenario,
    motions: Vec<Vec<Motion>>,
}

impl Flown {
    fn new(seed: u64) -> Self {
        let scenario = Scenario::lab(seed);
        let mut flight = Flight::new(&scenario);
        let mut motions = vec![flight.advance()];
        for frame_idx in 0..scenario.frame_count - 1 {
            let now = &motions[frame_idx];
            let heading_from_site = now[2].site_from_body.rotation().inverse();
            let apart = position(&now[1]) - position(&now[2]);
            let off = heading_from_site * apart - Vector3::x() * PLACE_BEHIND_M;
            let velocity = heading_from_site * now[1].velocity_in_site + off;
            motions.push(flight.advance());
            flight.command(2, &velocity, frame_idx);
        }
        Self { scenario, motions }
    }

    fn site_from_camera(&self, vehicle_idx: usize, frame_idx: usize) -> SiteFromCamera {
        let motion = &self.motions[frame_idx][vehicle_idx];
        motion.site_from_body
            * self.scenario.vehicles[vehicle_idx]
                .description
                .body_from_camera
    }

    fn positions(&self, vehicle_idx: usize) -> Vec<Vector3<f64>> {
        let motions = self.motions.iter();
        motions.map(|now| position(&now[vehicle_idx])).collect()
    }
}

type SiteFromCamera = geometry::Transform<geometry::Enu, geometry::Camera>;

fn position(motion: &Motion) -> Vector3<f64> {
    *motion.site_from_body.translation()
}

/// Without the wobble: the means over 0.6 s.
fn length_m(positions: &[Vector3<f64>]) -> f64 {
    let mean = |part: &[Vector3<f64>]| part.iter().sum::<Vector3<f64>>() / part.len() as f64;
    let smooth: Vec<Vector3<f64>> = positions.windows(6).map(mean).collect();
    smooth
        .windows(2)
        .map(|pair| (pair[1] - pair[0]).norm())
        .sum()
}

#[test]
fn drones_fly_far_and_where_the_ground_vehicle_has_not_been() {
    for seed in 1..=20 {
        let flown = Flown::new(seed);
        let driven = flown.positions(0);
        assert!(length_m(&driven) > 12.0);
        for drone in 1..3 {
            let way = flown.positions(drone);
            let length_m = length_m(&way);
            let least_m = [16.0, 15.0][drone - 1];
            assert!(
                length_m >= least_m,
                "seed {seed}: drone {drone} flies {length_m} m"
            );
            let mut new_m = 0.0;
            let mut all_m = 0.0;
            for pair in way.windows(2) {
                let apart_m = |been: &Vector3<f64>| (been - pair[0]).xy().norm();
                let nearest_m = driven.iter().map(apart_m).fold(f64::INFINITY, f64::min);
                let step_m = (pair[1] - pair[0]).norm();
                all_m += step_m;
                new_m += if nearest_m > BEEN_THERE_M {
                    step_m
                } else {
                    0.0
                };
            }
            assert!(new_m / all_m > 0.34, "seed {seed}: {new_m} of {all_m} m");
        }
    }
}

#[test]
fn nobody_comes_close_to_anything() {
    for seed in 1..=20 {
        let flown = Flown::new(seed);
        let scenario = &flown.scenario;
        let surroundings = Surroundings::new(&scenario.world);
        for (frame_idx, now) in flown.motions.iter().enumerate().step_by(4) {
            let at = [0, 1, 2].map(|vehicle| position(&now[vehicle]));
            let time_s = scenario.frame_time_s(frame_idx);
            for (vehicle, position) in at.iter().enumerate() {
                let clearance_m = surroundings.clearance_m(position);
                assert!(
                    clearance_m > 0.33 && scenario.world.encloses(position),
                    "seed {seed}: {clearance_m} m around vehicle {vehicle} at {time_s} s"
                );
                for other in &at[vehicle + 1..] {
                    let apart_m = (position - other).norm();
                    assert!(
                        apart_m > 0.7,
                        "seed {seed}: {apart_m} m apart at {time_s} s"
                    );
                }
            }
        }
    }
}

#[test]
fn motion_is_smooth_and_slow() {
    for seed in 1..=20 {
        let flown = Flown::new(seed);
        for idx in 0..3 {
            let mut before = flown.motions[0][idx];
            for now in &flown.motions {
                let motion = now[idx];
                let speed_m_per_s = motion.velocity_in_site.norm();
                let limit_m_per_s = if idx == 0 { 0.4 } else { 0.65 };
                assert!(
                    speed_m_per_s < limit_m_per_s,
                    "seed {seed}: {speed_m_per_s} m/s"
                );
                let yaw_deg_per_s = motion.rotation_rate_in_body.z.to_degrees().abs();
                assert!(yaw_deg_per_s < 27.0, "seed {seed}: {yaw_deg_per_s} °/s");
                let tilt_deg_per_s = motion.rotation_rate_in_body.xy().norm().to_degrees();
                assert!(tilt_deg_per_s < 10.0, "seed {seed}: {tilt_deg_per_s} °/s");
                let change = (motion.velocity_in_site - before.velocity_in_site).norm();
                let rate = change / PERIOD_S;
                assert!(rate < 1.2, "seed {seed}: vehicle {idx}, {rate} m/s²");
                before = motion;
            }
        }
    }
}

#[test]
fn cameras_translate_before_they_have_turned_much() {
    for seed in 1..=20 {
        let flown = Flown::new(seed);
        for idx in 0..3 {
            let first = flown.site_from_camera(idx, 0);
            let later = flown.site_from_camera(idx, 20);
            let moved = later.translation() - first.translation();
            let turned_deg = first.rotation().angle_to(later.rotation()).to_degrees();
            assert!(
                moved.norm() > 0.25 && moved.xy().norm() > 0.2,
                "seed {seed}: vehicle {idx} moves {moved} m"
            );
            assert!(
                turned_deg < 25.0,
                "seed {seed}: vehicle {idx} turns {turned_deg}°"
            );
        }
    }
}

/// The first drone has to be in the middle of the second one's picture, in its place.
#[test]
fn an_ideal_follower_keeps_its_place_and_the_first_drone_in_view() {
    for seed in 1..=20 {
        let flown = Flown::new(seed);
        let camera = &flown.scenario.vehicles[2].description.camera;
        for frame_idx in 0..flown.motions.len() {
            let now = &flown.motions[frame_idx];
            let in_body = now[2].site_from_body.inverse() * position(&now[1]);
            let off_m = (in_body.xy() - Vector2::new(PLACE_BEHIND_M, 0.0)).norm();
            assert!(
                off_m < 0.25,
                "seed {seed}: {off_m} m off at frame {frame_idx}"
            );
            let in_camera = flown.site_from_camera(2, frame_idx).inverse() * position(&now[1]);
            let pixel = camera.project(&in_camera).unwrap();
            assert!(
                (pixel.x - 162.0).abs() < 40.0 && (pixel.y - 122.0).abs() < 60.0,
                "{pixel}"
            );
        }
    }
}

/// How much of what a drone sees at one moment the ground vehicle had seen 1.5 s before, from a
/// direction within 60°.
fn share_seen_before(
    flown: &Flown,
    surroundings: &Surroundings,
    drone: usize,
    frame_idx: usize,
) -> f64 {
    let site_from_camera = flown.site_from_camera(drone, frame_idx);
    let camera = &flown.scenario.vehicles[drone].description.camera;
    let anchor_camera = &flown.scenario.vehicles[0].description.camera;
    let mut seen = 0;
    let mut count = 0;
    for row in 0..4 {
        for column in 0..5 {
            let pixel = nalgebra::Vector2::new(
                (f64::from(column) + 0.5) / 5.0 * camera.width() as f64,
                (f64::from(row) + 0.5) / 4.0 * camera.height() as f64,
            );
            let Some(ray) = camera.unproject(&pixel) else {
                continue;
            };
            let direction = site_from_camera.rotation() * ray;
            let origin = site_from_camera.translation();
            let Some(length_m) = surroundings.ray_length_m(origin, &direction) else {
                continue;
            };
            let point = origin + direction * length_m;
            count += 1;
            let was_seen = (0..frame_idx.saturating_sub(15))
                .step_by(7)
                .any(|earlier_idx| {
                    let anchor = flown.site_from_camera(0, earlier_idx);
                    let towards = point - anchor.translation();
                    towards.angle(&direction) < 60_f64.to_radians()
                        && anchor_camera
                            .project(&(anchor.inverse() * point))
                            .is_some_and(|pixel| anchor_camera.contains(&pixel, 10.0))
                        && surroundings.sees(anchor.translation(), &point)
                });
            seen += i32::from(was_seen);
        }
    }
    f64::from(seen) / f64::from(count.max(1))
}

#[test]
fn drones_see_what_the_ground_vehicle_saw_before() {
    for seed in 1..=6 {
        let flown = Flown::new(seed);
        let surroundings = Surroundings::new(&flown.scenario.world);
        for drone in 1..3 {
            let shares: Vec<f64> = (0..23)
                .map(|idx| 20 + 20 * idx)
                .map(|frame_idx| share_seen_before(&flown, &surroundings, drone, frame_idx))
                .collect();
            let mean = shares.iter().sum::<f64>() / shares.len() as f64;
            let least = shares.iter().copied().fold(1.0, f64::min);
            // The second one is 3 m away: it also sees floor and ceiling, and twice as much of the
            // wall as the ground vehicle's camera.
            let (mean_min, least_min) = [(0.6, 0.3), (0.3, 0.1)][drone - 1];
            assert!(
                mean > mean_min && least >= least_min,
                "seed {seed}: drone {drone}, {shares:.2?}"
            );
        }
    }
}
