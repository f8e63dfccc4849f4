//! From one alignment per anchor to one place of the own map on the Earth.

use geometry::{Camera, Enu, Map, Matrix7, Similarity, Tangent7, Transform};

use super::landmarks::AnchorPlacement;
use super::track::State;
use super::types::{AnchorIdx, LocalizerSettings};

/// What one anchor says about where the camera is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vote {
    pub anchor: AnchorIdx,
    pub enu_from_camera: Similarity<Enu, Camera>,
    /// Over `[ω; ν; ln s]` in the camera's axes, ν in the own map's unit.
    pub covariance: Matrix7,
}

impl Vote {
    /// The anchor's alignment at the camera's pose. The error of its georeference enters here,
    /// once, as far as the way has not averaged it out, as does the part of its map's error that
    /// no number of keyframes averages out.
    pub fn new(
        anchor: AnchorIdx,
        state: &State,
        placement: &AnchorPlacement,
        map_from_camera: &Transform<Map, Camera>,
        settings: &LocalizerSettings,
    ) -> Self {
        let state = state.predicted(map_from_camera, &settings.drift);
        let camera_from_anchor = state.anchor_from_camera.inverse().adjoint();
        let georeference =
            camera_from_anchor * placement.covariance * camera_from_anchor.transpose();
        let share = state.georeference_share(settings);
        let mut covariance = state.scaled_covariance() + georeference * share;
        let floor = &settings.alignment_floor;
        for axis in 0..3 {
            covariance[(axis, axis)] += floor.rotation_rad.powi(2);
            covariance[(axis + 3, axis + 3)] += (floor.translation * state.depth).powi(2);
        }
        covariance[(6, 6)] += floor.log_scale.powi(2);
        Self {
            anchor,
            enu_from_camera: placement.enu_from_map * state.anchor_from_camera,
            covariance,
        }
    }

    fn difference(&self, other: &Self) -> Tangent7 {
        (self.enu_from_camera.inverse() * other.enu_from_camera).log()
    }

    fn agrees(&self, other: &Self, settings: &LocalizerSettings) -> bool {
        let disagreement = disagreement(
            &self.difference(other),
            &(self.covariance + other.covariance),
        );
        disagreement < settings.anchor_disagreement_max
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
    pub map_from_camera: Transform<Map, Camera>,
    pub anchors: Vec<AnchorIdx>,
    pub inconsistent_anchors: Vec<AnchorIdx>,
    pub conflict: bool,
}

/// Weighs the votes of the largest group of anchors that agree.
///
/// `trusted`: the anchors that the last estimate rested on; they win a draw, but a draw is a
/// conflict and the covariance then covers both sides.
pub(super) fn fuse(
    votes: &[Vote],
    trusted: &[AnchorIdx],
    map_from_camera: &Transform<Map, Camera>,
    settings: &LocalizerSettings,
) -> Option<Fused> {
    let group_of = |centre: &Vote| -> Vec<&Vote> {
        votes
            .iter()
            .filter(|vote| vote.agrees(centre, settings))
            .collect()
    };
    let rank = |group: &Vec<&Vote>| {
        let trusted_count = group
            .iter()
            .filter(|vote| trusted.contains(&vote.anchor))
            .count();
        (group.len(), trusted_count)
    };
    let mut best: Option<Vec<&Vote>> = None;
    for vote in votes {
        let group = group_of(vote);
        if best.as_ref().is_none_or(|best| rank(&group) > rank(best)) {
            best = Some(group);
        }
    }
    let group = best.filter(|group| !group.is_empty())?;
    let (enu_from_camera, mut covariance) = weighted_mean(&group)?;
    let outside: Vec<&Vote> = votes
        .iter()
        .filter(|vote| !group.iter().any(|one| one.anchor == vote.anchor))
        .collect();
    let conflict = outside.iter().any(|vote| {
        let rivals = group_of(vote);
        let rival_count = rivals
            .iter()
            .filter(|one| outside_contains(&outside, one))
            .count();
        rival_count >= group.len()
    });
    if conflict {
        for vote in &outside {
            let difference = (enu_from_camera.inverse() * vote.enu_from_camera).log();
            covariance += difference * difference.transpose();
        }
    }
    Some(Fused {
        enu_from_camera,
        covariance,
        map_from_camera: *map_from_camera,
        anchors: group.iter().map(|vote| vote.anchor).collect(),
        inconsistent_anchors: outside.iter().map(|vote| vote.anchor).collect(),
        conflict,
    })
}

fn outside_contains(outside: &[&Vote], vote: &Vote) -> bool {
    outside.iter().any(|one| one.anchor == vote.anchor)
}

/// The mean on Sim(3), each vote weighted by its information.
pub(super) fn weighted_mean(group: &[&Vote]) -> Option<(Similarity<Enu, Camera>, Matrix7)> {
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
