//! A vehicle without a position source shares its map too, as what it is: a registered one.

use std::collections::{BTreeMap, BTreeSet};

use anchor::georeference::PlacedKeyframe;
use anchor::{Georeference, Registration};
use geometry::{Matrix7, Similarity, Timestamp};
use protocol::{MapId, VehicleId};
use registration::localizer::{CorrectedKeyframe, KeyframePoses};
use registration::{Estimate, Localizer};
use vslam::{FrameReport, Keyframe, KeyframeId, MappingReport, VslamMap};

use super::anchor_role::AnchorRole;
use super::outlet::Outlet;
use super::peer_role::{PeerRole, keyframe_idx};

/// So many newest keyframes stand where the newest estimate says: chunks are cut of them, at the
/// latest ten keyframes after they came.
const RECENT_COUNT: usize = 12;

/// The own map, for others.
pub(super) struct Sharing {
    shared: AnchorRole,
    /// Everybody on whom any place of this map has ever rested. It never shrinks: what once rested
    /// on somebody is no evidence for them, even if the newest estimate does without.
    provenance: BTreeSet<VehicleId>,
    /// The position variance (m²) with which each keyframe was placed.
    variances: BTreeMap<KeyframeId, f64>,
    /// Places of others, or the own map, moved since all keyframes were placed.
    moved: bool,
    map_revision: u64,
}

impl Sharing {
    pub fn new(shared: AnchorRole) -> Self {
        Self {
            shared,
            provenance: BTreeSet::new(),
            variances: BTreeMap::new(),
            moved: false,
            map_revision: 0,
        }
    }

    /// What the own map rests on has moved.
    pub fn places_moved(&mut self) {
        self.moved = true;
    }

    pub fn enter_map(&mut self, map_id: vslam::MapId, map: &VslamMap, outlet: &mut Outlet<'_>) {
        let before = self.shared.map().clone();
        self.shared.enter_map(map_id, map, outlet);
        if *self.shared.map() != before {
            self.provenance.clear();
            self.variances.clear();
        }
    }
}

impl PeerRole {
    /// The own map under the name that others know it by.
    pub fn shared_map(&self) -> &MapId {
        self.sharing.shared.map()
    }

    /// Publishes what is new of the own map, while it is known where it stands.
    pub fn share_map(
        &mut self,
        (report, mapped): (&FrameReport, &MappingReport),
        map: &VslamMap,
        is_placed: bool,
        outlet: &mut Outlet<'_>,
    ) {
        let corrected = self.sharing.map_revision != mapped.map_revision;
        self.sharing.map_revision = mapped.map_revision;
        if corrected {
            self.sharing.moved = true;
            let shared = &mut self.sharing.shared;
            shared.correct_map(mapped.map_revision, map, outlet);
        }
        if !is_placed {
            self.sharing.shared.take_registration(None, map, outlet);
        } else if corrected || mapped.new_keyframe.is_some() {
            let registration = self.registration(map, outlet.now);
            let shared = &mut self.sharing.shared;
            shared.take_registration(registration, map, outlet);
        }
        let shared = &mut self.sharing.shared;
        shared.follow_map((report, mapped), map, outlet);
    }

    fn registration(&mut self, map: &VslamMap, now: Timestamp) -> Option<Registration> {
        let estimate = self.estimate(now)?;
        let datum = self.datum()?.clone();
        let fix_sigma_m = self.fix_sigma_m()?;
        // Places in hindsight may rest on more than the estimate of now.
        let mut anchors = self.localizer().aligned_anchors();
        anchors.extend(&estimate.anchors);
        let named = self.provenance_of(&anchors);
        self.sharing.provenance.extend(named);
        let mut keyframes = BTreeMap::new();
        if std::mem::take(&mut self.sharing.moved) {
            keyframes = placed_by_hindsight(self.localizer(), map);
        }
        let recent = map.keyframes().rev().take(RECENT_COUNT);
        keyframes.extend(recent.map(|keyframe| (keyframe.id(), placed_now(keyframe, &estimate))));
        let variances = keyframes.iter();
        let variances = variances.map(|(id, placed)| (*id, position_variance(placed)));
        self.sharing.variances.extend(variances);
        Some(Registration {
            datum,
            provenance: self.sharing.provenance.iter().cloned().collect(),
            georeference: Georeference {
                enu_from_map: estimate.enu_from_map,
                covariance: self.covariance_of_all(&estimate),
                keyframes,
                fix_sigma_m,
                outlier_count: 0,
                fix_count: 0,
                drift_factor: 1.0,
                newest_fix_at: estimate.captured_at,
            },
        })
    }

    /// The one covariance for all that is shared: as that of the newest estimate, and as large as
    /// that of the worst place that was shared.
    fn covariance_of_all(&self, estimate: &Estimate) -> Matrix7 {
        let camera = &estimate.map_from_keyframe;
        let newest = PlacedKeyframe {
            enu_from_camera: estimate.enu_from_map * Similarity::from(*camera),
            covariance: estimate.covariance_at(camera),
        };
        let worst = self.sharing.variances.values().copied();
        let worst = worst.fold(0.0, f64::max);
        estimate.covariance * (worst / position_variance(&newest)).max(1.0)
    }
}

fn placed_now(keyframe: &Keyframe, estimate: &Estimate) -> PlacedKeyframe {
    let map_from_camera = keyframe.map_from_camera();
    PlacedKeyframe {
        enu_from_camera: estimate.enu_from_map * Similarity::from(map_from_camera),
        covariance: estimate.covariance_at(&map_from_camera),
    }
}

/// Every keyframe by the nearest in time that was located.
fn placed_by_hindsight(
    localizer: &Localizer,
    map: &VslamMap,
) -> BTreeMap<KeyframeId, PlacedKeyframe> {
    let poses: KeyframePoses = map
        .keyframes()
        .map(|one| (keyframe_idx(one.id()), one.map_from_camera()))
        .collect();
    let located = localizer.placed_keyframes(&poses);
    let nearest = |at: Timestamp| -> Option<&CorrectedKeyframe> {
        let later = located.partition_point(|one| one.captured_at <= at);
        let around = [later.checked_sub(1), Some(later)];
        let around = around
            .into_iter()
            .flatten()
            .filter_map(|idx| located.get(idx));
        around.min_by(|a, b| {
            let apart_s = |one: &CorrectedKeyframe| (one.captured_at - at).abs();
            apart_s(a).total_cmp(&apart_s(b))
        })
    };
    let placed = map.keyframes().filter_map(|keyframe| {
        let by = nearest(keyframe.captured_at())?;
        let map_from_camera = keyframe.map_from_camera();
        let way = by.map_from_camera.inverse() * map_from_camera;
        let adjoint = Similarity::from(way.inverse()).adjoint();
        let placed = PlacedKeyframe {
            enu_from_camera: by.enu_from_map * Similarity::from(map_from_camera),
            covariance: adjoint * by.covariance * adjoint.transpose()
                + by.drift_per_way * way.translation().norm(),
        };
        Some((keyframe.id(), placed))
    });
    placed.collect()
}

/// Of the camera (m²), over three axes.
fn position_variance(placed: &PlacedKeyframe) -> f64 {
    let scale = placed.enu_from_camera.scale();
    placed.covariance.fixed_view::<3, 3>(3, 3).trace() * scale * scale
}
