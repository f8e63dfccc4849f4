//! Which chunk to pull from whom: one holder per chunk, a window per holder, newest first.

use std::collections::BTreeMap;
use std::time::Duration;

use geometry::Timestamp;

use super::{OwnMap, Sync, SyncEffect};
use crate::{ChunkId, ChunkNumber, VehicleId};

/// A holder that fails rests this long at most (s).
const REST_MAX_S: f64 = 30.0;

#[derive(Debug)]
pub(super) struct Pull {
    pub(super) holder: VehicleId,
    asked_at: Timestamp,
}

impl OwnMap {
    /// Whether a number is still left to the fast path.
    fn is_fresh(&self, number: ChunkNumber, now: Timestamp) -> bool {
        self.fresh
            .is_some_and(|(from, until)| number.0 >= from && now < until)
    }
}

impl Sync {
    pub(super) fn fail(&mut self, holder: &VehicleId, chunk: &ChunkId, now: Timestamp) {
        if self
            .pulls
            .get(chunk)
            .is_some_and(|pull| pull.holder == *holder)
        {
            self.pulls.remove(chunk);
        }
        let Some(neighbour) = self.neighbours.get_mut(holder) else {
            return;
        };
        // It does not have it after all, until its next word.
        if let Some(claim) = neighbour.claims.get_mut(&chunk.map) {
            claim.held.remove(chunk.number);
        }
        rest(neighbour, now);
    }

    pub(super) fn time_out_pulls(&mut self, now: Timestamp) {
        let limit_s = self.settings.pull_timeout_s;
        let mut late: Vec<VehicleId> = Vec::new();
        self.pulls.retain(|_, pull| {
            let waits = now - pull.asked_at < limit_s;
            if !waits {
                late.push(pull.holder.clone());
            }
            waits
        });
        late.sort();
        late.dedup();
        for holder in late {
            if let Some(neighbour) = self.neighbours.get_mut(&holder) {
                rest(neighbour, now);
            }
        }
    }

    /// Fills the holders' windows, the least busy holder first.
    pub(super) fn pull(&mut self, now: Timestamp, effects: &mut Vec<SyncEffect>) {
        let window = self.settings.window_per_holder;
        let mut busy: BTreeMap<&VehicleId, usize> = BTreeMap::new();
        for pull in self.pulls.values() {
            *busy.entry(&pull.holder).or_default() += 1;
        }
        let mut queues: Vec<(usize, VehicleId, Vec<ChunkId>)> = Vec::new();
        for (holder, neighbour) in &self.neighbours {
            let used = busy.get(holder).copied().unwrap_or(0);
            let resting = neighbour.resting_until.is_some_and(|until| now < until);
            if resting || used >= window {
                continue;
            }
            let wanted = self.wanted_from(holder, window, now);
            if !wanted.is_empty() {
                queues.push((used, holder.clone(), wanted));
            }
        }
        // In rounds, so that holders of the same chunks share the work.
        loop {
            queues.retain(|(used, _, wanted)| *used < window && !wanted.is_empty());
            queues.sort_by(|a, b| (a.0, &a.1).cmp(&(b.0, &b.1)));
            let Some((used, holder, wanted)) = queues.first_mut() else {
                break;
            };
            let chunk = wanted.remove(0);
            if self.pulls.contains_key(&chunk) {
                continue;
            }
            *used += 1;
            let holder = holder.clone();
            let pull = Pull {
                holder: holder.clone(),
                asked_at: now,
            };
            self.pulls.insert(chunk.clone(), pull);
            effects.push(SyncEffect::Pull { holder, chunk });
        }
    }

    /// The newest chunks that a holder has and nobody was asked for, over its maps in turn.
    fn wanted_from(&self, holder: &VehicleId, window: usize, now: Timestamp) -> Vec<ChunkId> {
        let Some(neighbour) = self.neighbours.get(holder) else {
            return Vec::new();
        };
        // Enough that other holders' picks from the same list leave some.
        let list_count_max = window * (1 + self.neighbours.len()).min(8);
        let mut lists: Vec<Vec<ChunkId>> = Vec::new();
        for (map, claim) in &neighbour.claims {
            let own = self.maps.get(map);
            let list: Vec<ChunkId> = self
                .lacking(map, claim)
                .newest_first()
                .filter(|number| own.is_none_or(|own| !own.is_fresh(*number, now)))
                .map(|number| ChunkId {
                    map: map.clone(),
                    number,
                })
                .filter(|chunk| !self.pulls.contains_key(chunk))
                .take(list_count_max)
                .collect();
            lists.push(list);
        }
        let longest = lists.iter().map(Vec::len).max().unwrap_or(0);
        (0..longest)
            .flat_map(|idx| lists.iter().filter_map(move |list| list.get(idx).cloned()))
            .take(list_count_max)
            .collect()
    }
}

fn rest(neighbour: &mut super::claims::Neighbour, now: Timestamp) {
    let rest_s = (0.5 * f64::from(1_u32 << neighbour.failure_count.min(6))).min(REST_MAX_S);
    neighbour.failure_count += 1;
    neighbour.resting_until = Some(now.after(Duration::from_secs_f64(rest_s)));
}
