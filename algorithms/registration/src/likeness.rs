//! Whether two places that fit are one place: where both were seen, they must look alike all over.
//!
//! Rooms of one plan share furniture and posters, which match to a tenth of a percent. What tells
//! them apart is what one shows and the other does not, asked in both directions.

use features::Descriptor;
use nalgebra::Vector3;

use crate::cloud::to_single;
use crate::kd_tree::{KdTree, Neighbour};

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
        let share = |part: usize, whole: usize| part as f64 / whole.max(1) as f64;
        let beside = share(self.bare_beside_count, self.beside_count);
        let is_told = self.asked_count >= BARENESS_COUNT_MIN && beside >= BARE_BESIDE_SHARE_MIN;
        is_told.then(|| share(self.bare_count, self.asked_count) / beside)
    }
}

/// Whether points that look otherwise in the other map are there at all.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Vacancy {
    unlike: Bareness,
    /// Points that look alike, and those of them that lie as near as is asked of the others.
    alike_count: usize,
    coincident_count: usize,
}

/// Where maps are so coarse that fewer of the same points coincide, the others tell nothing.
const COINCIDENT_SHARE_MIN: f64 = 0.45;

impl Vacancy {
    /// Of both maps together; `None` if it cannot be told.
    pub(crate) fn ratio(of: [Self; 2]) -> Option<f64> {
        let sum = |count: fn(&Self) -> usize| of.iter().map(count).sum::<usize>() as f64;
        let alike = sum(|one| one.alike_count);
        if sum(|one| one.coincident_count) < COINCIDENT_SHARE_MIN * alike {
            return None;
        }
        Bareness::of_all(of.iter().map(|one| &one.unlike)).ratio()
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
    /// The same of points in the two maps that look otherwise.
    pub vacancy: Option<f64>,
}

/// The share of what both maps show that looks alike in one place. Of rendered rooms that share
/// furniture and posters, one pair in a hundred comes to more; nearly all common views from within
/// 30° do, by a standard deviation, and real ones come to 0.7.
pub(crate) const EXTENT_MIN: f64 = 0.35;

/// How much bareness and the least extent may come to together. Rendered rooms of one plan come to
/// a bareness of 0.85, common views from within 30° to 0.36.
const BARENESS_MAX: f64 = 1.1;
/// How much bareness and least extent together may exceed the extent less half of the vacancy. All
/// but two of 1,104 pairs of rendered rooms of one plan that are alike enough are beyond 0.83.
const BARENESS_EXCESS_MAX: f64 = 0.755;
/// Where nothing is known of it. Rendered rooms of one plan come to 0.85, common views to 0.55.
const USUAL_VACANCY: f64 = 0.65;

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
            vacancy: None,
        }
    }

    /// Whether the place is like the other over at least this share, although a standard deviation
    /// of it may be luck, and its corners are not missing.
    pub fn exceeds(&self, extent_min: f64) -> bool {
        let extent = self.extent - self.sigma;
        extent >= extent_min && self.shows_corners(extent, extent_min)
    }

    /// Whether it is not, although a standard deviation may be bad luck.
    pub fn falls_short_of(&self, extent_min: f64) -> bool {
        let extent = self.extent + self.sigma;
        extent < extent_min || !self.shows_corners(extent, extent_min)
    }

    /// Witnesses that know nothing of each other: the less the one says, the more is asked of the
    /// others.
    fn shows_corners(&self, extent: f64, extent_min: f64) -> bool {
        let vacancy = self.vacancy.unwrap_or(USUAL_VACANCY);
        let balance_max = extent - 0.5 * vacancy + BARENESS_EXCESS_MAX;
        self.bareness
            .is_none_or(|it| it + extent_min <= balance_max.min(BARENESS_MAX))
    }
}

/// Things of one map, in the frame of both.
pub(crate) struct Things<'a> {
    points: &'a [Vector3<f64>],
    descriptors: &'a [Descriptor],
    tree: KdTree,
}

/// So many things of the other map stand nearby where it has looked.
const COMPANY_COUNT_MIN: usize = 3;
/// How far they may be, relative to what is asked for itself.
const COMPANY_REACH: f64 = 1.25;
/// How far a corner may be from itself if only its place is asked for, relative to the same.
const CORNER_REACH: f64 = 0.25;
/// So many things tell what is missing.
const MISSED_COUNT_MAX: usize = 600;

impl<'a> Things<'a> {
    /// - `descriptors`: of the first points; the others are not looked at.
    pub fn new(points: &'a [Vector3<f64>], descriptors: &'a [Descriptor]) -> Self {
        let count = points.len().min(descriptors.len());
        let (points, descriptors) = (&points[..count], &descriptors[..count]);
        let single: Vec<[f32; 3]> = points.iter().map(to_single).collect();
        Self {
            points,
            descriptors,
            tree: KdTree::new(&single),
        }
    }

    /// Asks each thing here whether the other map has it, as far as that has looked there.
    ///
    /// - `reach`: how far a thing of one map may be from itself in the other.
    pub fn sought_in(&self, other: &Things, reach: f64, distance_max: u32) -> Evenness {
        let (mut points, mut agree) = (Vec::new(), Vec::new());
        let mut near: Vec<Neighbour> = Vec::new();
        let company_reach = (reach * COMPANY_REACH) as f32;
        let reach_squared = (reach * reach) as f32;
        for (point, descriptor) in self.points.iter().zip(self.descriptors) {
            other
                .tree
                .within(to_single(point), company_reach, &mut near);
            if near.len() < COMPANY_COUNT_MIN {
                continue;
            }
            points.push(*point);
            agree.push(near.iter().any(|one| {
                let theirs = &other.descriptors[one.idx as usize];
                one.distance_squared <= reach_squared && descriptor.distance(theirs) <= distance_max
            }));
        }
        Evenness::of(&points, &agree)
    }

    /// Asks each thing here that looks otherwise in the other map whether anything is there at all,
    /// and beside it.
    ///
    /// A place shows corners where they should be even where a view from aside changes their looks;
    /// another place does not.
    pub fn missed_in(&self, other: &Things, reach: f64, distance_max: u32) -> Vacancy {
        let mut found = Vacancy::default();
        let mut near: Vec<Neighbour> = Vec::new();
        let company_reach = (reach * COMPANY_REACH) as f32;
        let corner_reach_squared = (reach * CORNER_REACH).powi(2) as f32;
        let is_bare = |place: &Vector3<f64>| {
            let corner = other.tree.nearest(to_single(place), corner_reach_squared);
            corner.is_none()
        };
        let stride = self.points.len().div_ceil(MISSED_COUNT_MAX).max(1);
        for (point, descriptor) in self.points.iter().zip(self.descriptors).step_by(stride) {
            other
                .tree
                .within(to_single(point), company_reach, &mut near);
            if near.len() < COMPANY_COUNT_MIN {
                continue;
            }
            let alike = near.iter().filter(|one| {
                let theirs = &other.descriptors[one.idx as usize];
                f64::from(one.distance_squared) <= reach * reach
                    && descriptor.distance(theirs) <= distance_max
            });
            let nearest = alike.map(|one| one.distance_squared).min_by(f32::total_cmp);
            if let Some(distance_squared) = nearest {
                found.alike_count += 1;
                found.coincident_count += usize::from(distance_squared <= corner_reach_squared);
                continue;
            }
            found.unlike.asked_count += 1;
            found.unlike.bare_count += usize::from(is_bare(point));
            for idx in 0..6 {
                let shift = Vector3::ith(idx / 2, if idx % 2 == 0 { reach } else { -reach });
                found.unlike.beside_count += 1;
                found.unlike.bare_beside_count += usize::from(is_bare(&(point + shift)));
            }
        }
        found
    }
}

#[cfg(test)]
mod tests;
