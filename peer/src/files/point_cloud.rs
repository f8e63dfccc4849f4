//! A point cloud, whatever the format of its file.

use nalgebra::Vector3;
use registration::{Cloud, Descriptors};

use super::error::Refused;

/// Points with what a file says about each of them.
#[derive(Clone, Debug, Default)]
pub struct PointCloud {
    pub points: Vec<Vector3<f64>>,
    /// Red, green, blue: none, or one for each point.
    pub colors: Option<Vec<[u8; 3]>>,
    /// None, or one for each point.
    pub descriptors: Descriptors,
}

impl PointCloud {
    pub fn from_points(points: Vec<Vector3<f64>>) -> Self {
        Self {
            points,
            colors: None,
            descriptors: Descriptors::None,
        }
    }

    /// What registration needs of it; points that are not finite are dropped.
    pub fn into_cloud(self) -> Cloud {
        Cloud::new(self.points, self.descriptors)
            .expect("the readers give one descriptor for each point")
    }
}

/// Descriptors by their size: 32 bytes are binary, 128 a histogram.
pub(super) fn typed_descriptors(descriptors: Vec<Vec<u8>>) -> Result<Descriptors, Refused> {
    let Some(first) = descriptors.first() else {
        return Ok(Descriptors::None);
    };
    let expected = first.len();
    match expected {
        32 => fixed(&descriptors, |bytes| {
            bytes.try_into().map(features::Descriptor::from_bytes).ok()
        })
        .map(Descriptors::Binary),
        128 => fixed(&descriptors, |bytes| bytes.try_into().ok()).map(Descriptors::Histogram),
        _ => None,
    }
    .ok_or_else(|| Refused::whole("descriptors must all have 32 or all have 128 bytes"))
}

fn fixed<T>(descriptors: &[Vec<u8>], read: impl Fn(&[u8]) -> Option<T>) -> Option<Vec<T>> {
    descriptors.iter().map(|bytes| read(bytes)).collect()
}
