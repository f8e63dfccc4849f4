//! Whether two places that fit are one place: where both were seen, they must look alike all over.
//!
//! Rooms of one plan share furniture and posters, which match to a tenth of a percent. What tells
//! them apart is what one shows and the other does not, asked in both directions.

mod things;

use nalgebra::Vector3;

use crate::cloud::to_single;
use crate::kd_tree::KdTree;
pub(crate) use things::{Gates, Things};

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
        Self::among(&Neighbours::new(points), agree)
    }

    fn among(neighbours: &Neighbours, agree: &[bool]) -> Self {
        let mut nearby = Agreeing::default();
        let mut agreeing_count = 0;
        for idx in (0..agree.len()).filter(|idx| agree[*idx]) {
            let around = neighbours.agreeing(idx, agree);
            agreeing_count += 1;
            nearby.count += around.count;
            nearby.agreeing_count += around.agreeing_count;
        }
        Self {
            count: agree.len(),
            share: share(agreeing_count, agree.len()),
            share_nearby: share(nearby.agreeing_count, nearby.count),
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

fn share(part: usize, whole: usize) -> f64 {
    part as f64 / whole.max(1) as f64
}

/// Points, and which of them are near each other.
struct Neighbours {
    points: Vec<[f32; 3]>,
    tree: KdTree,
}

/// Of some neighbours.
#[derive(Clone, Copy, Debug, Default)]
struct Agreeing {
    count: usize,
    agreeing_count: usize,
}

impl Neighbours {
    fn new(points: &[Vector3<f64>]) -> Self {
        let points: Vec<[f32; 3]> = points.iter().map(to_single).collect();
        Self {
            tree: KdTree::new(&points),
            points,
        }
    }

    /// The nearest, and the point itself among them.
    fn with_itself(&self, idx: usize) -> Vec<usize> {
        let mut found = Vec::with_capacity(NEIGHBOUR_COUNT + 1);
        self.tree
            .nearest_many(self.points[idx], NEIGHBOUR_COUNT + 1, &mut found);
        found.into_iter().map(|one| one.idx as usize).collect()
    }

    fn agreeing(&self, idx: usize, agree: &[bool]) -> Agreeing {
        let mut around = Agreeing::default();
        for one in self.with_itself(idx) {
            around.count += usize::from(one != idx);
            around.agreeing_count += usize::from(one != idx && agree[one]);
        }
        around
    }
}

/// Of what one witness says, that may agree or not.
const SIGMA_OF_ONE: f64 = 0.5;

/// Whether corners stand where they should, whatever they look like.
///
/// A place shows about as many corners beside where one should be as another place does; only
/// exactly there it shows more.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Bareness {
    /// Places where a corner should be, and those of them where none is.
    pub asked_count: usize,
    pub bare_count: usize,
    /// The same of places beside them.
    pub beside_count: usize,
    pub bare_beside_count: usize,
}

/// Fewer places are of one thing or two, and tell nothing.
const BARENESS_COUNT_MIN: usize = 30;
/// Where corners stand as close as this everywhere, they tell nothing.
const BARE_BESIDE_SHARE_MIN: f64 = 0.1;

impl Bareness {
    /// Of several views together.
    pub(crate) fn of_all<'a>(views: impl IntoIterator<Item = &'a Self>) -> Self {
        let mut all = Self::default();
        for view in views {
            all.add(view);
        }
        all
    }

    pub(crate) fn add(&mut self, other: &Self) {
        self.asked_count += other.asked_count;
        self.bare_count += other.bare_count;
        self.beside_count += other.beside_count;
        self.bare_beside_count += other.bare_beside_count;
    }

    /// How often nothing is where a corner should be, relative to places beside: 1 of a place that
    /// has nothing to do with the other. `None` if that cannot be told.
    pub(crate) fn ratio(&self) -> Option<f64> {
        let beside = share(self.bare_beside_count, self.beside_count);
        let is_told = self.asked_count >= BARENESS_COUNT_MIN && beside >= BARE_BESIDE_SHARE_MIN;
        is_told.then(|| share(self.bare_count, self.asked_count) / beside)
    }

    /// How much oftener corners stand where they should than beside.
    fn contrast(&self) -> f64 {
        share(self.bare_beside_count, self.beside_count) - share(self.bare_count, self.asked_count)
    }
}

/// What all witnesses say together, of either place about the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Likeness {
    /// Witnesses.
    pub count: usize,
    /// The share of the place over which they agree, 0 to 1.
    pub extent: f64,
    /// Standard deviation of `extent`.
    pub sigma: f64,
    /// How often nothing is where a corner should be, relative to places beside: 1 of a place that
    /// has nothing to do with the other; `None` where that cannot be told.
    pub bareness: Option<f64>,
    /// How often corners stand where they should although nothing around looks alike, relative to
    /// where things do, 0 to 1: a view from aside changes the looks of a corner, not its place.
    pub presence: f64,
    /// The share of what looks alike that lies aside together with all around it, as a poster that
    /// hangs elsewhere does.
    pub displaced: f64,
}

/// Fewer may all be of one bush.
const WITNESS_COUNT_MIN: usize = 50;

/// The share of what both maps show that looks alike in one place. Of rendered rooms that share
/// furniture and posters, one pair in a hundred comes to more; nearly all common views from within
/// 30° do, by a standard deviation, and real ones come to 0.7.
pub(crate) const EXTENT_MIN: f64 = 0.35;

/// Rendered rooms of one plan come to a bareness of 0.85, common views from within 45° to 0.6, and
/// those of two real cameras of different make to 0.71: so much may it and the extent that is asked
/// for come to together.
const BARENESS_MAX: f64 = 1.1;
/// How much both may exceed the extent: the less is alike, the fewer corners may be missing.
const BARENESS_EXCESS_MAX: f64 = 0.47;
/// How much presence and displacement weigh beside the least extent: nearly what a logistic
/// regression gives them on rendered rooms, some of one plan and some seen in common.
const PRESENCE_WEIGHT: f64 = 2.5;
const DISPLACED_WEIGHT: f64 = 3.0;
/// What the three come to together, relative to the extent that is asked for: 1.05 at 0.35. Of 648
/// pairs of rendered rooms of one plan those whose corners are not missing come to 1.03 at most, of
/// common views from within 30° two in a hundred to less than 1.05, and a real one to 1.4.
const BALANCE_FACTOR: f64 = 3.0;

impl Likeness {
    /// Each kind of witness counts by their number; few of them leave much to luck.
    pub(crate) fn of(kinds: impl IntoIterator<Item = Evenness>) -> Self {
        let (mut count, mut agreeing, mut extent) = (0, 0.0, 0.0);
        for kind in kinds {
            count += kind.count;
            agreeing += kind.share * kind.count as f64;
            extent += kind.extent() * kind.count as f64;
        }
        let extent = extent / count.max(1) as f64;
        // Neighbours agree or not together: they are one witness.
        let independent = |count: f64| (count / NEIGHBOUR_COUNT as f64).max(1.0);
        let of_agreeing = extent / independent(agreeing).sqrt();
        // Where hardly any agree, as many as were asked.
        let of_all = SIGMA_OF_ONE / independent(count as f64).sqrt();
        Self {
            count,
            extent,
            sigma: of_agreeing.max(of_all),
            bareness: None,
            presence: things::USUAL_PRESENCE,
            displaced: 0.0,
        }
    }

    /// What two maps say of each other, and what else is known.
    pub(crate) fn between(
        [first, second]: [&Things; 2],
        gates: Gates,
        others: impl IntoIterator<Item = Evenness>,
    ) -> Self {
        let sought = [
            first.sought_in(second, gates),
            second.sought_in(first, gates),
        ];
        let kinds = sought.iter().map(|one| one.evenness);
        Self {
            presence: things::presence(&sought),
            displaced: things::displaced(&sought, gates.reach),
            ..Self::of(kinds.chain(others))
        }
    }

    /// Whether there are enough witnesses for a verdict that is not asked for again.
    pub(crate) fn tells_the_place(&self) -> bool {
        self.count >= WITNESS_COUNT_MIN
    }

    /// Whether the place is like the other over at least this share, although a standard deviation
    /// of it may be luck, and what speaks against it does not outweigh that.
    pub fn exceeds(&self, extent_min: f64) -> bool {
        let extent = self.extent - self.sigma;
        extent >= extent_min && self.outweighs_doubts(extent, extent_min)
    }

    /// Whether it is not, although a standard deviation may be bad luck.
    pub fn falls_short_of(&self, extent_min: f64) -> bool {
        let extent = self.extent + self.sigma;
        extent < extent_min || !self.outweighs_doubts(extent, extent_min)
    }

    /// Witnesses that know nothing of each other: the less the one says, the more is asked of the
    /// others.
    fn outweighs_doubts(&self, extent: f64, extent_min: f64) -> bool {
        let shows_corners = self
            .bareness
            .is_none_or(|it| it + extent_min <= BARENESS_MAX.min(extent + BARENESS_EXCESS_MAX));
        let balance = extent + PRESENCE_WEIGHT * self.presence - DISPLACED_WEIGHT * self.displaced;
        shows_corners && balance >= BALANCE_FACTOR * extent_min
    }
}

#[cfg(test)]
mod tests;
