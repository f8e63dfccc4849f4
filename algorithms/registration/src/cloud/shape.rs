//! A cloud made ready for alignment: thinned, centred, indexed, with the local shape.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::{Cloud, Descriptors};
use crate::kd_tree::KdTree;

/// Neighbours that a point's shape is estimated from.
const NEIGHBOUR_COUNT: usize = 10;
/// Fewer do not support a shape.
const NEIGHBOUR_COUNT_MIN: usize = 6;
/// A neighbourhood whose thinnest side is below this share of the next is a surface (squared).
const SURFACE_FLATNESS: f64 = 0.5;
/// Its middle side must be above this share of the longest, else it is a line (squared).
const SURFACE_BREADTH: f64 = 0.02;
/// Variance across a surface relative to along it, in generalised ICP.
pub(crate) const PLANE_THICKNESS: f64 = 1e-3;

/// Points about their centroid with a k-d tree and their local shape.
#[derive(Clone, Debug)]
pub struct ShapedCloud {
    /// The mean of the points, in the cloud's frame.
    pub(crate) centroid: Vector3<f64>,
    pub(crate) points: Vec<Vector3<f64>>,
    pub(crate) tree: KdTree,
    pub(crate) shapes: Vec<Shape>,
    pub(crate) descriptors: Descriptors,
    /// Median distance to the nearest other point.
    pub(crate) spacing: f64,
    /// Root mean square distance from the centroid.
    pub(crate) radius: f64,
}

/// The neighbourhood of a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    /// Where the neighbourhood is a surface.
    pub normal: Option<Vector3<f64>>,
    /// Unit variance along the surface and little across, or round where there is no surface.
    pub covariance: Matrix3<f64>,
}

impl Cloud {
    /// One point per cube of this edge, the mean of the points in it; descriptors are those of
    /// the first point in each cube.
    pub fn thinned(&self, voxel_m: f64) -> Self {
        let mut cubes: BTreeMap<[i64; 3], (Vector3<f64>, f64, usize)> = BTreeMap::new();
        for (idx, point) in self.points.iter().enumerate() {
            let cell = std::array::from_fn(|axis| (point[axis] / voxel_m).floor() as i64);
            let cube = cubes.entry(cell).or_insert((Vector3::zeros(), 0.0, idx));
            cube.0 += point;
            cube.1 += 1.0;
        }
        let descriptors = match &self.descriptors {
            Descriptors::None => Descriptors::None,
            Descriptors::Binary(all) => {
                Descriptors::Binary(cubes.values().map(|cube| all[cube.2]).collect())
            }
            Descriptors::Histogram(all) => {
                Descriptors::Histogram(cubes.values().map(|cube| all[cube.2]).collect())
            }
        };
        Self {
            points: cubes.values().map(|(sum, count, _)| sum / *count).collect(),
            descriptors,
            dropped_count: self.dropped_count,
        }
    }
}

impl ShapedCloud {
    pub fn new(cloud: &Cloud, voxel_m: Option<f64>) -> Self {
        let thinned = voxel_m
            .filter(|voxel_m| *voxel_m > 0.0)
            .map(|voxel_m| cloud.thinned(voxel_m));
        let cloud = thinned.as_ref().unwrap_or(cloud);
        let count = cloud.points.len().max(1) as f64;
        let centroid = cloud.points.iter().sum::<Vector3<f64>>() / count;
        let points: Vec<_> = cloud.points.iter().map(|point| point - centroid).collect();
        let single: Vec<[f32; 3]> = points.iter().map(to_single).collect();
        let tree = KdTree::new(&single);
        let (shapes, spacing) = shapes(&points, &tree);
        let radius_squared = points.iter().map(Vector3::norm_squared).sum::<f64>() / count;
        Self {
            centroid,
            points,
            tree,
            shapes,
            descriptors: cloud.descriptors.clone(),
            spacing,
            radius: radius_squared.sqrt(),
        }
    }

    pub fn point_count(&self) -> usize {
        self.points.len()
    }
}

pub(crate) fn to_single(point: &Vector3<f64>) -> [f32; 3] {
    [point.x as f32, point.y as f32, point.z as f32]
}

/// The shape of each point, and the median distance to the nearest other.
fn shapes(points: &[Vector3<f64>], tree: &KdTree) -> (Vec<Shape>, f64) {
    let mut found = Vec::new();
    let mut distances = Vec::with_capacity(points.len());
    let mut shapes = Vec::with_capacity(points.len());
    for point in points {
        tree.nearest_many(to_single(point), NEIGHBOUR_COUNT, &mut found);
        if let Some(second) = found.get(1) {
            distances.push(f64::from(second.distance_squared).sqrt());
        }
        shapes.push(shape(points, found.iter().map(|one| one.idx as usize)));
    }
    distances.sort_by(f64::total_cmp);
    let spacing = distances.get(distances.len() / 2).copied().unwrap_or(0.0);
    (shapes, spacing)
}

fn shape(points: &[Vector3<f64>], neighbours: impl Iterator<Item = usize> + Clone) -> Shape {
    let round = Shape {
        normal: None,
        covariance: Matrix3::identity(),
    };
    let count = neighbours.clone().count();
    if count < NEIGHBOUR_COUNT_MIN {
        return round;
    }
    let mean = neighbours
        .clone()
        .map(|idx| points[idx])
        .sum::<Vector3<f64>>()
        / count as f64;
    let mut scatter = Matrix3::zeros();
    for idx in neighbours {
        let offset = points[idx] - mean;
        scatter += offset * offset.transpose();
    }
    let eigen = SymmetricEigen::new(scatter);
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let [thin, middle, long] = order.map(|axis| eigen.eigenvalues[axis]);
    if !(thin < SURFACE_FLATNESS * middle && middle > SURFACE_BREADTH * long) {
        return round;
    }
    let normal = eigen.eigenvectors.column(order[0]).into_owned();
    Shape {
        normal: Some(normal),
        covariance: Matrix3::identity() - normal * normal.transpose() * (1.0 - PLANE_THICKNESS),
    }
}
