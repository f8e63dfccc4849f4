//! Whether a keyframe shows a place that a map has already.

use std::collections::BTreeSet;

use features::matching::{MatchSettings, match_mutual};
use geometry::{Map, Similarity};
use rand_chacha::ChaCha8Rng;

use super::align::{Pair, Side, Sighting, ransac, refine};
use crate::frame::Viewpoint;
use crate::optics::{Optics, level_scale};
use crate::places::{LookAlike, rank};
use crate::search::{Gate, Wanted, find};
use crate::{Keyframe, KeyframeId, PointId, VslamMap};

/// Places looked at per keyframe.
const CANDIDATES_MAX: usize = 3;
/// A candidate has this many descriptors in common with the keyframe.
const SHARED_MIN: u32 = 12;
/// Pairs of points that a first alignment needs.
const PAIRS_MIN: usize = 15;
/// Keypoints of the keyframe that show the place's points in the end.
const INLIERS_MIN: usize = 40;
/// And as many of all of the place's points that should be in view.
const INLIER_SHARE_MIN: f64 = 0.25;
/// Cells, of 4 × 4 of the image, in which they lie.
const CELLS_MIN: usize = 6;
/// A scale that is less certain than this is no basis for a correction.
const LOG_SCALE_SIGMA_MAX: f64 = 0.02;
/// Other keyframes beside this one that must see the place under the same similarity.
const SUPPORTERS_MIN: usize = 2;
/// Keyframes asked for that.
const WITNESSES_MAX: usize = 6;
/// Keypoints with which a keyframe supports, and their share of the points it should see.
const SUPPORT_MIN: usize = 20;
const SUPPORT_SHARE_MIN: f64 = 0.15;
/// Searches with an alignment that gets better each time.
const GUIDED_ROUNDS: usize = 2;
const WINDOW_PX: f64 = 8.0;
const VIEWING_COSINE_MIN: f64 = 0.5;
const GATE: Gate = Gate {
    distance_max: 60,
    ratio_max: 0.9,
};

/// A place that was seen before, as seen by a keyframe of the same or of another map.
#[derive(Clone, Debug)]
pub(crate) struct Recognition {
    pub(crate) keyframe: KeyframeId,
    /// The keyframe there that looks most like it.
    pub(crate) place: KeyframeId,
    /// The place and its neighbours.
    pub(crate) surroundings: Vec<KeyframeId>,
    /// From where the keyframe's part of its map is to where it should be.
    pub(crate) target_from_source: Similarity<Map, Map>,
    /// Observations of the keyframe and the points of the place that they show.
    pub(crate) matches: Vec<(u32, PointId)>,
}

/// A keyframe and the map that it belongs to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Query<'a> {
    pub(crate) map: &'a VslamMap,
    pub(crate) keyframe: &'a Keyframe,
}

impl<'a> Query<'a> {
    /// The keyframe, and after it those that share most with it.
    fn with_neighbours(&self) -> Vec<&'a Keyframe> {
        let neighbours = self.keyframe.neighbours.iter();
        let neighbours = neighbours.filter_map(|id| self.map.keyframe(*id));
        let mut all = vec![self.keyframe];
        all.extend(neighbours.take(WITNESSES_MAX));
        all
    }
}

/// Looks for a keyframe in a map, among the places that are usable.
///
/// A wrong place would bend the whole map. So an alignment must explain much of what is in view,
/// all over the image, with a sharp scale, and for several keyframes that stand beside each other.
pub(crate) fn recognise(
    optics: &Optics,
    query: Query,
    target: &VslamMap,
    alike: &[LookAlike],
    usable: impl Fn(KeyframeId) -> bool,
    rng: &mut ChaCha8Rng,
) -> Option<Recognition> {
    let candidates = rank(target, alike, &usable);
    candidates
        .iter()
        .filter(|one| one.shared_count >= SHARED_MIN)
        .take(CANDIDATES_MAX)
        .find_map(|one| verify(optics, query, (target, one.keyframe), &usable, rng))
}

fn verify(
    optics: &Optics,
    query: Query,
    (target, place): (&VslamMap, KeyframeId),
    usable: &impl Fn(KeyframeId) -> bool,
    rng: &mut ChaCha8Rng,
) -> Option<Recognition> {
    let mut surroundings = vec![place];
    let neighbours = target.keyframe(place)?.neighbours.iter().copied();
    surroundings.extend(neighbours.filter(|id| target.keyframe(*id).is_some() && usable(*id)));
    let points = target.points_of(&surroundings);

    let pairs = pair_points(query, target, &points, &surroundings);
    let mut similarity = ransac(&pairs, PAIRS_MIN, rng)?;
    let mut log_scale_sigma = f64::INFINITY;
    let witnesses = query.with_neighbours();
    let mut seen = Vec::new();
    for _ in 0..GUIDED_ROUNDS {
        let agreeing = pairs.iter().filter(|pair| pair.agrees(&similarity));
        let mut sightings: Vec<Sighting> = agreeing
            .flat_map(|pair| [pair.in_target, pair.in_source])
            .collect();
        // Several keyframes that find themselves among the same points make the scale sharp.
        seen = Vec::with_capacity(witnesses.len());
        for keyframe in &witnesses {
            let by_one = see(optics, target, &points, keyframe, &similarity);
            sightings.extend(by_one.sightings(keyframe, target));
            seen.push(by_one);
        }
        let refined = refine(&similarity, &sightings)?;
        (similarity, log_scale_sigma) = (refined.target_from_source, refined.log_scale_sigma);
    }
    for (by_one, keyframe) in seen.iter_mut().zip(&witnesses) {
        by_one.keep_agreeing(keyframe, target, &similarity);
    }
    let (own, others) = seen.split_first()?;
    let pair_count = pairs.iter().filter(|one| one.agrees(&similarity)).count();
    let convincing = own.matches.len() >= INLIERS_MIN
        && own.share() >= INLIER_SHARE_MIN
        && own.cell_count(optics, query.keyframe) >= CELLS_MIN
        && others.iter().filter(|one| one.supports()).count() >= SUPPORTERS_MIN
        && pair_count >= PAIRS_MIN
        && log_scale_sigma <= LOG_SCALE_SIGMA_MAX;
    if !convincing {
        return None;
    }
    let matches = own.matches.clone();
    Some(Recognition {
        keyframe: query.keyframe.id,
        place,
        surroundings,
        target_from_source: similarity,
        matches,
    })
}

/// Points of the keyframe and of the place whose descriptors are each other's nearest.
fn pair_points(
    query: Query,
    target: &VslamMap,
    points: &[PointId],
    surroundings: &[KeyframeId],
) -> Vec<Pair> {
    let keyframe = query.keyframe;
    let own: Vec<_> = keyframe
        .observations
        .iter()
        .filter_map(|one| Some((one, query.map.point(one.point?)?)))
        .filter(|(_, point)| point.has_range())
        .collect();
    let theirs = points.iter().filter_map(|id| target.point(*id));
    let theirs: Vec<_> = theirs.filter(|point| point.has_range()).collect();
    let own_descriptors: Vec<_> = own.iter().map(|(one, _)| one.descriptor).collect();
    let their_descriptors: Vec<_> = theirs.iter().map(|point| point.descriptor).collect();
    let settings = MatchSettings {
        distance_max: 64,
        ratio_max: 0.85,
    };
    match_mutual(&own_descriptors, &their_descriptors, &settings)
        .into_iter()
        .filter_map(|found| {
            let (observation, point) = own[found.query_idx as usize];
            let other = theirs[found.train_idx as usize];
            let viewed = |id: &KeyframeId| {
                let seeing = target.keyframe(*id)?;
                Some((seeing, &seeing.observations[other.observation_idx(*id)?]))
            };
            let (seeing, seen) = surroundings.iter().find_map(viewed)?;
            Some(Pair {
                in_target: Sighting {
                    point: point.position_in_map,
                    camera_from_map: seeing.camera_from_map,
                    position: seen.position,
                    sigma: seen.sigma,
                    side: Side::Target,
                },
                in_source: Sighting {
                    point: other.position_in_map,
                    camera_from_map: keyframe.camera_from_map,
                    position: observation.position,
                    sigma: observation.sigma,
                    side: Side::Source,
                },
            })
        })
        .collect()
}

/// Points of the target map that a keyframe shows.
#[derive(Clone, Debug, Default)]
struct Seen {
    matches: Vec<(u32, PointId)>,
    /// Points that it should show.
    visible_count: usize,
}

/// Searches a keyframe for the target map's points, where the similarity expects them.
fn see(
    optics: &Optics,
    target: &VslamMap,
    points: &[PointId],
    keyframe: &Keyframe,
    target_from_source: &Similarity<Map, Map>,
) -> Seen {
    let target_from_camera = target_from_source.transform_pose(&keyframe.map_from_camera());
    let viewpoint = Viewpoint::new(target_from_camera.inverse());
    let mut seen = Seen::default();
    let mut taken = BTreeSet::new();
    let points = points.iter().filter_map(|id| target.point(*id));
    for point in points.filter(|point| point.has_range()) {
        let ray = point.position_in_map - viewpoint.centre_in_map;
        let distance = ray.norm();
        let position = optics.project(&viewpoint.transform(&point.position_in_map));
        let viewing_cosine = ray.dot(&point.viewing_direction) / distance;
        let expected =
            point.in_distance_range(optics, distance) && viewing_cosine > VIEWING_COSINE_MIN;
        let Some(position) = position.filter(|_| expected) else {
            continue;
        };
        seen.visible_count += 1;
        let level = point.predicted_level(optics, distance);
        let wanted = Wanted {
            position,
            radius: WINDOW_PX * optics.window * level_scale(level),
            levels: level.saturating_sub(1)..=level + 1,
            descriptor: &point.descriptor,
        };
        let found = find(
            &wanted,
            (&keyframe.grid, &keyframe.observations),
            GATE,
            |_| true,
        );
        if let Some(found) = found.filter(|found| taken.insert(found.observation_idx)) {
            seen.matches.push((found.observation_idx as u32, point.id));
        }
    }
    seen
}

impl Seen {
    fn share(&self) -> f64 {
        self.matches.len() as f64 / self.visible_count.max(1) as f64
    }

    fn supports(&self) -> bool {
        self.matches.len() >= SUPPORT_MIN && self.share() >= SUPPORT_SHARE_MIN
    }

    fn sightings(&self, keyframe: &Keyframe, target: &VslamMap) -> impl Iterator<Item = Sighting> {
        self.matches
            .iter()
            .filter_map(move |one| sighting(one, keyframe, target))
    }

    fn keep_agreeing(
        &mut self,
        keyframe: &Keyframe,
        target: &VslamMap,
        target_from_source: &Similarity<Map, Map>,
    ) {
        self.matches.retain(|one| {
            sighting(one, keyframe, target).is_some_and(|one| one.agrees(target_from_source))
        });
    }

    /// In how many cells, of 4 × 4 of the image, there are matches.
    fn cell_count(&self, optics: &Optics, keyframe: &Keyframe) -> usize {
        let (width, height) = (optics.camera.width() as f64, optics.camera.height() as f64);
        let cells = self.matches.iter().map(|(observation_idx, _)| {
            let pixel = keyframe.observations[*observation_idx as usize].position_px;
            let cell = |share: f64| (4.0 * share).clamp(0.0, 3.0) as usize;
            (cell(pixel.x / width), cell(pixel.y / height))
        });
        cells.collect::<BTreeSet<_>>().len()
    }
}

fn sighting(
    (observation_idx, point): &(u32, PointId),
    keyframe: &Keyframe,
    target: &VslamMap,
) -> Option<Sighting> {
    let observation = &keyframe.observations[*observation_idx as usize];
    Some(Sighting {
        point: target.point(*point)?.position_in_map,
        camera_from_map: keyframe.camera_from_map,
        position: observation.position,
        sigma: observation.sigma,
        side: Side::Source,
    })
}
