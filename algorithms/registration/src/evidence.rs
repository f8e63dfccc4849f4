//! What speaks for an alignment beside how well the clouds fit in the end.

use nalgebra::Vector3;

use crate::alignment::Refusal;
use crate::cloud::to_single;
use crate::kd_tree::KdTree;

/// Where correspondences come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clue {
    /// Descriptors of both clouds.
    Appearance,
    /// The shape of both clouds alone.
    Shape,
}

/// Correspondences that were found before a pose was known, and how many of them agree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    pub clue: Clue,
    pub offered_count: usize,
    /// Those that the alignment brings together.
    pub consistent_count: usize,
    /// Those that the best alignment elsewhere brings together, the consistent ones left out.
    pub runner_up_count: usize,
    /// How many alignments as good are expected from shuffled correspondences, as a power of ten.
    pub false_alarms_log10: f64,
    /// How widely the consistent points lie, relative to all points of the source (root mean
    /// squares).
    pub spread: f64,
}

/// Points that look the same must lie at least this widely: posters and chairs recur, and say
/// nothing of where the rest is.
const SPREAD_MIN: f64 = 0.15;
/// A runner-up with this share of the best one's correspondences makes a search ambiguous: things
/// that recur share their correspondences about evenly, and chance gives a runner-up of few.
const RUNNER_UP_SHARE_MAX: f64 = 0.5;
/// One alignment in ten thousand searches may look this good by chance.
const APPEARANCE_FALSE_ALARMS_LOG10_MAX: f64 = -4.0;
/// Neighbours share their shape, so that three correspondences are worth about one: two maps of
/// different things came to −12.
const SHAPE_FALSE_ALARMS_LOG10_MAX: f64 = -15.0;

impl Evidence {
    /// Whether another alignment explains the correspondences nearly as well.
    pub fn is_ambiguous(&self) -> bool {
        self.runner_up_count as f64 > RUNNER_UP_SHARE_MAX * self.consistent_count as f64
    }

    /// Whether all that agrees may be one thing that stands elsewhere too.
    pub fn is_narrow(&self) -> bool {
        self.spread < SPREAD_MIN
    }

    /// What speaks against the alignment as it was found.
    pub(crate) fn judge(&self) -> Result<(), Refusal> {
        if self.may_be_chance() {
            Err(Refusal::SearchFoundNothing)
        } else if self.is_ambiguous() {
            Err(self.ambiguous())
        } else if self.is_narrow() {
            Err(Refusal::NarrowEvidence {
                spread: self.spread,
            })
        } else {
            Ok(())
        }
    }

    pub(crate) fn ambiguous(&self) -> Refusal {
        Refusal::Ambiguous {
            consistent_count: self.consistent_count,
            runner_up_count: self.runner_up_count,
        }
    }

    /// Whether shuffled correspondences might agree as well.
    pub fn may_be_chance(&self) -> bool {
        let limit = match self.clue {
            Clue::Appearance => APPEARANCE_FALSE_ALARMS_LOG10_MAX,
            Clue::Shape => SHAPE_FALSE_ALARMS_LOG10_MAX,
        };
        self.false_alarms_log10 > limit
    }
}

/// The expected number of alignments, among all that three correspondences fix, with at least
/// this many of the others in agreement by chance; as a power of ten.
///
/// An a-contrario bound (Moisan and Stival 2004) with Hoeffding's bound for the binomial tail.
///
/// - `chance`: the probability that a wrong correspondence agrees with a given alignment.
pub(crate) fn false_alarms_log10(offered: usize, consistent: usize, chance: f64) -> f64 {
    let offered = offered as f64;
    let sample_log10 = (offered * (offered - 1.0) * (offered - 2.0) / 6.0)
        .max(1.0)
        .log10();
    let others = (offered - 3.0).max(1.0);
    let share = ((consistent as f64 - 3.0) / others).clamp(0.0, 1.0);
    if share <= chance {
        return sample_log10;
    }
    let term = |share: f64, chance: f64| {
        if share > 0.0 {
            share * (share / chance).ln()
        } else {
            0.0
        }
    };
    let divergence = term(share, chance) + term(1.0 - share, 1.0 - chance);
    sample_log10 - others * divergence / std::f64::consts::LN_10
}

/// How evenly those that agree lie among all that should.
///
/// Where two views differ, agreement is thin everywhere; where two places share a cupboard and a
/// poster, it is dense on these and absent elsewhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evenness {
    pub count: usize,
    /// Of all, those that agree.
    pub share: f64,
    /// The same among the neighbours of those that agree.
    pub share_nearby: f64,
}

/// Neighbours that are asked.
const NEIGHBOUR_COUNT: usize = 8;
/// Of those that should agree, fewer do so by chance alone, anywhere.
const CHANCE_SHARE: f64 = 0.05;

impl Evenness {
    pub(crate) fn of(points: &[Vector3<f64>], agree: &[bool]) -> Self {
        let single: Vec<[f32; 3]> = points.iter().map(to_single).collect();
        let tree = KdTree::new(&single);
        let (mut agreeing_count, mut neighbour_count, mut agreeing_neighbour_count) = (0, 0, 0);
        let mut found = Vec::new();
        for (idx, point) in single.iter().enumerate().filter(|(idx, _)| agree[*idx]) {
            agreeing_count += 1;
            tree.nearest_many(*point, NEIGHBOUR_COUNT + 1, &mut found);
            for neighbour in found.iter().filter(|one| one.idx as usize != idx) {
                neighbour_count += 1;
                agreeing_neighbour_count += usize::from(agree[neighbour.idx as usize]);
            }
        }
        let share = |part: usize, whole: usize| part as f64 / whole.max(1) as f64;
        Self {
            count: points.len(),
            share: share(agreeing_count, points.len()),
            share_nearby: share(agreeing_neighbour_count, neighbour_count),
        }
    }

    /// The share of the place that agreement extends over, 0 to 1.
    pub fn extent(&self) -> f64 {
        if self.share < CHANCE_SHARE {
            return 0.0;
        }
        (self.share / self.share_nearby.max(1e-9)).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_among_many_are_chance_and_many_are_not() {
        // Agreement by chance of one in a thousand: 1,000 correspondences bring one more.
        assert!(false_alarms_log10(1000, 6, 1e-3) > 0.0);
        assert!(false_alarms_log10(1000, 50, 1e-3) < -40.0);
        // Three always agree.
        assert!(false_alarms_log10(3, 3, 1e-3) > -0.1);
        assert!(false_alarms_log10(10, 10, 1e-3) < -15.0);
    }

    /// Goal: thin agreement is told from patches. Method: points on a wall of which every third
    /// agrees, or all in a quarter of it, or hardly any.
    #[test]
    fn what_agrees_here_and_there_extends_over_all_and_a_poster_does_not() {
        let points: Vec<Vector3<f64>> = (0..900)
            .map(|idx| Vector3::new(f64::from(idx % 30), f64::from(idx / 30), 0.0))
            .collect();
        let extent = |agrees: &dyn Fn(usize) -> bool| {
            let agree: Vec<bool> = (0..900).map(agrees).collect();
            Evenness::of(&points, &agree).extent()
        };
        assert!(extent(&|idx| idx * 7919 % 97 < 32) > 0.8);
        let in_quarter = |idx: usize| idx % 30 < 15 && idx < 450;
        assert!((0.2..0.3).contains(&extent(&in_quarter)));
        let thin_quarter = |idx: usize| in_quarter(idx) && idx * 7919 % 97 < 60;
        assert!((0.2..0.36).contains(&extent(&thin_quarter)));
        assert_eq!(extent(&|idx| idx.is_multiple_of(60)), 0.0);
    }

    #[test]
    fn a_runner_up_of_half_is_ambiguous() {
        let evidence = |runner_up_count| Evidence {
            clue: Clue::Appearance,
            offered_count: 100,
            consistent_count: 40,
            runner_up_count,
            false_alarms_log10: -20.0,
            spread: 0.5,
        };
        assert_eq!(evidence(20).judge(), Ok(()));
        assert_eq!(evidence(21).judge(), Err(evidence(21).ambiguous()));
        let narrow = Evidence {
            spread: 0.1,
            ..evidence(0)
        };
        assert_eq!(narrow.judge(), Err(Refusal::NarrowEvidence { spread: 0.1 }));
    }
}
