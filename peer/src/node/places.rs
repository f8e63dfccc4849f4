//! Where the own map stood over time, by all that is known in the end.

use geometry::{Camera, Enu, Map, Matrix7, Similarity, Timestamp, Transform};
use nalgebra::Vector3;

use super::tied_pose::worst_sigma;

/// Where the own map stood at a keyframe.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub captured_at: Timestamp,
    pub map_from_camera: Transform<Map, Camera>,
    pub enu_from_map: Similarity<Enu, Map>,
    /// Over `[ω; ν; ln s]` in the camera's axes and the map's unit.
    pub covariance: Matrix7,
    /// What drift adds to it on each unit of the way to another camera.
    pub drift_per_way: Matrix7,
}

impl Place {
    /// One sigma of a camera's position along its worst axis, by this place alone.
    fn sigma_m(&self, map_from_camera: &Transform<Map, Camera>) -> f64 {
        let way = self.map_from_camera.inverse() * *map_from_camera;
        let adjoint = Similarity::from(way.inverse()).adjoint();
        let covariance = adjoint * self.covariance * adjoint.transpose()
            + self.drift_per_way * way.translation().norm();
        let position_covariance = covariance.fixed_view::<3, 3>(3, 3).into_owned();
        self.enu_from_map.scale() * worst_sigma(&position_covariance)
    }
}

/// A drifting map has no single place: one per keyframe, and between two keyframes a blend.
#[derive(Debug, Default)]
pub(super) struct Places {
    /// In the order of time.
    keyframes: Vec<Place>,
}

impl Places {
    pub(super) fn new(keyframes: impl Iterator<Item = Place>) -> Self {
        let mut keyframes: Vec<_> = keyframes.collect();
        keyframes.sort_by_key(|place| place.captured_at);
        Self { keyframes }
    }

    /// `None` where the position is less certain than `sigma_max_m`, as long before the first
    /// place, or without any place.
    pub(super) fn pose(
        &self,
        captured_at: Timestamp,
        map_from_camera: &Transform<Map, Camera>,
        sigma_max_m: f64,
    ) -> Option<Transform<Enu, Camera>> {
        let (before, after, share) = self.around(captured_at)?;
        let sigma_m = [before, after].map(|place| place.sigma_m(map_from_camera));
        if sigma_m[0].min(sigma_m[1]) > sigma_max_m {
            return None;
        }
        let before = before.enu_from_map.transform_pose(map_from_camera);
        let after = after.enu_from_map.transform_pose(map_from_camera);
        let turn = before.rotation().rotation_to(after.rotation());
        Some(Transform::new(
            turn.powf(share) * before.rotation(),
            before.translation().lerp(after.translation(), share),
        ))
    }

    /// Where a point is that was first seen at a time.
    pub(super) fn point(
        &self,
        captured_at: Timestamp,
        point_in_map: &Vector3<f64>,
    ) -> Option<Vector3<f64>> {
        let (before, after, share) = self.around(captured_at)?;
        let [before, after] = [before, after].map(|place| place.enu_from_map * *point_in_map);
        Some(before.lerp(&after, share))
    }

    /// The places before and after a time, and how far from one to the other it is; beyond the
    /// ends the nearest place is both.
    fn around(&self, captured_at: Timestamp) -> Option<(&Place, &Place, f64)> {
        let later = self
            .keyframes
            .partition_point(|place| place.captured_at <= captured_at);
        let last = self.keyframes.last()?;
        let after = self.keyframes.get(later).unwrap_or(last);
        let before = self.keyframes.get(later.saturating_sub(1)).unwrap_or(after);
        let span_s = after.captured_at - before.captured_at;
        let share = if span_s > 0.0 {
            ((captured_at - before.captured_at) / span_s).clamp(0.0, 1.0)
        } else {
            0.0
        };
        Some((before, after, share))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    fn camera(east: f64) -> Transform<Map, Camera> {
        Transform::new(UnitQuaternion::identity(), Vector3::x() * east)
    }

    /// Certain to 1 cm, drifting by 0.1 m per root of a metre.
    fn place(seconds: f64, east_m: f64, scale: f64) -> Place {
        let east = Vector3::x() * east_m;
        let mut drift_per_way = Matrix7::zeros();
        drift_per_way
            .fixed_view_mut::<3, 3>(3, 3)
            .fill_diagonal(0.1 * 0.1);
        Place {
            captured_at: at(seconds),
            map_from_camera: camera(0.0),
            enu_from_map: Similarity::new(scale, UnitQuaternion::identity(), east),
            covariance: Matrix7::identity() * 1e-4,
            drift_per_way,
        }
    }

    fn at(seconds: f64) -> Timestamp {
        Timestamp::from_seconds(seconds).unwrap()
    }

    #[test]
    fn frames_between_keyframes_are_between_their_places() {
        let places = Places::new([place(2.0, 1.0, 2.0), place(1.0, 0.0, 1.0)].into_iter());
        let pose = |seconds| places.pose(at(seconds), &camera(1.0), 1.0);
        // One metre at first, three in the end; beyond the ends nothing changes.
        for (seconds, expected) in [(0.0, 1.0), (1.0, 1.0), (1.5, 2.0), (2.0, 3.0), (9.0, 3.0)] {
            let east_m = pose(seconds).unwrap().translation().x;
            assert!((east_m - expected).abs() < 1e-12, "{seconds}");
        }
        let point = places.point(at(1.25), &Vector3::x()).unwrap();
        assert!((point.x - 1.5).abs() < 1e-12);
        assert!(Places::default().pose(at(0.0), &camera(1.0), 1.0).is_none());
    }

    /// Drift makes the place 16 m away uncertain by 0.4 m, and that 36 m away by 0.6 m; the turn
    /// of 0.01 rad adds 0.16 m and 0.36 m across.
    #[test]
    fn frames_too_far_from_any_place_are_left_out() {
        let places = Places::new([place(1.0, 0.0, 1.0)].into_iter());
        assert!(places.pose(at(0.0), &camera(16.0), 0.5).is_some());
        assert!(places.pose(at(0.0), &camera(36.0), 0.5).is_none());
    }
}
