//! A cloud made ready for alignment: thinned, centred, indexed, with the local shape.

use nalgebra::{Matrix3, Vector3};

use super::axes::{eigenvalues, eigenvector};
use super::thin::{Cubes, Moments};
use super::{Cloud, Descriptors};
use crate::kd_tree::{KdTree, Neighbour};
use crate::median::median;

/// Neighbours that a point's shape is estimated from.
const NEIGHBOUR_COUNT: usize = 10;
/// Fewer do not support a shape.
const NEIGHBOUR_COUNT_MIN: usize = 6;
/// A neighbourhood whose thinnest side is below this share of the next is a surface (squared).
const SURFACE_FLATNESS: f64 = 0.5;
/// Its middle side must be above this share of the longest, else it is a line (squared).
const SURFACE_BREADTH: f64 = 0.02;
/// So many points of a thinned cloud tell its spacing.
const GAP_COUNT: usize = 1000;
/// Variance across a surface relative to along it, in generalised ICP.
pub(crate) const PLANE_THICKNESS: f64 = 1e-3;

/// Points about their centroid with a k-d tree and their local shape.
#[derive(Clone, Debug)]
pub struct ShapedCloud {
    /// The mean of the points that it was made of, in the cloud's frame.
    pub(crate) centroid: Vector3<f64>,
    pub(crate) points: Vec<Vector3<f64>>,
    pub(crate) tree: KdTree,
    pub(crate) shapes: Vec<Shape>,
    pub(crate) descriptors: Descriptors,
    /// Median distance to the nearest other point.
    pub(crate) spacing: f64,
    /// Root mean square distance from the centroid.
    pub(crate) radius: f64,
    /// Squared distances of points to the nearest other; infinite where not known.
    gaps: Vec<f32>,
    covariances: Vec<Matrix3<f64>>,
}

/// The neighbourhood of a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    /// Where the neighbourhood is a surface.
    pub normal: Option<Vector3<f64>>,
    /// The point's own error alone, in squared spacings; zero where it is not known.
    pub noise: Matrix3<f64>,
    pub noise_known: bool,
}

impl ShapedCloud {
    /// - `voxel_m`: the cloud is thinned to one point per cube of this edge, and all points in
    ///   and around a cube tell the shape there; otherwise the nearest ten do.
    pub fn new(cloud: &Cloud, voxel_m: Option<f64>) -> Self {
        let cubes = voxel_m
            .filter(|voxel_m| *voxel_m > 0.0)
            .map(|voxel_m| Cubes::of(&cloud.points, voxel_m));
        let thinned = cubes.as_ref().map(|cubes| cloud.by_cubes(cubes));
        let cloud = thinned.as_ref().unwrap_or(cloud);
        let count = cloud.points.len().max(1) as f64;
        let mut shaped = Self {
            centroid: cloud.points.iter().sum::<Vector3<f64>>() / count,
            points: Vec::new(),
            tree: KdTree::default(),
            shapes: Vec::new(),
            descriptors: Descriptors::None,
            spacing: 0.0,
            radius: 0.0,
            gaps: Vec::new(),
            covariances: Vec::new(),
        };
        shaped.insert(cloud, cubes.map(|cubes| cubes.neighbourhoods()));
        shaped.descriptors = cloud.descriptors.clone();
        shaped
    }

    pub fn point_count(&self) -> usize {
        self.points.len()
    }

    /// Whether the covariances of points are known.
    pub(crate) fn knows_noise(&self) -> bool {
        !self.covariances.is_empty()
    }

    /// Adds the points of a cloud in the same frame, such as the next chunk of a map; nothing is
    /// built anew but the shapes next to them. Descriptors stay those of the first cloud.
    ///
    /// Cost: as for the new points alone, log(map size) times their share of the index, and one
    /// pass over all points for the radius and the spacing.
    pub fn extend(&mut self, cloud: &Cloud) {
        self.insert(cloud, None);
    }

    /// - `neighbourhoods`: what lies around each point; otherwise its neighbours tell.
    fn insert(&mut self, cloud: &Cloud, neighbourhoods: Option<Vec<Moments>>) {
        let old_count = self.points.len();
        let points = cloud.points.iter().map(|point| point - self.centroid);
        self.points.extend(points);
        let single: Vec<[f32; 3]> = self.points[old_count..].iter().map(to_single).collect();
        self.tree.extend(&single);
        self.shapes.resize(self.points.len(), Shape::ROUND);
        self.gaps.resize(self.points.len(), f32::INFINITY);
        if !cloud.covariances.is_empty() {
            self.covariances.resize(old_count, Matrix3::zeros());
            self.covariances.extend_from_slice(&cloud.covariances);
        }
        let mut found = Vec::new();
        let mut touched = Vec::new();
        if let Some(around) = neighbourhoods.filter(|all| support_shapes(all)) {
            self.shapes = around.iter().map(Shape::of).collect();
            self.find_gaps();
        } else {
            for idx in old_count..self.points.len() {
                self.find_neighbours(idx, &mut found);
                touched.extend(found.iter().map(|one| one.idx as usize));
                self.shapes[idx] = self.shape_of(&found);
            }
        }
        touched.retain(|idx| *idx < old_count);
        touched.sort_unstable();
        touched.dedup();
        for idx in touched {
            self.find_neighbours(idx, &mut found);
            self.shapes[idx] = self.shape_of(&found);
        }
        self.measure();
        self.whiten();
    }

    /// What is known of the points' errors, in the unit of the shapes.
    fn whiten(&mut self) {
        let unit = self.spacing * self.spacing;
        for (shape, covariance) in self.shapes.iter_mut().zip(&self.covariances) {
            shape.noise = covariance / unit.max(f64::MIN_POSITIVE);
            shape.noise_known = true;
        }
    }

    /// Of some points, evenly.
    fn find_gaps(&mut self) {
        let stride = self.points.len().div_ceil(GAP_COUNT).max(1);
        let places = self.points.iter().zip(&mut self.gaps).step_by(stride);
        for (point, gap) in places {
            let two = self.tree.nearest_two(to_single(point), f32::INFINITY);
            *gap = two.second.distance_squared;
        }
    }

    /// The nearest points, the point itself among them.
    fn find_neighbours(&mut self, idx: usize, found: &mut Vec<Neighbour>) {
        let query = to_single(&self.points[idx]);
        self.tree.nearest_many(query, NEIGHBOUR_COUNT, found);
        // Points that a file has twice are no neighbours.
        if let Some(next) = found.iter().find(|one| one.distance_squared > 0.0) {
            self.gaps[idx] = next.distance_squared;
        }
    }

    fn shape_of(&self, neighbours: &[Neighbour]) -> Shape {
        let points = neighbours.iter().map(|one| &self.points[one.idx as usize]);
        Shape::of(&Moments::of(points))
    }

    fn measure(&mut self) {
        let count = self.points.len().max(1) as f64;
        let squares = self.points.iter().map(Vector3::norm_squared).sum::<f64>();
        self.radius = (squares / count).sqrt();
        let mut gaps = self.gaps.clone();
        gaps.retain(|gap| gap.is_finite());
        self.spacing = median(&mut gaps, f32::total_cmp)
            .map_or(0.0, f64::from)
            .sqrt();
    }
}

/// Whether cubes hold enough points to tell the shape at most places; where thinning has merged
/// hardly any, the nearest points reach farther.
fn support_shapes(neighbourhoods: &[Moments]) -> bool {
    let supported = neighbourhoods
        .iter()
        .filter(|around| around.count >= NEIGHBOUR_COUNT as f64)
        .count();
    2 * supported > neighbourhoods.len()
}

pub(crate) fn to_single(point: &Vector3<f64>) -> [f32; 3] {
    [point.x as f32, point.y as f32, point.z as f32]
}

impl Shape {
    const ROUND: Self = Self {
        normal: None,
        noise: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        noise_known: false,
    };

    fn of(around: &Moments) -> Self {
        if around.count < NEIGHBOUR_COUNT_MIN as f64 {
            return Self::ROUND;
        }
        let [thin, middle, long] = eigenvalues(&around.scatter);
        if !(thin < SURFACE_FLATNESS * middle && middle > SURFACE_BREADTH * long) {
            return Self::ROUND;
        }
        Self {
            normal: eigenvector(&around.scatter, thin),
            ..Self::ROUND
        }
    }
}
