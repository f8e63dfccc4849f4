//! A round corridor of points, and the map that a drifting camera makes of it.

use camera::{CameraModel, Distortion, Intrinsics};
use features::Descriptor;
use geometry::{Camera, Map, Similarity, Timestamp, Transform};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::frame::Frame;
use crate::map::NewPoint;
use crate::mapping::update_neighbours;
use crate::optics::{LEVEL_FACTOR, Optics};
use crate::plane_grid::PlaneGrid;
use crate::{KeyframeId, MapId, Observation, PointId, View, VslamMap};

const FOCAL_PX: f64 = 260.0;
/// Of a keypoint on the full resolution.
const NOISE_PX: f64 = 0.5;
/// What is farther away is not seen.
const RANGE_M: f64 = 7.0;
/// A point not seen for so many keyframes is a new point when it comes into view again.
const FORGOTTEN_AFTER: usize = 8;
const STEP_M: f64 = 0.4;

/// Things on the walls of a ring.
pub(super) struct World {
    radius_m: f64,
    things: Vec<(Vector3<f64>, Descriptor)>,
}

/// What drifts from keyframe to keyframe.
#[derive(Clone, Copy)]
pub(super) struct Drift {
    pub(super) log_scale: f64,
    pub(super) turn_rad: f64,
}

impl World {
    /// - `cell_count`: how often the same things follow each other around the ring.
    pub(super) fn new(radius_m: f64, cell_count: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let cell_rad = std::f64::consts::TAU / cell_count as f64;
        let per_cell = (30.0 * cell_rad * radius_m) as usize;
        let mut things = Vec::new();
        for _ in 0..per_cell {
            let angle = rng.random_range(0.0..cell_rad);
            let across = if rng.random() { 1.6 } else { -1.6 };
            let height = rng.random_range(-1.2..1.2);
            let descriptor = Descriptor(std::array::from_fn(|_| rng.random()));
            for cell in 0..cell_count {
                let angle = angle + cell as f64 * cell_rad;
                let place = (radius_m + across) * Vector3::new(angle.cos(), 0.0, angle.sin());
                things.push((place + Vector3::y() * height, descriptor));
            }
        }
        Self { radius_m, things }
    }

    /// Keyframes for once around the ring.
    pub(super) fn keyframes_around(&self) -> usize {
        (std::f64::consts::TAU * self.radius_m / STEP_M) as usize
    }

    /// A camera on the ring that looks along it, and a bit outward.
    pub(super) fn pose(&self, keyframe: usize) -> Transform<Map, Camera> {
        let angle = keyframe as f64 * STEP_M / self.radius_m;
        let place = self.radius_m * Vector3::new(angle.cos(), 0.0, angle.sin());
        let rotation = Rotation3::from_axis_angle(&Vector3::y_axis(), 0.2 - angle);
        Transform::new(UnitQuaternion::from_rotation_matrix(&rotation), place)
    }

    /// The map of a walk over these steps. Ids go on from `ids_from`.
    pub(super) fn walk(
        &self,
        steps: std::ops::Range<usize>,
        drift: Drift,
        (id, ids_from): (MapId, u32),
    ) -> VslamMap {
        let optics = optics();
        let mut rng = ChaCha8Rng::seed_from_u64(11 + u64::from(id.0));
        let mut map = VslamMap::new(id, KeyframeId(ids_from), PointId(100 * ids_from));
        let mut last_seen: Vec<Option<(usize, Sight)>> = vec![None; self.things.len()];
        let mut estimate = Similarity::from(self.pose(steps.start));
        for step in steps.clone() {
            if step > steps.start {
                let (last, next) = (self.pose(step - 1), self.pose(step));
                let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), drift.turn_rad);
                let error = Similarity::<Camera, Camera>::new(
                    drift.log_scale.exp(),
                    UnitQuaternion::from_rotation_matrix(&turn),
                    Vector3::zeros(),
                );
                let moved: Similarity<Camera, Camera> = (last.inverse() * next).into();
                estimate = estimate * moved * error;
            }
            self.add_keyframe(
                &optics,
                &mut map,
                (step, estimate),
                &mut last_seen,
                &mut rng,
            );
        }
        map
    }

    fn add_keyframe(
        &self,
        optics: &Optics,
        map: &mut VslamMap,
        (step, estimate): (usize, Similarity<Map, Camera>),
        last_seen: &mut [Option<(usize, Sight)>],
        rng: &mut ChaCha8Rng,
    ) {
        let camera_from_world = self.pose(step).inverse();
        let mut seen = Vec::new();
        let mut observations = Vec::new();
        for (thing_idx, (place, descriptor)) in self.things.iter().enumerate() {
            let in_camera = camera_from_world * *place;
            let Some(sighted) = observe(optics, &in_camera, descriptor, rng) else {
                continue;
            };
            seen.push((thing_idx, in_camera));
            observations.push(sighted);
        }
        let frame = Frame {
            frame_idx: step as u64,
            captured_at: Timestamp::from_seconds(step as f64).unwrap(),
            grid: PlaneGrid::new(optics, &observations),
            observations,
        };
        let before = map.keyframes().next_back().map(crate::Keyframe::id);
        let camera_from_map = estimate.rigid_part().inverse();
        let id = map.add_keyframe(frame, camera_from_map);
        map.keyframe_mut(id).unwrap().parent = before;
        for (observation_idx, (thing_idx, in_camera)) in (0..).zip(seen) {
            let view = View {
                keyframe: id,
                observation_idx,
            };
            let memory = &mut last_seen[thing_idx];
            let sight = match *memory {
                Some((last, sight)) if step - last <= FORGOTTEN_AFTER => sight,
                _ => Sight::Once(view),
            };
            let sight = match sight {
                Sight::Once(first) if first != view => {
                    let new = NewPoint {
                        position_in_map: estimate * in_camera,
                        covariance_in_map: Matrix3::identity() * 1e-4,
                        parallax_rad: 0.1,
                        expected_range: None,
                    };
                    Sight::Point(map.add_point(new, vec![first, view]))
                }
                Sight::Point(point) => {
                    map.link(point, view);
                    Sight::Point(point)
                }
                once => once,
            };
            *memory = Some((step, sight));
        }
        update_neighbours(map, id);
    }
}

/// What a thing is in the map so far.
#[derive(Clone, Copy)]
enum Sight {
    Once(View),
    Point(PointId),
}

pub(super) fn optics() -> Optics {
    let intrinsics = Intrinsics {
        fx: FOCAL_PX,
        fy: FOCAL_PX,
        cx: 159.5,
        cy: 119.5,
    };
    Optics::new(
        CameraModel::new(320, 240, intrinsics, Distortion::None).unwrap(),
        0.9,
    )
}

fn observe(
    optics: &Optics,
    in_camera: &Vector3<f64>,
    descriptor: &Descriptor,
    rng: &mut ChaCha8Rng,
) -> Option<Observation> {
    let distance = in_camera.norm();
    optics.project(in_camera)?;
    if !(0.8..RANGE_M).contains(&distance) {
        return None;
    }
    let level = ((RANGE_M / distance).ln() / LEVEL_FACTOR.ln())
        .round()
        .min(7.0) as u8;
    let mut noise = || NOISE_PX * rng.random_range(-1.7..1.7);
    let noise = Vector2::new(noise(), noise());
    let position = in_camera.xy() / in_camera.z + noise / FOCAL_PX;
    let mut words = descriptor.0;
    for _ in 0..15 {
        let bit = rng.random_range(0..256_usize);
        words[bit / 64] ^= 1 << (bit % 64);
    }
    Some(Observation {
        position,
        position_px: position * FOCAL_PX + Vector2::new(159.5, 119.5),
        sigma: 0.9 * LEVEL_FACTOR.powi(i32::from(level)) / FOCAL_PX,
        level,
        angle_rad: 0.0,
        descriptor: Descriptor(words),
        point: None,
    })
}
