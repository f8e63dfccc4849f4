//! The own map against one anchor's map, over the recent keyframes.
//!
//! A Kalman filter on Sim(3) whose state is `anchor_from_camera` with the own map's unit in the
//! camera, perturbed on the right. Drift of either map is process noise that grows with the
//! distance travelled, in units of the scene's depth, because neither map knows metres.
//! The filter runs anew over the window whenever a placement or an own keyframe has moved.

mod admission;

use std::collections::VecDeque;

use geometry::{Camera, Map, Matrix7, Similarity, Tangent7, Timestamp, Transform, so3};
use nalgebra::{SMatrix, Vector3};

pub(super) use admission::Admission;
use admission::{doubt, has_majority};

use super::landmarks::{AnchorLandmarks, AnchorMap};
use super::locate::Located;
use super::matching::FeatureIndex;
use super::testimony::{self, Statement, Testimony};
use super::types::{ChunkIdx, DriftRates, KeyframeIdx, KeyframeObservation, LocalizerSettings};
use crate::likeness::Likeness;

/// A keyframe that was located.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub keyframe: KeyframeIdx,
    pub captured_at: Timestamp,
    pub map_from_camera: Transform<Map, Camera>,
    pub located: Located,
    /// Only while the entry waits, or the track is on probation.
    pub testimony: Option<Testimony>,
}

/// The alignment at one pose of the camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct State {
    pub anchor_from_camera: Similarity<AnchorMap, Camera>,
    /// Over `[ω; ν; ln s]` in the camera's axes, ν in the own map's unit.
    pub covariance: Matrix7,
    pub map_from_camera: Transform<Map, Camera>,
    /// Of the scene, in the own map's unit.
    pub depth: f64,
    /// What the innovations say about the assumed noise: variance relative to it.
    pub noise_factor: f64,
    /// How far the camera came over the keyframes behind this, in depths of the scene.
    pub way_depths: f64,
}

/// The variance that drift adds on the way between two poses of the own map.
///
/// A camera that mistakes a turn for a shift keeps what it looks at in place, so the turn is about
/// the scene ahead, `ν = ν_scene − ω × p`; a change of scale is about the camera.
pub(super) fn drift_covariance(rates: &DriftRates, depth: f64, travelled: f64) -> Matrix7 {
    let share = travelled / depth;
    let mut diagonal = Tangent7::zeros();
    diagonal
        .fixed_rows_mut::<3>(0)
        .fill(rates.rotation_rad.powi(2) * share);
    diagonal
        .fixed_rows_mut::<3>(3)
        .fill((rates.translation * depth).powi(2) * share);
    diagonal[6] = rates.log_scale.powi(2) * share;
    let mut camera_from_scene = Matrix7::identity();
    camera_from_scene
        .fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&so3::hat(&(Vector3::z() * depth)));
    camera_from_scene * Matrix7::from_diagonal(&diagonal) * camera_from_scene.transpose()
}

impl State {
    /// The alignment at another pose, less certain by the drift on the way.
    pub fn predicted(&self, map_from_camera: &Transform<Map, Camera>, rates: &DriftRates) -> Self {
        let old_from_new = self.map_from_camera.inverse() * *map_from_camera;
        let adjoint = Similarity::from(old_from_new.inverse()).adjoint();
        let travelled = old_from_new.translation().norm();
        let drift = drift_covariance(rates, self.depth, travelled);
        Self {
            anchor_from_camera: self.anchor_from_camera * old_from_new,
            covariance: adjoint * self.covariance * adjoint.transpose() + drift,
            map_from_camera: *map_from_camera,
            ..*self
        }
    }

    /// The share of the variance of a chunk's georeference that remains: chunks far apart along
    /// the way err apart, and the keyframes behind this average them.
    pub fn georeference_share(&self, settings: &LocalizerSettings) -> f64 {
        let averaged = 1.0 / (1.0 + self.way_depths / settings.georeference_correlation_depths);
        averaged.max(settings.georeference_share_min)
    }

    /// The covariance in which differences from what is measured are judged.
    pub fn scaled_covariance(&self) -> Matrix7 {
        self.covariance * self.noise_factor
    }
}

/// What an entry says, in the anchor's map as it is placed now.
struct Measurement {
    anchor_from_camera: Similarity<AnchorMap, Camera>,
    covariance: Matrix7,
    depth: f64,
    scale_known: bool,
}

impl Measurement {
    /// `None` if the chunk is no longer there. An unknown scale is taken from `scale_guess`.
    fn new(
        entry: &Entry,
        anchor: &AnchorLandmarks,
        settings: &LocalizerSettings,
        scale_guess: f64,
    ) -> Option<Self> {
        let located = &entry.located;
        let map_from_chunk = anchor.map_from_chunk(located.chunk)?;
        let mut anchor_from_camera = *map_from_chunk * located.chunk_from_camera;
        if !located.scale_known {
            anchor_from_camera = Similarity::new(
                scale_guess,
                *anchor_from_camera.rotation(),
                *anchor_from_camera.translation(),
            );
        }
        let chunk_unit_in_map = map_from_chunk.scale() / anchor_from_camera.scale();
        let depth = located.depth * chunk_unit_in_map;
        let mut unit = Tangent7::repeat(1.0);
        unit.fixed_rows_mut::<3>(3).fill(chunk_unit_in_map);
        let mut covariance = located.covariance.component_mul(&(unit * unit.transpose()));
        covariance += settings.keyframe_floor.covariance(depth);
        Some(Self {
            anchor_from_camera,
            covariance,
            depth,
            scale_known: located.scale_known,
        })
    }

    /// The difference from a predicted state, as a tangent at that state.
    fn innovation(&self, state: &State) -> Tangent7 {
        (state.anchor_from_camera.inverse() * self.anchor_from_camera).log()
    }

    /// The innovation squared against both covariances, per degree of freedom.
    fn disagreement(&self, state: &State) -> f64 {
        let innovation = self.innovation(state);
        let covariance = state.scaled_covariance() + self.covariance;
        if self.scale_known {
            squared_norm::<7>(&innovation, &covariance)
        } else {
            squared_norm::<6>(&innovation, &covariance)
        }
    }
}

fn squared_norm<const ROWS: usize>(innovation: &Tangent7, covariance: &Matrix7) -> f64 {
    let innovation = innovation.fixed_rows::<ROWS>(0).into_owned();
    let covariance = covariance.fixed_view::<ROWS, ROWS>(0, 0).into_owned();
    match covariance.cholesky() {
        Some(cholesky) => innovation.dot(&cholesky.solve(&innovation)) / ROWS as f64,
        None => f64::INFINITY,
    }
}

fn updated<const ROWS: usize>(
    state: &State,
    measurement: &Measurement,
    noise_factor: f64,
) -> Option<State> {
    let mut observe = SMatrix::<f64, ROWS, 7>::zeros();
    observe.fill_diagonal(1.0);
    let noise = measurement.covariance.fixed_view::<ROWS, ROWS>(0, 0) * noise_factor;
    let innovation_covariance = observe * state.covariance * observe.transpose() + noise;
    let inverse = innovation_covariance.cholesky()?.inverse();
    let gain = state.covariance * observe.transpose() * inverse;
    let innovation = measurement
        .innovation(state)
        .fixed_rows::<ROWS>(0)
        .into_owned();
    let rest = Matrix7::identity() - gain * observe;
    let covariance = rest * state.covariance * rest.transpose() + gain * noise * gain.transpose();
    Some(State {
        anchor_from_camera: state.anchor_from_camera.perturbed(&(gain * innovation)),
        covariance: (covariance + covariance.transpose()) * 0.5,
        ..*state
    })
}

/// One step of the filter.
pub(super) struct Step {
    pub predicted: State,
    pub updated: State,
    /// Squared, per degree of freedom.
    pub disagreement: f64,
}

impl Step {
    /// `None` if the entry's chunk is no longer known.
    pub fn new(
        before: &State,
        entry: &Entry,
        anchor: &AnchorLandmarks,
        settings: &LocalizerSettings,
    ) -> Option<Self> {
        let scale_guess = before.anchor_from_camera.scale();
        let measurement = Measurement::new(entry, anchor, settings, scale_guess)?;
        let travelled =
            (entry.map_from_camera.translation() - before.map_from_camera.translation()).norm();
        let mut predicted = before.predicted(&entry.map_from_camera, &settings.drift);
        predicted.depth = measurement.depth;
        predicted.way_depths += travelled / measurement.depth;
        let disagreement = measurement.disagreement(&predicted);
        // Keyframes from nearly the same place see the same landmarks with the same errors: they
        // count as one only after a way of `correlation_depths`.
        let repeats = settings.correlation_depths * measurement.depth / travelled.max(1e-9);
        let noise_factor = repeats.clamp(1.0, 30.0) * disagreement.max(1.0);
        let updated = if measurement.scale_known {
            updated::<7>(&predicted, &measurement, noise_factor)
        } else {
            updated::<6>(&predicted, &measurement, noise_factor)
        };
        Some(Self {
            predicted,
            updated: updated.unwrap_or(predicted),
            disagreement,
        })
    }
}

/// The state after the first entry; `None` if it gives no scale, or its chunk is gone.
pub(super) fn first_state(
    entry: &Entry,
    anchor: &AnchorLandmarks,
    settings: &LocalizerSettings,
) -> Option<State> {
    let measurement = Measurement::new(entry, anchor, settings, 1.0)?;
    measurement.scale_known.then_some(State {
        anchor_from_camera: measurement.anchor_from_camera,
        covariance: measurement.covariance,
        map_from_camera: entry.map_from_camera,
        depth: measurement.depth,
        noise_factor: 1.0,
        way_depths: 0.0,
    })
}

/// Runs the filter over the entries in order; `None` if none of them gives a scale.
pub(super) fn filter<'a>(
    entries: impl Iterator<Item = &'a Entry>,
    anchor: &AnchorLandmarks,
    settings: &LocalizerSettings,
) -> Option<State> {
    let mut state: Option<State> = None;
    let mut disagreement_sum = 0.0;
    let mut disagreement_count = 0.0;
    for entry in entries {
        let Some(before) = &state else {
            state = first_state(entry, anchor, settings);
            continue;
        };
        let Some(step) = Step::new(before, entry, anchor, settings) else {
            continue;
        };
        disagreement_sum += step.disagreement.min(settings.disagreement_max);
        disagreement_count += 1.0;
        state = Some(step.updated);
    }
    let mut state = state?;
    // A few pretended innovations of the expected size keep the factor calm at the start.
    state.noise_factor = ((disagreement_sum + 4.0) / (disagreement_count + 4.0)).clamp(0.5, 5.0);
    Some(state)
}

/// The keyframes that agree on an alignment, and those that wait for company.
#[derive(Default)]
pub(super) struct Track {
    entries: VecDeque<Entry>,
    /// Entries that left the window, for the trajectory after all corrections.
    past: VecDeque<Entry>,
    waiting: VecDeque<Entry>,
    state: Option<State>,
    /// What keyframes said of the place when they last would have founded the track, or since.
    pub likeness: Option<Likeness>,
    /// Keyframes in a row that were not located or did not agree.
    pub miss_count: usize,
}

/// Entries that wait at most; the oldest goes first.
const WAITING_MAX: usize = 12;
/// Entries over which a new track is tested on.
const PROBATION_COUNT: usize = 12;
/// Entries that are remembered beyond the window: half an hour at one a second.
const PAST_MAX: usize = 2000;

impl Track {
    pub fn state(&self) -> Option<&State> {
        self.state.as_ref()
    }

    /// Whether an entry is kept relative to this chunk.
    pub fn rests_on(&self, chunk: ChunkIdx) -> bool {
        self.entries
            .iter()
            .any(|entry| entry.located.chunk == chunk)
    }

    /// All that agreed, the oldest first, as far as it is remembered.
    pub fn history(&self) -> impl Iterator<Item = &Entry> {
        self.past.iter().chain(&self.entries)
    }

    pub fn newest(&self) -> Option<&Entry> {
        self.entries.back()
    }

    /// Whether this keyframe agreed, as far as it is remembered.
    pub fn holds(&self, keyframe: KeyframeIdx) -> bool {
        self.history().any(|entry| entry.keyframe == keyframe)
    }

    /// The keyframes that it rests on, and those that wait.
    pub fn keyframes(&self) -> impl Iterator<Item = KeyframeIdx> {
        let entries = self.entries.iter().chain(&self.waiting);
        entries.map(|entry| entry.keyframe)
    }

    pub fn admit(
        &mut self,
        mut entry: Entry,
        (keyframe, features): (&KeyframeObservation, &FeatureIndex),
        anchor: &AnchorLandmarks,
        settings: &LocalizerSettings,
    ) -> Admission {
        self.waiting
            .retain(|known| known.keyframe != entry.keyframe);
        let agrees = self.agrees(&entry, anchor, settings);
        let on_probation = agrees && self.entries.len() < PROBATION_COUNT && self.past.is_empty();
        if on_probation || !agrees {
            let pose = entry.camera_from_anchor(anchor);
            entry.testimony =
                pose.map(|pose| Testimony::of((keyframe, features), anchor, &pose, settings));
        }
        if agrees {
            insert(&mut self.entries, entry);
            self.waiting.clear();
            self.miss_count = 0;
            self.keep_window(settings);
            self.refresh(anchor, settings);
            if on_probation {
                return self.test(anchor, settings);
            }
            return Admission::Agrees;
        }
        self.miss_count += 1;
        self.waiting.push_back(entry);
        if self.waiting.len() > WAITING_MAX {
            self.waiting.pop_front();
        }
        self.count_votes(anchor, settings)
    }

    fn agrees(
        &self,
        entry: &Entry,
        anchor: &AnchorLandmarks,
        settings: &LocalizerSettings,
    ) -> bool {
        let Some(state) = &self.state else {
            return false;
        };
        let predicted = state.predicted(&entry.map_from_camera, &settings.drift);
        let scale = predicted.anchor_from_camera.scale();
        let measurement = Measurement::new(entry, anchor, settings, scale);
        measurement.is_some_and(|measurement| {
            measurement.disagreement(&predicted) < settings.disagreement_max
        })
    }

    fn keep_window(&mut self, settings: &LocalizerSettings) {
        while self.entries.len() > settings.window_keyframe_count
            && let Some(mut oldest) = self.entries.pop_front()
        {
            oldest.testimony = None;
            insert(&mut self.past, oldest);
        }
        while self.past.len() > PAST_MAX {
            self.past.pop_front();
        }
    }

    /// Gives the track up if what its keyframes show contradicts it; its keyframes wait on, so
    /// that all of them must be outvoted before the same is believed again.
    fn test(&mut self, anchor: &AnchorLandmarks, settings: &LocalizerSettings) -> Admission {
        let Some(state) = &self.state else {
            return Admission::Agrees;
        };
        let likeness = weigh(&self.entries, state, anchor, settings);
        self.likeness = Some(likeness);
        if likeness.falls_short_of(settings.agreement_extent_min) {
            self.waiting = std::mem::take(&mut self.entries);
            while self.waiting.len() > WAITING_MAX {
                self.waiting.pop_front();
            }
            self.past.clear();
            self.state = None;
            return Admission::Revokes;
        }
        if self.entries.len() >= PROBATION_COUNT {
            for entry in &mut self.entries {
                entry.testimony = None;
            }
        }
        Admission::Agrees
    }

    /// Whether the newest waiting entry has enough company to found a new track.
    fn count_votes(&mut self, anchor: &AnchorLandmarks, settings: &LocalizerSettings) -> Admission {
        let Some(newest) = self.waiting.back() else {
            return Admission::Waits;
        };
        let mut agreeing: Vec<Entry> = self
            .waiting
            .iter()
            .filter(|entry| {
                entry.keyframe == newest.keyframe || agree(entry, newest, anchor, settings)
            })
            .cloned()
            .collect();
        agreeing.sort_by_key(|entry| entry.captured_at);
        let inlier_count: usize = agreeing
            .iter()
            .map(|entry| entry.located.inlier_count)
            .sum();
        let required = match self.state {
            Some(_) => settings.switch_keyframe_count,
            None => settings.first_keyframe_count,
        };
        let spread = agreeing.iter().any(|entry| {
            let apart = entry.map_from_camera.translation() - newest.map_from_camera.translation();
            apart.norm() > 0.0
        });
        let is_for = |entry: &Entry| agreeing.iter().any(|one| one.keyframe == entry.keyframe);
        let outvoted = !has_majority(self.waiting.iter().map(is_for));
        let too_few = agreeing.len() < required || inlier_count < settings.first_inlier_count;
        if too_few || outvoted || !spread {
            return Admission::Waits;
        }
        let Some(founded) = filter(agreeing.iter(), anchor, settings) else {
            return Admission::Waits;
        };
        let likeness = weigh(&agreeing, &founded, anchor, settings);
        self.likeness = Some(likeness);
        if let Some(doubt) = doubt(&likeness, settings.agreement_extent_min) {
            return doubt;
        }
        self.entries = agreeing.into();
        self.past.clear();
        self.waiting.clear();
        self.state = Some(founded);
        self.miss_count = 0;
        Admission::Founds
    }

    /// Runs the filter anew, after entries or placements have changed.
    pub fn refresh(&mut self, anchor: &AnchorLandmarks, settings: &LocalizerSettings) {
        self.state = filter(self.entries.iter(), anchor, settings);
    }

    pub fn stretch_keyframe(&mut self, keyframe: KeyframeIdx, factor: f64) {
        for entry in self.entries.iter_mut().chain(&mut self.waiting) {
            if entry.keyframe == keyframe {
                entry.stretch(factor);
            }
        }
    }

    /// Whether the keyframe is part of the track and has moved.
    pub fn move_keyframe(
        &mut self,
        keyframe: KeyframeIdx,
        map_from_camera: &Transform<Map, Camera>,
    ) -> bool {
        let mut found = false;
        for entry in self.entries.iter_mut().chain(&mut self.waiting) {
            if entry.keyframe == keyframe && entry.map_from_camera != *map_from_camera {
                entry.map_from_camera = *map_from_camera;
                found = true;
            }
        }
        found
    }
}

/// Entries are in the order of time, also those of keyframes that were located late.
fn insert(entries: &mut VecDeque<Entry>, entry: Entry) {
    let place = entries.partition_point(|known| known.captured_at <= entry.captured_at);
    entries.insert(place, entry);
}

impl Entry {
    fn camera_from_anchor(&self, anchor: &AnchorLandmarks) -> Option<Transform<Camera, AnchorMap>> {
        let map_from_chunk = anchor.map_from_chunk(self.located.chunk)?;
        let anchor_from_camera = *map_from_chunk * self.located.chunk_from_camera;
        Some(anchor_from_camera.rigid_part().inverse())
    }

    /// Keeps what was located, of a camera whose map is larger now by this factor.
    fn stretch(&mut self, factor: f64) {
        let old = &self.located.chunk_from_camera;
        self.located.chunk_from_camera =
            Similarity::new(old.scale() / factor, *old.rotation(), *old.translation());
        if let Some(testimony) = &mut self.testimony {
            testimony.stretch(factor);
        }
    }
}

/// What entries say together of the place, as the alignment puts them.
fn weigh<'a>(
    entries: impl IntoIterator<Item = &'a Entry>,
    state: &State,
    anchor: &AnchorLandmarks,
    settings: &LocalizerSettings,
) -> Likeness {
    let statements = entries.into_iter().filter_map(|entry| {
        let way = state.map_from_camera.inverse() * entry.map_from_camera;
        Some(Statement {
            testimony: entry.testimony.as_ref()?,
            anchor_from_camera: state.anchor_from_camera * way,
            depth: state.depth * state.anchor_from_camera.scale(),
        })
    });
    let statements: Vec<Statement> = statements.collect();
    testimony::weigh(&statements, anchor, settings)
}

/// Whether two located keyframes tell of the same alignment.
fn agree(
    first: &Entry,
    second: &Entry,
    anchor: &AnchorLandmarks,
    settings: &LocalizerSettings,
) -> bool {
    let Some(state) = filter([first].into_iter(), anchor, settings) else {
        return false;
    };
    let predicted = state.predicted(&second.map_from_camera, &settings.drift);
    let measurement = Measurement::new(second, anchor, settings, 1.0);
    measurement.is_some_and(|measurement| {
        measurement.scale_known && measurement.disagreement(&predicted) < settings.disagreement_max
    })
}
