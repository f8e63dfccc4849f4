//! Without a position source: the own map is registered to what the anchors published.

use std::collections::{BTreeMap, BTreeSet};

use features::Descriptor;
use geodesy::{Datum, enu_from_enu};
use geometry::{Enu, Map, Similarity, Timestamp};
use nalgebra::Vector3;
use protocol::{Chunk, MapId, PROVENANCE_COUNT_MAX, Placement, PlacementPage, VehicleId};
use registration::localizer::{Contradiction, OwnerIdx, Reference, Refusal, Verdict};
use registration::{
    AlignmentReport, AnchorIdx, ChunkIdx, Estimate, KeyframeIdx, KeyframeObservation, Landmark,
    Localizer, LocalizerSettings, ObservedFeature, ObservedPoint,
};
use vslam::{FrameReport, Keyframe, KeyframeId, MappingReport, VslamMap};

use crate::files::StampedPose;

use super::anchor_role::AnchorRole;
use super::handover::Handover;
use super::outlet::Outlet;
use super::places::{Place, Places};
use super::sharing::Sharing;

/// The incremental alignment of the own map to the anchors' maps, by their names on the wire.
pub struct PeerRole {
    id: VehicleId,
    pub(super) localizer: Localizer,
    pub(super) handover: Handover,
    /// What others say of where their maps stand.
    bases: BTreeMap<MapId, Basis>,
    /// The own map, for others.
    pub(super) sharing: Sharing,
    circular_count: u64,
    anchors: BTreeMap<MapId, AnchorIdx>,
    /// Vehicles, numbered; the maps of one share its errors.
    owners: BTreeMap<VehicleId, OwnerIdx>,
    /// Who was left out when it was last looked at, to say it once.
    left_out: Vec<AnchorIdx>,
    /// What this vehicle's ENU is relative to: the datum of the first anchor that was placed.
    datum: Option<Datum>,
    /// The least stated sigma of a fix of any anchor (m).
    fix_sigma_m: Option<f64>,
    own_map: Option<vslam::MapId>,
    map_revision: u64,
    /// [`Keyframe::unit`] of the own keyframes when they were last looked at.
    units: BTreeMap<KeyframeId, f64>,
    last_verdict: Option<Verdict>,
    /// Why the newest single frame was not located, if one was looked at.
    pub(super) frame_verdict: Option<Verdict>,
    datum_refusal: Option<String>,
    chunk_count: usize,
}

/// What a map's place rests on, by all that was heard of it.
#[derive(Clone, Debug, Default)]
struct Basis {
    reference: protocol::Reference,
    provenance: BTreeSet<VehicleId>,
}

impl PeerRole {
    pub fn new(id: VehicleId, seed: u64, shared: AnchorRole) -> Self {
        Self {
            id,
            bases: BTreeMap::new(),
            sharing: Sharing::new(shared),
            circular_count: 0,
            localizer: Localizer::new(LocalizerSettings {
                seed,
                ..LocalizerSettings::default()
            }),
            handover: Handover::default(),
            anchors: BTreeMap::new(),
            owners: BTreeMap::new(),
            left_out: Vec::new(),
            datum: None,
            fix_sigma_m: None,
            own_map: None,
            map_revision: 0,
            units: BTreeMap::new(),
            last_verdict: None,
            frame_verdict: None,
            datum_refusal: None,
            chunk_count: 0,
        }
    }

    pub fn take_chunk(&mut self, chunk: &Chunk, page: Option<&PlacementPage>) {
        let header = chunk.header();
        let map = &chunk.id().map;
        // Of a map that rests on this one nothing is used any more, from its first word of it.
        if self.rest_on(map, header.reference, &header.provenance) == Reference::Circular {
            self.circular_count += 1;
            return;
        }
        let anchor = self.anchor_idx(map);
        let idx = ChunkIdx(u64::from(chunk.id().number.0));
        let camera = chunk.header().camera;
        let landmarks = chunk.points().map(|point| Landmark {
            covariance_in_chunk: point.covariance_in_chunk(&camera),
            point_in_chunk: point.position_in_chunk,
            descriptor: Descriptor::from_bytes(point.descriptor),
        });
        let intake = self
            .localizer
            .insert_chunk(anchor, idx, landmarks.collect());
        if intake.refused_count > 0 {
            tracing::warn!(
                "left out {} of {} points that cannot be: chunk {}",
                intake.refused_count,
                intake.refused_count + intake.accepted_count,
                chunk.id(),
            );
        }
        self.chunk_count += 1;
        let placed = page
            .into_iter()
            .flat_map(PlacementPage::placements)
            .find(|placed| placed.number == chunk.id().number);
        if let Some(placed) = placed {
            self.localizer
                .place_chunk(anchor, idx, placed.map_from_chunk);
        }
        for replaced in &chunk.header().replaces {
            let replaced = ChunkIdx(u64::from(replaced.0));
            self.localizer.remove_chunk(anchor, replaced);
        }
    }

    pub fn take_page(&mut self, page: &PlacementPage) {
        let anchor = self.anchor_idx(page.map());
        let placements = page.placements();
        let placements = placements.map(|placed| {
            let chunk = ChunkIdx(u64::from(placed.number.0));
            (chunk, placed.map_from_chunk)
        });
        self.localizer.place_chunks(anchor, placements);
        self.sharing.places_moved();
        self.report_left_out();
    }

    /// Takes where an anchor's map stands, in this vehicle's own datum.
    pub fn take_placement(&mut self, placement: &Placement) {
        let datum = self.datum.get_or_insert_with(|| placement.datum.clone());
        let own_from_theirs = match enu_from_enu(datum, &placement.datum, &[]) {
            Ok(own_from_theirs) => own_from_theirs,
            Err(error) => {
                self.datum_refusal = Some(format!("{} left out: {error}", placement.map.anchor));
                return;
            }
        };
        let (reference, provenance) = (placement.reference, &placement.provenance);
        if self.rest_on(&placement.map, reference, provenance) == Reference::Circular {
            self.circular_count += 1;
        }
        let least = self.fix_sigma_m.unwrap_or(f64::INFINITY);
        self.fix_sigma_m = Some(least.min(placement.fix_sigma_m));
        let anchor = self.anchor_idx(&placement.map);
        self.localizer.place_anchor(
            anchor,
            own_from_theirs * placement.enu_from_map,
            placement.covariance,
            u64::from(placement.revision),
        );
        self.sharing.places_moved();
        self.report_left_out();
    }

    /// Poses are in this map from now on.
    pub fn enter_map(&mut self, map_id: vslam::MapId, map: &VslamMap, outlet: &mut Outlet<'_>) {
        self.sharing.enter_map(map_id, map, outlet);
        if self.own_map.is_some_and(|known| known != map_id) {
            self.localizer.forget_map();
            self.units.clear();
            self.last_verdict = None;
        }
        self.own_map = Some(map_id);
    }

    /// Follows the own map, and registers a new keyframe, unless its frame has no pose of its own
    /// and was only followed by directions.
    pub fn follow_map(&mut self, (report, mapped): (&FrameReport, &MappingReport), map: &VslamMap) {
        let corrected = self.map_revision != mapped.map_revision;
        let new_keyframe = mapped.new_keyframe.and_then(|id| map.keyframe(id));
        if corrected || new_keyframe.is_some() {
            self.map_revision = mapped.map_revision;
            self.follow_keyframes(corrected, map);
        }
        let new_keyframe = new_keyframe.filter(|_| report.map_from_camera.is_some());
        let alignment = match new_keyframe {
            Some(keyframe) => {
                self.units.insert(keyframe.id(), keyframe.unit());
                let alignment = self.localizer.observe_keyframe(&observe(keyframe, map));
                self.last_verdict = Some(alignment.verdict);
                Some(alignment)
            }
            // A moment to spare: chunks may have come that show where earlier keyframes were.
            None => self.localizer.retry(),
        };
        if let Some(alignment) = alignment {
            self.report(&alignment);
        }
    }

    /// Tells where the keyframes are now that alignments rest on, which are never many. A loop
    /// closure changes the scale of the own map about them too.
    fn follow_keyframes(&mut self, corrected: bool, map: &VslamMap) {
        let tied = self.localizer.tied_keyframes();
        let tied: Vec<&Keyframe> = tied
            .iter()
            .filter_map(|idx| map.keyframe(KeyframeId(u32::try_from(idx.0).ok()?)))
            .collect();
        for keyframe in tied.iter().filter(|_| corrected) {
            if let Some(unit) = self.units.get(&keyframe.id()) {
                let factor = keyframe.unit() / unit;
                let idx = keyframe_idx(keyframe.id());
                self.localizer.keyframe_stretched(idx, factor);
            }
        }
        self.units = tied.iter().map(|one| (one.id(), one.unit())).collect();
        let poses = tied.iter();
        let poses = poses.map(|known| (keyframe_idx(known.id()), known.map_from_camera()));
        self.localizer.keyframes_moved(poses);
    }

    /// Says what an operator should know of an alignment.
    fn report(&mut self, alignment: &AlignmentReport) {
        if alignment.revoked {
            self.handover.doubt();
            tracing::warn!(
                "the alignment was wrong: too much of what both maps show looks different; another \
                 one is sought"
            );
        }
        if alignment.overruled {
            tracing::warn!(
                jumped = alignment.jumped,
                "the alignment was wrong: keyframes that agree put the vehicle elsewhere"
            );
        } else if alignment.jumped {
            tracing::warn!("the global pose has moved by more than its uncertainty explains");
        }
        self.report_left_out();
    }

    /// Names anchors that contradict the others, once.
    fn report_left_out(&mut self) {
        let estimate = self.localizer.estimate(Timestamp::default());
        let left_out = estimate.map_or_else(Vec::new, |estimate| estimate.left_out);
        for one in &left_out {
            if !self.left_out.contains(&one.anchor) {
                let (distance_m, turn_deg) = (one.distance_m, one.turn_rad.to_degrees());
                tracing::warn!(
                    anchor = self.names([one.anchor]),
                    "left out, since it contradicts the others: {distance_m:.2} m, \
                     {turn_deg:.1}° and a scale of {:.3} from them",
                    one.scale
                );
            }
        }
        self.left_out = left_out.iter().map(|one| one.anchor).collect();
    }

    pub(super) fn localizer(&self) -> &Localizer {
        &self.localizer
    }

    pub fn estimate(&self, now: Timestamp) -> Option<Estimate> {
        self.localizer.estimate(now)
    }

    pub fn enu_from_map(&self, now: Timestamp) -> Option<Similarity<Enu, Map>> {
        Some(self.localizer.estimate(now)?.enu_from_map)
    }

    /// Where the own map stood at each keyframe that was located.
    pub(super) fn places(&self, map: &VslamMap) -> Places {
        let keyframes = map.keyframes();
        let keyframes = keyframes.map(|one| (keyframe_idx(one.id()), one.map_from_camera()));
        let corrected = self.localizer.corrected_keyframes(&keyframes.collect());
        Places::new(corrected.into_iter().map(|one| Place {
            captured_at: one.captured_at,
            map_from_camera: one.map_from_camera,
            enu_from_map: one.enu_from_map,
            covariance: one.covariance,
            drift_per_way: one.drift_per_way,
        }))
    }

    /// Where the cameras of single frames were, by all that is known now.
    pub fn located_frames(&self) -> impl Iterator<Item = StampedPose<Enu>> {
        let frames = self.localizer.located_frames();
        frames.map(|(captured_at, target_from_camera)| StampedPose {
            captured_at,
            target_from_camera,
        })
    }

    pub fn datum(&self) -> Option<&Datum> {
        self.datum.as_ref()
    }

    pub fn fix_sigma_m(&self) -> Option<f64> {
        self.fix_sigma_m
    }

    pub fn circular_count(&self) -> u64 {
        self.circular_count
    }

    /// Takes what a map's place rests on, and says what that means here. Once any part of a map is
    /// said to be registered, all of it is.
    fn rest_on(
        &mut self,
        map: &MapId,
        reference: protocol::Reference,
        provenance: &[VehicleId],
    ) -> Reference {
        let known = self.bases.entry(map.clone()).or_default();
        if !reference.is_fixed() {
            known.reference = reference;
            // One more than can be named suffices to know that they cannot.
            let room = (PROVENANCE_COUNT_MAX + 1).saturating_sub(known.provenance.len());
            let names = provenance
                .iter()
                .filter(|name| !known.provenance.contains(*name));
            let named: Vec<VehicleId> = names.take(room).cloned().collect();
            known.provenance.extend(named);
        }
        let known = &self.bases[map];
        let is_circular = known.provenance.len() > PROVENANCE_COUNT_MAX;
        let reference = match self.reference_of(map, (known.reference, &known.provenance)) {
            // What cannot be named in full might name this vehicle.
            _ if is_circular => Reference::Circular,
            reference => reference,
        };
        let anchor = self.anchor_idx(map);
        if let Some(owner) = self.owners.get(&map.anchor) {
            self.localizer.set_reference(anchor, *owner, reference);
        }
        reference
    }

    /// What came from here, in whatever way, is no evidence here.
    fn reference_of(
        &self,
        map: &MapId,
        (reference, provenance): (protocol::Reference, &BTreeSet<VehicleId>),
    ) -> Reference {
        match reference {
            protocol::Reference::Fixed => Reference::Fixed,
            protocol::Reference::Registered
                if map.anchor == self.id || provenance.contains(&self.id) =>
            {
                Reference::Circular
            }
            protocol::Reference::Registered => Reference::Registered,
        }
    }

    /// Everybody whose evidence these maps bring, directly or through others.
    pub(super) fn provenance_of(&self, anchors: &[AnchorIdx]) -> BTreeSet<VehicleId> {
        let used = self.anchors.iter().filter(|(_, idx)| anchors.contains(idx));
        let mut named = BTreeSet::new();
        for (map, _) in used {
            named.insert(map.anchor.clone());
            let basis = self.bases.get(map);
            named.extend(basis.into_iter().flat_map(|basis| basis.provenance.clone()));
        }
        named
    }

    /// Whose maps these are, and if they are registered, whom they rest on.
    pub fn names_with_sources(&self, anchors: &[AnchorIdx]) -> String {
        let names = self.names(anchors.iter().copied());
        let used = self.anchors.iter().filter(|(_, idx)| anchors.contains(idx));
        let bases = used.filter_map(|(map, _)| self.bases.get(map));
        let sources: BTreeSet<&str> = bases
            .flat_map(|basis| basis.provenance.iter().map(VehicleId::as_str))
            .collect();
        if sources.is_empty() {
            return names;
        }
        let sources = sources.into_iter().collect::<Vec<_>>().join(", ");
        format!("{names}, itself registered ({sources})")
    }

    /// Why there is no estimate.
    pub fn reason(&self) -> String {
        if let Some(refusal) = &self.datum_refusal {
            return refusal.clone();
        }
        if self.anchors.is_empty() {
            return "no anchor heard yet".to_owned();
        }
        if self.datum.is_none() {
            return "no anchor that was heard knows where it is yet".to_owned();
        }
        if self.chunk_count == 0 {
            return "no chunk received yet".to_owned();
        }
        match self.last_verdict.or(self.frame_verdict) {
            None => "no keyframe since the chunks came".to_owned(),
            Some(Verdict::Refused(Refusal::NoLandmarks)) => "no chunk is placed yet".to_owned(),
            Some(verdict) => format!("no chunk matches: {verdict}"),
        }
    }

    /// The anchors that an estimate rests on, by name.
    pub fn names(&self, anchors: impl IntoIterator<Item = AnchorIdx>) -> String {
        let anchors: Vec<AnchorIdx> = anchors.into_iter().collect();
        let names = self.anchors.iter();
        let names = names.filter(|(_, idx)| anchors.contains(idx));
        let mut names: Vec<&str> = names.map(|(map, _)| map.anchor.as_str()).collect();
        names.dedup();
        names.join(", ")
    }

    /// The anchors that contradict an estimate, by name.
    pub fn names_of(&self, left_out: &[Contradiction]) -> String {
        self.names(left_out.iter().map(|one| one.anchor))
    }

    pub fn landmarks_in_enu(&self) -> Vec<Vector3<f64>> {
        let anchors = self.anchors.values();
        anchors
            .flat_map(|anchor| self.localizer.landmarks_in_enu(*anchor))
            .collect()
    }

    fn anchor_idx(&mut self, map: &MapId) -> AnchorIdx {
        if let Some(known) = self.anchors.get(map) {
            return *known;
        }
        let next = AnchorIdx(u32::try_from(self.anchors.len()).unwrap_or(u32::MAX));
        self.anchors.insert(map.clone(), next);
        let owner = OwnerIdx(u32::try_from(self.owners.len()).unwrap_or(u32::MAX));
        let owner = *self.owners.entry(map.anchor.clone()).or_insert(owner);
        self.localizer.set_reference(next, owner, Reference::Fixed);
        next
    }
}

pub(super) fn keyframe_idx(id: KeyframeId) -> KeyframeIdx {
    KeyframeIdx(u64::from(id.0))
}

/// What registration is told of a keyframe.
pub fn observe(keyframe: &Keyframe, map: &VslamMap) -> KeyframeObservation {
    let features = keyframe.observations().iter().map(|observation| {
        let point = observation.point.and_then(|id| map.point(id));
        let point = point.filter(|point| point.has_range());
        ObservedFeature {
            position: observation.position,
            sigma: observation.sigma,
            descriptor: observation.descriptor,
            point: point.map(|point| ObservedPoint {
                point_in_map: *point.position_in_map(),
                covariance_in_map: *point.covariance_in_map(),
            }),
        }
    });
    KeyframeObservation {
        id: keyframe_idx(keyframe.id()),
        captured_at: keyframe.captured_at(),
        map_from_camera: keyframe.map_from_camera(),
        features: features.collect(),
    }
}
