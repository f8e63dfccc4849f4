//! Changes that keep keyframes and points consistent with each other.
//!
//! Invariant: observation `i` of keyframe `k` names point `p` exactly if `p` has the view `(k, i)`.

use geometry::{Camera, Map, Transform};
use nalgebra::{Matrix3, Vector3};

use super::place::CulledKeyframe;
use super::{ExpectedRange, Keyframe, MapPoint, View, VslamMap};
use crate::frame::Frame;
use crate::optics::level_scale;
use crate::{KeyframeId, PointId};

/// What is known of a point when it is made.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NewPoint {
    pub(crate) position_in_map: Vector3<f64>,
    pub(crate) covariance_in_map: Matrix3<f64>,
    pub(crate) parallax_rad: f64,
    pub(crate) expected_range: Option<ExpectedRange>,
}

impl VslamMap {
    /// Makes a keyframe of a frame; observations that name points become views of those.
    pub(crate) fn add_keyframe(
        &mut self,
        frame: Frame,
        camera_from_map: Transform<Camera, Map>,
    ) -> KeyframeId {
        let id = KeyframeId(self.keyframes.next_id());
        let mut observations = frame.observations;
        for (idx, observation) in observations.iter_mut().enumerate() {
            let seen = observation
                .point
                .and_then(|point| self.points.get_mut(point.0));
            let new_view = seen.filter(|point| point.observation_idx(id).is_none());
            match new_view {
                Some(point) => point.views.push(View {
                    keyframe: id,
                    observation_idx: idx as u32,
                }),
                None => observation.point = None,
            }
        }
        self.keyframes.push(Keyframe {
            id,
            frame_idx: Some(frame.frame_idx),
            captured_at: frame.captured_at,
            camera_from_map,
            observations,
            grid: frame.grid,
            unit: 1.0,
            parent: None,
            neighbours: Vec::new(),
        });
        id
    }

    /// Makes a point seen by these views; `views` name observations without a point.
    pub(crate) fn add_point(&mut self, new: NewPoint, mut views: Vec<View>) -> PointId {
        views.sort_unstable();
        let id = PointId(self.points.next_id());
        let (first_keyframe, descriptor) = views
            .first()
            .and_then(|view| {
                let keyframe = self.keyframe(view.keyframe)?;
                let observation = &keyframe.observations[view.observation_idx as usize];
                Some((view.keyframe, observation.descriptor))
            })
            .expect("a point is made from views of the map's keyframes");
        for view in &views {
            if let Some(keyframe) = self.keyframes.get_mut(view.keyframe.0) {
                keyframe.observations[view.observation_idx as usize].point = Some(id);
            }
        }
        self.points.push(MapPoint {
            id,
            position_in_map: new.position_in_map,
            covariance_in_map: new.covariance_in_map,
            parallax_rad: new.parallax_rad,
            expected_range: new.expected_range,
            descriptor,
            first_keyframe,
            made_at: KeyframeId(self.keyframes.next_id() - 1),
            views,
            viewing_direction: Vector3::zeros(),
            finest_distance: 0.0,
            visible_count: 1,
            found_count: 1,
        });
        self.refresh_point(id);
        id
    }

    /// Adds a view to a point, if neither the observation nor the point has one yet.
    pub(crate) fn link(&mut self, point: PointId, view: View) {
        let (Some(point), Some(keyframe)) = (
            self.points.get_mut(point.0),
            self.keyframes.get_mut(view.keyframe.0),
        ) else {
            return;
        };
        let observation = &mut keyframe.observations[view.observation_idx as usize];
        if observation.point.is_some() {
            return;
        }
        if let Err(slot) = point
            .views
            .binary_search_by_key(&view.keyframe, |one| one.keyframe)
        {
            observation.point = Some(point.id);
            point.views.insert(slot, view);
        }
    }

    /// Takes a keyframe's view from a point; a point with a single view left is removed.
    pub(crate) fn unlink(&mut self, id: PointId, keyframe: KeyframeId) {
        let Some(point) = self.points.get_mut(id.0) else {
            return;
        };
        let Ok(slot) = point
            .views
            .binary_search_by_key(&keyframe, |view| view.keyframe)
        else {
            return;
        };
        let view = point.views.remove(slot);
        let few_views_left = point.views.len() < 2;
        if let Some(keyframe) = self.keyframes.get_mut(keyframe.0) {
            keyframe.observations[view.observation_idx as usize].point = None;
        }
        if few_views_left {
            self.remove_point(id);
        }
    }

    pub(crate) fn remove_point(&mut self, id: PointId) {
        for view in self
            .points
            .remove(id.0)
            .map(|point| point.views)
            .unwrap_or_default()
        {
            if let Some(keyframe) = self.keyframes.get_mut(view.keyframe.0) {
                keyframe.observations[view.observation_idx as usize].point = None;
            }
        }
    }

    /// Makes one point of two that show the same place; where a keyframe sees both, the view of
    /// `kept` stays.
    pub(crate) fn merge_points(&mut self, kept: PointId, dropped: PointId) {
        if kept == dropped {
            return;
        }
        let Some(old) = self.points.get(dropped.0) else {
            return;
        };
        let (views, visible_count, found_count) =
            (old.views.clone(), old.visible_count, old.found_count);
        self.remove_point(dropped);
        for view in views {
            self.link(kept, view);
        }
        if let Some(point) = self.points.get_mut(kept.0) {
            point.visible_count += visible_count;
            point.found_count += found_count;
        }
    }

    /// Removes a keyframe; the most covisible one takes over its place in trajectories.
    ///
    /// The first keyframe, which holds the map in place, stays.
    pub(crate) fn remove_keyframe(&mut self, id: KeyframeId) {
        let Some((keyframe, place)) = self
            .keyframe(id)
            .filter(|keyframe| keyframe.parent.is_some())
            .and_then(|keyframe| {
                let heir = self.covisible(id).first()?.keyframe;
                Some((keyframe, self.place(heir, &keyframe.camera_from_map)?))
            })
        else {
            return;
        };
        let unit = keyframe.unit;
        let points: Vec<PointId> = keyframe.points().collect();
        for &point in &points {
            self.unlink(point, id);
        }
        for point in points {
            self.refresh_point(point);
        }
        self.keyframes.remove(id.0);
        self.culled.insert(id, CulledKeyframe { place, unit });
    }

    /// Recomputes what a point takes from its views: descriptor, viewing direction, distance range.
    pub(crate) fn refresh_point(&mut self, id: PointId) {
        let Some(point) = self.points.get(id.0) else {
            return;
        };
        let mut descriptors = Vec::with_capacity(point.views.len());
        let mut direction_sum = Vector3::zeros();
        let mut finest_distance = 0.0;
        for view in &point.views {
            let Some(keyframe) = self.keyframes.get(view.keyframe.0) else {
                continue;
            };
            let observation = &keyframe.observations[view.observation_idx as usize];
            let ray = point.position_in_map - keyframe.centre_in_map();
            let distance = ray.norm();
            descriptors.push(observation.descriptor);
            direction_sum += ray / distance.max(f64::MIN_POSITIVE);
            finest_distance += distance * level_scale(observation.level);
        }
        let view_count = descriptors.len().max(1) as f64;
        let descriptor = most_typical(&descriptors);
        if let Some(point) = self.points.get_mut(id.0) {
            point.descriptor = descriptor.unwrap_or(point.descriptor);
            point.viewing_direction = direction_sum
                .try_normalize(1e-9)
                .unwrap_or(point.viewing_direction);
            point.finest_distance = finest_distance / view_count;
        }
    }
}

/// Views that take part in the choice of the most typical descriptor; the newest, as they are most
/// like what comes.
const TYPICAL_VIEWS_MAX: usize = 12;

/// The descriptor with the least median distance to the others.
fn most_typical(descriptors: &[features::Descriptor]) -> Option<features::Descriptor> {
    let recent = &descriptors[descriptors.len().saturating_sub(TYPICAL_VIEWS_MAX)..];
    let median = |one: &features::Descriptor| {
        let mut distances: Vec<u32> = recent.iter().map(|other| one.distance(other)).collect();
        distances.sort_unstable();
        distances[(distances.len() - 1) / 2]
    };
    recent.iter().min_by_key(|one| median(one)).copied()
}
