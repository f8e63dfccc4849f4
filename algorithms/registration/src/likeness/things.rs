//! Two maps of what may be one place, thing by thing.

use features::Descriptor;
use nalgebra::Vector3;

use super::{Bareness, Evenness, NEIGHBOUR_COUNT, Neighbours};
use crate::cloud::to_single;
use crate::kd_tree::{KdTree, Neighbour};
use crate::median::median;

/// Things of one map, in the frame of both.
pub(crate) struct Things<'a> {
    points: &'a [Vector3<f64>],
    descriptors: &'a [Descriptor],
    tree: KdTree,
}

/// How near the things of two maps must be to be compared.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gates {
    /// How far a thing of one map may be from itself in the other.
    pub reach: f64,
    /// Bits that may differ between two looks of one thing.
    pub bits_max: u32,
}

/// So many things of the other map stand nearby where it has looked.
const COMPANY_COUNT_MIN: usize = 3;
/// How far they may be, relative to what is asked for itself.
const COMPANY_REACH: f64 = 1.25;
/// How far a corner may be from itself if only its place is asked for, relative to the same.
const CORNER_REACH: f64 = 0.25;
/// So many things tell whether corners are where they should be.
const CORNER_COUNT_MAX: usize = 600;

/// What the other map has of the things of one map, as far as it has looked there.
pub(crate) struct Sought {
    pub evenness: Evenness,
    /// Whether corners stand where things look alike, and where nothing around does.
    alike: Bareness,
    unlike: Bareness,
    /// Where things look alike, and from there to what they look like.
    offsets: Vec<[Vector3<f64>; 2]>,
}

/// A thing that the other map should have.
struct Asked {
    /// To what looks like it most.
    offset: Option<Vector3<f64>>,
    /// Whether a corner of any look is exactly there.
    is_bare: bool,
}

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
    pub fn sought_in(&self, other: &Things, gates: Gates) -> Sought {
        let (mut points, mut asked) = (Vec::new(), Vec::new());
        let mut near: Vec<Neighbour> = Vec::new();
        for idx in 0..self.points.len() {
            let point = &self.points[idx];
            let company_reach = (gates.reach * COMPANY_REACH) as f32;
            other
                .tree
                .within(to_single(point), company_reach, &mut near);
            if near.len() >= COMPANY_COUNT_MIN {
                points.push(*point);
                asked.push(self.ask(idx, other, &near, gates));
            }
        }
        let agree: Vec<bool> = asked.iter().map(|one| one.offset.is_some()).collect();
        let neighbours = Neighbours::new(&points);
        let (mut alike, mut unlike) = (Bareness::default(), Bareness::default());
        let stride = points.len().div_ceil(CORNER_COUNT_MAX).max(1);
        for (turn, idx) in (0..points.len()).step_by(stride).enumerate() {
            let of_kind = match agree[idx] {
                true => &mut alike,
                false if neighbours.agreeing(idx, &agree).agreeing_count == 0 => &mut unlike,
                // Beside what is alike much is hidden, and little is another thing.
                false => continue,
            };
            of_kind.add(&other.bareness_at(&points[idx], turn % 3, asked[idx].is_bare, gates));
        }
        let offsets = points.iter().zip(&asked);
        Sought {
            evenness: Evenness::among(&neighbours, &agree),
            alike,
            unlike,
            offsets: offsets
                .filter_map(|(point, asked)| Some([*point, asked.offset?]))
                .collect(),
        }
    }

    fn ask(&self, idx: usize, other: &Things, near: &[Neighbour], gates: Gates) -> Asked {
        let reach_squared = (gates.reach * gates.reach) as f32;
        let looks = near
            .iter()
            .filter(|one| one.distance_squared <= reach_squared)
            .map(|one| {
                let theirs = &other.descriptors[one.idx as usize];
                (self.descriptors[idx].distance(theirs), one.idx as usize)
            });
        let (bits, most_alike) = looks.min().unwrap_or((u32::MAX, 0));
        let corner_reach_squared = (gates.reach * CORNER_REACH).powi(2) as f32;
        Asked {
            offset: (bits <= gates.bits_max).then(|| other.points[most_alike] - self.points[idx]),
            is_bare: near
                .iter()
                .all(|one| one.distance_squared > corner_reach_squared),
        }
    }

    /// Whether corners stand at a place, and on either side of it along an axis.
    fn bareness_at(
        &self,
        place: &Vector3<f64>,
        axis: usize,
        is_bare: bool,
        gates: Gates,
    ) -> Bareness {
        let corner_reach_squared = (gates.reach * CORNER_REACH).powi(2) as f32;
        let beside = [gates.reach, -gates.reach].map(|shift| {
            let place = place + Vector3::ith(axis, shift);
            let corner = self.tree.nearest(to_single(&place), corner_reach_squared);
            usize::from(corner.is_none())
        });
        Bareness {
            asked_count: 1,
            bare_count: usize::from(is_bare),
            beside_count: 2,
            bare_beside_count: beside.iter().sum(),
        }
    }
}

/// What [`presence`] comes to in common views, the median, and what that counts for: as many things
/// as stand on a shelf.
pub(super) const USUAL_PRESENCE: f64 = 0.45;
const USUAL_COUNT: f64 = 15.0;
/// Maps so coarse that corners hardly coincide where things look alike.
const CONTRAST_MIN: f64 = 0.05;

/// How often corners stand where they should although nothing around looks alike, relative to where
/// things do: 0 of a place that has other things there, 1 of one that is only seen differently.
///
/// A view from aside changes the looks of a corner, not its place.
pub(super) fn presence(sought: &[Sought; 2]) -> f64 {
    let alike = Bareness::of_all(sought.iter().map(|one| &one.alike));
    let unlike = Bareness::of_all(sought.iter().map(|one| &one.unlike));
    let count = unlike.asked_count as f64;
    let relative = unlike.contrast() / alike.contrast().max(CONTRAST_MIN);
    let weighted = relative * count + USUAL_PRESENCE * USUAL_COUNT;
    (weighted / (count + USUAL_COUNT)).clamp(0.0, 1.0)
}

/// A thing and its neighbours are displaced if they lie aside in common by so much of the reach,
/// and differ among each other by less than a share of that: the noise of maps differs from point
/// to point, and comes to half as much in common.
const DISPLACED_REACH_MIN: f64 = 0.2;
const SCATTER_MAX: f64 = 0.35;
/// Fewer are one thing.
const OFFSET_COUNT_MIN: usize = NEIGHBOUR_COUNT + 5;

/// The share of what looks alike that is displaced together with all around it.
///
/// In another room of the same plan, posters hang a little elsewhere, each as a whole; what a map
/// is out of shape bends it slowly.
pub(super) fn displaced(sought: &[Sought; 2], reach: f64) -> f64 {
    let [there, back] = sought;
    let back = back.offsets.iter().map(|[point, offset]| [*point, -offset]);
    let (points, offsets): (Vec<_>, Vec<_>) = there
        .offsets
        .iter()
        .copied()
        .chain(back)
        .map(|[point, offset]| (point, offset))
        .unzip();
    if points.len() < OFFSET_COUNT_MIN {
        return 0.0;
    }
    let neighbours = Neighbours::new(&points);
    let is_displaced = |idx: &usize| {
        let around = neighbours.with_itself(*idx);
        let around: Vec<Vector3<f64>> = around.iter().map(|one| offsets[*one]).collect();
        let common = Vector3::from_fn(|axis, _| middle(around.iter().map(|one| one[axis])));
        let scatter = middle(around.iter().map(|one| (one - common).norm()));
        let distance = common.norm();
        distance > DISPLACED_REACH_MIN * reach && scatter < SCATTER_MAX * distance
    };
    (0..points.len()).filter(is_displaced).count() as f64 / points.len() as f64
}

fn middle(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    median(&mut values, f64::total_cmp).unwrap_or(0.0)
}
