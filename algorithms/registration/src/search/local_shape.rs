//! Histograms of the angles between the normals around a point: correspondences by shape alone.
//!
//! Like fast point feature histograms (Rusu et al. 2009), but blind to the sign of the normals,
//! which has no meaning in a cloud without viewpoints.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::consensus::Correspondence;
use super::mutual::mutual;
use crate::cloud::{ShapedCloud, thinned, to_single};
use crate::kd_tree::{KdTree, Neighbour};

const BIN_COUNT: usize = 11;
const ANGLE_COUNT: usize = 3;
/// Inner and outer shell apart.
const SHELL_COUNT: usize = 2;
const HISTOGRAM_SIZE: usize = BIN_COUNT * ANGLE_COUNT * SHELL_COUNT;
/// Points that are described, about.
const KEYPOINT_COUNT: f64 = 1500.0;
/// The neighbourhood's radius relative to the cloud's.
const RADIUS_SHARES: [f64; 3] = [0.15, 0.3, 0.5];
/// Clouds are thinned to this share of a neighbourhood's radius, so that density matters little.
const VOXEL_SHARE: f64 = 0.1;
/// A normal is that of the points within this share of a neighbourhood's radius: of what is
/// described, not of how dense the points are.
const NORMAL_SHARE: f64 = 0.5;
/// Fewer points have no normal.
const NORMAL_POINT_COUNT_MIN: usize = 6;
/// Neighbours that are looked at, at most; a denser neighbourhood is thinned evenly.
const NEIGHBOUR_COUNT_MAX: usize = 300;

type Histogram = [f32; HISTOGRAM_SIZE];

/// Histograms that are among each other's nearest, over three sizes of neighbourhood.
///
/// - `source_radius`, `target_radius`: the radii of the clouds if they showed the same; the
///   neighbourhoods follow them.
pub(crate) fn correspondences(
    source: &ShapedCloud,
    target: &ShapedCloud,
    source_radius: f64,
    target_radius: f64,
) -> Vec<Correspondence> {
    let mut pairs = Vec::new();
    for share in RADIUS_SHARES {
        let of_source = describe(&source.points, share * source_radius);
        let of_target = describe(&target.points, share * target_radius);
        let matches = mutual(&of_source.histograms, &of_target.histograms, |a, b| {
            let squares = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b));
            squares.sum::<f32>()
        });
        let paired = matches
            .into_iter()
            .map(|(source_idx, target_idx)| Correspondence {
                in_target: of_target.points[target_idx],
                in_source: of_source.points[source_idx],
            });
        pairs.extend(paired);
    }
    pairs
}

struct Described {
    points: Vec<Vector3<f64>>,
    histograms: Vec<Histogram>,
}

fn describe(points: &[Vector3<f64>], radius: f64) -> Described {
    let points = thinned(points, VOXEL_SHARE * radius);
    let single: Vec<[f32; 3]> = points.iter().map(to_single).collect();
    let tree = KdTree::new(&single);
    let mut found = Vec::new();
    let normals: Vec<Option<Vector3<f64>>> = single
        .iter()
        .map(|point| {
            tree.within(*point, (NORMAL_SHARE * radius) as f32, &mut found);
            normal(&points, &found)
        })
        .collect();
    let mut described = Described {
        points: Vec::new(),
        histograms: Vec::new(),
    };
    let keypoint_step = (points.len() as f64 / KEYPOINT_COUNT).ceil().max(1.0) as usize;
    for (idx, point) in points.iter().enumerate().step_by(keypoint_step) {
        let Some(own_normal) = normals[idx] else {
            continue;
        };
        tree.within(single[idx], radius as f32, &mut found);
        let step = found.len().div_ceil(NEIGHBOUR_COUNT_MAX).max(1);
        let neighbours = found.iter().step_by(step).filter_map(|neighbour| {
            let idx = neighbour.idx as usize;
            Some((points[idx] - point, normals[idx]?))
        });
        if let Some(histogram) = histogram(&own_normal, neighbours, radius) {
            described.points.push(*point);
            described.histograms.push(histogram);
        }
    }
    described
}

/// Across the plane that fits best.
fn normal(points: &[Vector3<f64>], found: &[Neighbour]) -> Option<Vector3<f64>> {
    if found.len() < NORMAL_POINT_COUNT_MIN {
        return None;
    }
    let near = found.iter().map(|one| points[one.idx as usize]);
    let mean = near.clone().sum::<Vector3<f64>>() / found.len() as f64;
    let mut scatter = Matrix3::zeros();
    for point in near {
        let offset = point - mean;
        scatter += offset * offset.transpose();
    }
    let eigen = SymmetricEigen::new(scatter);
    let thin = eigen.eigenvalues.imin();
    Some(eigen.eigenvectors.column(thin).into_owned())
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
