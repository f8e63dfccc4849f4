//! Whether keyframes that agree become a track.

use crate::likeness::Likeness;

/// What a located keyframe did to a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::localizer) enum Admission {
    Agrees,
    /// Kept until others agree with it.
    Waits,
    /// It and others that agree with it have become the track.
    Founds,
    /// They agree, but show too little to tell the place.
    Doubts,
    /// They agree, but what they show says that this is another place.
    Denies,
    /// What it shows, and what others of the track showed, says that this is another place.
    Revokes,
}

/// The newest of those that wait, who have a vote on where the place is.
const VOTERS_MAX: usize = 6;
/// Fewer witnesses leave so much to luck that none of them can settle it.
const WITNESS_COUNT_MIN: usize = 19;

/// Whether most of the newest voters are for it, of all that wait.
///
/// Things that stand a little elsewhere in another room put each keyframe elsewhere; but who was
/// there long ago may have been wrong about that place, and not about this one.
pub(super) fn has_majority(votes: impl DoubleEndedIterator<Item = bool>) -> bool {
    let (mut count, mut for_count) = (0, 0);
    for is_for in votes.rev().take(VOTERS_MAX) {
        count += 1;
        for_count += usize::from(is_for);
    }
    2 * for_count > count
}

/// Why keyframes that agree do not found a track yet; `None` if they do.
pub(super) fn doubt(likeness: &Likeness, extent_min: f64) -> Option<Admission> {
    if likeness.exceeds(extent_min) {
        None
    } else if likeness.count < WITNESS_COUNT_MIN {
        Some(Admission::Doubts)
    } else if likeness.falls_short_of(extent_min) {
        Some(Admission::Denies)
    } else {
        Some(Admission::Waits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: an alignment does not begin late because of what was seen elsewhere long ago.
    #[test]
    fn old_keyframes_have_no_vote() {
        let votes = |old: usize, new: usize| [vec![false; old], vec![true; new]].concat();
        assert!(has_majority(votes(8, 4).into_iter()));
        assert!(!has_majority(votes(8, 3).into_iter()));
        assert!(has_majority(votes(1, 2).into_iter()));
        assert!(!has_majority(votes(2, 2).into_iter()));
        let newest_against = [true, true, true, true, true, false, false, false];
        assert!(!has_majority(newest_against.into_iter()));
    }

    #[test]
    fn too_few_witnesses_are_a_reason_of_their_own() {
        let likeness = |count, extent, sigma| Likeness {
            count,
            extent,
            sigma,
            bareness: None,
            presence: 0.45,
            displaced: 0.0,
        };
        let doubt = |likeness| doubt(&likeness, 0.35);
        assert_eq!(doubt(likeness(18, 1.0, 0.67)), Some(Admission::Doubts));
        assert_eq!(doubt(likeness(100, 0.5, 0.2)), Some(Admission::Waits));
        assert_eq!(doubt(likeness(100, 0.1, 0.1)), Some(Admission::Denies));
        assert_eq!(doubt(likeness(100, 0.8, 0.2)), None);
    }
}
