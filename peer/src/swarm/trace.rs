//! One flight in full, to be plotted and recorded.

use std::path::Path;

use geometry::{Body, Enu, Timestamp, Transform};
use nalgebra::{UnitQuaternion, Vector3};

use super::flight::Moment;
use crate::recorder::{Recorder, RecorderError, Stamp};

/// Where everybody was and how everybody deviated from the nominal velocity.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    pub times_s: Vec<f64>,
    /// By drone.
    pub positions: Vec<Vec<Vector3<f64>>>,
    /// By drone: the command less the nominal velocity, in its heading frame.
    pub corrections: Vec<Vec<Vector3<f64>>>,
    headings_rad: Vec<Vec<f64>>,
    moment_count: usize,
}

/// Large swarms are traced more rarely, so that memory and recording stay bounded.
const SAMPLES_MAX: usize = 120_000;
const MOMENTS_EXPECTED: usize = 1200;

impl Trace {
    pub fn add(&mut self, moment: &Moment<'_>) {
        let drone_count = moment.steering.len();
        let stride = (drone_count * MOMENTS_EXPECTED)
            .div_ceil(SAMPLES_MAX)
            .max(1);
        self.moment_count += 1;
        if !(self.moment_count - 1).is_multiple_of(stride) {
            return;
        }
        self.positions.resize_with(drone_count, Vec::new);
        self.corrections.resize_with(drone_count, Vec::new);
        self.headings_rad.resize_with(drone_count, Vec::new);
        self.times_s.push(moment.time_s);
        let nominal = Vector3::x() * moment.swarm.settings().speed_mps;
        for drone in 0..drone_count {
            self.positions[drone].push(moment.swarm.positions()[drone]);
            self.corrections[drone].push(moment.steering[drone].velocity - nominal);
            self.headings_rad[drone].push(moment.swarm.headings_rad()[drone]);
        }
    }

    /// Writes `drone1/pose` and so on, in the frame `site`.
    pub fn record(&self, path: &Path) -> Result<(), RecorderError> {
        let mut recorder = Recorder::create(path)?;
        let topics: Vec<String> = (1..=self.positions.len())
            .map(|drone| format!("drone{drone}/pose"))
            .collect();
        for (idx, time_s) in self.times_s.iter().enumerate() {
            let stamp = Stamp {
                frame_id: "site",
                captured_at: Timestamp::from_seconds(*time_s)
                    .expect("flights last hours at most, which time stamps can hold"),
            };
            for (drone, topic) in topics.iter().enumerate() {
                let heading_rad = self.headings_rad[drone][idx];
                let enu_from_body: Transform<Enu, Body> = Transform::new(
                    UnitQuaternion::from_euler_angles(0.0, 0.0, heading_rad),
                    self.positions[drone][idx],
                );
                recorder.record_pose(topic, stamp, &enu_from_body, None)?;
            }
        }
        recorder.finish()
    }
}
