//! Many flights of one scenario, and the numbers over them.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use serde::Serialize;

use super::flight::{FlightRecord, Moment, fly};
use super::metrics::{Mean, Totals};
use super::scenario::Scenario;

/// The names are those of the command line's contract; unknown numbers are `null`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The share of runs whose distances settled.
    pub converged: f64,
    pub settle_s_p50: Option<f64>,
    pub settle_s_p95: Option<f64>,
    /// At the end: the median over all runs of the distances of adjacent drones, of whom no third
    /// one is between; of more than three drones, of the mean distance to the nearest.
    pub spacing_m_p50: Option<f64>,
    /// The same of all pairs of up to three drones, the ends of chains included.
    pub pair_distance_m_p50: Option<f64>,
    pub min_distance_m: Option<f64>,
    /// Runs with any pair under half a metre.
    pub collisions: usize,
    /// Those of them in which no such pair had seen each other shortly before.
    pub unseen: usize,
    /// Drones that touched an obstacle, over all runs.
    pub hits: usize,
    pub order: Option<f64>,
    pub union: Option<f64>,
    pub safety: Option<f64>,
    pub nn_mean_m: Option<f64>,
    pub nn_sd_m: Option<f64>,
    /// Of the others in range and view, how many a drone sees at any time.
    pub seen_share: Option<f64>,
    /// Of all that was taken for a neighbour, how much was none.
    pub false_share: Option<f64>,
}

/// Flies a scenario `run_count` times on as many threads as there are cores.
///
/// The order and the bits of the records do not depend on the threads.
///
/// - `watch`: sees every moment of the first run.
/// - `done`: called after each run.
pub fn fly_all(
    scenario: &Scenario,
    run_count: usize,
    seed: u64,
    watch: impl FnMut(&Moment<'_>) + Send,
    done: impl Fn() + Sync,
) -> Vec<FlightRecord> {
    let next_run = AtomicUsize::new(0);
    let records = Mutex::new(vec![None; run_count]);
    let watch = Mutex::new(Some(watch));
    let thread_count = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| {
        for _ in 0..thread_count.min(run_count) {
            scope.spawn(|| {
                loop {
                    let run = next_run.fetch_add(1, Ordering::Relaxed);
                    if run >= run_count {
                        break;
                    }
                    let run_seed = seed.wrapping_mul(SEED_STRIDE).wrapping_add(run as u64);
                    let record = if run == 0 {
                        let watch = watch.lock().unwrap_or_else(PoisonError::into_inner).take();
                        match watch {
                            Some(watch) => fly(scenario, run_seed, watch),
                            None => fly(scenario, run_seed, |_| {}),
                        }
                    } else {
                        fly(scenario, run_seed, |_| {})
                    };
                    let mut records = records.lock().unwrap_or_else(PoisonError::into_inner);
                    records[run] = Some(record);
                    drop(records);
                    done();
                }
            });
        }
    });
    let records = records.into_inner().unwrap_or_else(PoisonError::into_inner);
    records.into_iter().flatten().collect()
}

/// Runs of neighbouring seeds do not overlap up to this number of them.
const SEED_STRIDE: u64 = 1_000_003;

pub fn summarise(records: &[FlightRecord]) -> Summary {
    let mut settle_s: Vec<f64> = records
        .iter()
        .filter_map(|record| record.settle_s)
        .collect();
    settle_s.sort_by(f64::total_cmp);
    let mut spacing_m: Vec<f64> = records
        .iter()
        .flat_map(|record| adjacent(&record.final_m))
        .collect();
    spacing_m.sort_by(f64::total_cmp);
    let mut pair_distances_m: Vec<f64> = records
        .iter()
        .flat_map(|record| record.final_m.iter().copied())
        .collect();
    pair_distances_m.sort_by(f64::total_cmp);
    let sum = |part: fn(&Totals) -> usize| -> usize {
        records.iter().map(|record| part(&record.totals)).sum()
    };
    let share = |part: usize, whole: usize| (whole > 0).then(|| part as f64 / whole as f64);
    let (seen, false_sightings) = (
        sum(|totals| totals.seen),
        sum(|totals| totals.false_sightings),
    );
    let joined = |part: fn(&FlightRecord) -> &Mean| {
        let mut all = Mean::default();
        records.iter().for_each(|record| all.join(part(record)));
        all
    };
    let nearest = joined(|record| &record.totals.nearest_m);
    let count_runs =
        |is_counted: fn(&FlightRecord) -> bool| records.iter().filter(|r| is_counted(r)).count();
    let collisions =
        count_runs(|record| record.totals.seen_collisions + record.totals.unseen_collisions > 0);
    let with_seen = count_runs(|record| record.totals.seen_collisions > 0);
    let min_distance_m = records
        .iter()
        .map(|record| record.totals.min_distance_m)
        .fold(f64::INFINITY, f64::min);
    Summary {
        converged: settle_s.len() as f64 / records.len().max(1) as f64,
        settle_s_p50: percentile(&settle_s, 0.5),
        settle_s_p95: percentile(&settle_s, 0.95),
        spacing_m_p50: percentile(&spacing_m, 0.5),
        pair_distance_m_p50: percentile(&pair_distances_m, 0.5),
        min_distance_m: Some(min_distance_m).filter(|value| value.is_finite()),
        collisions,
        unseen: collisions - with_seen,
        hits: sum(|totals| totals.hits),
        order: joined(|record| &record.totals.order).mean(),
        union: joined(|record| &record.totals.union).mean(),
        safety: joined(|record| &record.totals.safety).mean(),
        nn_mean_m: nearest.mean(),
        nn_sd_m: nearest.standard_deviation(),
        seen_share: share(seen, sum(|totals| totals.in_view)),
        false_share: share(false_sightings, seen + false_sightings),
    }
}

/// The distances that stay when a triangle's side opposite an obtuse angle is left out: the third
/// drone stands between its ends, and the side follows from the other two.
fn adjacent(distances_m: &[f64]) -> Vec<f64> {
    let square_sum: f64 = distances_m.iter().map(|distance| distance * distance).sum();
    let is_adjacent =
        |distance: &f64| distances_m.len() < 3 || 2.0 * distance * distance <= square_sum;
    distances_m.iter().copied().filter(is_adjacent).collect()
}

/// Interpolated between ranks, so that the median of two is their mean.
pub fn percentile(sorted: &[f64], share: f64) -> Option<f64> {
    let rank = share * sorted.len().checked_sub(1)? as f64;
    let (low, high) = (sorted[rank.floor() as usize], sorted[rank.ceil() as usize]);
    Some(low + (high - low) * rank.fract())
}

#[cfg(test)]
mod tests {
    use super::super::scenario::{RuleName, SensingName};
    use super::*;

    #[test]
    fn the_ends_of_a_chain_are_not_adjacent() {
        assert_eq!(adjacent(&[3.0, 3.1, 5.9]), [3.0, 3.1]);
        assert_eq!(adjacent(&[3.0, 3.1, 3.2]), [3.0, 3.1, 3.2]);
        assert_eq!(adjacent(&[5.0]), [5.0]);
    }

    /// Threads take runs as they come free; whatever the order, the records are the same.
    #[test]
    fn records_do_not_depend_on_threads() {
        let mut scenario = Scenario::new(RuleName::Gabriel, SensingName::Realistic);
        scenario.duration_s = 10.0;
        let done = AtomicUsize::new(0);
        let count = || {
            done.fetch_add(1, Ordering::Relaxed);
        };
        let records = fly_all(&scenario, 6, 3, |_| {}, count);
        assert_eq!(done.into_inner(), 6);
        for record in &records {
            assert_eq!(record, &fly(&scenario, record.seed, |_| {}));
        }
        let seeds: Vec<u64> = records.iter().map(|record| record.seed).collect();
        assert!(seeds.is_sorted());
    }

    #[test]
    fn percentiles_interpolate() {
        assert_eq!(percentile(&[], 0.5), None);
        assert_eq!(percentile(&[1.0, 2.0], 0.5), Some(1.5));
        assert_eq!(percentile(&[1.0, 2.0, 3.0], 0.95), Some(2.9));
    }
}
