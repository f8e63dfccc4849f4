//! What the anchors have published: chunks of landmarks, and where they stand.

use std::collections::BTreeMap;

use features::Descriptor;
use geometry::{Chunk, Enu, Map, Matrix7, Similarity};
use nalgebra::{Matrix3, Vector3};

use super::chunk_grid::ChunkGrid;
use super::types::{ChunkIdx, ChunkIntake, Landmark};

/// An anchor's map, apart from the own one.
pub(super) enum AnchorMap {}

/// Landmarks in one chunk, and chunks of one anchor, at most; what is beyond is refused.
const LANDMARKS_PER_CHUNK_MAX: usize = 4096;
const CHUNKS_PER_ANCHOR_MAX: usize = 16_384;
/// Lengths in a chunk are of the order of its scene; beyond this they are not believed.
const LENGTH_LIMIT: f64 = 1e6;
/// A landmark is found again from so many times nearer or farther at most: the range of the image
/// pyramid.
pub(super) const DISTANCE_FACTOR_MAX: f64 = 5.0;

/// A landmark in its anchor's map.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlacedLandmark {
    pub point: Vector3<f64>,
    pub covariance: Matrix3<f64>,
    /// The unit vector from the camera that saw it first to the landmark.
    pub direction: Vector3<f64>,
    /// How far that camera was.
    pub distance: f64,
    pub descriptor: Descriptor,
}

pub(super) struct StoredChunk {
    landmarks: Vec<Landmark>,
    map_from_chunk: Option<Similarity<AnchorMap, Chunk>>,
    placed: Vec<PlacedLandmark>,
    centre: Vector3<f64>,
    radius: f64,
    /// A camera farther from the centre finds none of the landmarks.
    reach: f64,
}

impl StoredChunk {
    /// The landmarks in the anchor's map; empty until the chunk is placed.
    pub fn placed(&self) -> &[PlacedLandmark] {
        &self.placed
    }

    /// Centre and radius of a sphere around all landmarks.
    pub fn bounds(&self) -> (Vector3<f64>, f64) {
        (self.centre, self.radius)
    }

    fn place(&mut self) {
        let Some(map_from_chunk) = self.map_from_chunk else {
            return;
        };
        let linear = map_from_chunk.linear_matrix();
        self.placed.clear();
        self.placed.extend(self.landmarks.iter().map(|landmark| {
            let distance_in_chunk = landmark.point_in_chunk.norm();
            PlacedLandmark {
                point: map_from_chunk * landmark.point_in_chunk,
                covariance: linear * landmark.covariance_in_chunk * linear.transpose(),
                direction: map_from_chunk.rotation() * landmark.point_in_chunk / distance_in_chunk,
                distance: distance_in_chunk * map_from_chunk.scale(),
                descriptor: landmark.descriptor,
            }
        }));
        let count = self.placed.len().max(1) as f64;
        self.centre = self
            .placed
            .iter()
            .map(|one| one.point)
            .sum::<Vector3<f64>>()
            / count;
        let distances = self
            .placed
            .iter()
            .map(|one| (one.point - self.centre).norm());
        self.radius = distances.fold(0.0, f64::max);
        let reaches = self
            .placed
            .iter()
            .map(|one| (one.point - self.centre).norm() + DISTANCE_FACTOR_MAX * one.distance);
        self.reach = reaches.fold(0.0, f64::max);
    }
}

/// Where an anchor's map stands on the Earth.
#[derive(Clone, Copy, Debug)]
pub(super) struct AnchorPlacement {
    pub enu_from_map: Similarity<Enu, AnchorMap>,
    pub covariance: Matrix7,
    pub revision: u64,
}

/// All that is known of one anchor's map.
#[derive(Default)]
pub(super) struct AnchorLandmarks {
    chunks: BTreeMap<ChunkIdx, StoredChunk>,
    /// Placements of chunks that have not come yet.
    early_placements: BTreeMap<ChunkIdx, Similarity<AnchorMap, Chunk>>,
    /// Where removed chunks stood: what was located relative to them stays true.
    last_placements: BTreeMap<ChunkIdx, Similarity<AnchorMap, Chunk>>,
    placement: Option<AnchorPlacement>,
    /// The placed chunks by where they can be seen from.
    grid: ChunkGrid,
    placed_count: usize,
    landmark_count: usize,
}

impl AnchorLandmarks {
    pub fn insert_chunk(&mut self, chunk: ChunkIdx, mut landmarks: Vec<Landmark>) -> ChunkIntake {
        let offered_count = landmarks.len();
        landmarks.retain(is_believable);
        landmarks.truncate(LANDMARKS_PER_CHUNK_MAX);
        let full = self.chunks.len() >= CHUNKS_PER_ANCHOR_MAX && !self.chunks.contains_key(&chunk);
        if landmarks.is_empty() || full {
            return ChunkIntake {
                accepted_count: 0,
                refused_count: offered_count,
            };
        }
        let accepted_count = landmarks.len();
        let replaced = self.take_out(chunk);
        let known_placement = replaced.and_then(|replaced| replaced.map_from_chunk);
        let mut stored = StoredChunk {
            landmarks,
            map_from_chunk: self.early_placements.remove(&chunk).or(known_placement),
            placed: Vec::new(),
            centre: Vector3::zeros(),
            radius: 0.0,
            reach: 0.0,
        };
        stored.place();
        self.put_in(chunk, stored);
        ChunkIntake {
            accepted_count,
            refused_count: offered_count - accepted_count,
        }
    }

    /// Whether the placement was believable.
    pub fn place_chunk(
        &mut self,
        chunk: ChunkIdx,
        map_from_chunk: &Similarity<Map, Chunk>,
    ) -> bool {
        if !is_finite(map_from_chunk) {
            return false;
        }
        match self.take_out(chunk) {
            Some(mut stored) => {
                stored.map_from_chunk = Some(map_from_chunk.relabel());
                stored.place();
                self.put_in(chunk, stored);
            }
            None if self.early_placements.len() < CHUNKS_PER_ANCHOR_MAX => {
                self.early_placements
                    .insert(chunk, map_from_chunk.relabel());
            }
            None => return false,
        }
        true
    }

    /// Whether the placement was believable and not older than the known one.
    pub fn place(&mut self, placement: AnchorPlacement) -> bool {
        let covariance = &placement.covariance;
        let believable = is_finite(&placement.enu_from_map)
            && covariance
                .iter()
                .all(|entry| entry.abs() < LENGTH_LIMIT * LENGTH_LIMIT)
            && (covariance - covariance.transpose()).norm() <= 1e-6 * covariance.norm()
            && covariance.symmetric_eigenvalues().min() >= -1e-9 * covariance.norm();
        let newer = self
            .placement
            .is_none_or(|known| known.revision <= placement.revision);
        if believable && newer {
            self.placement = Some(placement);
        }
        believable
    }

    pub fn remove_chunk(&mut self, chunk: ChunkIdx) {
        let removed = self.take_out(chunk);
        if let Some(placement) = removed.and_then(|removed| removed.map_from_chunk) {
            self.last_placements.insert(chunk, placement);
            while self.last_placements.len() > CHUNKS_PER_ANCHOR_MAX {
                self.last_placements.pop_first();
            }
        }
        self.early_placements.remove(&chunk);
    }

    pub fn placement(&self) -> Option<&AnchorPlacement> {
        self.placement.as_ref()
    }

    /// Where a stored chunk stands.
    pub fn placed(&self, chunk: ChunkIdx) -> Option<&Similarity<AnchorMap, Chunk>> {
        self.chunks.get(&chunk)?.map_from_chunk.as_ref()
    }

    /// Where a chunk stands, or stood when it was removed.
    pub fn map_from_chunk(&self, chunk: ChunkIdx) -> Option<&Similarity<AnchorMap, Chunk>> {
        self.placed(chunk)
            .or_else(|| self.last_placements.get(&chunk))
    }

    /// All chunks that are placed, in order.
    pub fn placed_chunks(&self) -> impl Iterator<Item = (ChunkIdx, &StoredChunk)> {
        let chunks = self.chunks.iter().map(|(idx, chunk)| (*idx, chunk));
        chunks.filter(|(_, chunk)| !chunk.placed.is_empty())
    }

    /// The same from a number on, and then from the first.
    pub fn placed_chunks_from(
        &self,
        first: ChunkIdx,
    ) -> impl Iterator<Item = (ChunkIdx, &StoredChunk)> {
        let chunks = self.chunks.range(first..).chain(self.chunks.range(..first));
        let chunks = chunks.map(|(idx, chunk)| (*idx, chunk));
        chunks.filter(|(_, chunk)| !chunk.placed.is_empty())
    }

    /// The placed chunks that a camera at a place may see something of, in order; beyond so many
    /// landmarks the newest.
    pub fn chunks_near(
        &self,
        place: &Vector3<f64>,
        landmark_count_max: usize,
    ) -> Vec<(ChunkIdx, &StoredChunk)> {
        let mut near = self.grid.near(place);
        near.sort_unstable_by(|a, b| b.cmp(a));
        let stored = near
            .into_iter()
            .filter_map(|idx| Some((idx, self.chunks.get(&idx)?)));
        let within_reach = stored.filter(|(_, chunk)| (place - chunk.centre).norm() <= chunk.reach);
        let mut landmark_count = 0;
        let mut chosen: Vec<_> = within_reach
            .take_while(|(_, chunk)| {
                landmark_count += chunk.placed.len();
                landmark_count <= landmark_count_max
            })
            .collect();
        chosen.reverse();
        chosen
    }

    pub fn placed_count(&self) -> usize {
        self.placed_count
    }

    /// Landmarks of placed chunks.
    pub fn landmark_count(&self) -> usize {
        self.landmark_count
    }

    fn put_in(&mut self, idx: ChunkIdx, chunk: StoredChunk) {
        if !chunk.placed.is_empty() {
            self.grid.insert(idx, &chunk.centre, chunk.reach);
            self.placed_count += 1;
            self.landmark_count += chunk.placed.len();
        }
        self.chunks.insert(idx, chunk);
    }

    fn take_out(&mut self, idx: ChunkIdx) -> Option<StoredChunk> {
        let chunk = self.chunks.remove(&idx)?;
        if !chunk.placed.is_empty() {
            self.grid.remove(idx, &chunk.centre, chunk.reach);
            self.placed_count -= 1;
            self.landmark_count -= chunk.placed.len();
        }
        Some(chunk)
    }
}

fn is_believable(landmark: &Landmark) -> bool {
    let distance = landmark.point_in_chunk.norm();
    let covariance = &landmark.covariance_in_chunk;
    let limit = LENGTH_LIMIT * LENGTH_LIMIT;
    distance > 1.0 / LENGTH_LIMIT
        && distance < LENGTH_LIMIT
        && covariance.iter().all(|entry| entry.abs() < limit)
        && (0..3).all(|axis| covariance[(axis, axis)] >= 0.0)
}

fn is_finite<Target, Source>(similarity: &Similarity<Target, Source>) -> bool {
    let scale = similarity.scale();
    let translation = similarity.translation();
    scale > 1.0 / LENGTH_LIMIT
        && scale < LENGTH_LIMIT
        && similarity
            .rotation()
            .coords
            .iter()
            .all(|entry| entry.is_finite())
        && translation.iter().all(|entry| entry.abs() < 1e9)
}
