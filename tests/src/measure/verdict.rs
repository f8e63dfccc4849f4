//! Whether poses that were called good were good.

use geometry::{Camera, Enu, Map, Transform, umeyama};

/// A pose given while the state said tracking, and the truth.
#[derive(Clone, Copy, Debug)]
pub struct LivePose {
    pub frame_idx: usize,
    /// Poses of different maps share no frame of reference.
    pub map_id: u32,
    /// A map that was corrected or joined to another has moved: later poses of it are not
    /// compared with those before.
    pub map_revision: u64,
    pub map_from_camera: Transform<Map, Camera>,
    pub site_from_camera: Transform<Enu, Camera>,
}

/// The worst pose of the maps that say enough.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Verdict {
    /// The error of the worst pose over the distance travelled in its map.
    pub worst_share: f64,
    pub worst_frame_idx: usize,
    pub worst_map_id: u32,
    /// Travelled in that map, metres.
    pub distance_m: f64,
    /// Maps that were compared, each revision for itself.
    pub map_count: usize,
}

/// A pose that is further off than this share of the distance travelled is wrong.
pub const WRONG_SHARE: f64 = 0.05;
/// A map says too little if fewer frames were tracked in it, or over a shorter way: the alignment
/// would take up all errors, or a few millimetres would count as large.
const FRAME_COUNT_MIN: usize = 10;
const DISTANCE_M_MIN: f64 = 0.3;

impl Verdict {
    pub fn is_wrong(&self) -> bool {
        self.worst_share > WRONG_SHARE
    }
}

/// Compares each map's live poses with the truth after Sim(3) alignment of that map, as it was
/// between two corrections; the distance travelled is that in the map until then, corrections
/// included.
pub fn verdict(poses: &[LivePose]) -> Verdict {
    let mut verdict = Verdict::default();
    let key = |pose: &LivePose| (pose.map_id, pose.map_revision);
    let mut keys: Vec<(u32, u64)> = poses.iter().map(key).collect();
    keys.sort_unstable();
    keys.dedup();
    for wanted in keys {
        let of_map = |pose: &&LivePose| key(pose) == wanted;
        let of_map: Vec<&LivePose> = poses.iter().filter(of_map).collect();
        if of_map.len() < FRAME_COUNT_MIN || distance_m(&of_map) < DISTANCE_M_MIN {
            continue;
        }
        let last_frame_idx = of_map.iter().map(|pose| pose.frame_idx).max();
        let until_then = poses
            .iter()
            .filter(|pose| pose.map_id == wanted.0 && Some(pose.frame_idx) <= last_frame_idx);
        let distance_m = distance_m(&until_then.collect::<Vec<_>>());
        let places = of_map.iter().map(|pose| {
            let truth = *pose.site_from_camera.translation();
            (truth, *pose.map_from_camera.translation(), 1.0)
        });
        let Ok(site_from_map) = umeyama::<Enu, Map>(places.clone(), true) else {
            continue;
        };
        verdict.map_count += 1;
        for (pose, (truth, own, _)) in of_map.iter().zip(places) {
            let share = (site_from_map * own - truth).norm() / distance_m;
            if share > verdict.worst_share {
                verdict.worst_share = share;
                verdict.worst_frame_idx = pose.frame_idx;
                verdict.worst_map_id = wanted.0;
                verdict.distance_m = distance_m;
            }
        }
    }
    verdict
}

/// The true way over the frames of a map, straight where it was lost.
fn distance_m(poses: &[&LivePose]) -> f64 {
    let steps = poses.windows(2).map(|pair| {
        let [from, to] = [pair[0], pair[1]].map(|pose| pose.site_from_camera.translation());
        (to - from).norm()
    });
    steps.sum()
}

#[cfg(test)]
mod tests {
    use geometry::so3;
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    /// Frames on an arc of two metres; `bend` moves the estimate.
    fn arc(map_id: u32, bend: impl Fn(usize) -> Vector3<f64>) -> Vec<LivePose> {
        (0..40)
            .map(|frame_idx| {
                let angle_rad = 0.05 * frame_idx as f64;
                let place = Vector3::new(angle_rad.sin(), 1.0 - angle_rad.cos(), 0.0);
                let own = so3::exp(&Vector3::new(0.1, 0.2, 0.3)) * (place + bend(frame_idx)) * 3.0;
                LivePose {
                    frame_idx,
                    map_id,
                    map_revision: 0,
                    map_from_camera: Transform::new(UnitQuaternion::identity(), own),
                    site_from_camera: Transform::new(UnitQuaternion::identity(), place),
                }
            })
            .collect()
    }

    #[test]
    fn another_frame_and_scale_are_no_error() {
        let verdict = verdict(&arc(3, |_| Vector3::zeros()));
        assert!(verdict.worst_share < 1e-9 && verdict.map_count == 1);
        assert!((verdict.distance_m - 1.95).abs() < 0.01);
    }

    #[test]
    fn one_pose_that_jumps_is_wrong() {
        let jump = |frame_idx| Vector3::z() * if frame_idx == 17 { 0.15 } else { 0.0 };
        let verdict = verdict(&arc(0, jump));
        assert!(verdict.is_wrong());
        assert_eq!(verdict.worst_frame_idx, 17);
    }

    #[test]
    fn maps_are_judged_apart_and_short_ones_not() {
        let mut poses = arc(0, |_| Vector3::zeros());
        poses.extend(arc(1, |_| Vector3::new(5.0, 0.0, 2.0)));
        assert!(verdict(&poses).worst_share < 1e-9);
        let mut corrected = arc(1, |_| Vector3::new(9.0, 1.0, 0.0));
        for pose in &mut corrected {
            pose.map_revision = 1;
        }
        poses.extend(corrected);
        assert!(verdict(&poses).worst_share < 1e-9);
        // A correction shortens no way.
        let jump = |frame_idx| Vector3::z() * if frame_idx == 17 { 0.15 } else { 0.0 };
        let mut longer = poses.clone();
        longer.extend(arc(1, jump).into_iter().map(|pose| LivePose {
            map_revision: 2,
            ..pose
        }));
        let verdict_of_longer = verdict(&longer);
        assert!(!verdict_of_longer.is_wrong() && verdict_of_longer.distance_m > 4.0);
        let jump = |frame_idx| Vector3::z() * frame_idx as f64;
        poses.extend(arc(2, jump).into_iter().take(5));
        assert_eq!(verdict(&poses).map_count, 3);
    }
}
