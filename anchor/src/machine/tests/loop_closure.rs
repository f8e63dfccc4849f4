//! What a correction of the map's scale does to what was published.

use std::collections::BTreeMap;
use std::time::Duration;

use geometry::{Chunk, Enu, Similarity};

use super::*;

/// By how much the loop closure makes the map larger.
const STRETCH: f64 = 1.3;

/// What a receiver makes of placements and pages.
#[derive(Default)]
struct Receiver {
    enu_from_map: Option<Similarity<Enu, geometry::Map>>,
    map_from_chunk: BTreeMap<protocol::ChunkNumber, Similarity<geometry::Map, Chunk>>,
}

impl Receiver {
    fn take(&mut self, effects: impl IntoIterator<Item = Effect>) {
        for effect in effects {
            match effect {
                Effect::PublishPlacement(one) => self.enu_from_map = Some(one.enu_from_map),
                Effect::PublishPage(page) => self.map_from_chunk.extend(
                    page.placements()
                        .map(|one| (one.number, one.map_from_chunk)),
                ),
                _ => {}
            }
        }
    }

    fn enu_from_chunks(&self) -> Vec<Similarity<Enu, Chunk>> {
        let enu_from_map = self.enu_from_map.unwrap();
        let chunks = self.map_from_chunk.values();
        chunks.map(|one| enu_from_map * *one).collect()
    }
}

#[test]
fn chunks_stay_where_they_are_when_a_loop_closure_stretches_the_map() {
    let frames = fly(with_a_turn, 20.0, &TYPICAL_DRIFT, 3);
    let mut anchor = Anchor::new(settings(), EPOCH);
    let mut receiver = Receiver::default();
    let effects = run(&mut anchor, &frames, 0.02).into_iter();
    receiver.take(effects.map(|(_, effect)| effect));
    let mut now = frames
        .last()
        .unwrap()
        .captured_at
        .after(Duration::from_secs(1));
    receiver.take(anchor.handle(Event::Tick, now));
    let before = receiver.enu_from_chunks();

    let stretched = frames.iter().filter_map(Frame::keyframe_pose).map(|pose| {
        let map_from_camera = &pose.map_from_camera;
        let way = map_from_camera.translation() * STRETCH;
        KeyframePose {
            map_from_camera: geometry::Transform::new(*map_from_camera.rotation(), way),
            unit: pose.unit * STRETCH,
            ..pose
        }
    });
    receiver.take(anchor.handle(Event::KeyframesMoved(stretched.collect()), now));
    for _ in 0..3 {
        now = now.after(Duration::from_secs(1));
        receiver.take(anchor.handle(Event::Tick, now));
    }
    assert_eq!(anchor.state().0, VehicleState::Global);
    let after = receiver.enu_from_chunks();
    assert_eq!(after.len(), before.len());
    for (before, after) in before.iter().zip(after) {
        // Half a sigma of 0.02 m fixes is not worth a message; the content is 1 to 2 units away.
        let content = Vector3::new(0.0, 0.0, 1.5);
        let moved_m = (*before * content - after * content).norm();
        assert!(moved_m < 0.05, "{moved_m} m");
        assert!((after.scale() / before.scale() - 1.0).abs() < 0.03);
    }
}
