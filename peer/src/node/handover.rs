//! From single frames to the own map without a step, and back at once where that is lost.

use geometry::{Camera, Enu, Timestamp, Transform, so3};
use nalgebra::{Matrix6, Vector6};

use super::tied_pose::{position_block, worst_sigma};

/// A pose on the Earth and its covariance `[ω; p]` in the global axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct GlobalCamera {
    pub enu_from_camera: Transform<Enu, Camera>,
    pub covariance: Matrix6<f64>,
    /// Median depth of the scene (m).
    pub depth_m: f64,
}

impl GlobalCamera {
    /// One sigma of the position along its worst axis.
    pub fn sigma_m(&self) -> f64 {
        worst_sigma(&position_block(&self.covariance))
    }
}

/// How far the own map has taken over from single frames.
#[derive(Debug)]
pub(super) struct Handover {
    /// 0 while single frames say where the camera is, 1 once the own map alone does.
    map_share: f64,
    newest: Option<Newest>,
    /// The newest pose was found wrong.
    doubted: bool,
    /// The newest frame's pose is by the own map alone, whose jumps its registration counts.
    map_alone: bool,
    /// The two contradict each other in this handover; counted once.
    contradicted: bool,
    jump_count: u64,
}

/// The newest pose, and how the camera moves.
#[derive(Clone, Copy, Debug)]
struct Newest {
    captured_at: Timestamp,
    camera: GlobalCamera,
    /// `[ω; p]` a second in the global axes, if that is known.
    rate: Option<Vector6<f64>>,
}

/// A step that is left between the two is gone after so long.
const DURATION_S: f64 = 1.0;
/// An own map that says so many times less of where the camera is waits until it knows more.
const SIGMA_FACTOR_MAX: f64 = 2.0;
/// An older pose does not say where the camera is now.
const NEAR_S: f64 = 1.0;
/// Squared difference per degree of freedom above which the two contradict each other.
const DISAGREEMENT_MAX: f64 = 4.0;
/// One sigma of the change of a camera's motion in a second: turns, and shares of the depth.
const TURN_CHANGE_RAD: f64 = 3.0;
const WAY_CHANGE: f64 = 0.5;

impl Default for Handover {
    fn default() -> Self {
        Self {
            map_share: 1.0,
            newest: None,
            doubted: false,
            map_alone: false,
            contradicted: false,
            jump_count: 0,
        }
    }
}

impl Handover {
    /// Whether the own map, if it says where the camera is, says so alone.
    pub fn is_over(&self) -> bool {
        self.map_share >= 1.0
    }

    /// Whether single frames say more of where the camera is than the own map.
    pub fn rests_on_frames(&self) -> bool {
        self.map_share < 0.5
    }

    pub fn jump_count(&self) -> u64 {
        self.jump_count
    }

    /// The newest pose was wrong: no frame should be looked for near it.
    pub fn doubt(&mut self) {
        self.doubted = true;
    }

    /// Where the camera was last, if that was a moment ago.
    pub fn near(&self, now: Timestamp) -> Option<(Timestamp, GlobalCamera)> {
        let near = self.newest.filter(|newest| newest.is_near(now));
        let near = near.filter(|_| !self.doubted);
        near.map(|newest| (newest.captured_at, newest.camera))
    }

    /// The pose of a frame by what is there of the two.
    pub fn pose(
        &mut self,
        captured_at: Timestamp,
        by_map: Option<GlobalCamera>,
        by_frame: Option<GlobalCamera>,
    ) -> Option<GlobalCamera> {
        let elapsed_s = self.newest.map(|newest| captured_at - newest.captured_at);
        if by_map.is_none() && by_frame.is_some() {
            self.map_share = 0.0;
            self.contradicted = false;
        }
        let ready = by_map.as_ref().is_some_and(|by_map| {
            by_frame.is_none_or(|by_frame| by_map.sigma_m() < SIGMA_FACTOR_MAX * by_frame.sigma_m())
        });
        if ready {
            let step = elapsed_s.map_or(1.0, |elapsed_s| elapsed_s / DURATION_S);
            self.map_share = (self.map_share + step).min(1.0);
        }
        let pose = match (by_map, by_frame) {
            (Some(by_map), Some(by_frame)) => Some(self.between(&by_frame, &by_map)),
            (by_map, by_frame) => by_map.or(by_frame),
        };
        let by_both = by_map.is_some() && by_frame.is_some() && !self.is_over();
        let map_alone = by_map.is_some() && !by_both;
        if let Some(pose) = pose {
            // On the way from one to the other the step between them is counted already.
            let is_counted =
                (map_alone && self.map_alone) || (by_map.is_some() && self.contradicted);
            self.take(captured_at, pose, is_counted);
        }
        self.map_alone = map_alone;
        pose
    }

    /// Follows the camera, and counts a step that no motion explains.
    fn take(&mut self, captured_at: Timestamp, camera: GlobalCamera, is_counted: bool) {
        let before = self.newest;
        let jumped = before.is_some_and(|before| before.contradicts(captured_at, &camera));
        self.jump_count += u64::from(jumped && !is_counted);
        let near = before.filter(|before| !jumped && before.is_near(captured_at));
        let rate = near.map(|before| {
            let elapsed_s = captured_at - before.captured_at;
            difference(&before.camera, &camera) / elapsed_s.max(1e-3)
        });
        self.doubted = false;
        self.newest = Some(Newest {
            captured_at,
            camera,
            rate,
        });
    }

    /// Both, weighted; they share the anchor's error, so that nothing is gained by their number.
    fn between(&mut self, by_frame: &GlobalCamera, by_map: &GlobalCamera) -> GlobalCamera {
        let share = self.map_share;
        let difference = difference(by_frame, by_map);
        let sum = by_frame.covariance + by_map.covariance;
        if disagreement(&difference, sum) > DISAGREEMENT_MAX && !self.contradicted {
            self.contradicted = true;
            self.jump_count += 1;
        }
        let spread = difference * difference.transpose() * (share * (1.0 - share));
        let moved = difference * share;
        let turn = so3::exp(&moved.fixed_rows::<3>(0).into_owned());
        let shift = moved.fixed_rows::<3>(3).into_owned();
        GlobalCamera {
            depth_m: by_frame.depth_m,
            enu_from_camera: Transform::new(
                turn * by_frame.enu_from_camera.rotation(),
                by_frame.enu_from_camera.translation() + shift,
            ),
            covariance: by_frame.covariance * (1.0 - share) + by_map.covariance * share + spread,
        }
    }
}

impl Newest {
    fn is_near(&self, now: Timestamp) -> bool {
        now - self.captured_at < NEAR_S
    }

    /// Whether no motion that a camera is capable of leads from here to there.
    fn contradicts(&self, captured_at: Timestamp, camera: &GlobalCamera) -> bool {
        let elapsed_s = (captured_at - self.captured_at).max(0.0);
        let rate = self.rate.filter(|_| elapsed_s < NEAR_S);
        let moved = rate.unwrap_or_default() * elapsed_s;
        let step = difference(&self.camera, camera) - moved;
        // Of a motion that is known only what changes of it is doubted.
        let doubt_s = rate.map_or(elapsed_s, |_| elapsed_s * elapsed_s);
        let depth_m = self.camera.depth_m.max(camera.depth_m);
        let sigmas = [TURN_CHANGE_RAD, WAY_CHANGE * depth_m].map(|change| change * doubt_s);
        let mut covariance = self.camera.covariance + camera.covariance;
        for axis in 0..6 {
            covariance[(axis, axis)] += sigmas[axis / 3].powi(2);
        }
        disagreement(&step, covariance) > DISAGREEMENT_MAX
    }
}

/// Squared, per degree of freedom.
fn disagreement(difference: &Vector6<f64>, covariance: Matrix6<f64>) -> f64 {
    let squared = covariance.cholesky().map_or(f64::INFINITY, |covariance| {
        difference.dot(&covariance.solve(difference))
    });
    squared / 6.0
}

/// `[ω; p]` that leads from one to the other, in the global axes.
fn difference(from: &GlobalCamera, to: &GlobalCamera) -> Vector6<f64> {
    let (from, to) = (&from.enu_from_camera, &to.enu_from_camera);
    let turn = so3::log(&(to.rotation() * from.rotation().inverse()));
    let shift = to.translation() - from.translation();
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    fn camera(east_m: f64, yaw_rad: f64) -> GlobalCamera {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::z() * yaw_rad);
        GlobalCamera {
            enu_from_camera: Transform::new(rotation, Vector3::x() * east_m),
            covariance: Matrix6::identity() * 0.02 * 0.02,
            depth_m: 2.0,
        }
    }

    fn at(frame_idx: usize) -> Timestamp {
        Timestamp::from_seconds(frame_idx as f64 / 10.0).unwrap()
    }

    fn east_m(pose: &GlobalCamera) -> f64 {
        pose.enu_from_camera.translation().x
    }

    /// Single frames, and from the tenth on the own map, which is 5 cm and 0.02 rad off.
    #[test]
    fn the_own_map_takes_over_without_a_step() {
        let mut handover = Handover::default();
        let mut before = camera(0.0, 0.0);
        for frame_idx in 0..30 {
            let by_map = (frame_idx >= 10).then(|| camera(0.05, 0.02));
            let by_frame = (frame_idx < 10 || !handover.is_over()).then(|| camera(0.0, 0.0));
            let pose = handover.pose(at(frame_idx), by_map, by_frame).unwrap();
            let way = before.enu_from_camera.inverse() * pose.enu_from_camera;
            assert!(way.translation().norm() < 0.006, "{frame_idx}");
            assert!(way.rotation().angle() < 0.003, "{frame_idx}");
            // Nothing is gained by the number of them: they share the anchor's error.
            assert!(pose.covariance[(3, 3)] >= 0.02 * 0.02 - 1e-12);
            before = pose;
        }
        assert!((east_m(&before) - 0.05).abs() < 1e-12);
        assert!(handover.is_over());
        assert_eq!(handover.jump_count(), 0);
    }

    #[test]
    fn a_map_that_contradicts_single_frames_is_a_jump_that_is_counted_once() {
        let mut handover = Handover::default();
        for frame_idx in 0..10 {
            let by_map = (frame_idx > 0).then(|| camera(0.5, 0.0));
            // One frame on the way is not located.
            let by_frame = (frame_idx != 5).then(|| camera(0.0, 0.0));
            handover.pose(at(frame_idx), by_map, by_frame);
        }
        assert_eq!(handover.jump_count(), 1);
        // On the way the covariance covers both.
        let halfway = handover.newest.unwrap().camera;
        assert!(halfway.covariance[(3, 3)] > 0.02 * 0.02);
    }

    #[test]
    fn nothing_is_looked_for_near_a_pose_that_was_wrong() {
        let mut handover = Handover::default();
        handover.pose(at(0), Some(camera(1.0, 0.0)), None);
        handover.doubt();
        assert!(handover.near(at(1)).is_none());
        handover.pose(at(1), Some(camera(1.0, 0.0)), None);
        assert!(handover.near(at(2)).is_some());
    }

    #[test]
    fn a_map_that_knows_far_less_waits() {
        let mut handover = Handover::default();
        let mut vague = camera(0.05, 0.0);
        vague.covariance *= 25.0;
        for frame_idx in 0..30 {
            let by_map = (frame_idx > 0).then_some(vague);
            let pose = handover.pose(at(frame_idx), by_map, Some(camera(0.0, 0.0)));
            assert!(east_m(&pose.unwrap()).abs() < 1e-12);
        }
    }

    #[test]
    fn single_frames_take_over_at_once_when_the_map_is_lost() {
        let mut handover = Handover::default();
        let by_map = handover.pose(at(0), Some(camera(1.0, 0.0)), None);
        assert!(by_map.is_some() && handover.is_over());
        let near = handover.near(at(1)).unwrap().1;
        assert!((east_m(&near) - 1.0).abs() < 1e-12);
        let pose = handover.pose(at(1), None, Some(camera(1.01, 0.0)));
        assert!((east_m(&pose.unwrap()) - 1.01).abs() < 1e-12);
        assert!(handover.rests_on_frames());
        assert!(handover.pose(at(2), None, None).is_none());
        assert!(handover.near(at(20)).is_none());
        assert_eq!(handover.jump_count(), 0);
    }

    /// How many jumps are counted, of cameras by the map and by single frames, ten a second.
    fn jump_count(frames: impl Iterator<Item = (Option<f64>, Option<f64>)>) -> u64 {
        let mut handover = Handover::default();
        for (frame_idx, (by_map, by_frame)) in frames.enumerate() {
            let [by_map, by_frame] =
                [by_map, by_frame].map(|east_m| east_m.map(|east_m| camera(east_m, 0.0)));
            handover.pose(at(frame_idx), by_map, by_frame);
        }
        handover.jump_count()
    }

    /// The camera is by single frames up to the tenth, and then a metre from there.
    #[test]
    fn a_step_that_is_no_motion_is_counted_whoever_takes_it() {
        let frames = |before, after| (0..20).map(move |idx| if idx < 10 { before } else { after });
        let (here, there) = (Some(0.0), Some(1.0));
        // From one single frame to the next.
        assert_eq!(jump_count(frames((None, here), (None, there))), 1);
        // The map is lost, and comes back.
        assert_eq!(jump_count(frames((here, None), (None, there))), 1);
        assert_eq!(jump_count(frames((None, here), (there, None))), 1);
        // From map to map its registration counts, unless another came in between.
        assert_eq!(jump_count(frames((here, None), (there, None))), 0);
        let between = [(here, None), (None, None), (there, None)];
        assert_eq!(jump_count(between.into_iter()), 1);
    }

    #[test]
    fn motion_is_no_jump() {
        // It speeds up to 3 m/s within a second, and stops as fast; noise of 1 cm.
        let east_m = |idx: usize| {
            let seconds = idx as f64 / 10.0;
            let sped_up = seconds.min(1.0);
            let slowed_down = (seconds - 2.0).clamp(0.0, 1.0);
            let way_m = 1.5 * sped_up * sped_up + 3.0 * (seconds.clamp(1.0, 3.0) - 1.0)
                - 1.5 * slowed_down * slowed_down;
            way_m + if idx.is_multiple_of(2) { 0.01 } else { -0.01 }
        };
        assert_eq!(jump_count((0..40).map(|idx| (None, Some(east_m(idx))))), 0);
        // Out of sight for two seconds.
        let seen = |idx: usize| (!(10..30).contains(&idx)).then(|| east_m(idx));
        assert_eq!(jump_count((0..40).map(|idx| (None, seen(idx)))), 0);
    }
}
