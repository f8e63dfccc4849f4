//! From tracks in the pictures of a vehicle's cameras to sightings around the vehicle.

use camera::CameraModel;
use nalgebra::{UnitQuaternion, Vector2, Vector3};

use crate::bounded::Bounded;
use crate::markers::{FramePairs, MarkerTrack, MergedPair, TrackState};
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
        let direction = self.ray(center_px.x, center_px.y)?;
        Some(Sighting {
            direction,
            range: self.markers.range(&direction, separation),
        })
    }

    /// What an image shows: lights apart and lights that look like one.
    pub fn sightings<'a>(
        &'a self,
        frame: &FramePairs<'a>,
        tracks: &'a [MarkerTrack],
    ) -> impl Iterator<Item = Sighting> + use<'a> {
        let apart = tracks
            .iter()
            .filter_map(|track| self.sighting_of_track(track));
        let merged = frame.merged.iter();
        apart.chain(merged.filter_map(|merged| self.sighting_of_merged(merged)))
    }

    /// The direction in the image in which an upright baseline lies; `None` for a camera that looks
    /// up or down by more than 60°, to which the lights of others do not look upright.
    pub fn upright_rad(&self) -> Option<f64> {
        let up = self.heading_from_camera.inverse() * Vector3::z();
        (up.x.hypot(up.y) >= UPRIGHT_SHARE_MIN).then(|| up.y.atan2(up.x))
    }

    /// Where it looks, left of ahead.
    pub fn azimuth_rad(&self) -> f64 {
        let ahead = self.heading_from_camera * Vector3::z();
        ahead.y.atan2(ahead.x)
    }

    /// The wedge about its azimuth and level that it covers, if its rows are about level.
    ///
    /// `None` where it does not cover level, or its model does not hold at its borders.
    pub fn view(&self) -> Option<FieldOfView> {
        let azimuth_rad = self.azimuth_rad();
        let (mut half_width_rad, mut elevation_rad_max) = (f64::INFINITY, f64::INFINITY);
        let [right_px, bottom_px] =
            [self.camera.width(), self.camera.height()].map(|side| side as f64 - 1.0);
        for step in 0..=BORDER_STEPS {
            let share = f64::from(step) / f64::from(BORDER_STEPS);
            for u_px in [0.0, right_px] {
                let aside = self.ray(u_px, share * bottom_px)?;
                let turn_rad = aside.y.atan2(aside.x) - azimuth_rad;
                let turn_rad = turn_rad.sin().atan2(turn_rad.cos());
                // A camera that hangs upside down has left and right the other way around.
                half_width_rad = half_width_rad.min(turn_rad.abs());
            }
            let [first, last] = [0.0, bottom_px].map(|v_px| {
                let upright = self.ray(share * right_px, v_px)?;
                Some(upright.z.atan2(upright.x.hypot(upright.y)))
            });
            let (high_rad, low_rad) = (first?.max(last?), first?.min(last?));
            elevation_rad_max = elevation_rad_max.min(high_rad).min(-low_rad);
        }
        (elevation_rad_max > 0.0).then_some(FieldOfView {
            azimuth_rad,
            half_width_rad,
            elevation_rad_max,
        })
    }

    /// A pixel's ray in the heading frame.
    fn ray(&self, u_px: f64, v_px: f64) -> Option<Vector3<f64>> {
        Some(self.heading_from_camera * self.camera.unproject(&Vector2::new(u_px, v_px))?)
    }
}

/// Points of each border that are looked at.
const BORDER_STEPS: u32 = 16;
/// Half of a light's baseline is left at 60°.
const UPRIGHT_SHARE_MIN: f64 = 0.5;

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

    /// Goal: nothing is called covered that the camera does not see. Method: directions all over
    /// the wedge, of cameras that look down by different angles, projected into the image.
    #[test]
    fn all_of_a_view_is_in_the_picture() {
        for pitch_deg in [0.0, 8.0, -20.0, 35.0] {
            let pitch_rad: f64 = f64::to_radians(pitch_deg);
            let mut mount = left_camera();
            let tilt = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -pitch_rad);
            mount.heading_from_camera *= tilt;
            let view = mount.view().unwrap();
            assert!((view.azimuth_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
            assert!(
                view.half_width_rad > 0.5 && view.elevation_rad_max > 0.05,
                "{view:?}"
            );
            for aside in [-0.99, -0.5, 0.0, 0.5, 0.99] {
                for up in [-0.99, 0.0, 0.99] {
                    let azimuth_rad = view.azimuth_rad + aside * view.half_width_rad;
                    let elevation_rad: f64 = up * view.elevation_rad_max;
                    let direction = Vector3::new(
                        elevation_rad.cos() * azimuth_rad.cos(),
                        elevation_rad.cos() * azimuth_rad.sin(),
                        elevation_rad.sin(),
                    );
                    let in_camera = mount.heading_from_camera.inverse() * direction;
                    let pixel = mount.camera.project(&in_camera).unwrap();
                    assert!(
                        mount.camera.contains(&pixel, 0.0),
                        "{pitch_deg}: {direction:?}"
                    );
                }
            }
        }
        // Level is above this one's picture.
        let mut mount = left_camera();
        mount.heading_from_camera *= UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -0.8);
        assert_eq!(mount.view(), None);
    }

    #[test]
    fn upright_lights_lie_where_the_camera_is_turned_to() {
        let mut mount = left_camera();
        let upright_rad = mount.upright_rad().unwrap();
        assert!((upright_rad.abs() - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
        mount.heading_from_camera *= UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.3);
        let turned_rad = mount.upright_rad().unwrap();
        assert!(((turned_rad - upright_rad).abs() - 0.3).abs() < 1e-9);
        mount.heading_from_camera = UnitQuaternion::identity();
        assert_eq!(mount.upright_rad(), None);
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
