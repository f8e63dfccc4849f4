//! What one vehicle has mapped, as it would be shared, and where it truly is.

use std::path::Path;
use std::sync::Arc;

use camera::CameraModel;
use geometry::{Camera, Chunk, Enu, Map, Similarity, Transform, umeyama};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use peer::files::{read_slam_map, write_slam_map};
use peer::node::observe;
use registration::{Cloud, Descriptors, KeyframeObservation, Landmark};
use sim::{Scene, Surroundings, Visit};
use vslam::{Keyframe, MapPoint, Vslam, VslamMap, VslamSettings};

/// A map with all that registration is given of it.
pub(super) struct VehicleMap {
    pub keyframes: Vec<KeyframeObservation>,
    /// Landmarks of each keyframe that saw them first, cut as an anchor cuts them.
    pub chunks: Vec<MapChunk>,
    /// The same landmarks as one cloud.
    pub cloud: Cloud,
    pub truth: MapTruth,
}

pub(super) struct MapChunk {
    pub map_from_chunk: Similarity<Map, Chunk>,
    pub landmarks: Vec<Landmark>,
}

/// Where the map is, and what it shows.
pub(super) struct MapTruth {
    pub site_from_map: Similarity<Enu, Map>,
    /// How far the part with the larger disagreement is from the whole.
    pub bend: Bend,
    /// Where points of the map truly are.
    pub points_in_site: Vec<Vector3<f64>>,
    /// Of the keyframes.
    pub site_from_cameras: Vec<Transform<Enu, Camera>>,
    pub camera: CameraModel,
    /// Of the map's points, from the keyframe that saw them first.
    pub depth_m: f64,
}

/// How much a map is out of shape.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Bend {
    pub log_scale: f64,
    pub rotation_deg: f64,
    /// Of points, relative to their depth, the median.
    pub residual: f64,
}

/// What an anchor asks of the points that it publishes.
const VIEW_COUNT_MIN: usize = 3;
const PARALLAX_RAD_MIN: f64 = 0.03;
const RELATIVE_SIGMA_MAX: f64 = 0.3;
const CHUNK_POINT_COUNT_MIN: usize = 12;
const KEYFRAME_COUNT_MIN: usize = 4;
/// Points whose true place is looked up, at most.
const TRUE_POINT_COUNT_MAX: usize = 600;
const FIT_ROUND_COUNT: usize = 12;

impl VehicleMap {
    /// What a vehicle maps; `None` if no map came of it.
    ///
    /// - `file`: where the map is kept, if anywhere.
    pub fn find(
        visit: &Visit,
        file: Option<&Path>,
        scene: &Arc<Scene>,
        surroundings: &Surroundings,
    ) -> Option<Self> {
        let Some(file) = file else {
            return Self::new(&build(visit, scene)?, visit, surroundings);
        };
        if !file.is_file() {
            write_slam_map(file, &build(visit, scene)?, visit.camera()).ok()?;
        }
        let settings = VslamSettings::default();
        let map = read_slam_map(file, visit.camera(), &settings).ok()?;
        Self::new(&map, visit, surroundings)
    }

    fn new(map: &VslamMap, visit: &Visit, surroundings: &Surroundings) -> Option<Self> {
        let focal_length_px = visit.camera().focal_length_px();
        let chunks = chunks(map, focal_length_px);
        let (points, descriptors): (Vec<Vector3<f64>>, Vec<_>) = chunks
            .iter()
            .flat_map(|chunk| {
                let placed = |one: &Landmark| chunk.map_from_chunk * one.point_in_chunk;
                let landmarks = chunk.landmarks.iter();
                landmarks.map(move |one| (placed(one), one.descriptor))
            })
            .unzip();
        Some(Self {
            keyframes: map.keyframes().map(|one| observe(one, map)).collect(),
            chunks,
            cloud: Cloud::new(points, Descriptors::Binary(descriptors)).ok()?,
            truth: MapTruth::find(map, visit, surroundings)?,
        })
    }
}

fn build(visit: &Visit, scene: &Arc<Scene>) -> Option<VslamMap> {
    let mut vslam = Vslam::new(visit.camera().clone(), VslamSettings::default());
    for frame in visit.frames(scene) {
        vslam.process(&frame.image, frame.captured_at);
    }
    vslam.finish();
    let map = vslam.largest_map();
    (map.keyframe_count() >= KEYFRAME_COUNT_MIN).then(|| map.clone())
}

/// The chunks that an anchor would cut from the map.
fn chunks(map: &VslamMap, focal_length_px: f64) -> Vec<MapChunk> {
    let chunk = |keyframe: &Keyframe| {
        let camera_from_map = keyframe.camera_from_map();
        let landmarks: Vec<Landmark> = map
            .points()
            .filter(|point| first_view(point, map).is_some_and(|it| it.0.id() == keyframe.id()))
            .filter_map(|point| landmark(point, camera_from_map, focal_length_px))
            .collect();
        let map_from_camera: Transform<Map, Chunk> = keyframe.map_from_camera().relabel();
        (landmarks.len() >= CHUNK_POINT_COUNT_MIN).then_some(MapChunk {
            map_from_chunk: Similarity::from(map_from_camera),
            landmarks,
        })
    };
    map.keyframes().filter_map(chunk).collect()
}

/// A point as a chunk's bytes tell it: its uncertainty is that of its depth, and a pixel.
fn landmark(
    point: &MapPoint,
    camera_from_map: &Transform<Camera, Map>,
    focal_length_px: f64,
) -> Option<Landmark> {
    let point_in_chunk = *camera_from_map * *point.position_in_map();
    let axis = camera_from_map.rotation_matrix().row(2).into_owned();
    let variance = (axis * point.covariance_in_map() * axis.transpose()).x;
    let depth = point_in_chunk.z;
    let is_seen = point.view_count() >= VIEW_COUNT_MIN || point.parallax_rad() >= PARALLAX_RAD_MIN;
    let is_certain = depth > 0.0 && variance.sqrt() <= RELATIVE_SIGMA_MAX * depth;
    let ray = point_in_chunk / depth;
    let across = depth / focal_length_px;
    (is_seen && is_certain && point.has_range()).then(|| Landmark {
        point_in_chunk,
        covariance_in_chunk: ray * ray.transpose() * variance
            + Matrix3::identity() * (across * across),
        descriptor: *point.descriptor(),
    })
}

/// The oldest keyframe that shows a point, and where.
fn first_view<'a>(point: &MapPoint, map: &'a VslamMap) -> Option<(&'a Keyframe, usize)> {
    let view = point.views().first()?;
    Some((map.keyframe(view.keyframe)?, view.observation_idx as usize))
}

fn true_pose(keyframe: &Keyframe, visit: &Visit) -> Option<Transform<Enu, Camera>> {
    let captured_at = keyframe.captured_at();
    let mut truth = visit.truth();
    truth.find_map(|(stamp, pose)| (stamp == captured_at).then_some(pose))
}

/// A point of the map, and where the ray that showed it first ends in truth.
struct TruePoint {
    in_map: Vector3<f64>,
    in_site: Vector3<f64>,
    depth_m: f64,
    keyframe_rank: usize,
}

impl MapTruth {
    fn find(map: &VslamMap, visit: &Visit, surroundings: &Surroundings) -> Option<Self> {
        let ranks: Vec<_> = map.keyframes().map(Keyframe::id).collect();
        let step = map.point_count().div_ceil(TRUE_POINT_COUNT_MAX).max(1);
        let points: Vec<TruePoint> = map
            .points()
            .filter(|point| point.has_range() && point.view_count() >= VIEW_COUNT_MIN)
            .step_by(step)
            .filter_map(|point| {
                let (keyframe, observation_idx) = first_view(point, map)?;
                let site_from_camera = true_pose(keyframe, visit)?;
                let position = keyframe.observations()[observation_idx].position;
                let ray = site_from_camera.rotation() * position.push(1.0).normalize();
                let origin = site_from_camera.translation();
                let depth_m = surroundings.ray_length_m(origin, &ray)?;
                Some(TruePoint {
                    in_map: *point.position_in_map(),
                    in_site: origin + ray * depth_m,
                    depth_m,
                    keyframe_rank: ranks.binary_search(&keyframe.id()).ok()?,
                })
            })
            .collect();
        let all: Vec<&TruePoint> = points.iter().collect();
        let (site_from_map, residual) = fit(&all)?;
        let mut depths: Vec<f64> = points.iter().map(|point| point.depth_m).collect();
        depths.sort_by(f64::total_cmp);
        let cameras = map
            .keyframes()
            .filter_map(|one| Some((one.map_from_camera(), true_pose(one, visit)?)));
        let (own, site_from_cameras): (Vec<_>, Vec<_>) = cameras.unzip();
        Some(Self {
            bend: Bend {
                residual,
                ..bend(&points, &site_from_map, &own, &site_from_cameras)
            },
            site_from_map,
            depth_m: depths[depths.len() / 2],
            points_in_site: points.iter().map(|point| point.in_site).collect(),
            site_from_cameras,
            camera: visit.camera().clone(),
        })
    }
}

/// The robust similarity of the points, and the median of their residuals relative to their depth.
fn fit(points: &[&TruePoint]) -> Option<(Similarity<Enu, Map>, f64)> {
    let mut weights = vec![1.0; points.len()];
    let mut result = None;
    for _ in 0..FIT_ROUND_COUNT {
        let pairs = points.iter().zip(&weights);
        let weighted = pairs.map(|(point, weight)| (point.in_site, point.in_map, *weight));
        let site_from_map: Similarity<Enu, Map> = umeyama(weighted, true).ok()?;
        let residuals: Vec<f64> = points
            .iter()
            .map(|one| (site_from_map * one.in_map - one.in_site).norm() / one.depth_m)
            .collect();
        let mut sorted = residuals.clone();
        sorted.sort_by(f64::total_cmp);
        let median = sorted[sorted.len() / 2].max(1e-4);
        for ((weight, residual), point) in weights.iter_mut().zip(&residuals).zip(points) {
            let ratio = residual / (2.0 * median);
            *weight = (1.0 + ratio * ratio).powi(-2) / (point.depth_m * point.depth_m);
        }
        result = Some((site_from_map, median));
    }
    result
}

/// Parts of the map against the whole: the points of its first and of its second half, and its
/// cameras.
fn bend(
    points: &[TruePoint],
    whole: &Similarity<Enu, Map>,
    own: &[Transform<Map, Camera>],
    truth: &[Transform<Enu, Camera>],
) -> Bend {
    let mut bend = Bend::default();
    let middle = own.len() / 2;
    for is_first in [true, false] {
        let is_part = |point: &&TruePoint| (point.keyframe_rank < middle) == is_first;
        let part: Vec<&TruePoint> = points.iter().filter(is_part).collect();
        if part.len() < 30 {
            continue;
        }
        if let Some((found, _)) = fit(&part) {
            let log_scale = (found.scale() / whole.scale()).ln().abs();
            bend.log_scale = bend.log_scale.max(log_scale);
        }
    }
    let turns = own.iter().zip(truth).map(|(own, truth)| {
        let turned: UnitQuaternion<f64> = whole.rotation() * own.rotation();
        turned.angle_to(truth.rotation()).to_degrees()
    });
    let mut turns: Vec<f64> = turns.collect();
    turns.sort_by(f64::total_cmp);
    bend.rotation_deg = turns.get(turns.len() / 2).copied().unwrap_or(f64::INFINITY);
    bend
}
