//! A set of points as it comes from a file or a map.

mod shape;

use nalgebra::Vector3;

pub use shape::ShapedCloud;
pub(crate) use shape::{PLANE_THICKNESS, to_single};

/// Points, and what is known about their appearance.
///
/// Points that are not finite are dropped, with their descriptors.
#[derive(Clone, Debug, Default)]
pub struct Cloud {
    points: Vec<Vector3<f64>>,
    descriptors: Descriptors,
}

/// The appearance of each point of a [`Cloud`]: none, or one descriptor per point.
#[derive(Clone, Debug, Default)]
pub enum Descriptors {
    /// Geometry alone.
    #[default]
    None,
    /// 256-bit binary descriptors, compared by Hamming distance.
    Binary(Vec<features::Descriptor>),
    /// 128-byte gradient histograms, compared by Euclidean distance.
    Histogram(Vec<[u8; 128]>),
}

/// The number of descriptors is not the number of points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DescriptorCountMismatch {
    pub point_count: usize,
    pub descriptor_count: usize,
}

impl std::fmt::Display for DescriptorCountMismatch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} descriptors for {} points",
            self.descriptor_count, self.point_count
        )
    }
}

impl std::error::Error for DescriptorCountMismatch {}

impl Cloud {
    /// A cloud without descriptors.
    pub fn from_points(mut points: Vec<Vector3<f64>>) -> Self {
        points.retain(is_usable);
        Self {
            points,
            descriptors: Descriptors::None,
        }
    }

    /// A cloud with one descriptor per point.
    pub fn new(
        points: Vec<Vector3<f64>>,
        descriptors: Descriptors,
    ) -> Result<Self, DescriptorCountMismatch> {
        let descriptor_count = match &descriptors {
            Descriptors::None => points.len(),
            Descriptors::Binary(list) => list.len(),
            Descriptors::Histogram(list) => list.len(),
        };
        if descriptor_count != points.len() {
            return Err(DescriptorCountMismatch {
                point_count: points.len(),
                descriptor_count,
            });
        }
        let usable: Vec<bool> = points.iter().map(is_usable).collect();
        let descriptors = match descriptors {
            Descriptors::None => Descriptors::None,
            Descriptors::Binary(list) => Descriptors::Binary(retained(list, &usable)),
            Descriptors::Histogram(list) => Descriptors::Histogram(retained(list, &usable)),
        };
        Ok(Self {
            points: retained(points, &usable),
            descriptors,
        })
    }

    pub fn points(&self) -> &[Vector3<f64>] {
        &self.points
    }

    pub fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }
}

fn retained<T>(list: Vec<T>, usable: &[bool]) -> Vec<T> {
    list.into_iter()
        .zip(usable)
        .filter_map(|(item, &usable)| usable.then_some(item))
        .collect()
}

/// Coordinates beyond this could not be squared and summed in single precision.
const COORDINATE_LIMIT: f64 = 1e9;

fn is_usable(point: &Vector3<f64>) -> bool {
    point
        .iter()
        .all(|coordinate| coordinate.abs() < COORDINATE_LIMIT)
}
