//! A synthetic room with points, an anchor that maps it and a vehicle that flies in it.
//!
//! The room is 8 m × 6 m × 3 m. Landmarks carry random descriptors of which every view changes
//! some bits; maps have scale, depth noise and slow drift of their own.

use std::ops::{AddAssign, Range};

use features::Descriptor;
use geometry::{Camera, Chunk, Enu, Map, Matrix7, Similarity, Tangent7, Timestamp, Transform};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::localizer::{
    AnchorIdx, ChunkIdx, KeyframeIdx, KeyframeObservation, Landmark, Localizer, ObservedFeature,
    ObservedPoint,
};

pub struct World {
    points: Vec<Vector3<f64>>,
    descriptors: Vec<Descriptor>,
}

pub fn normal(rng: &mut impl Rng) -> f64 {
    // Box and Muller.
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}

pub fn normal_vector(rng: &mut impl Rng, sigma: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| sigma * normal(rng))
}

pub fn tangent(rng: &mut impl Rng, rotation: f64, translation: f64, log_scale: f64) -> Tangent7 {
    let omega = normal_vector(rng, rotation);
    let nu = normal_vector(rng, translation);
    let lambda = log_scale * normal(rng);
    Tangent7::from_column_slice(&[omega.x, omega.y, omega.z, nu.x, nu.y, nu.z, lambda])
}

fn random_descriptor(rng: &mut impl Rng) -> Descriptor {
    Descriptor(std::array::from_fn(|_| rng.random()))
}

fn disturbed(descriptor: &Descriptor, bit_count: usize, rng: &mut impl Rng) -> Descriptor {
    let mut words = descriptor.0;
    for _ in 0..bit_count {
        let bit = rng.random_range(0..256_usize);
        words[bit / 64] ^= 1 << (bit % 64);
    }
    Descriptor(words)
}

/// Looks along `forward`, upright.
pub fn look(position: Vector3<f64>, forward: Vector3<f64>) -> Transform<Enu, Camera> {
    let z = forward.normalize();
    let x = z.cross(&Vector3::z()).normalize();
    let matrix = Matrix3::from_columns(&[x, z.cross(&x), z]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    Transform::new(rotation, position)
}

impl World {
    pub fn new(point_count: usize, rng: &mut impl Rng) -> Self {
        let size = Vector3::new(8.0, 6.0, 3.0);
        let points = (0..point_count)
            .map(|_| {
                let mut point = size.map(|length| length * (rng.random::<f64>() - 0.5));
                // Half on the walls, half on things in front of them.
                let axis = rng.random_range(0..3_usize);
                let depth = if rng.random() {
                    0.0
                } else {
                    0.6 * rng.random::<f64>()
                };
                point[axis] = (0.5 * size[axis] - depth) * point[axis].signum();
                point
            })
            .collect();
        let descriptors = (0..point_count).map(|_| random_descriptor(rng)).collect();
        Self {
            points,
            descriptors,
        }
    }

    /// The same room with other looks, except where it is to look alike.
    pub fn redecorated(
        &self,
        looks_alike: impl Fn(&Vector3<f64>) -> bool,
        rng: &mut impl Rng,
    ) -> Self {
        let known = self.points.iter().zip(&self.descriptors);
        let descriptors = known.map(|(point, descriptor)| match looks_alike(point) {
            true => *descriptor,
            false => random_descriptor(rng),
        });
        Self {
            descriptors: descriptors.collect(),
            points: self.points.clone(),
        }
    }

    /// Another room, with these things of this one.
    pub fn furnished_anew(
        &self,
        is_kept: impl Fn(&Vector3<f64>) -> bool,
        rng: &mut impl Rng,
    ) -> Self {
        let mut room = self.only(&is_kept);
        let others = Self::new(self.points.len(), rng).only(|point| !is_kept(point));
        room.points.extend(others.points);
        room.descriptors.extend(others.descriptors);
        room
    }

    /// The same room with nothing else in it.
    pub fn only(&self, is_kept: impl Fn(&Vector3<f64>) -> bool) -> Self {
        let known = self.points.iter().zip(&self.descriptors);
        let (points, descriptors) = known.filter(|(point, _)| is_kept(point)).unzip();
        Self {
            points,
            descriptors,
        }
    }

    /// Everything near the east wall stands at the west wall again, turned by half a round.
    pub fn repeat_east_in_the_west(&mut self) {
        for idx in 0..self.points.len() {
            let point = self.points[idx];
            if point.x < -2.5 {
                // Not to be seen from anywhere.
                self.points[idx] = Vector3::repeat(1e3);
            }
            if point.x > 2.5 {
                self.points.push(Vector3::new(-point.x, -point.y, point.z));
                self.descriptors.push(self.descriptors[idx]);
            }
        }
    }

    fn visible(&self, enu_from_camera: &Transform<Enu, Camera>) -> Vec<(usize, Vector3<f64>)> {
        let camera_from_enu = enu_from_camera.inverse();
        let points = self.points.iter().enumerate();
        points
            .map(|(idx, point)| (idx, camera_from_enu * *point))
            .filter(|(_, point)| {
                point.z > 0.5 && point.x.abs() < 0.8 * point.z && point.y.abs() < 0.6 * point.z
            })
            .collect()
    }
}

/// A point as a camera triangulates it: depth error grows with the square of the depth.
fn triangulated(
    point: &Vector3<f64>,
    unit: f64,
    rng: &mut impl Rng,
) -> (Vector3<f64>, Matrix3<f64>) {
    let ray = point / point.z;
    let (sigma_depth, sigma_across) = (0.008 * point.z * point.z, 0.002 * point.z);
    let covariance = ray * ray.transpose() * sigma_depth * sigma_depth
        + Matrix3::identity() * sigma_across * sigma_across;
    let noisy = point + ray * sigma_depth * normal(rng) + normal_vector(rng, sigma_across);
    (noisy / unit, covariance / (unit * unit))
}

pub struct AnchorSettings {
    pub idx: AnchorIdx,
    /// Metres per unit of its map.
    pub unit_m: f64,
    /// How far its map is bent (m).
    pub bend_m: f64,
    /// Error of the georeference that its covariance does not tell of.
    pub lie: Similarity<Enu, Enu>,
    /// Of the thirty along its way, those that are published.
    pub chunks: Range<usize>,
    pub revision: u64,
    /// Standard deviations of the georeference, on the map's right: rotation, map unit, scale.
    pub georeference_sigma: [f64; 3],
}

impl Default for AnchorSettings {
    fn default() -> Self {
        Self {
            idx: AnchorIdx(0),
            unit_m: 1.7,
            bend_m: 0.003,
            lie: Similarity::identity(),
            chunks: 0..30,
            revision: 1,
            georeference_sigma: [0.002, 0.008, 0.003],
        }
    }
}

/// An anchor drives along the room's long axis and round, and its chunks reach the localiser.
pub fn publish_anchor(
    world: &World,
    settings: &AnchorSettings,
    localizer: &mut Localizer,
    rng: &mut ChaCha8Rng,
) {
    let axis = Vector3::new(0.3, -0.2, 1.0);
    let rotation = UnitQuaternion::from_scaled_axis(axis);
    let enu_from_map: Similarity<Enu, Map> =
        Similarity::new(settings.unit_m, rotation, Vector3::new(1.0, -2.0, 0.4));
    let phase = normal_vector(rng, 3.0);
    let mut known = vec![false; world.points.len()];
    for chunk_number in settings.chunks.clone() {
        let turn = std::f64::consts::TAU * chunk_number as f64 / 30.0;
        let position = Vector3::new(1.5 * turn.cos(), turn.sin(), -0.8);
        let enu_from_camera = look(position, Vector3::new(turn.cos(), turn.sin(), 0.1));
        let mut landmarks = Vec::new();
        for (idx, point) in world.visible(&enu_from_camera) {
            if std::mem::replace(&mut known[idx], true) {
                continue;
            }
            let (point_in_chunk, covariance_in_chunk) = triangulated(&point, settings.unit_m, rng);
            landmarks.push(Landmark {
                point_in_chunk,
                covariance_in_chunk,
                descriptor: disturbed(&world.descriptors[idx], 15, rng),
            });
        }
        let bend = phase.map(|phase| settings.bend_m * (turn + phase).sin());
        let bent = Transform::<Enu, Camera>::new(*enu_from_camera.rotation(), position + bend);
        let map_from_camera = enu_from_map.inverse() * bent;
        let map_from_chunk = Similarity::<Map, Chunk>::new(
            1.0,
            *map_from_camera.rotation(),
            *map_from_camera.translation(),
        );
        let chunk = ChunkIdx(chunk_number as u64);
        localizer.insert_chunk(settings.idx, chunk, landmarks);
        localizer.place_chunk(settings.idx, chunk, map_from_chunk);
    }
    let sigma = settings.georeference_sigma;
    let error = tangent(rng, sigma[0], sigma[1], sigma[2]);
    let covariance = Matrix7::from_diagonal(&Tangent7::from_fn(|row, _| sigma[row / 3].powi(2)));
    localizer.place_anchor(
        settings.idx,
        settings.lie * enu_from_map.perturbed(&error),
        covariance,
        settings.revision,
    );
}

const SCENE_DEPTH_M: f64 = 2.0;

/// A vehicle without a position source; its map drifts.
pub struct Flyer {
    /// Own map as it is now: turns and changes scale on the way.
    map_from_enu: Similarity<Map, Enu>,
    drift_scale: f64,
    pub enu_from_camera: Transform<Enu, Camera>,
    keyframe_count: u64,
    pub wrong_descriptor_share: f64,
    rng: ChaCha8Rng,
}

impl Flyer {
    pub fn new(seed: u64, drift_scale: f64) -> Self {
        let axis = Vector3::new(-0.5, 0.9, 1.2);
        Self {
            map_from_enu: Similarity::new(
                0.4,
                UnitQuaternion::from_scaled_axis(axis),
                Vector3::new(3.0, 1.0, -2.0),
            ),
            drift_scale,
            enu_from_camera: Transform::identity(),
            keyframe_count: 0,
            wrong_descriptor_share: 0.2,
            rng: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    /// A round that starts where the anchor has been too, from another height.
    pub fn fly_to(&mut self, step: usize) {
        let turn = 0.06 * step as f64 + 0.4;
        let position = Vector3::new(1.2 * turn.cos(), 0.9 * turn.sin(), 0.2 + 0.3 * turn.sin());
        let side = 0.3 * (2.0 * turn).sin();
        let forward = Vector3::new((turn + side).cos(), (turn + side).sin(), -0.1);
        let next = look(position, forward);
        let travelled = (next.translation() - self.enu_from_camera.translation()).norm();
        self.enu_from_camera = next;
        if step > 0 {
            // About 1 % of the way; the map turns about the scene ahead, not about the camera.
            let root = (travelled / SCENE_DEPTH_M).sqrt() * self.drift_scale;
            let mut drift = tangent(&mut self.rng, 0.005 * root, 0.006 * root, 0.005 * root);
            let turn = drift.fixed_rows::<3>(0).into_owned();
            let shift = -turn.cross(&(Vector3::z() * SCENE_DEPTH_M));
            drift.fixed_rows_mut::<3>(3).add_assign(&shift);
            let at_camera = Similarity::from(next);
            let error = at_camera * Similarity::<Camera, Camera>::exp(&drift);
            self.map_from_enu = self.map_from_enu * error * at_camera.inverse();
        }
    }

    /// Hovers, or turns on the spot.
    pub fn turn_to(&mut self, position: Vector3<f64>, yaw_rad: f64) {
        let forward = Vector3::new(yaw_rad.cos(), yaw_rad.sin(), -0.1);
        self.enu_from_camera = look(position, forward);
    }

    pub fn restart_map(&mut self) {
        let other = Similarity::<Map, Map>::exp(&Tangent7::from_element(0.4));
        self.map_from_enu = other * self.map_from_enu;
    }

    pub fn map_from_camera(&self) -> Transform<Map, Camera> {
        self.map_from_enu.transform_pose(&self.enu_from_camera)
    }

    pub fn keyframe(&mut self, world: &World) -> KeyframeObservation {
        let map_from_camera = self.map_from_camera();
        let unit = 1.0 / self.map_from_enu.scale();
        let rng = &mut self.rng;
        let mut features = Vec::new();
        for (idx, point) in world.visible(&self.enu_from_camera) {
            let sigma = 0.5 / 181.0 * 1.2_f64.powi(rng.random_range(0..8));
            let noise = Vector2::new(normal(rng), normal(rng)) * sigma;
            let wrong = rng.random::<f64>() < self.wrong_descriptor_share;
            let descriptor = if wrong {
                random_descriptor(rng)
            } else {
                disturbed(&world.descriptors[idx], 20, rng)
            };
            let has_point = rng.random::<f64>() < 0.6;
            let (own, covariance) = triangulated(&point, unit, rng);
            let rotation = map_from_camera.rotation_matrix();
            features.push(ObservedFeature {
                position: point.xy() / point.z + noise,
                sigma,
                descriptor,
                point: has_point.then(|| ObservedPoint {
                    point_in_map: map_from_camera * own,
                    covariance_in_map: rotation * covariance * rotation.transpose(),
                }),
            });
        }
        self.keyframe_count += 1;
        KeyframeObservation {
            id: KeyframeIdx(self.keyframe_count),
            captured_at: Timestamp::from_nanoseconds(self.keyframe_count as i64 * 300_000_000),
            map_from_camera,
            features,
        }
    }
}
