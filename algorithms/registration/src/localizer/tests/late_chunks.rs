//! Chunks that come after the keyframes that see them.

use super::*;

/// Goal: what was seen before its map came is located when it comes. Method: eight keyframes, then
/// the chunks, and no keyframe after them.
#[test]
fn old_keyframes_are_located_in_new_chunks() {
    let mut scene = scene(21, 1.0);
    for step in 0..8 {
        scene.step(step);
    }
    assert!(scene.localizer.retry().is_none(), "nothing has come");
    scene.publish(&AnchorSettings::default());
    assert!(scene.estimate().is_none());
    let reports: Vec<_> = std::iter::from_fn(|| scene.localizer.retry()).collect();
    assert!((2..=4).contains(&reports.len()), "{}", reports.len());
    assert!(scene.position_error().unwrap().0 < 0.08);
    // What was located is not tried again; later keyframes go on from there.
    assert!(scene.localizer.retry().is_none());
    let report = scene.step(8);
    assert_eq!((report.verdict, report.jumped), (Verdict::Accepted, false));
}

/// Goal: the same with a vehicle that lost its map for a while. Method: half of the round is
/// mapped; the vehicle flies out of it, and the other half comes while it hovers.
#[test]
fn a_vehicle_that_left_the_map_is_found_where_the_map_grows_to() {
    let mut scene = scene(22, 2.0);
    scene.publish(&AnchorSettings {
        chunks: 0..8,
        ..AnchorSettings::default()
    });
    let last_located = (0..40).filter(|step| scene.step(*step).verdict == Verdict::Accepted);
    let last_located = last_located.last().unwrap();
    assert!(last_located < 38, "{last_located}");
    let captured_before = scene.estimate().unwrap().captured_at;
    scene.publish(&AnchorSettings::default());
    while scene.localizer.retry().is_some() {}
    let estimate = scene.estimate().unwrap();
    assert!(estimate.captured_at > captured_before);
    assert!(scene.position_error().unwrap().0 < 0.1);
}

/// Goal: the trajectory in hindsight follows the order of time. Method: a short window, and a
/// keyframe that is located only after later ones have left it.
#[test]
fn what_is_located_late_is_remembered_where_it_belongs() {
    let mut scene = scene(24, 1.0);
    scene.localizer.settings.window_keyframe_count = 3;
    scene.publish(&AnchorSettings::default());
    let mut late = None;
    for step in 0..12 {
        scene.flyer.fly_to(step);
        let keyframe = scene.flyer.keyframe(&scene.world);
        if step == 5 {
            late = Some(keyframe);
        } else {
            scene.localizer.observe_keyframe(&keyframe);
        }
    }
    let late = late.unwrap();
    let report = scene.localizer.observe_keyframe(&late);
    assert_eq!(report.verdict, Verdict::Accepted);
    let track = &scene.localizer.anchors[&AnchorIdx(0)].track;
    assert!(track.holds(late.id), "it would be located again");
    let times: Vec<_> = track.history().map(|entry| entry.captured_at).collect();
    assert_eq!(times.len(), 12);
    assert!(times.is_sorted(), "{times:?}");
}

/// Goal: corrections of the own map between a keyframe and its chunks are not lost.
#[test]
fn keyframes_that_wait_for_chunks_follow_the_own_map() {
    let laid_anew = Transform::<Map, Map>::new(
        UnitQuaternion::from_scaled_axis(Vector3::new(0.4, -0.3, 0.8)),
        Vector3::new(2.0, 0.5, -1.0),
    );
    let factor = 1.25;
    let mut places = Vec::new();
    for moves in [false, true] {
        let mut scene = scene(23, 0.0);
        let mut keyframes = Vec::new();
        for step in 0..6 {
            scene.step(step);
            keyframes.push(scene.localizer.newest.unwrap());
        }
        let (newest, mut map_from_camera) = keyframes[5];
        if moves {
            for (id, pose) in keyframes {
                scene.localizer.keyframe_stretched(id, factor);
                let way = pose.translation() * factor;
                let moved = laid_anew * Transform::<Map, Camera>::new(*pose.rotation(), way);
                scene.localizer.keyframe_moved(id, &moved);
                if id == newest {
                    map_from_camera = moved;
                }
            }
        }
        scene.publish(&AnchorSettings::default());
        while scene.localizer.retry().is_some() {}
        let estimate = scene.estimate().unwrap();
        places.push(*estimate.enu_from_camera(&map_from_camera).translation());
    }
    assert!((places[0] - places[1]).norm() < 0.01, "{places:?}");
}
