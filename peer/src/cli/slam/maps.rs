//! Which maps the frames of a run ended in.

use std::path::Path;

use serde::Serialize;
use vslam::{MapId, TrajectoryEntry};

/// A map that was never joined to the others, and the frames with a pose in it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct MapFrames {
    id: u32,
    frames: usize,
    /// Poses of different maps share neither origin nor scale: a file holds those of one.
    in_trajectory: bool,
}

/// That of the trajectory, whatever is in it, then the others by their frames.
pub fn frames_by_map(trajectory: &[TrajectoryEntry], written: MapId) -> Vec<MapFrames> {
    let mut maps = vec![MapFrames {
        id: written.0,
        frames: 0,
        in_trajectory: true,
    }];
    let posed = trajectory
        .iter()
        .filter(|entry| entry.map_from_camera.is_some());
    for entry in posed {
        match maps.iter_mut().find(|map| map.id == entry.map_id.0) {
            Some(map) => map.frames += 1,
            None => maps.push(MapFrames {
                id: entry.map_id.0,
                frames: 1,
                in_trajectory: false,
            }),
        }
    }
    maps[1..].sort_by_key(|map| std::cmp::Reverse(map.frames));
    maps
}

/// For a person, that a trajectory is not of all frames that were tracked.
///
/// - `live_left_out`: frames that had a pose when they came and are not in it.
pub fn warning(maps: &[MapFrames], live_left_out: usize, out: &Path) -> Option<String> {
    let (written, others) = maps.split_first()?;
    if others.is_empty() && live_left_out == 0 {
        return None;
    }
    let live = format!(
        "{live_left_out} frames had a pose when they came and are not in {}",
        out.display()
    );
    if others.is_empty() {
        return Some(format!(
            "{live}: their maps were given up, or the poses were"
        ));
    }
    let others: Vec<String> = others
        .iter()
        .map(|map| format!("{} in map {}", map.frames, map.id))
        .collect();
    Some(format!(
        "{} maps were never joined: {} of the frames are in map {}, which alone is in {}; left \
         out are {}, whose poses share neither origin nor scale with it ({live})",
        maps.len(),
        written.frames,
        written.id,
        out.display(),
        others.join(", ")
    ))
}

#[cfg(test)]
mod tests {
    use geometry::{Timestamp, Transform};

    use super::*;

    #[test]
    fn maps_that_were_never_joined_are_told() {
        let entry = |frame_idx: u64, map_id, is_posed: bool| TrajectoryEntry {
            frame_idx,
            captured_at: Timestamp::from_nanoseconds(frame_idx as i64),
            map_id: MapId(map_id),
            map_from_camera: is_posed.then(Transform::identity),
        };
        let trajectory = [
            entry(0, 4, true),
            entry(1, 2, true),
            entry(2, 5, true),
            entry(3, 5, true),
            entry(4, 7, false),
        ];
        let maps = frames_by_map(&trajectory, MapId(2));
        let told: Vec<_> = maps
            .iter()
            .map(|map| (map.id, map.frames, map.in_trajectory))
            .collect();
        assert_eq!(told, [(2, 1, true), (5, 2, false), (4, 1, false)]);
        let warning_of = |maps: &[MapFrames], left_out| warning(maps, left_out, Path::new("o.tum"));
        let text = warning_of(&maps, 3).unwrap();
        assert!(
            text.starts_with("3 maps were never joined: 1 of the frames"),
            "{text}"
        );
        assert!(
            text.contains("left out are 2 in map 5, 1 in map 4"),
            "{text}"
        );
        // A map that was continued in vain is that of the trajectory nevertheless.
        let maps = frames_by_map(&trajectory[4..], MapId(2));
        assert_eq!((maps.len(), maps[0].frames), (1, 0));
        assert_eq!(warning_of(&maps, 0), None);
        assert!(
            warning_of(&maps, 2)
                .unwrap()
                .starts_with("2 frames had a pose")
        );
    }
}
