use super::*;
use crate::world::{Surroundings, World};

fn encounter(seed: u64, settings: &EncounterSettings) -> Option<(World, Encounter)> {
    let world = World::lab(seed);
    let surroundings = Surroundings::new(&world);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let encounter = Encounter::draw(&world, &surroundings, settings, &mut rng)?;
    Some((world, encounter))
}

#[test]
fn two_vehicles_see_one_place_from_the_angle_that_was_asked_for() {
    let settings = EncounterSettings {
        heights_m: [0.3, 1.5],
        angle_rad: [0.3, 0.5],
        shift: 0.0,
    };
    for seed in 1..=3 {
        let (world, Encounter { standpoints }) = encounter(seed, &settings).unwrap();
        let [low, high] = standpoints;
        assert_eq!((low.place.z, high.place.z), (0.3, 1.5));
        assert!((0.3..0.5).contains(&low.sight().angle(&high.sight())));
        assert!(world.encloses(&low.place) && world.encloses(&high.place));
    }
}

#[test]
fn a_visit_looks_at_its_focus_and_never_jumps() {
    let standpoint = Standpoint {
        place: Vector3::new(-1.0, 0.2, 0.3),
        focus: Vector3::new(-4.0, -0.5, 0.9),
    };
    let visit = Visit::new(&standpoint, 5);
    let mut last = visit.site_from_camera(0);
    for frame_idx in 1..visit.frame_count() {
        let here = visit.site_from_camera(frame_idx);
        let step_m = (here.translation() - last.translation()).norm();
        assert!(step_m < 0.15, "{frame_idx}: {step_m}");
        assert!((here.translation() - standpoint.place).norm() < 0.8);
        let focus = here.inverse() * standpoint.focus;
        let pixel = visit.camera().project(&focus).unwrap();
        assert!(
            visit.camera().contains(&pixel, 60.0),
            "{frame_idx}: {pixel}"
        );
        last = here;
    }
}
