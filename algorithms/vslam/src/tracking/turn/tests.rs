use features::Descriptor;
use nalgebra::Vector2;
use rand::SeedableRng;

use super::*;

fn observation(ray: &Vector3<f64>, descriptor: Descriptor) -> Observation {
    Observation {
        position: ray.xy() / ray.z,
        position_px: Vector2::zeros(),
        sigma: 0.002,
        level: 0,
        angle_rad: 0.0,
        descriptor,
        point: None,
    }
}

/// Two looks at 200 things 2 to 6 away; the camera turns and steps 5 cm aside between them.
fn looks(rng: &mut ChaCha8Rng, turn: &UnitQuaternion<f64>) -> [Vec<Observation>; 2] {
    let mut looks = [Vec::new(), Vec::new()];
    for _ in 0..200 {
        let mut side = || rng.random_range(-0.6..0.6);
        let ray = Vector3::new(side(), side(), 1.0);
        let point = ray * rng.random_range(2.0..6.0);
        let descriptor = Descriptor(std::array::from_fn(|_| rng.random()));
        let later = turn * (point - Vector3::new(0.05, 0.0, 0.0));
        looks[0].push(observation(&point, descriptor));
        looks[1].push(observation(&later, descriptor));
    }
    looks
}

#[test]
fn a_turn_is_told_among_wrong_matches_and_by_a_camera_that_also_moves() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let turn = UnitQuaternion::from_euler_angles(0.05, -0.3, 0.1);
    let [earlier, mut later] = looks(&mut rng, &turn);
    // Every third thing is mistaken for another one.
    for idx in (0..199).step_by(3) {
        let mistaken = later[idx].descriptor;
        later[idx].descriptor = later[idx + 1].descriptor;
        later[idx + 1].descriptor = mistaken;
    }
    let found = turn_between(&earlier, &later, &mut rng).unwrap();
    // A step of 5 cm shifts what is 2 to 6 away by 0.8 to 2.5 cm per unit.
    assert!(found.angle_to(&turn) < 0.025, "{}", found.angle_to(&turn));
}

#[test]
fn frames_that_share_nothing_tell_no_turn() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let turn = UnitQuaternion::identity();
    let [earlier, _] = looks(&mut rng, &turn);
    let [_, later] = looks(&mut rng, &turn);
    assert_eq!(turn_between(&earlier, &later, &mut rng), None);
    assert_eq!(turn_between(&earlier, &[], &mut rng), None);
}
