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

fn seen_from_origin(sensing: SensingSettings, others: &[Vector3<f64>]) -> Vec<Glimpse> {
    let mut swarm = swarm(SwarmSettings {
        drone_count: others.len() + 1,
        sensing,
        ..SwarmSettings::default()
    });
    swarm.now.positions[0] = Vector3::zeros();
    swarm.now.positions[1..].copy_from_slice(others);
    swarm.past.clear();
    swarm.past.push_back(swarm.now.clone());
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
