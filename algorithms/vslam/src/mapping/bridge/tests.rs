use features::Descriptor;

use geometry::{Camera, Map, Timestamp, Transform};
use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3};

use super::*;
use crate::frame::Frame;
use crate::map::{ExpectedRange, NewPoint};
use crate::plane_grid::PlaneGrid;
use crate::{MapId, Observation, PointId, View};

const SIGMA: f64 = 0.002;
const PLACED: usize = 6;
const HALF_VIEW_RAD: f64 = 0.5;
/// What is expected of everything that is new, which is 3 to 5 m away.
const EXPECTED: ExpectedRange = ExpectedRange {
    inverse_range: 0.2,
    sigma: 0.12,
};

/// Where a camera is, and where it looks.
#[derive(Clone, Copy)]
struct Stand {
    centre: Vector3<f64>,
    yaw_rad: f64,
}

impl Stand {
    fn camera_from_map(&self) -> Transform<Camera, Map> {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -self.yaw_rad);
        Transform::new(rotation, -(rotation * self.centre))
    }

    fn sees(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let point_in_camera = self.camera_from_map() * *point;
        let position = point_in_camera.xy() / point_in_camera.z;
        let is_seen = point_in_camera.z > 0.1 && position.amax() < HALF_VIEW_RAD.tan();
        is_seen.then_some(position)
    }
}

/// Things all around, at different distances.
fn things() -> Vec<Vector3<f64>> {
    let thing = |idx: usize| {
        let even = |step: f64| (step * idx as f64).fract();
        let azimuth_rad = -0.6 + 3.6 * even(0.754_878);
        let distance = 3.0 + 2.0 * even(0.323_1);
        let height = 1.6 * (even(0.569_840) - 0.5);
        Vector3::new(azimuth_rad.sin(), height, azimuth_rad.cos()) * distance
    };
    (0..1500).map(thing).collect()
}

/// A camera that walks sidewards, and turns then with these yaws, a step of `step_m` each.
fn stands(step_m: f64, yaws_rad: &[f64]) -> Vec<Stand> {
    let walk = (0..PLACED).map(|idx| Stand {
        centre: Vector3::x() * (0.1 * idx as f64),
        yaw_rad: 0.0,
    });
    let entry = Vector3::x() * (0.1 * (PLACED - 1) as f64);
    let step = Vector3::new(0.6, 0.1, 0.8) * step_m;
    let turn = (1..).zip(yaws_rad).map(|(idx, &yaw_rad)| Stand {
        centre: entry + step * f64::from(idx),
        yaw_rad,
    });
    walk.chain(turn).collect()
}

/// The things that a camera sees, and where, with some noise.
fn seen_from(stand: &Stand, things: &[Vector3<f64>]) -> Vec<(usize, Observation)> {
    let phase = (1e3 * stand.centre.sum() + 1e2 * stand.yaw_rad).abs();
    let noise = |idx: usize, step: f64| SIGMA * ((step * (idx as f64 + phase)).fract() - 0.5);
    let observation = |(idx, thing): (usize, &Vector3<f64>)| {
        let noise = Vector2::new(noise(idx, 0.618_034), noise(idx, 0.414_214));
        let observation = Observation {
            position: stand.sees(thing)? + noise,
            position_px: Vector2::zeros(),
            sigma: SIGMA,
            level: 0,
            angle_rad: 0.0,
            descriptor: Descriptor([0; 4]),
            point: None,
        };
        Some((idx, observation))
    };
    things.iter().enumerate().filter_map(observation).collect()
}

/// The map of a camera that knows the range of all that it saw while it walked, and took half of
/// each step of its turn for granted.
fn map_of(stands: &[Stand]) -> (VslamMap, Vec<KeyframeId>) {
    let entry = stands[PLACED - 1].centre;
    let believed = |(idx, stand): (usize, &Stand)| Stand {
        centre: match idx {
            0..PLACED => stand.centre,
            _ => entry + (stand.centre - entry) * 0.5,
        },
        ..*stand
    };
    let believed: Vec<Stand> = stands.iter().enumerate().map(believed).collect();
    let things = things();
    let mut map = VslamMap::new(MapId(0), KeyframeId(0), PointId(0));
    let mut views: Vec<Vec<View>> = vec![Vec::new(); things.len()];
    let mut keyframes = Vec::new();
    for (idx, stand) in stands.iter().enumerate() {
        let (seen, observations): (Vec<usize>, _) = seen_from(stand, &things).into_iter().unzip();
        let frame = Frame {
            frame_idx: idx as u64,
            captured_at: Timestamp::from_nanoseconds(idx as i64 * 200_000_000),
            observations,
            grid: PlaneGrid::default(),
        };
        let keyframe = map.add_keyframe(frame, believed[idx].camera_from_map());
        for (observation_idx, thing) in (0..).zip(seen) {
            views[thing].push(View {
                keyframe,
                observation_idx,
            });
        }
        keyframes.push(keyframe);
    }
    for (thing, views) in things
        .iter()
        .zip(views)
        .filter(|(_, views)| views.len() > 1)
    {
        let first = keyframes.iter().position(|id| *id == views[0].keyframe);
        let first = first.expect("the keyframes are the map's");
        let is_known = first + 1 < PLACED;
        let ray = (thing - stands[first].centre).normalize();
        let guess = believed[first].centre + ray / EXPECTED.inverse_range;
        let new = NewPoint {
            position_in_map: if is_known { *thing } else { guess },
            covariance_in_map: Matrix3::identity() * 1e-4,
            parallax_rad: 0.1,
            expected_range: (!is_known).then_some(EXPECTED),
        };
        map.add_point(new, views);
    }
    (map, keyframes)
}

fn ranged_count(map: &VslamMap) -> usize {
    map.points().filter(|point| point.has_range()).count()
}

fn error_m(map: &VslamMap, id: KeyframeId, stand: &Stand) -> f64 {
    (map.keyframe(id).unwrap().centre_in_map() - stand.centre).norm()
}

#[test]
fn a_turn_is_crossed_by_what_only_its_keyframes_saw() {
    let stands = stands(0.25, &[0.4, 0.75, 1.1, 1.45]);
    let (mut map, keyframes) = map_of(&stands);
    let newest = *keyframes.last().unwrap();
    assert!(!is_placed(&map, map.keyframe(newest).unwrap()));
    let before = ranged_count(&map);
    let (free, shift) = bridge(&mut map, newest, &mut Workspace::default()).unwrap();
    assert!(free.contains(&newest) && shift > 0.3, "{shift}");
    for (id, stand) in keyframes.iter().zip(&stands) {
        let error_m = error_m(&map, *id, stand);
        assert!(error_m < 0.01, "{id:?}: {error_m}");
    }
    assert!(is_placed(&map, map.keyframe(newest).unwrap()));
    assert!(ranged_count(&map) > before + 50, "{}", ranged_count(&map));
    let truth = things();
    let wrong = map
        .points()
        .filter(|point| point.has_range())
        .filter(|point| {
            let distance = |thing: &Vector3<f64>| (thing - point.position_in_map()).norm();
            truth.iter().map(distance).fold(f64::INFINITY, f64::min) > 0.2
        });
    // The least parallax tells a range by a fifth.
    assert!(wrong.count() * 20 < ranged_count(&map) - before);
}

#[test]
fn a_turn_on_the_spot_places_nothing() {
    // In truth it stays; the believed places are those, so only the length of the step refuses.
    for step_m in [0.0, 0.02] {
        let (mut map, keyframes) = map_of(&stands(step_m, &[0.4, 0.75, 1.1]));
        let newest = *keyframes.last().unwrap();
        assert!(!is_placed(&map, map.keyframe(newest).unwrap()));
        let before = ranged_count(&map);
        assert_eq!(bridge(&mut map, newest, &mut Workspace::default()), None);
        assert_eq!(ranged_count(&map), before);
    }
}

#[test]
fn what_hangs_on_nothing_known_stays_as_it_is() {
    // The last two see nothing that any other has seen: how far they went apart is anyone's guess.
    let (mut map, keyframes) = map_of(&stands(0.25, &[0.4, 0.75, 2.0, 2.2]));
    let newest = *keyframes.last().unwrap();
    let poses = |map: &VslamMap| -> Vec<_> {
        let poses = map.keyframes().map(|one| *one.camera_from_map());
        poses.collect()
    };
    let (before, ranged_before) = (poses(&map), ranged_count(&map));
    assert_eq!(bridge(&mut map, newest, &mut Workspace::default()), None);
    assert_eq!((poses(&map), ranged_count(&map)), (before, ranged_before));
}

#[test]
fn a_placed_keyframe_needs_no_bridge() {
    let (mut map, keyframes) = map_of(&stands(0.25, &[]));
    let newest = *keyframes.last().unwrap();
    assert_eq!(bridge(&mut map, newest, &mut Workspace::default()), None);
}
