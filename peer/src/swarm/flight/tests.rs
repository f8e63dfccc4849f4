use super::super::scenario::{RuleName, SensingName};
use super::*;

fn short(rule: RuleName, sensing: SensingName, drone_count: usize) -> Scenario {
    let mut scenario = Scenario::new(rule, sensing);
    scenario.swarm.drone_count = drone_count;
    scenario.duration_s = 40.0;
    scenario
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let scenario = short(RuleName::Gabriel, SensingName::Realistic, 6);
    let record = fly(&scenario, 5, |_| {});
    assert_eq!(record, fly(&scenario, 5, |_| {}));
    assert_ne!(record.curves, fly(&scenario, 6, |_| {}).curves);
}

#[test]
fn three_drones_settle_under_the_papers_rule() {
    let scenario = short(RuleName::Paper, SensingName::Ideal, 3);
    let record = fly(&scenario, 1, |_| {});
    assert_eq!(record.curves.len(), 3);
    assert_eq!(record.curves[0].len(), 401);
    assert!(record.settle_s.is_some());
    assert!(record.totals.min_distance_m > 0.5);
    assert_eq!(record.totals.order.mean(), None);
}

#[test]
fn a_moving_swarm_keeps_together_without_collision() {
    let mut scenario = short(RuleName::Gabriel, SensingName::Realistic, 10);
    scenario.swarm.speed_mps = 1.0;
    let totals = fly(&scenario, 2, |_| {}).totals;
    assert_eq!(totals.seen_collisions + totals.unseen_collisions, 0);
    assert_eq!(totals.union.mean(), Some(1.0));
    assert!(totals.order.mean().unwrap() > 0.99, "{totals:?}");
}
