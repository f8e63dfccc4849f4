//! What fails in flight must not make drones collide that could have known of each other.

use keeping::FieldOfView;
use sim::swarm::FAULT_AFTER_S;

use super::super::scenario::{RuleName, SensingName};
use super::*;

/// Of 100 starts each, hovering and moving.
const SEED_COUNT: u64 = 100;
const UNSEEN_SHARE_MAX: f64 = 0.01;

/// Goal: no collision between drones of which either saw the other within the last two seconds,
/// few others, and no motion towards where nobody looked. Method: every command is compared with
/// the view of the last two seconds, which headings that are held make simple.
fn check(name: &str, change: impl Fn(&mut Scenario)) {
    for speed_mps in [0.0, 1.0] {
        let mut scenario = Scenario::new(RuleName::Gabriel, SensingName::Realistic);
        scenario.swarm.drone_count = 6;
        scenario.swarm.speed_mps = speed_mps;
        scenario.duration_s = 60.0;
        change(&mut scenario);
        let mut unseen_runs = 0;
        for seed in 0..SEED_COUNT {
            let at = format!("{name}, {speed_mps} m/s, seed {seed}");
            let totals = fly(&scenario, seed, |moment| check_commands(moment, &at)).totals;
            assert_eq!(totals.seen_collisions, 0, "{at}");
            unseen_runs += usize::from(totals.unseen_collisions > 0);
        }
        let share = unseen_runs as f64 / SEED_COUNT as f64;
        assert!(
            share <= UNSEEN_SHARE_MAX,
            "{name}, {speed_mps} m/s: {share}"
        );
    }
}

/// Nobody is told to fly where no camera looked within two seconds.
fn check_commands(moment: &Moment<'_>, at: &str) {
    let sensing = &moment.swarm.settings().sensing;
    let view = FieldOfView {
        azimuth_rad: 0.0,
        half_width_rad: sensing.azimuth_rad_max + 1e-6,
        elevation_rad_max: sensing.elevation_rad_max + 1e-6,
    };
    let blind_s = moment.time_s - FAULT_AFTER_S;
    for (drone, steering) in moment.steering.iter().enumerate() {
        let velocity = &steering.velocity;
        let is_still = velocity.norm() < 1e-9;
        assert!(is_still || view.contains(velocity), "{at}: {velocity:?}");
        let is_blind = moment.swarm.is_blinded(drone) && blind_s > 2.15;
        assert!(
            is_still || !is_blind,
            "{at}: blind drone {drone} told {velocity:?}"
        );
    }
}

#[test]
fn one_camera_ahead_is_safe() {
    check("one camera", |scenario| {
        let sensing = &mut scenario.swarm.sensing;
        sensing.azimuth_rad_max = 42_f64.to_radians();
        sensing.elevation_rad_max = 34_f64.to_radians();
    });
}

#[test]
fn a_drone_whose_lights_are_out_keeps_clear() {
    check("lights out", |scenario| scenario.swarm.sensing.unlit = 1);
}

#[test]
fn a_drone_blinded_for_a_while_keeps_clear() {
    check("blinded for 5 s", |scenario| {
        scenario.swarm.sensing.blinded = 1;
        scenario.swarm.sensing.blinded_s = 5.0;
    });
    check("blinded for good", |scenario| {
        scenario.swarm.sensing.blinded = 1;
    });
}

#[test]
fn a_drone_that_drops_out_leaves_the_others_safe() {
    check("dropped out", |scenario| scenario.swarm.dropped = 1);
}

/// Goal: gusts of 0.3 m/s push nobody into another in the first 200 flights. It is no promise for
/// all: of 800 one ended in a collision (`BENCHMARKS.md`). Method: hovering drones, which
/// gusts blow towards each other faster than the rule alone moves them; without the filter's room
/// for gusts, and with its speed at 0.5 m/s, seven of these flights ended in one.
#[test]
fn gusts_push_nobody_into_another() {
    let mut scenario = Scenario::new(RuleName::Gabriel, SensingName::Realistic);
    scenario.swarm.drone_count = 10;
    scenario.swarm.wind_mps = 0.3;
    for seed in 0..2 * SEED_COUNT {
        let totals = fly(&scenario, seed, |_| {}).totals;
        let collision_count = totals.seen_collisions + totals.unseen_collisions;
        assert_eq!(
            collision_count, 0,
            "seed {seed}: {} m",
            totals.min_distance_m
        );
    }
}
