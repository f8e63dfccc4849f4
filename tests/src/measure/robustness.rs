//! Many short recordings under random conditions: nothing panics, and no wrong pose is called
//! good.

use std::panic::{AssertUnwindSafe, catch_unwind};

use geometry::{Camera, Enu, Transform};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::{Condition, Recording, RecordingSettings, RecordingWorld};
use vslam::{TrajectoryEntry, Vslam, VslamSettings};

use super::{LivePose, Verdict, verdict};

/// What one run came to.
#[derive(Clone, Debug)]
pub struct Trial {
    pub settings: RecordingSettings,
    pub frame_count: usize,
    pub live_count: usize,
    /// Of the poses that were given at once.
    pub verdict: Verdict,
    /// Frames that have a pose in the end.
    pub final_count: usize,
    /// Of the trajectory in the end: maps corrected and joined, and frames found afterwards.
    pub final_verdict: Verdict,
}

impl Trial {
    /// What was wrong, if anything was.
    pub fn fault(&self) -> Option<&'static str> {
        match (self.verdict.is_wrong(), self.final_verdict.is_wrong()) {
            (false, false) => None,
            (true, false) => Some("WRONG"),
            (false, true) => Some("WRONG IN THE END"),
            (true, true) => Some("WRONG, AND IN THE END"),
        }
    }
}

/// Each condition holds with this probability.
const CONDITION_SHARE: f64 = 0.3;

/// The recording of one run of a campaign: a world, its seed, 10 to 20 s of it, and conditions.
pub fn draw(campaign_seed: u64, run_idx: u64) -> RecordingSettings {
    let mut rng = ChaCha8Rng::seed_from_u64(campaign_seed ^ (run_idx << 32) ^ 0x7e57_0001);
    let world = RecordingWorld::MOVING[rng.random_range(0..RecordingWorld::MOVING.len())];
    let duration_s = rng.random_range(10.0..20.0);
    let mut conditions: Vec<Condition> = Vec::new();
    for condition in Condition::ALL {
        if rng.random_bool(CONDITION_SHARE) {
            conditions.push(condition);
        }
    }
    RecordingSettings {
        world,
        seed: rng.random_range(0..1_000_000),
        conditions,
        frame_count_max: Some((duration_s * world.frame_rate_hz()) as usize),
    }
}

/// Renders the recording frame by frame and tracks it.
pub fn run(settings: &RecordingSettings) -> Trial {
    let recording = Recording::new(settings.clone());
    let mut vslam = Vslam::new(recording.camera().clone(), VslamSettings::default());
    let mut poses = Vec::new();
    let mut truth = Vec::new();
    for frame in recording.frames() {
        let (report, _) = vslam.process(&frame.image, frame.captured_at);
        let pose = report.map_from_camera.map(|map_from_camera| LivePose {
            frame_idx: truth.len(),
            map_id: report.map_id.0,
            map_revision: report.map_revision,
            map_from_camera,
            site_from_camera: frame.site_from_camera,
        });
        poses.extend(pose);
        truth.push(frame.site_from_camera);
    }
    vslam.finish();
    let final_poses = final_poses(&vslam, &truth);
    Trial {
        settings: settings.clone(),
        frame_count: truth.len(),
        live_count: poses.len(),
        verdict: verdict(&poses),
        final_count: final_poses.len(),
        final_verdict: verdict(&final_poses),
    }
}

/// The trajectory as it is now, each map in one piece.
fn final_poses(vslam: &Vslam, truth: &[Transform<Enu, Camera>]) -> Vec<LivePose> {
    let entries = vslam.trajectory().into_iter().zip(truth).enumerate();
    let pose = |(frame_idx, (entry, truth)): (usize, (TrajectoryEntry, &_))| {
        Some(LivePose {
            frame_idx,
            map_id: entry.map_id.0,
            map_revision: 0,
            map_from_camera: entry.map_from_camera?,
            site_from_camera: *truth,
        })
    };
    entries.filter_map(pose).collect()
}

/// The same; `Err` has the message of a panic.
pub fn run_guarded(settings: &RecordingSettings) -> Result<Trial, String> {
    catch_unwind(AssertUnwindSafe(|| run(settings))).map_err(|panic| {
        let text = panic.downcast_ref::<String>().cloned();
        text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()))
            .unwrap_or_else(|| "a panic without a message".to_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_campaign_draws_every_world_and_the_same_again() {
        let drawn: Vec<RecordingSettings> = (0..60).map(|run_idx| draw(3, run_idx)).collect();
        for world in RecordingWorld::MOVING {
            assert!(drawn.iter().any(|it| it.world == world), "{world:?}");
        }
        for condition in Condition::ALL {
            assert!(drawn.iter().any(|it| it.conditions.contains(&condition)));
        }
        for (run_idx, settings) in (0..).zip(&drawn) {
            let frame_count = settings.frame_count_max.unwrap() as f64;
            let duration_s = frame_count / settings.world.frame_rate_hz();
            assert!((9.7..=20.0).contains(&duration_s));
            assert_eq!(*settings, draw(3, run_idx));
        }
    }

    /// A campaign in small; `cargo xtask robustness` runs hundreds.
    #[test]
    fn no_wrong_pose_is_called_good_in_hard_recordings() {
        let cases: [(RecordingWorld, usize, &[Condition]); 2] = [
            (
                RecordingWorld::Corridor,
                40,
                &[Condition::Exposure, Condition::Drops],
            ),
            (RecordingWorld::Office, 40, &[Condition::Radio]),
        ];
        for (world, frame_count, conditions) in cases {
            let settings = RecordingSettings {
                world,
                seed: 11,
                conditions: conditions.to_vec(),
                frame_count_max: Some(frame_count),
            };
            let trial = run(&settings);
            assert!(trial.fault().is_none(), "{trial:?}");
            assert!(trial.verdict.map_count > 0, "{trial:?}");
            assert!(trial.final_verdict.map_count > 0, "{trial:?}");
            assert!(3 * trial.live_count > trial.frame_count, "{trial:?}");
            assert!(trial.final_count <= trial.frame_count, "{trial:?}");
        }
    }

    /// After a turn of 90° few keypoints find the points that they should; those that do by chance
    /// once put the camera half a metre beside its way.
    #[test]
    fn a_turn_is_not_followed_by_poses_found_by_chance() {
        let trial = run(&draw(1, 107));
        assert!(trial.fault().is_none(), "{trial:?}");
        assert!(trial.live_count > 60, "{trial:?}");
    }

    /// After 5 s of changed exposure a map begins in images that show a fifth of the usual, and
    /// each keyframe bends it.
    #[test]
    fn a_map_that_does_not_come_to_rest_gives_no_poses() {
        let trial = run(&draw(1, 176));
        assert!(trial.fault().is_none(), "{trial:?}");
        assert!(trial.live_count > 40, "{trial:?}");
    }

    /// Four frames of a turn show posters that hang in another part of the building as well.
    #[test]
    fn a_poster_that_hangs_elsewhere_too_is_no_place() {
        let trial = run(&draw(3, 4));
        assert!(trial.fault().is_none(), "{trial:?}");
        assert!(trial.final_count > 45, "{trial:?}");
    }
}
