//! Whether a place counts that was found afterwards, when nothing but the image spoke for it.

use nalgebra::Vector3;

use crate::held::place_sigma;
use crate::tracking::Tracked;
use crate::trajectory::FrameRecord;
use crate::{Observation, VslamMap};

/// A place may be uncertain by this share of the way that the camera went: even four times as much
/// does not put it far beside that way.
pub(super) const WAY_SHARE_MAX: f64 = 1.0 / 80.0;
/// A camera that hovers goes no way; then this share of the depth that it sees is in its place.
pub(super) const WAY_DEPTHS_MIN: f64 = 0.3;
/// Places that are looked at for the way, at most.
const WAY_PLACES_MAX: usize = 1000;
/// A step is one if it is longer than this many standard deviations; others are noise.
const STEP_SIGMAS: f64 = 2.0;

/// A frame that shows less than this of what it should may be of another place: a poster that hangs
/// there as well fits to a third of a pixel. Frames that are where they were found show 0.35 and
/// more in 49 of 50 cases.
const FOUND_SHARE_MIN: f64 = 0.3;

/// Whether the camera was there: certain enough for the way that it went in the map, and showing
/// what it should.
pub(super) fn is_sure(
    map: &VslamMap,
    trajectory: &[FrameRecord],
    (observations, tracked): (&[Observation], &Tracked),
) -> bool {
    if (tracked.ranged_count as f64) < FOUND_SHARE_MIN * tracked.expected_count as f64 {
        return false;
    }
    let sigma = place_sigma(map, &tracked.camera_from_map, observations);
    let depth = map.median_depth(tracked.reference).unwrap_or(0.0);
    sigma.is_some_and(|sigma| {
        let way = way(map, trajectory, STEP_SIGMAS * sigma);
        sigma <= WAY_SHARE_MAX * way.max(WAY_DEPTHS_MIN * depth)
    })
}

/// How far the camera went in the map, by steps of at least this length.
fn way(map: &VslamMap, trajectory: &[FrameRecord], step_min: f64) -> f64 {
    let of_map = || trajectory.iter().filter(|one| one.map_id == map.id());
    let stride = of_map().count().div_ceil(WAY_PLACES_MAX).max(1);
    let places = of_map().step_by(stride).filter_map(|one| one.place);
    let centres = places.filter_map(|place| Some(*map.pose(&place)?.inverse().translation()));
    length(centres, step_min)
}

/// How long a way through these places is, by steps of at least this length.
pub(super) fn length(places: impl Iterator<Item = Vector3<f64>>, step_min: f64) -> f64 {
    let (mut length, mut last) = (0.0, None);
    for place in places {
        let step = (place - *last.get_or_insert(place)).norm();
        if step > step_min {
            length += step;
            last = Some(place);
        }
    }
    length
}

#[cfg(test)]
mod tests;
