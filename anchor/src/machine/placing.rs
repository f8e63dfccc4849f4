//! Where chunks stand: one similarity for the map, and what drift bends beyond it per chunk.
//!
//! What was published stays until it is wrong by a good part of its own uncertainty. If most of
//! the map moved together, the one similarity is published again (under 1 kB); only chunks that
//! moved otherwise make their pages go out again.

use std::collections::{BTreeMap, BTreeSet};

use geodesy::Datum;
use geometry::{Camera, Chunk as ChunkFrame, Enu, Map, Similarity, umeyama};
use nalgebra::{UnitQuaternion, Vector3};
use protocol::{
    BoundingBox, ChunkNumber, ChunkPlacement, Manifest, MapId, Placement, PlacementPage, Ranges,
    Reference, VehicleId,
};
use vslam::KeyframeId;

use super::Effect;
use crate::georeference::{PlacedKeyframe, d_point_d_tangent, move_keyframes, probes};
use crate::{AnchorSettings, Georeference, KeyframePose};

/// Moves below this are never worth a message (m).
const MOVE_MIN_M: f64 = 0.002;
/// Before the map stands on the Earth: as a share of the chunk's typical depth.
const MOVE_SHARE: f64 = 0.01;
/// A change of a keyframe's unit (ln) that comes from a loop closure.
const STRETCH_MIN: f64 = 0.005;
/// The placement's stated uncertainty is published again when it changes by this factor.
const SIGMA_FACTOR: f64 = 1.15;
/// A registered map never states much less than its vehicle would of itself.
const REGISTERED_SIGMA_FACTOR: f64 = 1.02;

/// What a map's place on the Earth rests on.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Basis {
    pub reference: Reference,
    /// Empty for a map with fixes of its own.
    pub provenance: Vec<VehicleId>,
}

#[derive(Debug, Default)]
pub(super) struct Placer {
    basis: Basis,
    basis_changed: bool,
    chunks: BTreeMap<ChunkNumber, Placed>,
    origins: BTreeMap<KeyframeId, KeyframePose>,
    enu_from_map: Option<Similarity<Enu, Map>>,
    published_sigma_m: f64,
    revision: u32,
    manifest_revision: u32,
    changed_pages: BTreeSet<u32>,
    manifest_changed: bool,
}

#[derive(Debug)]
struct Placed {
    keyframe: KeyframeId,
    /// [`KeyframePose::unit`] when it was cut: its content keeps that unit.
    unit_at_cut: f64,
    typical_depth: f64,
    map_from_chunk: Similarity<Map, ChunkFrame>,
    /// The place that the fixes last gave it, kept when its keyframe leaves the window.
    enu_from_chunk: Option<Wanted>,
}

#[derive(Clone, Copy, Debug)]
struct Wanted {
    enu_from_chunk: Similarity<Enu, ChunkFrame>,
    /// Of the chunk's content (m).
    sigma_m: f64,
}

impl Placer {
    pub(super) fn new(reference: Reference) -> Self {
        let mut placer = Self::default();
        placer.basis.reference = reference;
        placer
    }

    pub(super) fn basis(&self) -> &Basis {
        &self.basis
    }

    /// Names everybody whose evidence the map's place rests on.
    pub(super) fn rest_on(&mut self, provenance: Vec<VehicleId>) {
        if self.basis.provenance != provenance {
            self.basis.provenance = provenance;
            self.basis_changed = true;
            self.manifest_changed = true;
        }
    }

    /// - `placed`: where its keyframe stands on the Earth, if that is known.
    pub(super) fn insert(
        &mut self,
        number: ChunkNumber,
        origin: KeyframePose,
        typical_depth: f64,
        placed: Option<&PlacedKeyframe>,
    ) {
        let map_from_camera: Similarity<Map, Camera> = origin.map_from_camera.into();
        self.origins.insert(origin.id, origin);
        self.changed_pages.insert(number.page());
        self.manifest_changed = true;
        let mut chunk = Placed {
            keyframe: origin.id,
            unit_at_cut: origin.unit,
            typical_depth,
            map_from_chunk: map_from_camera.relabel(),
            enu_from_chunk: None,
        };
        if let Some(placed) = placed {
            chunk.want(placed, Some(&origin));
        }
        self.chunks.insert(number, chunk);
    }

    /// Chunks that others replace stay where they are, so that holders may keep using them.
    pub(super) fn retire(&mut self, replaced: &[ChunkNumber]) {
        self.manifest_changed |= !replaced.is_empty();
    }

    /// Whether the map grew or shrank somewhere by more than adjustments do all the time.
    pub(super) fn move_keyframes(&mut self, poses: &[KeyframePose]) -> bool {
        let stretched = poses.iter().any(|pose| {
            let known = self.origins.get(&pose.id);
            known.is_some_and(|known| (pose.unit / known.unit).ln().abs() > STRETCH_MIN)
        });
        move_keyframes(&mut self.origins, poses);
        stretched
    }

    /// Whether it was said where the map stands.
    pub(super) fn is_placed(&self) -> bool {
        self.enu_from_map.is_some()
    }

    /// What is to be said after an attempt to solve; `solved` only while the map is global.
    pub(super) fn publish(
        &mut self,
        solved: Option<&Georeference>,
        map: &MapId,
        datum: Option<&Datum>,
        settings: &AnchorSettings,
    ) -> Vec<Effect> {
        let mut effects = Vec::new();
        match (solved, datum) {
            (Some(georeference), Some(datum)) => {
                self.want(georeference);
                let factor = settings.republish_sigma;
                if let Some(placement) = self.revise(georeference, map, datum, factor) {
                    effects.push(Effect::PublishPlacement(placement));
                }
            }
            _ => self.follow_origins(),
        }
        for page in std::mem::take(&mut self.changed_pages) {
            self.revision += 1;
            effects.push(Effect::PublishPage(self.page(map, page)));
        }
        if let Some(datum) = datum
            && std::mem::take(&mut self.manifest_changed)
        {
            effects.push(Effect::PublishManifest(self.manifest(map, datum)));
        }
        effects
    }

    /// Takes over where the fixes put the chunks.
    fn want(&mut self, georeference: &Georeference) {
        for chunk in self.chunks.values_mut() {
            let Some(placed) = georeference.keyframes.get(&chunk.keyframe) else {
                continue;
            };
            chunk.want(placed, self.origins.get(&chunk.keyframe));
        }
    }

    /// Corrects what is published as far as it is wrong.
    fn revise(
        &mut self,
        georeference: &Georeference,
        map: &MapId,
        datum: &Datum,
        factor: f64,
    ) -> Option<Placement> {
        let sigma_m = position_sigma_m(georeference);
        let known = self.enu_from_map;
        let mut enu_from_map = known.unwrap_or(georeference.enu_from_map);
        let wanting = self
            .chunks
            .values()
            .filter(|chunk| chunk.enu_from_chunk.is_some());
        let wrong = |similarity: &Similarity<Enu, Map>, chunk: &Placed| {
            chunk
                .error_m(similarity)
                .is_some_and(|(error_m, sigma_m)| error_m > MOVE_MIN_M.max(factor * sigma_m))
        };
        let wrong_count = wanting
            .clone()
            .filter(|chunk| wrong(&enu_from_map, chunk))
            .count();
        if known.is_some() && wrong_count * 2 > wanting.clone().count() {
            enu_from_map = self.common_fit().unwrap_or(enu_from_map);
        }
        for (number, chunk) in &mut self.chunks {
            if wrong(&enu_from_map, chunk)
                && let Some(wanted) = &chunk.enu_from_chunk
            {
                chunk.map_from_chunk = enu_from_map.inverse() * wanted.enu_from_chunk;
                self.changed_pages.insert(number.page());
            }
        }
        let ratio = sigma_m / self.published_sigma_m;
        let growth_max = match self.basis.reference {
            Reference::Fixed => SIGMA_FACTOR,
            Reference::Registered => REGISTERED_SIGMA_FACTOR,
        };
        let stated = (1.0 / SIGMA_FACTOR..growth_max).contains(&ratio);
        if known == Some(enu_from_map) && stated && !self.basis_changed {
            return None;
        }
        self.basis_changed = false;
        self.enu_from_map = Some(enu_from_map);
        self.published_sigma_m = sigma_m;
        self.manifest_changed |= known.is_none();
        self.revision += 1;
        Some(Placement {
            map: map.clone(),
            revision: self.revision,
            captured_at: georeference.newest_fix_at,
            datum: datum.clone(),
            enu_from_map,
            covariance: georeference.covariance,
            fix_sigma_m: georeference.fix_sigma_m,
            reference: self.basis.reference,
            provenance: self.basis.provenance.clone(),
            signature: Vec::new(),
        })
    }

    /// The similarity that moves what is published of the chunks nearest to where they belong.
    fn common_fit(&self) -> Option<Similarity<Enu, Map>> {
        let pairs: Vec<_> = self
            .chunks
            .values()
            .filter_map(|chunk| Some((chunk, chunk.enu_from_chunk?)))
            .flat_map(|(chunk, wanted)| {
                probes(chunk.typical_depth).map(|probe| {
                    let weight = (wanted.sigma_m + MOVE_MIN_M).powi(-2);
                    (
                        wanted.enu_from_chunk * probe,
                        chunk.map_from_chunk * probe,
                        weight,
                    )
                })
            })
            .collect();
        umeyama(pairs.iter().copied(), true).ok()
    }

    /// Without fixes, chunks follow their keyframes: a loop closure moves them.
    fn follow_origins(&mut self) {
        for (number, chunk) in &mut self.chunks {
            let Some(origin) = self.origins.get(&chunk.keyframe) else {
                continue;
            };
            if chunk.enu_from_chunk.is_some() {
                continue;
            }
            let map_from_camera: Similarity<Map, Camera> = origin.map_from_camera.into();
            let map_from_chunk = map_from_camera * chunk.camera_from_chunk(Some(origin));
            let moved = probes(chunk.typical_depth)
                .map(|probe| (chunk.map_from_chunk * probe - map_from_chunk * probe).norm())
                .into_iter()
                .fold(0.0, f64::max);
            if moved > MOVE_SHARE * chunk.typical_depth {
                chunk.map_from_chunk = map_from_chunk;
                self.changed_pages.insert(number.page());
            }
        }
    }

    fn page(&self, map: &MapId, page: u32) -> PlacementPage {
        let first = ChunkNumber(page * protocol::CHUNKS_PER_PAGE);
        let last = ChunkNumber(first.0 + (protocol::CHUNKS_PER_PAGE - 1));
        let placements: Vec<ChunkPlacement> = self
            .chunks
            .range(first..=last)
            .map(|(number, chunk)| ChunkPlacement {
                number: *number,
                map_from_chunk: chunk.map_from_chunk,
            })
            .collect();
        PlacementPage::new(map.clone(), page, self.revision, &placements)
    }

    fn manifest(&mut self, map: &MapId, datum: &Datum) -> Manifest {
        self.manifest_revision += 1;
        let chunks: Ranges = self.chunks.keys().copied().collect();
        let bounding_box = self.enu_from_map.and_then(|enu_from_map| {
            let corners = self.chunks.values().flat_map(|chunk| {
                probes(chunk.typical_depth)
                    .map(|probe| enu_from_map * (chunk.map_from_chunk * probe))
            });
            BoundingBox::around(corners)
        });
        Manifest {
            map: map.clone(),
            revision: self.manifest_revision,
            datum: datum.clone(),
            held: chunks.clone(),
            chunks,
            bounding_box,
            reference: self.basis.reference,
            provenance: self.basis.provenance.clone(),
            public_key: Vec::new(),
            signature: Vec::new(),
            holder: map.anchor.clone(),
        }
    }
}

impl Placed {
    /// Belongs where its keyframe was placed.
    fn want(&mut self, placed: &PlacedKeyframe, origin: Option<&KeyframePose>) {
        let content = Vector3::z() * self.typical_depth;
        let linear = placed.enu_from_camera.linear_matrix();
        let jacobian = d_point_d_tangent(&linear, &content);
        let spread = jacobian * placed.covariance * jacobian.transpose();
        self.enu_from_chunk = Some(Wanted {
            enu_from_chunk: placed.enu_from_camera * self.camera_from_chunk(origin),
            sigma_m: (spread.trace() / 3.0).max(0.0).sqrt(),
        });
    }

    /// The chunk's content is frozen in the unit that the map had there when it was cut; a loop
    /// closure changes that unit.
    fn camera_from_chunk(&self, origin: Option<&KeyframePose>) -> Similarity<Camera, ChunkFrame> {
        let stretch = origin.map_or(1.0, |origin| origin.unit / self.unit_at_cut);
        Similarity::new(stretch, UnitQuaternion::identity(), Vector3::zeros())
    }

    /// How far what is published of this chunk is from where it belongs, and how certain that is.
    fn error_m(&self, enu_from_map: &Similarity<Enu, Map>) -> Option<(f64, f64)> {
        let wanted = self.enu_from_chunk?;
        let published = *enu_from_map * self.map_from_chunk;
        let error_m = probes(self.typical_depth)
            .map(|probe| (published * probe - wanted.enu_from_chunk * probe).norm())
            .into_iter()
            .fold(0.0, f64::max);
        Some((error_m, wanted.sigma_m))
    }
}

/// The standard deviation of the newest keyframe's position (m).
fn position_sigma_m(georeference: &Georeference) -> f64 {
    georeference
        .keyframes
        .values()
        .next_back()
        .map_or(f64::INFINITY, |placed| {
            let scale = placed.enu_from_camera.scale();
            let block = placed.covariance.fixed_view::<3, 3>(3, 3).into_owned();
            (block.trace() / 3.0).max(0.0).sqrt() * scale
        })
}
