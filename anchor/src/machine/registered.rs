//! A map without fixes of its own: it stands where its vehicle found itself in the maps of others.
//!
//! It extends what those cover, and names them: whoever uses it knows that it is no evidence beside
//! theirs. It is shared only while its vehicle is global.

use geodesy::Datum;
use geometry::Timestamp;
use protocol::{Epoch, PROVENANCE_COUNT_MAX, Reference, VehicleId, VehicleState};
use vslam::KeyframeId;

use super::{Anchor, Effect};
use crate::{AnchorSettings, Georeference};

/// Keyframes from before the first registration that are cut once it is there.
const UNPLACED_COUNT_MAX: usize = 16;

/// Where a map stands by registration.
#[derive(Clone, Debug)]
pub struct Registration {
    pub datum: Datum,
    /// Of the keyframes, those that are placed anew; the others stay where they were put.
    pub georeference: Georeference,
    /// Everybody whose evidence the place rests on, directly or through others.
    pub provenance: Vec<VehicleId>,
}

impl Anchor {
    /// A vehicle without a position source that shares its map nevertheless.
    pub fn registered(settings: AnchorSettings, epoch: Epoch) -> Self {
        Self::with_reference(settings, epoch, Reference::Registered)
    }

    pub(super) fn is_fixed(&self) -> bool {
        self.reference.is_fixed()
    }

    /// An anchor's chunks may wait for their placement; those of others would only cost bandwidth.
    pub(super) fn may_cut(&self) -> bool {
        self.is_fixed() || self.state == VehicleState::Global
    }

    pub(super) fn forget_unplaced(&mut self) {
        if !self.may_cut() {
            self.cutter.forget_oldest(UNPLACED_COUNT_MAX);
        }
    }

    pub(super) fn take_registration(
        &mut self,
        registration: Option<Box<Registration>>,
        now: Timestamp,
        effects: &mut Vec<Effect>,
    ) {
        if self.is_fixed() {
            return;
        }
        let nameable = |registration: &Registration| {
            (1..=PROVENANCE_COUNT_MAX).contains(&registration.provenance.len())
        };
        let Some(registration) = registration.filter(|one| nameable(one)) else {
            // What was cut since the last placement belongs where it was known to be.
            if self.may_cut() {
                self.place(now, effects);
            }
            let reason = "not placed by registration".to_owned();
            self.enter((VehicleState::GlobalStale, reason), effects);
            return;
        };
        let Registration {
            datum,
            mut georeference,
            provenance,
        } = *registration;
        self.datum.get_or_insert(datum);
        // What the chunks were told is with them; the others have yet to hear of it.
        if let Some(before) = self.georeference.take() {
            for (id, placed) in before.keyframes {
                if !self.chunks_were_told || self.cutter.waits_for(id) {
                    georeference.keyframes.entry(id).or_insert(placed);
                }
            }
        }
        self.chunks_were_told = false;
        self.georeference = Some(georeference);
        self.placer.rest_on(provenance);
        let reason = "registration".to_owned();
        self.enter((VehicleState::Global, reason), effects);
    }

    /// Whether it is known where a keyframe stands; one with fixes is corrected later.
    pub(super) fn is_placed(&self, keyframe: KeyframeId) -> bool {
        let placed = self.georeference.as_ref();
        self.is_fixed() || placed.is_some_and(|placed| placed.keyframes.contains_key(&keyframe))
    }
}
