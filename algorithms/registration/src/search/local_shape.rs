//! Histograms of the angles between the normals around a point: correspondences by shape alone.
//!
//! Like fast point feature histograms (Rusu et al. 2009), but blind to the sign of the normals,
//! which has no meaning in a cloud without viewpoints.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::consensus::Correspondence;
use super::mutual::mutual;
use crate::cloud::{ShapedCloud, to_single};

const BIN_COUNT: usize = 11;
const ANGLE_COUNT: usize = 3;
/// Inner and outer shell apart.
const SHELL_COUNT: usize = 2;
const HISTOGRAM_SIZE: usize = BIN_COUNT * ANGLE_COUNT * SHELL_COUNT;
/// Points that are described, about.
const KEYPOINT_COUNT: f64 = 1500.0;
/// The neighbourhood's radius relative to the cloud's.
const RADIUS_SHARES: [f64; 2] = [0.15, 0.3];
/// Neighbours that are looked at, at most; a denser neighbourhood is thinned evenly.
const NEIGHBOUR_COUNT_MAX: usize = 300;

type Histogram = [f32; HISTOGRAM_SIZE];

/// Mutually nearest histograms, over two sizes of neighbourhood.
///
/// With a free scale the neighbourhood follows each cloud's own radius, which works as long as
/// both show about the same scene.
pub(crate) fn correspondences(
    source: &ShapedCloud,
    target: &ShapedCloud,
    with_scale: bool,
) -> Vec<Correspondence> {
    let source_keypoints = keypoints(source);
    let target_keypoints = keypoints(target);
    let mut pairs = Vec::new();
    for share in RADIUS_SHARES {
        let target_radius = share * target.radius;
        let source_radius = if with_scale {
            share * source.radius
        } else {
            target_radius
        };
        let of_source = describe(source, &source_keypoints, source_radius);
        let of_target = describe(target, &target_keypoints, target_radius);
        let matches = mutual(&of_source.histograms, &of_target.histograms, 1.0, |a, b| {
            let squares = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b));
            f64::from(squares.sum::<f32>())
        });
        pairs.extend(
            matches
                .into_iter()
                .map(|(source_idx, target_idx)| Correspondence {
                    in_target: target.points[of_target.point_idx[target_idx]],
                    in_source: source.points[of_source.point_idx[source_idx]],
                }),
        );
    }
    pairs
}

/// One point with a normal per cube, the cubes as large as gives the wanted number.
fn keypoints(cloud: &ShapedCloud) -> Vec<usize> {
    let mut edge = cloud.radius * 0.04;
    loop {
        let mut cubes: BTreeMap<[i64; 3], usize> = BTreeMap::new();
        for (idx, point) in cloud.points.iter().enumerate() {
            if cloud.shapes[idx].normal.is_some() {
                let cell = std::array::from_fn(|axis| (point[axis] / edge).floor() as i64);
                cubes.entry(cell).or_insert(idx);
            }
        }
        if (cubes.len() as f64) < 1.3 * KEYPOINT_COUNT {
            return cubes.into_values().collect();
        }
        edge *= (cubes.len() as f64 / KEYPOINT_COUNT).sqrt().max(1.1);
    }
}

struct Described {
    point_idx: Vec<usize>,
    histograms: Vec<Histogram>,
}

fn describe(cloud: &ShapedCloud, keypoints: &[usize], radius: f64) -> Described {
    let mut found = Vec::new();
    let mut described = Described {
        point_idx: Vec::new(),
        histograms: Vec::new(),
    };
    for idx in keypoints {
        let point = &cloud.points[*idx];
        let Some(normal) = cloud.shapes[*idx].normal else {
            continue;
        };
        cloud
            .tree
            .within(to_single(point), radius as f32, &mut found);
        let step = found.len().div_ceil(NEIGHBOUR_COUNT_MAX).max(1);
        let neighbours = found.iter().step_by(step).filter_map(|neighbour| {
            let idx = neighbour.idx as usize;
            let normal = cloud.shapes[idx].normal?;
            Some((cloud.points[idx] - point, normal))
        });
        if let Some(histogram) = histogram(&normal, neighbours, radius) {
            described.point_idx.push(*idx);
            described.histograms.push(histogram);
        }
    }
    described
}

/// `None` where there is only a plane, or hardly a neighbour: such points look all alike.
fn histogram(
    normal: &Vector3<f64>,
    neighbours: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)>,
    radius: f64,
) -> Option<Histogram> {
    let mut histogram = [0.0_f32; HISTOGRAM_SIZE];
    let mut counts = [0.0_f32; SHELL_COUNT];
    let mut bent = 0.0_f32;
    for (offset, neighbour_normal) in neighbours {
        let distance = offset.norm();
        if distance <= 0.0 {
            continue;
        }
        let direction = offset / distance;
        let shell = usize::from(distance > 0.6 * radius);
        let cosines = [
            normal.dot(&neighbour_normal).abs(),
            normal.dot(&direction).abs(),
            neighbour_normal.dot(&direction).abs(),
        ];
        bent += (1.0 - cosines[0] as f32).min(0.3);
        counts[shell] += 1.0;
        for (angle, cosine) in cosines.into_iter().enumerate() {
            // Shared between two bins, so that a small change is a small difference.
            let place = cosine.min(1.0) * (BIN_COUNT - 1) as f64;
            let bin = (place as usize).min(BIN_COUNT - 2);
            let upper = (place - bin as f64) as f32;
            let first = (shell * ANGLE_COUNT + angle) * BIN_COUNT + bin;
            histogram[first] += 1.0 - upper;
            histogram[first + 1] += upper;
        }
    }
    let total: f32 = counts.iter().sum();
    if total < 20.0 || bent < 0.02 * total {
        return None;
    }
    let shells = histogram.chunks_exact_mut(ANGLE_COUNT * BIN_COUNT);
    for (bins, count) in shells.zip(counts) {
        bins.iter_mut().for_each(|bin| *bin /= count.max(1.0));
    }
    Some(histogram)
}
