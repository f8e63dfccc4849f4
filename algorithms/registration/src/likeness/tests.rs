use features::Descriptor;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

const GATES: Gates = Gates {
    reach: 1.2,
    bits_max: 64,
};

/// Goal: thin agreement is told from patches. Method: points on a wall of which every third
/// agrees, or all in a quarter of it, or hardly any.
#[test]
fn what_agrees_here_and_there_extends_over_all_and_a_poster_does_not() {
    let points: Vec<Vector3<f64>> = (0..900)
        .map(|idx| Vector3::new(f64::from(idx % 30), f64::from(idx / 30), 0.0))
        .collect();
    let extent = |agrees: &dyn Fn(usize) -> bool| {
        let agree: Vec<bool> = (0..900).map(agrees).collect();
        Evenness::of(&points, &agree).extent()
    };
    assert!(extent(&|idx| idx * 7919 % 97 < 32) > 0.8);
    let in_quarter = |idx: usize| idx % 30 < 15 && idx < 450;
    assert!((0.2..0.3).contains(&extent(&in_quarter)));
    let thin_quarter = |idx: usize| in_quarter(idx) && idx * 7919 % 97 < 60;
    assert!((0.2..0.36).contains(&extent(&thin_quarter)));
    assert_eq!(extent(&|idx| idx.is_multiple_of(60)), 0.0);
}

/// A wall of things, each with a look of its own.
fn wall() -> (Vec<Vector3<f64>>, Vec<Descriptor>) {
    let thing = |idx: u64| {
        let point = Vector3::new((idx % 40) as f64, (idx / 40) as f64, 0.0);
        (point, another_look(idx))
    };
    (0..1600).map(thing).unzip()
}

fn another_look(idx: u64) -> Descriptor {
    let mut rng = ChaCha8Rng::seed_from_u64(idx);
    Descriptor(std::array::from_fn(|_| rng.random()))
}

/// Goal: one place is told from two that share a part. Method: a wall against itself, seen so
/// differently that two of three things are not known again, and against one of which a third,
/// in patches, looks the same.
#[test]
fn a_wall_of_which_a_part_stands_elsewhere_too_is_another_wall() {
    let (points, descriptors) = wall();
    let likeness = |is_alike: &dyn Fn(usize) -> bool| {
        let looks = descriptors.iter().enumerate().map(|(idx, look)| {
            let other = another_look(10_000 + idx as u64);
            if is_alike(idx) { *look } else { other }
        });
        let looks: Vec<Descriptor> = looks.collect();
        let first = Things::new(&points, &descriptors);
        let second = Things::new(&points, &looks);
        Likeness::of([
            first.sought_in(&second, GATES).evenness,
            second.sought_in(&first, GATES).evenness,
        ])
    };
    let seen_differently = likeness(&|idx| idx * 7919 % 97 < 32);
    assert!(seen_differently.exceeds(EXTENT_MIN), "{seen_differently:?}");
    let shared = likeness(&|idx| (idx % 40 / 10 + idx / 400) % 4 == 0);
    assert!(shared.falls_short_of(EXTENT_MIN), "{shared:?}");
    assert_eq!(shared.count, 3200);
    let nothing = likeness(&|_| false);
    assert_eq!((nothing.extent, nothing.exceeds(EXTENT_MIN)), (0.0, false));
}

/// Goal: what the other map has not looked at does not speak against it.
#[test]
fn nobody_is_asked_where_the_other_map_has_nothing() {
    let (points, descriptors) = wall();
    let whole = Things::new(&points, &descriptors);
    let corner = Things::new(&points[..400], &descriptors[..400]);
    let found = whole.sought_in(&corner, GATES).evenness;
    // One row more: its things have three neighbours in the corner.
    assert!((400..=440).contains(&found.count), "{found:?}");
    assert!(found.extent() > 0.85, "{found:?}");
}

/// Goal: a few witnesses settle nothing, whatever they say.
#[test]
fn few_witnesses_settle_nothing() {
    let kind = |count: usize| Evenness {
        count,
        share: 1.0,
        share_nearby: 1.0,
    };
    assert!(!Likeness::of([]).exceeds(EXTENT_MIN));
    assert!(!Likeness::of([kind(9), kind(9)]).exceeds(EXTENT_MIN));
    assert!(Likeness::of([kind(15), kind(15)]).exceeds(EXTENT_MIN));
    let disagree = |count| {
        let share = 0.0;
        Likeness::of([Evenness {
            share,
            share_nearby: share,
            ..kind(count)
        }])
    };
    assert!(!Likeness::of([]).falls_short_of(EXTENT_MIN));
    assert!(!disagree(10).falls_short_of(EXTENT_MIN));
    assert!(disagree(100).falls_short_of(EXTENT_MIN));
    let half = Evenness {
        share: 0.3,
        share_nearby: 0.6,
        ..kind(60)
    };
    let unsettled = Likeness::of([half]);
    assert!(!unsettled.exceeds(EXTENT_MIN) && !unsettled.falls_short_of(EXTENT_MIN));
    let settled = Likeness::of([Evenness {
        count: 2000,
        ..half
    }]);
    assert!(settled.exceeds(EXTENT_MIN));
}

/// Goal: points that came later, without descriptors, are left out.
#[test]
fn points_without_descriptors_are_not_looked_at() {
    let (points, descriptors) = wall();
    let first = Things::new(&points, &descriptors[..800]);
    let second = Things::new(&points, &descriptors);
    let found = second.sought_in(&first, GATES).evenness;
    assert!((800..=840).contains(&found.count), "{found:?}");
}

fn seen_from(views: &[Bareness], extent: f64) -> Likeness {
    Likeness {
        count: 1000,
        extent,
        sigma: 0.1,
        bareness: Bareness::of_all(views).ratio(),
        presence: 0.45,
        displaced: 0.0,
    }
}

fn view(asked_count: usize, bare_count: usize, bare_beside_count: usize) -> Bareness {
    Bareness {
        asked_count,
        bare_count,
        beside_count: 8 * asked_count,
        bare_beside_count,
    }
}

/// Goal: corners that are not where they should be speak against a place, and views that show few
/// of them, or corners everywhere, do not.
#[test]
fn a_place_without_the_corners_is_another_place() {
    let right = seen_from(&[view(100, 30, 640), view(100, 20, 560)], 0.9);
    assert!((right.bareness.unwrap() - 0.333).abs() < 0.001, "{right:?}");
    assert!(right.exceeds(EXTENT_MIN) && !right.falls_short_of(EXTENT_MIN));
    let wrong = seen_from(&[view(100, 60, 640), view(100, 70, 560)], 0.9);
    assert!(!wrong.exceeds(EXTENT_MIN) && wrong.falls_short_of(EXTENT_MIN));
    let few = seen_from(&[view(14, 14, 112), view(14, 14, 112)], 0.9);
    assert_eq!(few.bareness, None);
    let together = seen_from(&[view(14, 14, 112); 3], 0.9);
    assert_eq!(
        together.bareness,
        Some(1.0),
        "in several views there are enough"
    );
    let everywhere = seen_from(&[view(100, 5, 40)], 0.9);
    assert_eq!(everywhere.bareness, None);
    assert!(seen_from(&[], 0.9).exceeds(EXTENT_MIN));
}

/// Goal: what looks alike over little of the place needs its corners the more.
#[test]
fn the_less_is_alike_the_more_corners_are_asked_for() {
    let half = [view(100, 50, 640)];
    assert!(seen_from(&half, 0.7).exceeds(EXTENT_MIN));
    assert!(!seen_from(&half, 0.55).exceeds(EXTENT_MIN));
    assert!(
        !seen_from(&half, 0.55).falls_short_of(EXTENT_MIN),
        "unsettled"
    );
}

/// Goal: other things that stand there, and things that hang elsewhere, speak against a place.
#[test]
fn other_things_and_displaced_ones_speak_against_a_place() {
    let with = |presence: f64, displaced: f64| Likeness {
        presence,
        displaced,
        ..seen_from(&[], 0.6)
    };
    assert!(with(0.45, 0.0).exceeds(EXTENT_MIN));
    for unsettled in [with(0.2, 0.0), with(0.45, 0.2)] {
        assert!(!unsettled.exceeds(EXTENT_MIN) && !unsettled.falls_short_of(EXTENT_MIN));
    }
    assert!(with(0.1, 0.0).falls_short_of(EXTENT_MIN));
    assert!(with(0.45, 0.4).falls_short_of(EXTENT_MIN));
}

/// A wall seen so differently on one side, or with such things there, that nothing on it looks
/// alike.
fn half_known(change: impl Fn(&Vector3<f64>) -> Vector3<f64>) -> Likeness {
    let (points, descriptors) = wall();
    let other = points.iter().zip(&descriptors).map(|(point, look)| {
        if point.x < 20.0 {
            (*point, *look)
        } else {
            (change(point), Descriptor(look.0.map(|word| !word)))
        }
    });
    let (places, looks): (Vec<_>, Vec<_>) = other.unzip();
    let maps = [
        Things::new(&points, &descriptors),
        Things::new(&places, &looks),
    ];
    Likeness::between([&maps[0], &maps[1]], GATES, [])
}

/// Goal: things that look otherwise, but stand where they should, are told from other things.
#[test]
fn corners_stand_where_they_should_although_they_look_otherwise() {
    let same = half_known(|point| *point);
    assert!(same.presence > 0.9, "{same:?}");
    let others = half_known(|point| point + Vector3::new(0.41, 0.37, 0.0));
    assert!(others.presence < 0.1, "{others:?}");
}

/// Goal: what hangs elsewhere as a whole is told from noise. Method: a patch of a wall lies aside,
/// or every point of the wall by as much in a direction of its own.
#[test]
fn a_poster_that_hangs_elsewhere_is_displaced_and_noise_is_not() {
    let (points, descriptors) = wall();
    let displaced = |offset: &dyn Fn(usize) -> Vector3<f64>| {
        let places = points.iter().enumerate();
        let places: Vec<Vector3<f64>> = places.map(|(idx, point)| point + offset(idx)).collect();
        let maps = [&points, &places].map(|points| Things::new(points, &descriptors));
        Likeness::between([&maps[0], &maps[1]], GATES, []).displaced
    };
    let is_on_poster = |idx: usize| idx % 40 < 16 && idx < 640;
    let poster = |idx| match is_on_poster(idx) {
        true => Vector3::new(0.4, -0.3, 0.0),
        false => Vector3::zeros(),
    };
    // A tenth of the wall is the poster's inside, another fifth of that its rim.
    assert!(
        (0.11..0.18).contains(&displaced(&poster)),
        "{}",
        displaced(&poster)
    );
    let turned = |idx: usize| {
        let angle = (idx * 7919 % 97) as f64;
        Vector3::new(angle.cos(), angle.sin(), 0.0) * 0.5
    };
    assert!(displaced(&turned) < 0.02, "{}", displaced(&turned));
    assert_eq!(displaced(&|_| Vector3::zeros()), 0.0);
}
