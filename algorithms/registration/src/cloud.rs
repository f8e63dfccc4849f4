//! A set of points as it comes from a file or a map.

mod axes;
mod bounds;
mod shape;
mod thin;

use nalgebra::{Matrix3, Vector3};

pub(crate) use bounds::bounds;
pub use shape::ShapedCloud;
pub(crate) use shape::{PLANE_THICKNESS, Shape, to_single};
pub(crate) use thin::thinned;

/// Points, and what is known about their appearance.
///
/// Points that are not finite, or absurdly far, are dropped with their descriptors, and counted.
#[derive(Clone, Debug, Default)]
pub struct Cloud {
    points: Vec<Vector3<f64>>,
    /// One per point, or none at all.
    covariances: Vec<Matrix3<f64>>,
    descriptors: Descriptors,
    dropped_count: usize,
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
        let offered_count = points.len();
        points.retain(is_usable);
        Self {
            dropped_count: offered_count - points.len(),
            points,
            covariances: Vec::new(),
            descriptors: Descriptors::None,
        }
    }

    /// A cloud whose points are known to these covariances, such as those of a map.
    ///
    /// A point without a usable one, finite and with no negative variance, is dropped with it.
    pub fn with_covariances(
        points: impl IntoIterator<Item = (Vector3<f64>, Matrix3<f64>)>,
    ) -> Self {
        let mut cloud = Self::default();
        for (point, covariance) in points {
            let known = covariance.iter().all(|value| value.is_finite())
                && (0..3).all(|axis| covariance[(axis, axis)] >= 0.0);
            if known && is_usable(&point) {
                cloud.points.push(point);
                cloud.covariances.push(covariance);
            } else {
                cloud.dropped_count += 1;
            }
        }
        cloud
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
            covariances: Vec::new(),
            descriptors,
            dropped_count: usable.iter().filter(|usable| !**usable).count(),
        })
    }

    pub fn points(&self) -> &[Vector3<f64>] {
        &self.points
    }

    /// How many of the points that were given are not part of the cloud.
    pub fn dropped_count(&self) -> usize {
        self.dropped_count
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

/// Whether a point can be part of a cloud: finite, and not absurdly far.
pub fn is_usable(point: &Vector3<f64>) -> bool {
    point
        .iter()
        .all(|coordinate| coordinate.abs() < COORDINATE_LIMIT)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_that_are_none_are_dropped_and_counted() {
        let point = |x: f64| Vector3::new(x, 0.0, 0.0);
        let points = vec![
            point(f64::NAN),
            point(1.0),
            point(f64::INFINITY),
            point(1e12),
        ];
        let cloud = Cloud::from_points(points.clone());
        assert_eq!(
            (cloud.points(), cloud.dropped_count()),
            (&[point(1.0)][..], 3)
        );
        let histograms = (0..4).map(|idx| [idx; 128]).collect();
        let cloud = Cloud::new(points, Descriptors::Histogram(histograms)).unwrap();
        assert_eq!((cloud.points().len(), cloud.dropped_count()), (1, 3));
        let Descriptors::Histogram(kept) = cloud.descriptors() else {
            panic!("the descriptors stay");
        };
        assert_eq!(kept, &[[1; 128]]);
        // Thinning merges points, but drops none.
        assert_eq!(cloud.thinned(1.0).dropped_count(), 3);
    }
}
