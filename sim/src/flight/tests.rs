use super::*;

const DRONE1: usize = 1;
const DRONE2: usize = 2;

fn scenario() -> Scenario {
    let mut scenario = Scenario::lab(1);
    // Nothing is looked at.
    scenario.world.panels.clear();
    scenario
}

/// The motions of one vehicle that commands the same at every frame before `silent_from`. The
/// next frame is flown before one is answered, as the simulator does.
fn fly(
    scenario: &Scenario,
    vehicle_idx: usize,
    velocity: [f64; 3],
    silent_from: usize,
) -> Vec<Motion> {
    let mut flight = Flight::new(scenario);
    let mut motions = vec![flight.advance()[vehicle_idx]];
    for frame_idx in 0..99 {
        motions.push(flight.advance()[vehicle_idx]);
        if frame_idx < silent_from {
            flight.command(vehicle_idx, &Vector3::from(velocity), frame_idx);
        }
    }
    motions
}

/// How far it was carried from its route, along its heading and to the left.
fn carried_m(scenario: &Scenario, frame_idx: usize, motion: &Motion) -> Vector3<f64> {
    let planned = scenario.vehicles[DRONE2]
        .route
        .pose(scenario.frame_time_s(frame_idx));
    let way = motion.site_from_body.translation() - planned.translation();
    planned.rotation().inverse() * way
}

#[test]
fn without_commands_it_rises_and_hovers_at_its_start() {
    let scenario = scenario();
    let motions = fly(&scenario, DRONE2, [0.0; 3], 0);
    let start = *motions[0].site_from_body.translation();
    for motion in &motions {
        let moved = motion.site_from_body.translation() - start;
        assert!(moved.xy().norm() < 0.05, "{moved}");
    }
    assert!(start.z < 0.6 && motions[60].site_from_body.translation().z > 0.8);
}

#[test]
fn a_constant_command_is_flown_with_a_lag() {
    let scenario = scenario();
    let motions = fly(&scenario, DRONE2, [-0.2, 0.3, 0.7], usize::MAX);
    // What was said at frame 0 acts from frame 1 on, and its velocity is reached by 1 - 1/e
    // after the lag. The heading wobbles by about 1°.
    let after_s = scenario.frame_time_s(40) - scenario.frame_time_s(1);
    let lagged_s = after_s - LAG_S * (1.0 - (-after_s / LAG_S).exp());
    let carried = carried_m(&scenario, 40, &motions[40]);
    let expected = Vector3::new(-0.2, 0.3, 0.0) * lagged_s;
    assert!((carried - expected).norm() < 0.05, "{carried} {expected}");
    let still = carried_m(&scenario, 1, &motions[1]);
    assert_eq!(still.norm(), 0.0);
    assert!(carried_m(&scenario, 2, &motions[2]).norm() > 1e-3);
}

#[test]
fn velocities_are_those_of_the_positions() {
    let scenario = scenario();
    let motions = fly(&scenario, DRONE2, [-0.4, 0.3, 0.0], 50);
    for (idx, pair) in motions.windows(2).enumerate() {
        let [before, after] = pair else {
            unreachable!()
        };
        let moved = after.site_from_body.translation() - before.site_from_body.translation();
        let mean = (before.velocity_in_site + after.velocity_in_site) * 0.5;
        // The trapezium rule errs by the third derivative: the wobble's is 0.012 · 8³ m/s³.
        assert!((moved * 10.0 - mean).norm() < 0.02, "frame {idx}");
        let change = (after.velocity_in_site - before.velocity_in_site).norm();
        assert!(change < 0.1 * (ACCELERATION_MAX_M_PER_S2 + 1.2));
    }
}

#[test]
fn it_hovers_again_once_no_command_came_for_half_a_second() {
    let scenario = scenario();
    let motions = fly(&scenario, DRONE2, [0.0, 0.3, 0.0], 30);
    let carried_y = |frame_idx: usize| carried_m(&scenario, frame_idx, &motions[frame_idx]).y;
    // The last was said at frame 29, which is flown until 3.4 s.
    assert!(carried_y(34) - carried_y(33) > 0.025);
    assert!(carried_y(60) - carried_y(34) < 0.3 * LAG_S + 0.02);
    assert!((carried_y(90) - carried_y(60)).abs() < 0.03);
}

#[test]
fn commands_are_capped_and_walls_stop_it() {
    let scenario = scenario();
    let motions = fly(&scenario, DRONE2, [0.0, 1e300, -1e300], usize::MAX);
    for motion in &motions {
        assert!(scenario.world.encloses(motion.site_from_body.translation()));
        assert!(motion.velocity_in_site.norm() < 1.2);
    }
    let last = motions[99].site_from_body.translation();
    assert!(last.x.abs() > 0.5 * scenario.world.size_m.x - 2.0 * BUMPER_M);
}

#[test]
fn those_with_a_route_follow_it_whatever_they_command() {
    let scenario = scenario();
    let motions = fly(&scenario, DRONE1, [1.0, 1.0, 1.0], usize::MAX);
    for (frame_idx, motion) in motions.iter().enumerate() {
        let time_s = scenario.frame_time_s(frame_idx);
        assert_eq!(*motion, scenario.vehicles[DRONE1].route.motion(time_s));
    }
}

#[test]
fn the_same_commands_give_the_same_flight() {
    let scenario = scenario();
    let fly = || fly(&scenario, DRONE2, [0.1, -0.2, 0.3], 70);
    assert_eq!(fly(), fly());
}
