use super::*;

fn swarm(settings: SwarmSettings) -> Swarm {
    Swarm::new(settings, 7)
}

#[test]
fn starts_keep_their_distance_and_follow_from_the_seed() {
    for drone_count in [1, 3, 10, 200] {
        let settings = SwarmSettings {
            drone_count,
            ..SwarmSettings::default()
        };
        let first = Swarm::new(settings.clone(), 3);
        for (idx, left) in first.positions().iter().enumerate() {
            for right in &first.positions()[..idx] {
                assert!((left - right).norm() >= 1.0);
            }
        }
        assert_eq!(first.positions(), Swarm::new(settings, 3).positions());
    }
}

#[test]
fn velocity_lags_behind_the_command() {
    let mut swarm = swarm(SwarmSettings {
        drone_count: 1,
        lag_s: 0.3,
        ..SwarmSettings::default()
    });
    let steering = [Steering {
        velocity: Vector3::x(),
        heading_rad: 0.0,
    }];
    for _ in 0..3 {
        swarm.advance(&steering);
    }
    // One time constant.
    assert!((swarm.velocities()[0].x - (1.0 - (-1.0_f64).exp())).abs() < 1e-12);
}

#[test]
fn frames_show_the_past() {
    let mut settings = SwarmSettings {
        drone_count: 2,
        ..SwarmSettings::default()
    };
    settings.sensing.latency_s = 0.2;
    settings.sensing.azimuth_rad_max = 4.0;
    let mut swarm = swarm(settings);
    swarm.now.positions = vec![Vector3::zeros(), Vector3::new(3.0, 0.0, 0.0)];
    swarm.past.clear();
    swarm.past.push_back(swarm.now.clone());
    let still = Steering::default();
    let moving = Steering {
        velocity: Vector3::x(),
        heading_rad: 0.0,
    };
    let mut glimpses = Vec::new();
    let mut distances_m = Vec::new();
    for _ in 0..5 {
        swarm.glimpses(0, &mut glimpses);
        distances_m.push(18.1 / glimpses[0].separation_px.unwrap());
        swarm.advance(&[still, moving]);
    }
    let expected_m = [3.0, 3.0, 3.0, 3.1, 3.2];
    for (found, expected) in distances_m.iter().zip(expected_m) {
        assert!((found - expected).abs() < 1e-9, "{distances_m:?}");
    }
}

/// Drone 0 at the origin, and the others where they have always been.
fn around_origin(sensing: SensingSettings, others: &[Vector3<f64>]) -> Swarm {
    let mut swarm = swarm(SwarmSettings {
        drone_count: others.len() + 1,
        sensing,
        ..SwarmSettings::default()
    });
    swarm.now.positions[0] = Vector3::zeros();
    swarm.now.positions[1..].copy_from_slice(others);
    swarm.past.clear();
    swarm.past.push_back(swarm.now.clone());
    swarm
}

fn seen_from_origin(sensing: SensingSettings, others: &[Vector3<f64>]) -> Vec<Glimpse> {
    let mut swarm = around_origin(sensing, others);
    let mut glimpses = Vec::new();
    swarm.glimpses(0, &mut glimpses);
    glimpses
}

#[test]
fn cameras_have_borders_and_bodies_hide() {
    let ideal = SensingSettings::default();
    let behind = -Vector3::x() * 3.0;
    assert!(seen_from_origin(ideal, &[behind]).is_empty());
    let above = Vector3::new(0.5, 0.0, 3.0);
    assert_eq!(seen_from_origin(ideal, &[above]).len(), 1);
    let flat = SensingSettings {
        elevation_rad_max: 0.7,
        ..ideal
    };
    assert!(seen_from_origin(flat, &[above]).is_empty());
    let in_line = [Vector3::y() * 2.0, Vector3::y() * 4.0];
    assert_eq!(seen_from_origin(ideal, &in_line).len(), 2);
    let solid = SensingSettings {
        occlusion: true,
        ..ideal
    };
    assert_eq!(seen_from_origin(solid, &in_line).len(), 1);
}

#[test]
fn a_horizontal_baseline_merges_abeam() {
    let sensing = SensingSettings {
        baseline: LightBaseline::Horizontal,
        separation_px_min: 2.0,
        ..SensingSettings::default()
    };
    let abeam = seen_from_origin(sensing, &[Vector3::y() * 2.0]);
    assert_eq!(abeam[0].separation_px, None);
    let ahead = seen_from_origin(sensing, &[Vector3::x() * 2.0]);
    assert!((ahead[0].separation_px.unwrap() - 9.05).abs() < 1e-9);
}

#[test]
fn a_cylinder_hides_and_is_hit() {
    let cylinder = Cylinder {
        x_m: 5.0,
        y_m: 0.0,
        radius_m: 0.5,
    };
    let origin = Vector3::zeros();
    assert!(cylinder.hides(&origin, &Vector3::new(9.0, 0.2, 1.0)));
    assert!(!cylinder.hides(&origin, &Vector3::new(4.0, 0.2, 1.0)));
    assert!(cylinder.is_hit_by(&Vector3::new(4.46, 0.0, 2.0)));
    assert!(!cylinder.is_hit_by(&Vector3::new(4.4, 0.0, 2.0)));
}

fn camera_ahead() -> SwarmCamera {
    let axes = nalgebra::Matrix3::from_columns(&[-Vector3::y(), -Vector3::z(), Vector3::x()]);
    let intrinsics = camera::Intrinsics {
        fx: 181.0,
        fy: 181.0,
        cx: 161.5,
        cy: 121.5,
    };
    SwarmCamera {
        model: camera::CameraModel::new(324, 244, intrinsics, camera::Distortion::None).unwrap(),
        heading_from_camera: nalgebra::UnitQuaternion::from_matrix(&axes),
    }
}

/// What drone 0 at the origin takes of the others without noise.
fn pictured(others: &[Vector3<f64>], sensing: SensingSettings) -> camera::Image {
    let mut swarm = around_origin(sensing, others);
    let settings = PictureSettings {
        noise: 0.0,
        ..PictureSettings::default()
    };
    let studio = Studio::new(vec![camera_ahead()], &settings, 3);
    swarm.picture(0, &studio, 0)
}

/// Pixels that are brighter than any background.
fn bright_pixels(image: &camera::Image) -> Vec<[f64; 2]> {
    let width = image.width();
    let bright = image.pixels().iter().enumerate();
    bright
        .filter(|(_, shade)| **shade > 150)
        .map(|(idx, _)| [(idx % width) as f64, (idx / width) as f64])
        .collect()
}

/// Goal: the two lights are where the pinhole's formula puts them. Method: bright pixels of a
/// round spot surround its centre, so that their mean is good to half a pixel.
#[test]
fn pictures_show_lights_in_their_places() {
    let image = pictured(&[Vector3::new(2.0, 0.5, 0.3)], SensingSettings::default());
    let pixels = bright_pixels(&image);
    let expected_u = 161.5 - 181.0 * 0.25;
    for height_m in [0.35, 0.25] {
        let expected_v = 121.5 - 181.0 * height_m / 2.0;
        let near: Vec<&[f64; 2]> = pixels
            .iter()
            .filter(|[_, v]| (v - expected_v).abs() < 4.0)
            .collect();
        let mean = |axis: usize| near.iter().map(|at| at[axis]).sum::<f64>() / near.len() as f64;
        assert!(
            (mean(0) - expected_u).abs() < 0.5,
            "{} {expected_u}",
            mean(0)
        );
        assert!(
            (mean(1) - expected_v).abs() < 0.5,
            "{} {expected_v}",
            mean(1)
        );
    }
}

#[test]
fn pictures_hide_what_is_behind_a_body_or_unlit() {
    let near = Vector3::new(1.0, 0.0, 0.0);
    let far = Vector3::new(4.0, 0.0, 0.0);
    let ideal = SensingSettings::default();
    assert!(!bright_pixels(&pictured(&[far], ideal)).is_empty());
    let unlit = |unlit| SensingSettings { unlit, ..ideal };
    // The last one is in front of the other.
    assert!(bright_pixels(&pictured(&[far, near], unlit(1))).is_empty());
    let beside = Vector3::new(4.0, 1.0, 0.0);
    assert!(!bright_pixels(&pictured(&[beside, near], unlit(1))).is_empty());
}

#[test]
fn a_dropped_drone_is_gone_after_a_while() {
    let mut settings = SwarmSettings {
        drone_count: 2,
        dropped: 1,
        ..SwarmSettings::default()
    };
    settings.sensing.azimuth_rad_max = 4.0;
    let mut swarm = swarm(settings);
    swarm.now.positions = vec![Vector3::zeros(), Vector3::new(3.0, 0.0, 0.0)];
    let mut glimpses = Vec::new();
    let steps = (FAULT_AFTER_S / STEP_S).round() as usize;
    for _ in 0..=steps + 1 {
        assert_eq!(swarm.is_aloft(1), swarm.step_count <= steps);
        swarm.glimpses(0, &mut glimpses);
        assert_eq!(glimpses.len(), usize::from(swarm.is_aloft(1)));
        swarm.advance(&[Steering::default(); 2]);
    }
}

#[test]
fn a_blinded_drone_sees_again() {
    let mut settings = SwarmSettings::default();
    settings.sensing.blinded = 1;
    settings.sensing.blinded_s = 5.0;
    let mut swarm = swarm(settings);
    let mut blind_count = 0;
    for _ in 0..400 {
        blind_count += usize::from(swarm.is_blinded(0));
        assert!(!swarm.is_blinded(1));
        swarm.advance(&[Steering::default(); 3]);
    }
    assert_eq!(blind_count, 50);
}
