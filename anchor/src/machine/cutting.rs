//! Cuts keyframes into chunks: when they settle, or when others have waited long enough.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use geometry::Timestamp;
use nalgebra::Vector3;
use protocol::{
    Chunk, ChunkHeader, ChunkId, ChunkNumber, ChunkPoint, MAX_POINTS_PER_CHUNK, encode,
};
use vslam::{KeyframeId, PointId};

use super::{Anchor, Effect};
use crate::{CutSettings, KeyframeInput, KeyframePose, PointInput};

/// Chunks of one epoch; further keyframes are not cut.
const CHUNK_COUNT_MAX: u32 = 65_536;
/// Points that are known to be in a chunk; beyond, the oldest are forgotten.
const CUT_POINT_COUNT_MAX: usize = 1 << 20;
/// Keyframes that wait to be cut.
const WAITING_COUNT_MAX: usize = 256;
/// Chunks whose points are compared when their keyframe comes again.
const REMEMBERED_COUNT_MAX: usize = 512;

#[derive(Debug, Default)]
pub(super) struct Cutter {
    waiting: VecDeque<Waiting>,
    /// Points that are in a chunk already.
    cut_points: BTreeSet<PointId>,
    next_number: u32,
    remembered: BTreeMap<KeyframeId, FrozenPoints>,
}

#[derive(Debug)]
struct Waiting {
    keyframe: KeyframeId,
    inserted_at: Timestamp,
    /// When it was asked for, unless it came and could not be cut.
    requested_at: Option<Timestamp>,
}

/// What a keyframe's chunks hold, to see whether it moved since.
#[derive(Debug)]
struct FrozenPoints {
    numbers: Vec<ChunkNumber>,
    /// Position in the chunk and standard deviation of the depth.
    points: BTreeMap<PointId, (Vector3<f64>, f64)>,
}

impl Cutter {
    pub(super) fn insert(&mut self, pose: KeyframePose, now: Timestamp) {
        if self.waiting.len() == WAITING_COUNT_MAX {
            self.waiting.pop_front();
        }
        self.waiting.push_back(Waiting {
            keyframe: pose.id,
            inserted_at: now,
            requested_at: None,
        });
    }

    pub(super) fn waits_for(&self, keyframe: KeyframeId) -> bool {
        self.waiting.iter().any(|one| one.keyframe == keyframe)
    }

    /// Leaves this many of those that wait, the newest.
    pub(super) fn forget_oldest(&mut self, count_max: usize) {
        while self.waiting.len() > count_max {
            self.waiting.pop_front();
        }
    }

    /// The keyframes that have waited long enough, each named once, and again after it was put off.
    ///
    /// - `is_placed`: the others wait on, until somebody can say where they stand.
    pub(super) fn due(
        &mut self,
        now: Timestamp,
        settings: &CutSettings,
        is_placed: impl Fn(KeyframeId) -> bool,
    ) -> Vec<KeyframeId> {
        let newer_count = self.waiting.len();
        let mut due = Vec::new();
        for (idx, waiting) in self.waiting.iter_mut().enumerate() {
            let old = now - waiting.inserted_at >= settings.delay_max_s;
            let passed = newer_count - 1 - idx >= settings.keyframe_count_max;
            let is_wanted = (old || passed) && is_placed(waiting.keyframe);
            if is_wanted && waiting.requested_at.is_none() {
                waiting.requested_at = Some(now);
                due.push(waiting.keyframe);
            }
        }
        // What was asked for and never came was culled.
        self.waiting.retain(|waiting| {
            let requested_at = waiting.requested_at;
            requested_at.is_none_or(|then| now - then <= settings.delay_max_s)
        });
        due
    }

    /// A keyframe came while nobody could say where it stands: it is asked for again later.
    fn put_off(&mut self, keyframe: KeyframeId) {
        for waiting in &mut self.waiting {
            if waiting.keyframe == keyframe {
                waiting.requested_at = None;
            }
        }
    }

    fn remember(&mut self, keyframe: KeyframeId, frozen: FrozenPoints) {
        self.remembered.insert(keyframe, frozen);
        while self.remembered.len() > REMEMBERED_COUNT_MAX {
            self.remembered.pop_first();
        }
    }

    fn forget_oldest_points(&mut self) {
        while self.cut_points.len() > CUT_POINT_COUNT_MAX {
            self.cut_points.pop_first();
        }
    }
}

impl Anchor {
    pub(super) fn cut(&mut self, keyframe: &KeyframeInput, effects: &mut Vec<Effect>) {
        let id = keyframe.pose.id;
        if !self.may_cut() || !self.is_placed(id) {
            self.cutter.put_off(id);
            return;
        }
        let known = self
            .cutter
            .waiting
            .iter()
            .position(|waiting| waiting.keyframe == id);
        if let Some(idx) = known {
            self.cutter.waiting.remove(idx);
        }
        let replaced = match self.cutter.remembered.get(&id) {
            Some(frozen) if !self.moved(keyframe, frozen) => return,
            Some(frozen) => frozen.numbers.clone(),
            None if known.is_none() => return,
            None => Vec::new(),
        };
        let again: BTreeSet<PointId> = self
            .cutter
            .remembered
            .get(&id)
            .map(|frozen| frozen.points.keys().copied().collect())
            .unwrap_or_default();
        let candidates = keyframe.points.iter().filter(|point| {
            !self.cutter.cut_points.contains(&point.id) || again.contains(&point.id)
        });
        let mut chosen: Vec<(PointId, ChunkPoint)> = Vec::new();
        for point in candidates {
            match chunk_point(point, &keyframe.pose, &self.settings.cut) {
                Candidate::Good(chunk_point) => chosen.push((point.id, chunk_point)),
                Candidate::Weak => {}
                Candidate::Malformed => self.counts.points_dropped += 1,
            }
        }
        drop_depth_outliers(&mut chosen, &mut self.counts.points_dropped);
        if chosen.len() >= self.settings.cut.point_count_min {
            self.publish(keyframe, &chosen, replaced, effects);
        }
    }

    fn publish(
        &mut self,
        keyframe: &KeyframeInput,
        chosen: &[(PointId, ChunkPoint)],
        replaces: Vec<ChunkNumber>,
        effects: &mut Vec<Effect>,
    ) {
        let chunk_count = chosen.len().div_ceil(MAX_POINTS_PER_CHUNK) as u32;
        if self.cutter.next_number + chunk_count > CHUNK_COUNT_MAX {
            return;
        }
        self.counts.chunks_replaced += replaces.len() as u64;
        let header = ChunkHeader {
            id: ChunkId {
                map: self.map.clone(),
                number: ChunkNumber(self.cutter.next_number),
            },
            captured_at: keyframe.pose.captured_at,
            camera: self.settings.camera,
            replaces,
            reference: self.reference,
            provenance: self.placer.basis().provenance.clone(),
            signature: Vec::new(),
        };
        let points: Vec<ChunkPoint> = chosen.iter().map(|(_, point)| point.clone()).collect();
        let chunks = Chunk::split(&header, &points)
            .expect("malformed points were dropped and the settings' camera was checked");
        self.cutter.next_number += chunk_count;
        self.counts.chunks_cut += u64::from(chunk_count);
        let mut depths: Vec<f64> = points
            .iter()
            .map(|point| point.position_in_chunk.z)
            .collect();
        depths.sort_by(f64::total_cmp);
        let typical_depth = depths[depths.len() / 2];
        let numbers = chunks.iter().map(|chunk| chunk.id().number).collect();
        let placed = self.georeference.as_ref();
        let placed = placed.and_then(|placed| placed.keyframes.get(&keyframe.pose.id));
        for chunk in chunks {
            let number = chunk.id().number;
            self.placer
                .insert(number, keyframe.pose, typical_depth, placed);
            let bytes = encode(&chunk);
            effects.push(Effect::PublishChunk { chunk, bytes });
        }
        self.placer.retire(&header.replaces);
        let frozen = chosen
            .iter()
            .map(|(id, point)| (*id, (point.position_in_chunk, point.depth_sigma)))
            .collect();
        self.cutter
            .cut_points
            .extend(chosen.iter().map(|(id, _)| *id));
        self.cutter.forget_oldest_points();
        let points = FrozenPoints {
            numbers,
            points: frozen,
        };
        self.cutter.remember(keyframe.pose.id, points);
    }

    /// Whether the median point of a frozen chunk moved by more than it was uncertain.
    fn moved(&self, keyframe: &KeyframeInput, frozen: &FrozenPoints) -> bool {
        let camera_from_map = keyframe.pose.map_from_camera.inverse();
        let focal_length_px = f64::from(self.settings.camera.focal_length_px);
        let mut ratios: Vec<f64> = keyframe
            .points
            .iter()
            .filter_map(|point| {
                let (old, depth_sigma) = frozen.points.get(&point.id)?;
                let step = camera_from_map * point.position_in_map - old;
                let ray = old.normalize();
                let along = step.dot(&ray);
                let across = (step - ray * along).norm();
                Some((along / depth_sigma).hypot(across / (old.norm() / focal_length_px)))
            })
            .filter(|ratio| ratio.is_finite())
            .collect();
        ratios.sort_by(f64::total_cmp);
        let median = ratios.get(ratios.len() / 2);
        median.is_some_and(|median| *median > self.settings.cut.replace_sigma)
    }
}

enum Candidate {
    Good(ChunkPoint),
    /// Not yet certain enough; another keyframe may take it later.
    Weak,
    Malformed,
}

fn chunk_point(point: &PointInput, pose: &KeyframePose, settings: &CutSettings) -> Candidate {
    let camera_from_map = pose.map_from_camera.inverse();
    let position_in_chunk = camera_from_map * point.position_in_map;
    let rotation = camera_from_map.rotation_matrix();
    let covariance = rotation * point.covariance_in_map * rotation.transpose();
    let depth_sigma = covariance.m33.sqrt();
    if !Chunk::holds(&position_in_chunk) || !depth_sigma.is_finite() {
        return Candidate::Malformed;
    }
    let seen = point.view_count >= settings.view_count_min
        || point.parallax_rad >= settings.parallax_min_rad;
    if !seen || depth_sigma > settings.relative_sigma_max * position_in_chunk.z {
        return Candidate::Weak;
    }
    Candidate::Good(ChunkPoint {
        position_in_chunk,
        depth_sigma,
        descriptor: point.descriptor,
    })
}

/// Leaves out points a thousand times nearer or farther than the median: no map is that deep, and
/// the layout of chunks spans a million.
fn drop_depth_outliers(chosen: &mut Vec<(PointId, ChunkPoint)>, dropped_count: &mut u64) {
    let mut depths: Vec<f64> = chosen.iter().map(|(_, p)| p.position_in_chunk.z).collect();
    depths.sort_by(f64::total_cmp);
    let Some(median) = depths.get(depths.len() / 2).copied() else {
        return;
    };
    let before = chosen.len();
    chosen.retain(|(_, point)| {
        let ratio = point.position_in_chunk.z / median;
        (1e-3..1e3).contains(&ratio)
    });
    *dropped_count += (before - chosen.len()) as u64;
}
