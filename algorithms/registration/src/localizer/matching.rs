//! Which feature of a keyframe shows which landmark.

use features::Descriptor;
use geometry::{Camera, Transform};
use nalgebra::{Vector2, Vector3};

use super::image_grid::ImageGrid;
use super::landmarks::{AnchorLandmarks, AnchorMap, DISTANCE_FACTOR_MAX, PlacedLandmark};
use super::types::{ChunkIdx, LocalizerSettings, ObservedFeature};

/// Landmarks nearer to each other than this share of their distance are one thing, twice mapped;
/// the ratio test passes over such twins.
const TWIN_DISTANCE: f64 = 0.05;
/// Features nearer to each other than this on the ideal plane are one corner on two levels.
const TWIN_POSITION: f64 = 0.01;
/// A landmark is looked for only from within this angle of its first view (cosine).
const VIEW_ANGLE_COSINE_MIN: f64 = 0.5;
/// Only from so much nearer or farther.
const VIEW_DISTANCE_FACTORS: [f64; 2] = [1.0 / DISTANCE_FACTOR_MAX, DISTANCE_FACTOR_MAX];

/// A feature and the landmark that it may show.
#[derive(Clone, Copy)]
pub(super) struct LandmarkMatch<'a> {
    pub feature_idx: usize,
    pub landmark: &'a PlacedLandmark,
    pub chunk: ChunkIdx,
}

/// The features of one image, laid out for matching.
pub(super) struct FeatureIndex {
    positions: Vec<Vector2<f64>>,
    descriptors: Vec<Descriptor>,
    /// The corners of the box around all features.
    lowest: Vector2<f64>,
    highest: Vector2<f64>,
    grid: ImageGrid,
    cell_start: Vec<u32>,
    sorted: Vec<u32>,
}

/// Cells per axis of the grid over the features.
const GRID_SIZE: usize = 32;

impl FeatureIndex {
    /// `None` without features, or with numbers that are not finite.
    pub fn new(features: &[ObservedFeature]) -> Option<Self> {
        let positions: Vec<_> = features.iter().map(|feature| feature.position).collect();
        let first = *positions.first()?;
        let usable = features.iter().all(|feature| {
            feature.position.iter().all(|entry| entry.abs() < 100.0)
                && feature.sigma > 0.0
                && feature.sigma.is_finite()
        });
        if !usable {
            return None;
        }
        let lowest = positions.iter().fold(first, |low, one| low.inf(one));
        let highest = positions.iter().fold(first, |high, one| high.sup(one));
        let mut index = Self {
            descriptors: features.iter().map(|feature| feature.descriptor).collect(),
            positions,
            lowest,
            highest,
            grid: ImageGrid::new((lowest, highest), [GRID_SIZE; 2]),
            cell_start: vec![0; GRID_SIZE * GRID_SIZE + 1],
            sorted: Vec::new(),
        };
        index.sort_into_cells();
        Some(index)
    }

    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Corners of the box around all features on the ideal plane.
    pub fn bounds(&self) -> (Vector2<f64>, Vector2<f64>) {
        (self.lowest, self.highest)
    }

    fn sort_into_cells(&mut self) {
        let cells: Vec<usize> = self
            .positions
            .iter()
            .map(|position| self.grid.cell(position))
            .collect();
        self.sorted = (0..self.len() as u32).collect();
        self.sorted.sort_by_key(|idx| cells[*idx as usize]);
        for cell in &cells {
            self.cell_start[cell + 1] += 1;
        }
        for cell in 1..self.cell_start.len() {
            self.cell_start[cell] += self.cell_start[cell - 1];
        }
    }

    pub fn descriptor(&self, idx: usize) -> &Descriptor {
        &self.descriptors[idx]
    }

    pub fn for_each_near(
        &self,
        position: &Vector2<f64>,
        radius: f64,
        mut visit: impl FnMut(usize),
    ) {
        let offset = Vector2::repeat(radius);
        let [column_first, row_first] = self.grid.place(&(position - offset));
        let [column_last, row_last] = self.grid.place(&(position + offset));
        for row in row_first..=row_last {
            let first = self.cell_start[row * GRID_SIZE + column_first] as usize;
            let last = self.cell_start[row * GRID_SIZE + column_last + 1] as usize;
            for idx in &self.sorted[first..last] {
                let idx = *idx as usize;
                if (self.positions[idx] - position).norm_squared() <= radius * radius {
                    visit(idx);
                }
            }
        }
    }
}

/// The best landmark of a feature so far, and the second best that is another thing.
#[derive(Clone, Copy)]
struct Ranking<'a> {
    best: Option<(u32, LandmarkMatch<'a>)>,
    second_distance: u32,
}

impl<'a> Ranking<'a> {
    const EMPTY: Self = Self {
        best: None,
        second_distance: u32::MAX,
    };

    fn offer(&mut self, distance: u32, candidate: LandmarkMatch<'a>) {
        let Some((best_distance, best)) = self.best else {
            self.best = Some((distance, candidate));
            return;
        };
        let apart = (best.landmark.point - candidate.landmark.point).norm();
        let twin = apart < TWIN_DISTANCE * candidate.landmark.distance;
        if distance < best_distance {
            if !twin {
                self.second_distance = best_distance;
            }
            self.best = Some((distance, candidate));
        } else if !twin {
            self.second_distance = self.second_distance.min(distance);
        }
    }

    fn winner(&self, ratio_max: f64) -> Option<LandmarkMatch<'a>> {
        let (distance, best) = self.best?;
        (f64::from(distance) < ratio_max * f64::from(self.second_distance)).then_some(best)
    }
}

/// Matches that were found, and how many landmarks were looked at.
pub(super) struct Matches<'a> {
    pub list: Vec<LandmarkMatch<'a>>,
    pub candidate_count: usize,
    /// How many chunks were looked at.
    pub chunk_count: usize,
}

/// Compares all features with as many chunks as the budget allows.
///
/// `cursor` says with which chunk to begin, and is moved on, so that successive calls see every
/// chunk.
pub(super) fn search<'a>(
    features: &FeatureIndex,
    anchor: &'a AnchorLandmarks,
    settings: &LocalizerSettings,
    cursor: &mut ChunkIdx,
) -> Matches<'a> {
    let landmark_limit = (settings.search_distance_count_max / features.len().max(1)).max(1);
    let mut rankings = vec![Ranking::EMPTY; features.len()];
    let mut candidate_count = 0;
    let mut visited: Vec<ChunkIdx> = Vec::new();
    for (chunk_idx, chunk) in anchor.placed_chunks_from(*cursor) {
        if candidate_count > 0 && candidate_count + chunk.placed().len() > landmark_limit {
            break;
        }
        for landmark in chunk.placed() {
            if let Some((feature_idx, distance)) = best_feature(features, landmark, settings) {
                let candidate = LandmarkMatch {
                    feature_idx,
                    landmark,
                    chunk: chunk_idx,
                };
                rankings[feature_idx].offer(distance, candidate);
            }
        }
        candidate_count += chunk.placed().len();
        visited.push(chunk_idx);
    }
    // Half of what was seen is seen again: a place that straddles the border is not missed.
    let complete = visited.len() == anchor.placed_count();
    let next = visited.get(visited.len().div_ceil(2));
    *cursor = match next.or(visited.last()) {
        Some(next) if !complete => *next,
        _ => ChunkIdx(0),
    };
    let winners = rankings
        .iter()
        .filter_map(|ranking| ranking.winner(settings.search_ratio_max));
    Matches {
        list: winners.collect(),
        candidate_count,
        chunk_count: visited.len(),
    }
}

/// The feature that fits a landmark best, if clearly better than the second.
fn best_feature(
    features: &FeatureIndex,
    landmark: &PlacedLandmark,
    settings: &LocalizerSettings,
) -> Option<(usize, u32)> {
    let [a, b, c, d] = landmark.descriptor.0;
    // Half of the bits suffice to pass over nearly all strangers.
    let half_limit = settings.search_distance_max * 2 / 3;
    let (mut best, mut best_distance, mut second_distance) = (usize::MAX, u32::MAX, u32::MAX);
    for (idx, Descriptor([e, f, g, h])) in features.descriptors.iter().enumerate() {
        let half = (a ^ e).count_ones() + (b ^ f).count_ones();
        if half > half_limit {
            continue;
        }
        let distance = half + (c ^ g).count_ones() + (d ^ h).count_ones();
        if distance < best_distance {
            let apart = best != usize::MAX && !features_are_twins(features, idx, best);
            second_distance = if apart {
                best_distance
            } else {
                second_distance
            };
            (best, best_distance) = (idx, distance);
        } else if distance < second_distance && !features_are_twins(features, idx, best) {
            second_distance = distance;
        }
    }
    let clear = f64::from(best_distance) < settings.search_ratio_max * f64::from(second_distance);
    (best_distance <= settings.search_distance_max && clear).then_some((best, best_distance))
}

fn features_are_twins(features: &FeatureIndex, first: usize, second: usize) -> bool {
    let apart = features.positions[first] - features.positions[second];
    apart.norm_squared() < TWIN_POSITION * TWIN_POSITION
}

/// Looks for each landmark near where a predicted pose would see it.
pub(super) fn match_predicted<'a>(
    features: &FeatureIndex,
    anchor: &'a AnchorLandmarks,
    camera_from_anchor: &Transform<Camera, AnchorMap>,
    radius: f64,
    settings: &LocalizerSettings,
) -> Matches<'a> {
    let view = View::new(features, camera_from_anchor, radius);
    let mut rankings = vec![Ranking::EMPTY; features.len()];
    let mut candidate_count = 0;
    let chunks = anchor.chunks_near(&view.position, settings.predicted_landmark_count_max);
    let chunk_count = chunks.len();
    for (chunk, stored) in chunks {
        let (centre, sphere_radius) = stored.bounds();
        if !view.may_see(&centre, sphere_radius) {
            continue;
        }
        for landmark in stored.placed() {
            let Some(position) = view.project(landmark) else {
                continue;
            };
            candidate_count += 1;
            let (mut best, mut best_distance) = (usize::MAX, u32::MAX);
            let mut second_distance = u32::MAX;
            features.for_each_near(&position, radius, |idx| {
                let distance = landmark.descriptor.distance(&features.descriptors[idx]);
                let twin = best != usize::MAX && features_are_twins(features, idx, best);
                if distance < best_distance {
                    if best != usize::MAX && !twin {
                        second_distance = best_distance;
                    }
                    (best, best_distance) = (idx, distance);
                } else if !twin {
                    second_distance = second_distance.min(distance);
                }
            });
            let clear = f64::from(best_distance)
                < settings.predicted_ratio_max * f64::from(second_distance);
            if best_distance <= settings.predicted_distance_max && clear {
                let candidate = LandmarkMatch {
                    feature_idx: best,
                    landmark,
                    chunk,
                };
                rankings[best].offer(best_distance, candidate);
            }
        }
    }
    let ratio_max = settings.predicted_ratio_max;
    let winners = rankings
        .iter()
        .filter_map(|ranking| ranking.winner(ratio_max));
    Matches {
        list: winners.collect(),
        candidate_count,
        chunk_count,
    }
}

/// Cells per axis of the grid in which expectation and sight are compared.
const COVERAGE_GRID: [usize; 2] = [8, 6];
/// Landmarks, and features, that a cell needs before anything is expected of it.
const CELL_LANDMARKS_MIN: usize = 4;
const CELL_FEATURES_MIN: usize = 3;

/// How much of what a pose promises is there.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Coverage {
    /// Cells of a grid over the image that show features where landmarks should be.
    pub expected_count: usize,
    /// Those of them with a match.
    pub confirmed_count: usize,
}

/// Compares what should be in view of a pose with what was matched there, among as many landmarks
/// as were compared.
pub(super) fn coverage(
    features: &FeatureIndex,
    anchor: &AnchorLandmarks,
    camera_from_anchor: &Transform<Camera, AnchorMap>,
    matches: &[LandmarkMatch],
    settings: &LocalizerSettings,
) -> Coverage {
    #[derive(Clone, Copy, Default)]
    struct Cell {
        landmark_count: usize,
        feature_count: usize,
        match_count: usize,
    }
    let grid = ImageGrid::new(features.bounds(), COVERAGE_GRID);
    let mut cells = vec![Cell::default(); grid.cell_count()];
    let view = View::new(features, camera_from_anchor, 0.0);
    let landmark_count_max = settings.predicted_landmark_count_max;
    for (_, chunk) in anchor.chunks_near(&view.position, landmark_count_max) {
        let (centre, radius) = chunk.bounds();
        if !view.may_see(&centre, radius) {
            continue;
        }
        let positions = chunk.placed().iter().filter_map(|one| view.project(one));
        for position in positions {
            cells[grid.cell(&position)].landmark_count += 1;
        }
    }
    for position in &features.positions {
        cells[grid.cell(position)].feature_count += 1;
    }
    for one in matches {
        cells[grid.cell(&features.positions[one.feature_idx])].match_count += 1;
    }
    let mut coverage = Coverage::default();
    for cell in cells {
        let expected =
            cell.landmark_count >= CELL_LANDMARKS_MIN && cell.feature_count >= CELL_FEATURES_MIN;
        coverage.expected_count += usize::from(expected);
        coverage.confirmed_count += usize::from(expected && cell.match_count > 0);
    }
    coverage
}

/// What a camera at a predicted pose would see.
pub(super) struct View {
    camera_from_anchor: Transform<Camera, AnchorMap>,
    pub position: Vector3<f64>,
    lowest: Vector2<f64>,
    highest: Vector2<f64>,
    /// Largest angle between the optical axis and a feature, as a tangent.
    tangent_max: f64,
}

impl View {
    pub fn new(
        features: &FeatureIndex,
        camera_from_anchor: &Transform<Camera, AnchorMap>,
        margin: f64,
    ) -> Self {
        let (lowest, highest) = features.bounds();
        let offset = Vector2::repeat(margin);
        let (lowest, highest) = (lowest - offset, highest + offset);
        Self {
            camera_from_anchor: *camera_from_anchor,
            position: *camera_from_anchor.inverse().translation(),
            lowest,
            highest,
            tangent_max: lowest.abs().sup(&highest.abs()).norm(),
        }
    }

    pub fn may_see(&self, centre: &Vector3<f64>, radius: f64) -> bool {
        let centre = self.camera_from_anchor * *centre;
        // The sphere's nearest point to the cone about the optical axis.
        let across = centre.xy().norm();
        let secant = (1.0 + self.tangent_max * self.tangent_max).sqrt();
        centre.z > -radius && across - self.tangent_max * centre.z <= radius * secant
    }

    /// Where a landmark is in view, if it is seen from about where it was seen first.
    fn project(&self, landmark: &PlacedLandmark) -> Option<Vector2<f64>> {
        let seen = self.appearance(landmark)?;
        seen.is_within(VIEW_ANGLE_COSINE_MIN, VIEW_DISTANCE_FACTORS)
            .then_some(seen.position)
    }

    /// Where a landmark is in view, and from how different a place than when it was seen first.
    pub fn appearance(&self, landmark: &PlacedLandmark) -> Option<Appearance> {
        let point = self.camera_from_anchor * landmark.point;
        if point.z <= 0.0 {
            return None;
        }
        let position = point.xy() / point.z;
        let inside = (0..2)
            .all(|axis| position[axis] > self.lowest[axis] && position[axis] < self.highest[axis]);
        let ray = landmark.point - self.position;
        let distance = ray.norm();
        inside.then(|| Appearance {
            position,
            angle_cosine: ray.dot(&landmark.direction) / distance,
            distance_factor: distance / landmark.distance,
        })
    }
}

/// How a camera sees a landmark.
pub(super) struct Appearance {
    /// On the ideal plane.
    pub position: Vector2<f64>,
    /// Of the angle between the ray and that of the landmark's first view.
    pub angle_cosine: f64,
    /// How far the landmark is, relative to its first view.
    pub distance_factor: f64,
}

impl Appearance {
    /// Whether it looks about as it did when it was seen first.
    ///
    /// - `distance_factors`: least and largest.
    pub fn is_within(&self, angle_cosine_min: f64, distance_factors: [f64; 2]) -> bool {
        let [nearest, farthest] = distance_factors;
        self.angle_cosine > angle_cosine_min
            && self.distance_factor > nearest
            && self.distance_factor < farthest
    }
}
