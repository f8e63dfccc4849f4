//! What speaks for an alignment beside how well the clouds fit in the end.

use crate::alignment::Refusal;

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
