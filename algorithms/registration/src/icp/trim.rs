//! How much of the source has a partner at all.

use super::pairs::Pair;

/// Shares below this are not believed.
const SHARE_MIN: f64 = 0.3;
/// How much a larger share is worth against a larger distance (Phillips et al. 2007: 1.3 is best
/// in three dimensions).
const SHARE_POWER: f64 = 1.3;
const BIN_COUNT: usize = 128;

/// The distance beyond which pairs are those of points that the other cloud does not show.
///
/// Minimises the root mean square distance of the nearest pairs over their share to the power of
/// 1.3 (fractional ICP, Phillips et al. 2007), in bins of the gate's 128th part.
///
/// - `seeking_count`: points that sought a partner, those without one included.
pub(crate) fn distance(pairs: &[Pair], seeking_count: usize, gate: f64) -> f64 {
    let mut counts = [0_u32; BIN_COUNT];
    let mut squares = [0.0_f64; BIN_COUNT];
    let per_bin = BIN_COUNT as f64 / gate;
    for pair in pairs {
        let distance_squared = f64::from(pair.distance_squared);
        let bin = ((distance_squared.sqrt() * per_bin) as usize).min(BIN_COUNT - 1);
        counts[bin] += 1;
        squares[bin] += distance_squared;
    }
    let mut best = (f64::INFINITY, gate);
    let (mut count, mut sum) = (0, 0.0);
    for bin in 0..BIN_COUNT {
        count += counts[bin];
        sum += squares[bin];
        let share = f64::from(count) / seeking_count.max(1) as f64;
        if share < SHARE_MIN {
            continue;
        }
        // Half a bin, so that a perfect fit does not end the search at the least share.
        let floor = (0.5 / per_bin).powi(2);
        let worth = (sum / f64::from(count) + floor).sqrt() / share.powf(SHARE_POWER);
        if worth < best.0 {
            best = (worth, (bin + 1) as f64 / per_bin);
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: of points of which half have a partner near by, the others are left out.
    #[test]
    fn the_half_that_overlaps_is_told_from_the_rest() {
        let pair = |distance: f64| Pair {
            source_idx: 0,
            target_idx: 0,
            distance_squared: (distance * distance) as f32,
        };
        let near = (0..500).map(|idx| pair(0.02 + 0.0001 * f64::from(idx)));
        let far = (0..500).map(|idx| pair(0.1 + 0.0018 * f64::from(idx)));
        let pairs: Vec<Pair> = near.chain(far).collect();
        let found = distance(&pairs, 1000, 1.0);
        assert!((0.06..0.2).contains(&found), "{found}");
        let all = distance(&pairs[..500], 500, 1.0);
        assert!((0.06..0.1).contains(&all), "{all}");
    }
}
