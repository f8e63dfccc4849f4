//! From one alignment per anchor to one place of the own map on the Earth.
//!
//! Only maps that rest on position fixes of their own have a vote, and their owners one each.
//! Maps of vehicles that are registered themselves repeat what others said: they are used where
//! nothing better is known, alone, so that nothing is counted twice.

use geometry::{Camera, Enu, Map, Matrix7, Similarity, Tangent7, Transform};

use super::landmarks::AnchorPlacement;
use super::track::State;
use super::types::{AnchorIdx, Contradiction, LocalizerSettings, OwnerIdx, Reference};

/// What one anchor says about where the camera is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vote {
    pub anchor: AnchorIdx,
    pub owner: OwnerIdx,
    pub reference: Reference,
    pub enu_from_camera: Similarity<Enu, Camera>,
    /// Over `[ω; ν; ln s]` in the camera's axes, ν in the own map's unit.
    pub covariance: Matrix7,
}

/// Whose map says it, and what that rests on.
pub(super) type Voter = (AnchorIdx, OwnerIdx, Reference);

impl Vote {
    /// The anchor's alignment at the camera's pose. The error of its georeference enters here,
    /// once, as far as the way has not averaged it out, as does the part of its map's error that
    /// no number of keyframes averages out. What a registered map says of itself is one estimate
    /// for all of it, which no way averages out.
    pub fn new(
        (anchor, owner, reference): Voter,
        state: &State,
        placement: &AnchorPlacement,
        map_from_camera: &Transform<Map, Camera>,
        settings: &LocalizerSettings,
    ) -> Self {
        let state = state.predicted(map_from_camera, &settings.drift);
        let camera_from_anchor = state.anchor_from_camera.inverse().adjoint();
        let georeference =
            camera_from_anchor * placement.covariance * camera_from_anchor.transpose();
        let share = match reference {
            Reference::Fixed => state.georeference_share(settings),
            Reference::Registered | Reference::Circular => 1.0,
        };
        let covariance = state.scaled_covariance()
            + georeference * share
            + settings.alignment_floor.covariance(state.depth);
        Self {
            anchor,
            owner,
            reference,
            enu_from_camera: placement.enu_from_map * state.anchor_from_camera,
            covariance,
        }
    }

    fn agrees(&self, other: &Self, settings: &LocalizerSettings) -> bool {
        self.agrees_with(&other.enu_from_camera, &other.covariance, settings)
    }

    fn agrees_with(
        &self,
        enu_from_camera: &Similarity<Enu, Camera>,
        covariance: &Matrix7,
        settings: &LocalizerSettings,
    ) -> bool {
        let difference = (enu_from_camera.inverse() * self.enu_from_camera).log();
        let disagreement = disagreement(&difference, &(self.covariance + covariance));
        disagreement < settings.anchor_disagreement_max
    }

    /// Turn, way and scale from the estimate to what it says, each by itself: a covariance is read
    /// for one of them, so a way must not lean with the turn as it does in a logarithm.
    fn difference(&self, enu_from_camera: &Similarity<Enu, Camera>) -> Tangent7 {
        let between = enu_from_camera.inverse() * self.enu_from_camera;
        let (turn, way) = (between.rotation().scaled_axis(), between.translation());
        let log_scale = between.scale().ln();
        Tangent7::from_column_slice(&[turn.x, turn.y, turn.z, way.x, way.y, way.z, log_scale])
    }

    /// How far what it says is from the estimate.
    fn contradiction(&self, enu_from_camera: &Similarity<Enu, Camera>) -> Contradiction {
        let apart = self.enu_from_camera.translation() - enu_from_camera.translation();
        let (own, other) = (self.enu_from_camera.rotation(), enu_from_camera.rotation());
        Contradiction {
            anchor: self.anchor,
            distance_m: apart.norm(),
            turn_rad: own.angle_to(other),
            scale: self.enu_from_camera.scale() / enu_from_camera.scale(),
        }
    }
}

/// The squared difference against its covariance, per degree of freedom.
pub(super) fn disagreement(difference: &Tangent7, covariance: &Matrix7) -> f64 {
    match covariance.cholesky() {
        Some(cholesky) => difference.dot(&cholesky.solve(difference)) / 7.0,
        None => f64::INFINITY,
    }
}

/// The verdict over all anchors.
#[derive(Clone, Debug)]
pub(super) struct Fused {
    pub enu_from_camera: Similarity<Enu, Camera>,
    pub covariance: Matrix7,
    /// Before a conflict made it larger: by it, what the estimate does next is a jump or not.
    pub covariance_of_votes: Matrix7,
    pub map_from_camera: Transform<Map, Camera>,
    pub anchors: Vec<AnchorIdx>,
    /// The anchors that agree; with a registered map before its turn, those with fixes.
    pub trusted: Vec<AnchorIdx>,
    pub reference: Reference,
    pub left_out: Vec<Contradiction>,
    pub conflict: bool,
}

/// Weighs the votes of the largest group of anchors that agree.
///
/// `trusted`: the anchors that agreed the last time; they win a draw, but a draw is a
/// conflict and the covariance then covers both sides.
pub(super) fn fuse(
    votes: &[Vote],
    trusted: &[AnchorIdx],
    map_from_camera: &Transform<Map, Camera>,
    settings: &LocalizerSettings,
) -> Option<Fused> {
    let fixed = best_of_each_owner(votes, Reference::Fixed);
    let registered = best_of_each_owner(votes, Reference::Registered);
    let camera = map_from_camera;
    let independent = ballot(&fixed, trusted, settings);
    let Some(independent) = independent else {
        let hearsay = ballot(&registered, trusted, settings)?;
        let best = most_certain(&hearsay.group)?;
        let mean = (best.enu_from_camera, best.covariance);
        return Some(hearsay.conclude(&[best], mean, camera));
    };
    let mean = weighted_mean(&independent.group)?;
    let (enu_from_camera, covariance) = mean;
    let mut fused = independent.conclude(&independent.group, mean, camera);
    let (agreeing, contradicting): (Vec<&Vote>, Vec<&Vote>) = registered
        .into_iter()
        .partition(|vote| vote.agrees_with(&enu_from_camera, &covariance, settings));
    // Far from what the fixed maps cover, a registered one knows better by itself; it never adds.
    if let Some(best) = most_certain(&agreeing)
        && !fused.conflict
        && position_variance(&best.covariance) < position_variance(&covariance)
    {
        fused.enu_from_camera = best.enu_from_camera;
        fused.covariance = best.covariance;
        fused.covariance_of_votes = best.covariance;
        fused.anchors = vec![best.anchor];
        fused.reference = Reference::Registered;
    }
    let contradicting = contradicting.iter();
    let contradictions = contradicting.map(|vote| vote.contradiction(&fused.enu_from_camera));
    fused.left_out.extend(contradictions);
    Some(fused)
}

/// Where votes that do not contradict each other put a camera: those of maps with fixes of their
/// own together, else the most certain of the others.
pub(super) fn past_place(votes: &[Vote]) -> Option<(Similarity<Enu, Camera>, Matrix7)> {
    let fixed = best_of_each_owner(votes, Reference::Fixed);
    if !fixed.is_empty() {
        return weighted_mean(&fixed);
    }
    let best = most_certain(&best_of_each_owner(votes, Reference::Registered))?;
    Some((best.enu_from_camera, best.covariance))
}

/// The votes of a kind, of each owner the most certain: epochs of one map share their errors.
fn best_of_each_owner(votes: &[Vote], reference: Reference) -> Vec<&Vote> {
    let mut best: Vec<&Vote> = Vec::new();
    for vote in votes.iter().filter(|vote| vote.reference == reference) {
        match best.iter_mut().find(|known| known.owner == vote.owner) {
            Some(known) => {
                let variance = position_variance(&vote.covariance);
                if variance < position_variance(&known.covariance) {
                    *known = vote;
                }
            }
            None => best.push(vote),
        }
    }
    best
}

fn most_certain<'a>(votes: &[&'a Vote]) -> Option<&'a Vote> {
    let variance = |vote: &&&Vote| position_variance(&vote.covariance);
    let least = votes
        .iter()
        .min_by(|a, b| variance(a).total_cmp(&variance(b)));
    least.copied()
}

/// Of the camera's position, in the own map's unit.
fn position_variance(covariance: &Matrix7) -> f64 {
    covariance.fixed_view::<3, 3>(3, 3).trace()
}

/// Who agrees, and who does not.
struct Ballot<'a> {
    group: Vec<&'a Vote>,
    outside: Vec<&'a Vote>,
    /// As many of those outside agree with each other.
    conflict: bool,
}

/// The largest group of voters around one of them, the trusted ones before others.
fn ballot<'a>(
    votes: &[&'a Vote],
    trusted: &[AnchorIdx],
    settings: &LocalizerSettings,
) -> Option<Ballot<'a>> {
    let group_of = |centre: &Vote| -> Vec<&'a Vote> {
        let members = votes.iter().copied();
        members
            .filter(|vote| vote.agrees(centre, settings))
            .collect()
    };
    let rank = |group: &[&Vote]| {
        let known = group.iter().filter(|vote| trusted.contains(&vote.anchor));
        (group.len(), known.count())
    };
    let mut group: Vec<&Vote> = Vec::new();
    for vote in votes {
        let rival = group_of(vote);
        if rank(&rival) > rank(&group) {
            group = rival;
        }
    }
    if group.is_empty() {
        return None;
    }
    let is_inside = |vote: &Vote| group.iter().any(|one| one.anchor == vote.anchor);
    let outside: Vec<&Vote> = votes
        .iter()
        .copied()
        .filter(|one| !is_inside(one))
        .collect();
    let conflict = outside.iter().any(|vote| {
        let rivals = group_of(vote);
        rivals.iter().filter(|one| !is_inside(one)).count() >= group.len()
    });
    Some(Ballot {
        group,
        outside,
        conflict,
    })
}

impl Ballot<'_> {
    fn conclude(
        &self,
        used: &[&Vote],
        (enu_from_camera, covariance_of_votes): (Similarity<Enu, Camera>, Matrix7),
        map_from_camera: &Transform<Map, Camera>,
    ) -> Fused {
        let mut covariance = covariance_of_votes;
        if self.conflict {
            for vote in &self.outside {
                let difference = vote.difference(&enu_from_camera);
                covariance += difference * difference.transpose() + vote.covariance;
            }
        }
        let outside = self.outside.iter();
        Fused {
            enu_from_camera,
            covariance,
            covariance_of_votes,
            map_from_camera: *map_from_camera,
            anchors: used.iter().map(|vote| vote.anchor).collect(),
            trusted: self.group.iter().map(|vote| vote.anchor).collect(),
            reference: used.first().map_or(Reference::Fixed, |vote| vote.reference),
            left_out: outside
                .map(|vote| vote.contradiction(&enu_from_camera))
                .collect(),
            conflict: self.conflict,
        }
    }
}

/// The mean on Sim(3), each vote weighted by its information.
fn weighted_mean(group: &[&Vote]) -> Option<(Similarity<Enu, Camera>, Matrix7)> {
    let mut mean = group.first()?.enu_from_camera;
    let mut covariance = group.first()?.covariance;
    if group.len() == 1 {
        return Some((mean, covariance));
    }
    for _ in 0..3 {
        let mut information_sum = Matrix7::zeros();
        let mut weighted = Tangent7::zeros();
        for vote in group {
            let information = vote.covariance.cholesky()?.inverse();
            information_sum += information;
            weighted += information * (mean.inverse() * vote.enu_from_camera).log();
        }
        covariance = information_sum.cholesky()?.inverse();
        mean = mean.perturbed(&(covariance * weighted));
    }
    Some((mean, covariance))
}
