//! The improved rule: only the first shell of neighbours counts, and smoothly.

use nalgebra::Vector3;

use crate::bounded::Bounded;
use crate::paper_rule::Placed;
use crate::tracks::TRACK_COUNT_MAX;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GabrielSettings {
    /// Between neighbours abeam, above and below.
    pub preferred_m: f64,
    /// To the neighbour ahead.
    pub preferred_forward_m: f64,
    /// Speed for a neighbour that is off by [`Self::full_log_ratio`].
    pub gain_mps: f64,
    pub full_log_ratio: f64,
    /// Nearer or farther than preferred by up to this (log ratio) neither pushes nor pulls. Zero
    /// lets pixel noise move everybody, more loosens the spacing.
    pub similar_log_ratio: f64,
    /// All who pull together pull as much as so many who push. More settles faster, and presses
    /// large swarms together.
    pub pull_max: f64,
    /// The correction is never larger.
    pub correction_mps_max: f64,
    /// Nor faster backward, where nobody looks.
    pub reverse_mps_max: f64,
}

impl Default for GabrielSettings {
    fn default() -> Self {
        Self {
            preferred_m: 3.0,
            preferred_forward_m: 3.9,
            gain_mps: 0.5,
            full_log_ratio: 0.4,
            similar_log_ratio: 0.1,
            pull_max: 1.0,
            correction_mps_max: 0.5,
            reverse_mps_max: 0.1,
        }
    }
}

/// Neighbours from near to far.
pub type Shell = Bounded<ShellNeighbour, TRACK_COUNT_MAX>;

/// A neighbour of the first shell, and whether it may pull.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShellNeighbour {
    /// Of length one, in the heading frame.
    pub direction: Vector3<f64>,
    pub range_m: f64,
    pub is_first_shell: bool,
    pub is_link: bool,
}

/// Fills the shell with the nearest neighbours and says who is in it.
///
/// A neighbour leaves the *Gabriel graph*, the first shell, if another one stands in the sphere
/// whose diameter joins it to the vehicle: `d_k < d_j cos(j, k)`. It leaves the *relative
/// neighbourhood graph*, the links, if another is nearer to both: `d_k < 2 d_j cos(j, k)`. Both
/// contain the minimum spanning tree, so no link that connectivity needs is dropped; both need
/// ratios of sizes only.
pub fn select(neighbours: impl Iterator<Item = Placed>, shell: &mut Shell) {
    shell.clear();
    for neighbour in neighbours {
        let entry = ShellNeighbour {
            direction: neighbour.direction,
            range_m: neighbour.range_m,
            is_first_shell: true,
            is_link: true,
        };
        if shell.push(entry).is_err() {
            // Tracks have the same limit, so this cannot cost a near neighbour.
            break;
        }
    }
    shell.sort_unstable_by(|left, right| {
        let by_range = left.range_m.total_cmp(&right.range_m);
        by_range.then(left.direction.y.total_cmp(&right.direction.y))
    });
    for far_idx in 1..shell.len() {
        let (nearer, rest) = shell.split_at_mut(far_idx);
        let far = &mut rest[0];
        for near in nearer.iter() {
            let along_m = far.range_m * near.direction.dot(&far.direction);
            if near.range_m < 2.0 * along_m {
                far.is_link = false;
                if near.range_m < along_m {
                    far.is_first_shell = false;
                    break;
                }
            }
        }
    }
}

/// The correction for the neighbours of a shell, in the heading frame.
///
/// Every neighbour of the first shell that is nearer than preferred pushes, every link that is
/// farther pulls, both by the logarithm of the range over the preferred one. Continuous in all
/// ranges and bearings as long as the shell does not change.
pub fn correction(shell: &Shell, settings: &GabrielSettings) -> Vector3<f64> {
    let mut push = Vector3::zeros();
    let mut pull = Vector3::zeros();
    let mut pull_sum = 0.0;
    for neighbour in shell.iter().filter(|neighbour| neighbour.is_first_shell) {
        let preferred_m = settings.preferred_at(&neighbour.direction);
        let log_ratio = (neighbour.range_m / preferred_m).ln();
        let excess = (log_ratio.abs() - settings.similar_log_ratio).max(0.0);
        let strength = (excess / settings.full_log_ratio).min(1.0);
        if log_ratio < 0.0 {
            push -= neighbour.direction * strength;
        } else if neighbour.is_link {
            pull += neighbour.direction * strength;
            pull_sum += strength;
        }
    }
    if pull_sum > settings.pull_max {
        pull *= settings.pull_max / pull_sum;
    }
    let mut correction = (push + pull) * settings.gain_mps;
    let speed_mps = correction.norm();
    if speed_mps > settings.correction_mps_max {
        correction *= settings.correction_mps_max / speed_mps;
    }
    correction.x = correction.x.max(-settings.reverse_mps_max);
    correction
}

impl GabrielSettings {
    /// Blends from the lateral to the forward distance between 45° and 15° of ahead.
    fn preferred_at(&self, direction: &Vector3<f64>) -> f64 {
        // Azimuths only matter in the forward half, where the arctangent is needed.
        if direction.x <= direction.y.abs() {
            return self.preferred_m;
        }
        let azimuth_deg = direction.y.abs().atan2(direction.x).to_degrees();
        let share = ((45.0 - azimuth_deg) / 30.0).clamp(0.0, 1.0);
        let smooth = share * share * (3.0 - 2.0 * share);
        self.preferred_m + (self.preferred_forward_m - self.preferred_m) * smooth
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn placed(x: f64, y: f64, z: f64) -> Placed {
        let offset = Vector3::new(x, y, z);
        Placed {
            direction: offset.normalize(),
            range_m: offset.norm(),
        }
    }

    fn shell_of(neighbours: &[Placed]) -> Shell {
        let mut shell = Shell::default();
        select(neighbours.iter().copied(), &mut shell);
        shell
    }

    #[test]
    fn who_stands_behind_another_is_not_of_the_first_shell() {
        let shell = shell_of(&[placed(0.0, 6.0, 0.2), placed(0.0, 3.0, 0.0)]);
        let first: Vec<bool> = shell.iter().map(|entry| entry.is_first_shell).collect();
        assert_eq!(first, [true, false]);
    }

    #[test]
    fn near_pushes_and_far_pulls() {
        let settings = GabrielSettings::default();
        let near = correction(&shell_of(&[placed(0.0, 2.0, 0.0)]), &settings);
        assert!(near.y < -0.2, "{near:?}");
        let far = correction(&shell_of(&[placed(0.0, 5.0, 0.0)]), &settings);
        assert!(far.y > 0.2, "{far:?}");
        let right = correction(&shell_of(&[placed(0.0, 3.1, 0.0)]), &settings);
        assert_eq!(right, Vector3::zeros());
    }

    fn positions() -> impl Strategy<Value = Vec<Vector3<f64>>> {
        let coordinate = || -6.0_f64..6.0;
        let position = (coordinate(), coordinate(), coordinate());
        proptest::collection::vec(position.prop_map(|(x, y, z)| Vector3::new(x, y, z)), 2..14)
    }

    fn links_of(positions: &[Vector3<f64>], own: usize) -> Vec<usize> {
        let others = (0..positions.len()).filter(|other| *other != own);
        let neighbours: Vec<Placed> = others
            .map(|other| {
                let offset = positions[other] - positions[own];
                placed(offset.x, offset.y, offset.z)
            })
            .collect();
        let shell = shell_of(&neighbours);
        let is_link = |other: &usize| {
            let range_m = (positions[*other] - positions[own]).norm();
            shell
                .iter()
                .any(|entry| entry.is_link && (entry.range_m - range_m).abs() < 1e-9)
        };
        (0..positions.len())
            .filter(|other| *other != own)
            .filter(is_link)
            .collect()
    }

    proptest! {
        /// Goal: selection keeps a swarm together. Method: the graph of links is connected.
        #[test]
        fn links_connect_everybody(positions in positions()) {
            let separate = |left: &Vector3<f64>, right: &Vector3<f64>| (left - right).norm() > 0.05;
            prop_assume!(positions.iter().enumerate().all(|(idx, left)| {
                positions[..idx].iter().all(|right| separate(left, right))
            }));
            let mut reached = vec![0];
            let mut next = 0;
            while next < reached.len() {
                for other in links_of(&positions, reached[next]) {
                    if !reached.contains(&other) {
                        reached.push(other);
                    }
                }
                next += 1;
            }
            prop_assert_eq!(reached.len(), positions.len());
        }

        #[test]
        fn corrections_are_bounded_and_ignore_the_order(positions in positions()) {
            let settings = GabrielSettings::default();
            let mut neighbours: Vec<Placed> = positions
                .iter()
                .filter(|position| position.norm() > 0.1)
                .map(|position| placed(position.x, position.y, position.z))
                .collect();
            let forward = correction(&shell_of(&neighbours), &settings);
            neighbours.reverse();
            let backward = correction(&shell_of(&neighbours), &settings);
            prop_assert_eq!(forward, backward);
            prop_assert!(forward.norm() <= settings.correction_mps_max + 1e-12);
            prop_assert!(forward.x >= -settings.reverse_mps_max);
        }
    }
}
