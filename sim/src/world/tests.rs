use super::*;

#[test]
fn a_seed_gives_one_lab_and_another_seed_another() {
    assert_eq!(World::lab(7), World::lab(7));
    assert_ne!(World::lab(7), World::lab(8));
}

#[test]
fn everything_stands_in_the_room() {
    for seed in 1..=20 {
        let world = World::lab(seed);
        assert!(world.panels.len() < 2000, "{}", world.panels.len());
        let half = world.size_m * 0.5;
        for panel in &world.panels {
            assert!((panel.right.norm() - 1.0).abs() < 1e-9);
            assert!(panel.right.dot(&panel.down).abs() < 1e-9);
            for corner in panel.corners() {
                let beyond = (corner.abs() - half).max();
                assert!(corner.x.abs() <= half.x + 0.08, "seed {seed}: {beyond}");
                assert!(corner.y.abs() <= half.y + 0.08, "seed {seed}: {beyond}");
                assert!(corner.z >= -1e-9 && corner.z <= world.size_m.z + 1e-9);
            }
        }
    }
}

#[test]
fn walls_face_the_room_and_boxes_face_away_from_their_middle() {
    let world = World::lab(3);
    let centre = Vector3::new(0.0, 0.0, 0.5 * world.size_m.z);
    for panel in &world.panels[..6] {
        let middle = panel.point(0.5 * panel.width_m, 0.5 * panel.height_m);
        assert!((centre - middle).dot(&panel.normal()) > 0.0);
    }
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let extents = Vector3::new(0.4, 0.2, 0.3);
    let cuboid = Cuboid::standing(Vector3::new(1.0, 2.0, 0.5), extents, 0.4);
    let faces = cuboid.outer_faces(Finish::Crate, &mut rng);
    assert_eq!(faces.len(), 6);
    for panel in faces {
        let middle = panel.point(0.5 * panel.width_m, 0.5 * panel.height_m);
        let outward = (middle - cuboid.centre).normalize();
        assert!((outward - panel.normal()).norm() < 1e-9);
        // Upright faces are seen upright.
        assert!(panel.down.z <= 1e-12);
    }
}

#[test]
fn rays_end_at_walls() {
    let world = World::lab(5);
    let surroundings = Surroundings::new(&world);
    let origin = Vector3::new(0.0, 0.0, world.size_m.z - 0.2);
    let length_m = surroundings.ray_length_m(&origin, &Vector3::x()).unwrap();
    assert!((length_m - 0.5 * world.size_m.x).abs() < 1e-4);
    assert!((surroundings.clearance_m(&origin) - 0.2).abs() < 1e-4);
    let wall = Vector3::new(0.5 * world.size_m.x, 0.0, origin.z);
    assert!(surroundings.sees(&origin, &wall));
    assert!(!surroundings.sees(&origin, &(wall * 1.1)));
}

#[test]
fn a_twin_has_the_same_furniture_and_other_contents() {
    let room = World::parlour(4);
    let likeness = Likeness {
        furniture: 0.8,
        contents: 0.2,
    };
    let twin = room.twin(&likeness, 1);
    assert_eq!(twin, room.twin(&likeness, 1));
    assert_ne!(twin, room.twin(&likeness, 2));
    let of = |world: &World, finish| -> Vec<Panel> {
        let panels = world.panels.iter();
        panels.filter(|one| one.finish == finish).cloned().collect()
    };
    let same_count = |finish| {
        let pairs = of(&room, finish).into_iter().zip(of(&twin, finish));
        pairs.filter(|(own, other)| own == other).count()
    };
    let metal_count = of(&room, Finish::Metal).len();
    assert_eq!(metal_count, of(&twin, Finish::Metal).len());
    assert!(2 * same_count(Finish::Metal) > metal_count);
    assert_eq!(same_count(Finish::Plaster), 0);
    assert!(of(&twin, Finish::Cardboard).len() < of(&room, Finish::Cardboard).len());
    assert_eq!(same_count(Finish::Window), of(&room, Finish::Window).len());
    let alike = Likeness {
        furniture: 1.0,
        contents: 1.0,
    };
    let contents = |world: &World| of(world, Finish::Cardboard);
    assert_eq!(contents(&room.twin(&alike, 3)), contents(&room));
}
