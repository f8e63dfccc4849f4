//! Flights behind another vehicle, on the pixels of an ideal camera.

use camera::{CameraModel, Distortion, Intrinsics};
use nalgebra::{Matrix3, UnitQuaternion};
use proptest::prelude::*;

use super::*;
use crate::sighting::MarkerModel;

const STEP_S: f64 = 0.1;
const LIGHTS_M: f64 = 0.1;

fn mount() -> CameraMount {
    let intrinsics = Intrinsics {
        fx: 180.9,
        fy: 180.94,
        cx: 159.23,
        cy: 122.0,
    };
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    CameraMount {
        camera: CameraModel::new(324, 244, intrinsics, Distortion::None).unwrap(),
        heading_from_camera: UnitQuaternion::from_matrix(&axes),
        baseline_rad: std::f64::consts::FRAC_PI_2,
        markers: MarkerModel {
            length_m: LIGHTS_M,
            ..MarkerModel::default()
        },
    }
}

/// The track of a vehicle at this place in the heading frame; `None` outside the picture.
fn track_at(place: &Vector3<f64>, id: u32) -> Option<MarkerTrack> {
    let CameraMount {
        camera,
        heading_from_camera,
        ..
    } = mount();
    let from_body = heading_from_camera.inverse();
    let half = Vector3::z() * (0.5 * LIGHTS_M);
    let pixel = camera.project(&(from_body * *place))?;
    let [above, below] =
        [place + half, place - half].map(|light| camera.project(&(from_body * light)));
    camera.contains(&pixel, 0.0).then_some(MarkerTrack {
        id: TrackId(id),
        state: TrackState::Track,
        age_s: 0.0,
        u_px: pixel.x,
        v_px: pixel.y,
        separation_px: (above? - below?).norm(),
        sigma_separation_px: 0.1,
        rate_per_s: 0.0,
        log_peak_bounds: [(500.0 / place.norm_squared()).ln(); 2],
        merged: false,
    })
}

fn settings() -> GuardedFollowerSettings {
    GuardedFollowerSettings::calibrated(&mount())
}

/// Where the other is from the follower, image by image, with one image of latency and 0.3 s of
/// lag.
fn places(
    settings: GuardedFollowerSettings,
    start: Vector3<f64>,
    leader_velocity: impl Fn(f64) -> Vector3<f64>,
    duration_s: f64,
) -> Vec<Vector3<f64>> {
    let mut follower = GuardedFollower::new(settings, mount());
    let (mut place, mut velocity, mut command) = (start, Vector3::zeros(), Vector3::zeros());
    let mut places = Vec::new();
    for idx in 0..(duration_s / STEP_S) as usize {
        let late = std::mem::replace(
            &mut command,
            follower
                .step(track_at(&place, 1).as_slice(), &[], STEP_S)
                .velocity,
        );
        velocity += (late - velocity) * (1.0 - (-STEP_S / 0.3_f64).exp());
        place += (leader_velocity(idx as f64 * STEP_S) - velocity) * STEP_S;
        places.push(place);
    }
    places
}

#[test]
fn a_place_behind_a_leader_that_flies_to_and_fro_is_held() {
    let settings = settings();
    let place_m = settings.place_m(&mount());
    assert!((place_m - 1.8094).abs() < 1e-3, "{place_m}");
    let leader = |time_s: f64| {
        let to_and_fro_mps = 0.4 * (std::f64::consts::TAU * time_s / 20.0).sin();
        Vector3::new(
            0.06 * (std::f64::consts::TAU * time_s / 9.0).sin(),
            to_and_fro_mps,
            0.0,
        )
    };
    for place in places(settings, Vector3::new(2.0, -0.1, 0.05), leader, 60.0)
        .iter()
        .skip(50)
    {
        let range_m = place.norm();
        assert!((range_m / place_m - 1.0).abs() < 0.1, "{place:?}");
        assert!(place.y.abs() < 0.4, "{place:?}");
    }
}

/// Goal: whatever separation is commanded, nobody comes nearer than the filter allows. Method:
/// a place at half a metre.
#[test]
fn a_place_that_is_too_near_is_not_taken() {
    let mut settings = settings();
    settings.follower.separation_px = 36.0;
    let places = places(
        settings,
        Vector3::new(3.0, 0.2, 0.0),
        |_| Vector3::zeros(),
        30.0,
    );
    let nearest_m = places
        .iter()
        .map(Vector3::norm)
        .fold(f64::INFINITY, f64::min);
    let distance_m_min = settings.safety.distance_m_min + settings.safety.gust_m;
    assert!(nearest_m > 0.97 * distance_m_min, "{nearest_m}");
    let last_m = places.last().unwrap().norm();
    assert!(last_m < distance_m_min + 0.3, "{last_m}");
}

#[test]
fn who_comes_near_is_backed_away_from_slowly() {
    let settings = settings();
    let near = track_at(&Vector3::new(0.6, 0.0, 0.0), 1);
    let mut follower = GuardedFollower::new(settings, mount());
    for _ in 0..5 {
        let velocity = follower.step(near.as_slice(), &[], STEP_S).velocity;
        assert!((velocity.x + settings.backward_mps_max).abs() < 1e-12);
    }
}

#[test]
fn a_third_vehicle_on_the_way_is_kept_clear_of_and_not_followed() {
    let mut follower = GuardedFollower::new(settings(), mount());
    let leader = track_at(&Vector3::new(3.0, 0.0, 0.0), 1).unwrap();
    let free = follower.step(&[leader], &[], STEP_S).velocity;
    assert!(free.x > 0.3, "{free:?}");
    let third = track_at(&Vector3::new(0.9, 0.1, 0.0), 2).unwrap();
    for _ in 0..10 {
        let command = follower.step(&[third, leader], &[], STEP_S);
        assert_eq!(command.seen.unwrap().separation_px, leader.separation_px);
        assert!(command.velocity.x < 0.1, "{command:?}");
    }
}

#[test]
fn lost_lights_let_the_command_decay() {
    let mut follower = GuardedFollower::new(settings(), mount());
    let far = track_at(&Vector3::new(3.0, 0.8, 0.0), 1);
    assert!(follower.step(far.as_slice(), &[], STEP_S).velocity.norm() > 0.3);
    for _ in 0..20 {
        follower.step(&[], &[], STEP_S);
    }
    let command = follower.step(&[], &[], STEP_S);
    assert_eq!(command.seen, None);
    assert!(command.velocity.norm() < 0.01, "{command:?}");
}

#[test]
fn a_track_of_a_few_images_ago_is_held_and_not_measured_again() {
    let mut follower = GuardedFollower::new(settings(), mount());
    let mut track = track_at(&Vector3::new(2.5, 0.0, 0.0), 1).unwrap();
    let first = follower.step(&[track], &[], STEP_S);
    track.state = TrackState::Coast;
    let held = follower.step(&[track], &[], STEP_S);
    assert_eq!(held.seen, None);
    assert_eq!(held.velocity, first.velocity);
    track.state = TrackState::Acquire;
    assert_eq!(follower.step(&[track], &[], STEP_S).seen, None);
}

#[test]
fn an_obstacle_beside_the_place_stops_the_vehicle() {
    let mut follower = GuardedFollower::new(settings(), mount());
    let aside = track_at(&Vector3::new(1.8, 1.2, 0.0), 1);
    let free = follower.step(aside.as_slice(), &[], STEP_S).velocity;
    assert!(free.y > 0.3, "{free:?}");
    let wall = Obstacle {
        direction: Vector3::y(),
        clearance_m: 0.5,
    };
    let slow = follower.step(aside.as_slice(), &[wall], STEP_S).velocity;
    assert!(slow.y <= 0.1 + 1e-9, "{slow:?}");
}

/// Goal: what a camera to the left calls ahead is the vehicle's left. Method: the same lights and
/// the same wall, once seen ahead and once to the left.
#[test]
fn a_camera_that_looks_aside_flies_aside() {
    let command = |azimuth_rad: f64| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), azimuth_rad);
        let mount = CameraMount {
            heading_from_camera: turn * mount().heading_from_camera,
            ..mount()
        };
        let mut follower = GuardedFollower::new(settings(), mount);
        let wall = Obstacle {
            direction: turn * Vector3::y(),
            clearance_m: 0.5,
        };
        let lights = track_at(&Vector3::new(2.4, 0.9, 0.0), 1);
        follower.step(lights.as_slice(), &[wall], STEP_S).velocity
    };
    let ahead = command(0.0);
    assert!(ahead.x > 0.2 && ahead.y > 0.05, "{ahead:?}");
    let left = command(std::f64::consts::FRAC_PI_2);
    assert!(
        (left - Vector3::new(-ahead.y, ahead.x, 0.0)).norm() < 1e-9,
        "{left:?}"
    );
}

/// Goal: a pattern on a wall that looks like a near vehicle stops nobody, and a near vehicle
/// whose lights are clipped does. Method: both where the follower has to fly.
#[test]
fn faint_patterns_are_no_neighbours_and_clipped_lights_are() {
    let leader = track_at(&Vector3::new(3.0, 0.0, 0.0), 1).unwrap();
    let near = track_at(&Vector3::new(0.9, 0.1, 0.0), 2).unwrap();
    let forward_mps = |log_peak_bounds: [f64; 2]| {
        let mut follower = GuardedFollower::new(settings(), mount());
        let third = MarkerTrack {
            log_peak_bounds,
            ..near
        };
        let mut command = GuardedCommand::default();
        for _ in 0..10 {
            command = follower.step(&[leader, third], &[], STEP_S);
        }
        command.velocity.x
    };
    assert!(forward_mps([4.0; 2]) > 0.3);
    assert!(forward_mps([5.3, f64::INFINITY]) < 0.1);
}

/// Goal: lamps may dim, and an exposure may change, without anybody being lost or run into.
#[test]
fn lights_that_have_dimmed_are_still_followed_and_kept_clear_of() {
    let bright = track_at(&Vector3::new(2.5, 0.0, 0.0), 1).unwrap();
    let dimmed = |id: u32, ahead_m: f64| MarkerTrack {
        log_peak_bounds: bright.log_peak_bounds.map(|log_peak| log_peak - 2.5),
        ..track_at(&Vector3::new(ahead_m, 0.0, 0.0), id).unwrap()
    };
    let mut follower = GuardedFollower::new(settings(), mount());
    follower.step(&[bright], &[], STEP_S);
    assert!(follower.step(&[dimmed(1, 2.5)], &[], STEP_S).seen.is_some());
    // The same after a gap, in which its track was lost.
    let mut follower = GuardedFollower::new(settings(), mount());
    follower.step(&[bright], &[], STEP_S);
    for _ in 0..12 {
        follower.step(&[], &[], STEP_S);
    }
    let command = follower.step(&[dimmed(2, 1.0)], &[], STEP_S);
    assert!(command.seen.is_some());
    assert!(command.velocity.x < 0.0, "{command:?}");
}

proptest! {
    /// Goal: a cap on one speed never brings the vehicle nearer to anybody than the filter lets it.
    /// Method: a neighbour anywhere in the picture beside the one that is followed; as far as the
    /// speeds allow it, the limit that it sets is kept.
    #[test]
    fn caps_never_undo_the_filter(
        range_m in 0.5_f64..2.0,
        aside_rad in -0.65_f64..0.65,
        leader_left_m in -1.0_f64..1.0,
    ) {
        let settings = settings();
        let place = Vector3::new(aside_rad.cos(), aside_rad.sin(), 0.0) * range_m;
        let leader = track_at(&Vector3::new(2.2, leader_left_m, 0.0), 1).unwrap();
        let third = track_at(&place, 2).unwrap();
        let mut follower = GuardedFollower::new(settings, mount());
        follower.step(&[leader], &[], STEP_S);
        let command = follower.step(&[third, leader], &[], STEP_S);
        let keep_m = settings.safety.distance_m_min + settings.safety.gust_m;
        let closing_mps = command.velocity.dot(&place.normalize());
        // The vehicle may back away from the camera's view this fast in this direction.
        let retreat_mps = settings.backward_mps_max * aside_rad.cos()
            + settings.follower.speed_mps_max * aside_rad.sin().abs();
        let allowed_mps = (range_m - keep_m).max(-retreat_mps);
        prop_assert!(closing_mps <= allowed_mps.max(0.0) + 0.02, "{closing_mps} {allowed_mps}");
        if range_m < keep_m - 0.1 {
            prop_assert!(closing_mps < 0.0, "{closing_mps}");
        }
    }
}
