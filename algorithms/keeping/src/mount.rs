//! From tracks in the pictures of a vehicle's cameras to sightings around the vehicle.

use camera::CameraModel;
use nalgebra::{UnitQuaternion, Vector2, Vector3};

use crate::bounded::Bounded;
use crate::markers::{MarkerTrack, MergedPair, TrackState};
use crate::sighting::{MarkerModel, Separation, Sighting};
use crate::tracks::TRACK_COUNT_MAX;
use crate::view::FieldOfView;

/// How a camera looks out of its vehicle, and which lights it sees from there.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraMount {
    pub camera: CameraModel,
    pub heading_from_camera: UnitQuaternion<f64>,
    /// Direction of the lights' baseline in the image, as for the finder of pairs.
    pub baseline_rad: f64,
    pub markers: MarkerModel,
}

impl CameraMount {
    /// What a track says that is believed and was seen in the newest picture; `None` also where the
    /// camera's model does not hold.
    pub fn sighting_of_track(&self, track: &MarkerTrack) -> Option<Sighting> {
        if track.state != TrackState::Track || track.merged {
            return None;
        }
        let (sin, cos) = self.baseline_rad.sin_cos();
        let center_px = Vector2::new(track.u_px, track.v_px);
        let half_px = Vector2::new(cos, sin) * (0.5 * track.separation_px);
        let first = self.camera.unproject(&(center_px - half_px))?;
        let second = self.camera.unproject(&(center_px + half_px))?;
        let angle_rad = first.cross(&second).norm().atan2(first.dot(&second));
        let sigma_share = track.sigma_separation_px / track.separation_px;
        self.sighting(
            &center_px,
            Separation::Resolved {
                angle_rad,
                sigma_rad: angle_rad * sigma_share,
            },
        )
    }

    /// What lights say that look like one.
    pub fn sighting_of_merged(&self, merged: &MergedPair) -> Option<Sighting> {
        let intrinsics = self.camera.intrinsics();
        // Angles per pixel are largest on the optical axis.
        let angle_rad_max = merged.separation_px_max / intrinsics.fx.min(intrinsics.fy);
        self.sighting(
            &Vector2::from(merged.center_px),
            Separation::Merged { angle_rad_max },
        )
    }

    fn sighting(&self, center_px: &Vector2<f64>, separation: Separation) -> Option<Sighting> {
        let direction = self.heading_from_camera * self.camera.unproject(center_px)?;
        Some(Sighting {
            direction,
            range: self.markers.range(&direction, separation),
        })
    }

    /// What it covers at least: as far to either side, up and down as the nearer border.
    ///
    /// `None` where the camera's model does not hold in the middle of a border.
    pub fn view(&self) -> Option<FieldOfView> {
        let (right_px, bottom_px) = (
            self.camera.width() as f64 - 1.0,
            self.camera.height() as f64 - 1.0,
        );
        let ray = |u_px: f64, v_px: f64| -> Option<Vector3<f64>> {
            let ray = self.camera.unproject(&Vector2::new(u_px, v_px))?;
            Some(self.heading_from_camera * ray)
        };
        let ahead = self.heading_from_camera * Vector3::z();
        let azimuth_rad = ahead.y.atan2(ahead.x);
        let intrinsics = self.camera.intrinsics();
        let aside = [ray(0.0, intrinsics.cy)?, ray(right_px, intrinsics.cy)?];
        let half_width_rad = aside
            .map(|ray| {
                let turn_rad = ray.y.atan2(ray.x) - azimuth_rad;
                turn_rad.sin().atan2(turn_rad.cos()).abs()
            })
            .into_iter()
            .fold(f64::INFINITY, f64::min);
        let upright = [ray(intrinsics.cx, 0.0)?, ray(intrinsics.cx, bottom_px)?];
        let elevation_rad_max = upright
            .map(|ray| ray.z.atan2(ray.x.hypot(ray.y)).abs())
            .into_iter()
            .fold(f64::INFINITY, f64::min);
        Some(FieldOfView {
            azimuth_rad,
            half_width_rad,
            elevation_rad_max,
        })
    }
}

/// The sightings of all cameras in one step, each neighbour once.
pub type Sightings = Bounded<Sighting, TRACK_COUNT_MAX>;

/// Two cameras see the same neighbour within this angle.
const SAME_RAD: f64 = 0.04;

/// Adds what another camera saw. Where two see the same neighbour, the narrower bounds stay.
pub fn join(sightings: &mut Sightings, sighting: Sighting) {
    let is_same = |known: &&mut Sighting| {
        (known.direction - sighting.direction).norm() < SAME_RAD
            && known.range.low_m <= sighting.range.high_m
            && sighting.range.low_m <= known.range.high_m
    };
    let width = |sighting: &Sighting| sighting.range.high_m / sighting.range.low_m.max(1e-3);
    match sightings.iter_mut().find(is_same) {
        Some(known) if width(&sighting) < width(known) => *known = sighting,
        Some(_) => {}
        // More than this nobody follows.
        None => drop(sightings.push(sighting)),
    }
}

#[cfg(test)]
mod tests {
    use camera::{Distortion, Intrinsics};

    use super::*;
    use crate::markers::TrackId;
    use crate::sighting::{Baseline, Range};

    fn left_camera() -> CameraMount {
        let axes = nalgebra::Matrix3::from_columns(&[Vector3::x(), -Vector3::z(), Vector3::y()]);
        let intrinsics = Intrinsics {
            fx: 130.0,
            fy: 130.0,
            cx: 161.5,
            cy: 121.5,
        };
        CameraMount {
            camera: CameraModel::new(324, 244, intrinsics, Distortion::None).unwrap(),
            heading_from_camera: UnitQuaternion::from_matrix(&axes),
            baseline_rad: std::f64::consts::FRAC_PI_2,
            markers: MarkerModel {
                baseline: Baseline::Vertical,
                length_m: 0.15,
                ..MarkerModel::default()
            },
        }
    }

    fn track(u_px: f64, v_px: f64, separation_px: f64) -> MarkerTrack {
        MarkerTrack {
            id: TrackId(0),
            state: TrackState::Track,
            age_s: 0.0,
            u_px,
            v_px,
            separation_px,
            sigma_separation_px: 0.02,
            rate_per_s: 0.0,
            log_peak_bounds: [5.0; 2],
            merged: false,
        }
    }

    /// Goal: a place in the picture becomes the place it was drawn from. Method: project lights
    /// with the pinhole's own formula.
    #[test]
    fn a_track_is_where_its_lights_are() {
        let mount = left_camera();
        let place = Vector3::new(1.0, 3.0, 0.8);
        let project = |point: Vector3<f64>| {
            let in_camera = mount.heading_from_camera.inverse() * point;
            [
                130.0 * in_camera.x / in_camera.z + 161.5,
                130.0 * in_camera.y / in_camera.z + 121.5,
            ]
        };
        let [upper, lower] = [0.075, -0.075].map(|height| project(place + Vector3::z() * height));
        let seen = track(upper[0], 0.5 * (upper[1] + lower[1]), lower[1] - upper[1]);
        let sighting = mount.sighting_of_track(&seen).unwrap();
        assert!((sighting.direction - place.normalize()).norm() < 1e-9);
        let range_m = sighting.range.expected_m.unwrap();
        // Lights of a baseline that is seen askew are not quite half an angle to either side.
        assert!((range_m / place.norm() - 1.0).abs() < 2e-3, "{range_m}");
    }

    #[test]
    fn what_is_held_or_merged_is_no_sighting_of_lights_apart() {
        let mount = left_camera();
        for state in [TrackState::Acquire, TrackState::Coast] {
            let unsure = MarkerTrack {
                state,
                ..track(100.0, 100.0, 5.0)
            };
            assert_eq!(mount.sighting_of_track(&unsure), None);
        }
        let merged = mount.sighting_of_merged(&MergedPair {
            center_px: [161.5, 121.5],
            separation_px_max: 4.0,
            separation_px: 2.0,
        });
        let merged = merged.unwrap();
        assert_eq!(merged.range.expected_m, None);
        assert!((merged.range.low_m - 0.15 * 0.1_f64.cos() * 130.0 / 4.0).abs() < 1e-9);
    }

    #[test]
    fn a_view_ends_at_the_nearer_border() {
        let view = left_camera().view().unwrap();
        let half_rad = |half_px: f64| (half_px / 130.0_f64).atan();
        assert!((view.azimuth_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
        assert!((view.half_width_rad - half_rad(161.5)).abs() < 1e-9);
        assert!((view.elevation_rad_max - half_rad(121.5)).abs() < 1e-9);
    }

    #[test]
    fn a_neighbour_that_two_cameras_see_is_one() {
        let seen = |x: f64, low_m: f64, high_m: f64| Sighting {
            direction: Vector3::new(x, 1.0, 0.0).normalize(),
            range: Range {
                expected_m: Some(0.5 * (low_m + high_m)),
                low_m,
                high_m,
            },
        };
        let mut sightings = Sightings::default();
        join(&mut sightings, seen(0.0, 2.5, 3.5));
        join(&mut sightings, seen(0.001, 2.9, 3.1));
        join(&mut sightings, seen(0.002, 2.0, 4.0));
        assert_eq!(sightings.to_vec(), [seen(0.001, 2.9, 3.1)]);
        // Behind it is another one.
        join(&mut sightings, seen(0.0, 6.0, 7.0));
        assert_eq!(sightings.len(), 2);
    }
}
