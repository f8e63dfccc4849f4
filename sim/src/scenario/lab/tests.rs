use super::*;
use crate::scenario::Scenario;
use crate::world::Surroundings;

/// Positions nearer than this to the ground vehicle's path count as places where it has been.
const BEEN_THERE_M: f64 = 0.75;

fn site_position(scenario: &Scenario, vehicle_idx: usize, time_s: f64) -> Vector3<f64> {
    *scenario.site_from_camera(vehicle_idx, time_s).translation()
}

/// Ten times a second.
fn all_times_s() -> impl Iterator<Item = f64> {
    (0..520).map(|idx| 0.1 * f64::from(idx))
}

#[test]
fn drones_fly_far_and_where_the_ground_vehicle_has_not_been() {
    for seed in 1..=20 {
        let scenario = Scenario::lab(seed);
        let driven: Vec<_> = all_times_s()
            .map(|t| site_position(&scenario, 0, t).xy())
            .collect();
        assert!(scenario.vehicles[0].route.length_m(DURATION_S) > 12.0);
        for drone in 1..3 {
            let length_m = scenario.vehicles[drone].route.length_m(DURATION_S);
            assert!(
                length_m >= 15.0,
                "seed {seed}: drone {drone} flies {length_m} m"
            );
            let mut new_m = 0.0;
            for time_s in all_times_s() {
                let here = site_position(&scenario, drone, time_s);
                let next = site_position(&scenario, drone, time_s + 0.1);
                let apart_m = |been: &nalgebra::Vector2<f64>| (been - here.xy()).norm();
                let nearest_m = driven.iter().map(apart_m).fold(f64::INFINITY, f64::min);
                new_m += if nearest_m > BEEN_THERE_M {
                    (next - here).norm()
                } else {
                    0.0
                };
            }
            assert!(
                new_m / length_m > 0.34,
                "seed {seed}: {new_m} of {length_m} m"
            );
        }
    }
}

#[test]
fn nobody_comes_close_to_anything() {
    for seed in 1..=20 {
        let scenario = Scenario::lab(seed);
        let surroundings = Surroundings::new(&scenario.world);
        for time_s in all_times_s().step_by(4) {
            let at = [0, 1, 2].map(|vehicle| site_position(&scenario, vehicle, time_s));
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
        let scenario = Scenario::lab(seed);
        for (idx, vehicle) in scenario.vehicles.iter().enumerate() {
            let mut before = vehicle.route.motion(0.0);
            for time_s in all_times_s() {
                let motion = vehicle.route.motion(time_s);
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
                assert!(change / 0.1 < 1.2, "seed {seed}: {} m/s²", change / 0.1);
                before = motion;
            }
        }
    }
}

#[test]
fn cameras_translate_before_they_have_turned_much() {
    for seed in 1..=20 {
        let scenario = Scenario::lab(seed);
        for idx in 0..3 {
            let first = scenario.site_from_camera(idx, 0.0);
            let later = scenario.site_from_camera(idx, 2.0);
            let moved_m = (later.translation() - first.translation()).norm();
            let turned_deg = first.rotation().angle_to(later.rotation()).to_degrees();
            assert!(
                moved_m > 0.25,
                "seed {seed}: vehicle {idx} moves {moved_m} m"
            );
            assert!(
                turned_deg < 25.0,
                "seed {seed}: vehicle {idx} turns {turned_deg}°"
            );
        }
    }
}

/// How much of what a drone sees at one moment the ground vehicle had seen 1.5 s before, from a
/// direction within 60°.
fn share_seen_before(
    scenario: &Scenario,
    surroundings: &Surroundings,
    drone: usize,
    time_s: f64,
) -> f64 {
    let site_from_camera = scenario.site_from_camera(drone, time_s);
    let camera = &scenario.vehicles[drone].description.camera;
    let anchor_camera = &scenario.vehicles[0].description.camera;
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
            let was_seen = (0..)
                .map(|idx| 0.7 * f64::from(idx))
                .take_while(|earlier_s| *earlier_s < time_s - 1.5)
                .any(|earlier_s| {
                    let anchor = scenario.site_from_camera(0, earlier_s);
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
        let scenario = Scenario::lab(seed);
        let surroundings = Surroundings::new(&scenario.world);
        for drone in 1..3 {
            let shares: Vec<f64> = (0..23)
                .map(|idx| 2.0 + 2.0 * f64::from(idx))
                .map(|time_s| share_seen_before(&scenario, &surroundings, drone, time_s))
                .collect();
            let mean = shares.iter().sum::<f64>() / shares.len() as f64;
            let least = shares.iter().copied().fold(1.0, f64::min);
            assert!(mean > 0.6 && least >= 0.3, "seed {seed}: {shares:.2?}");
        }
    }
}
