//! A point cloud, whatever the format of its file.

use nalgebra::Vector3;
use registration::{Cloud, Descriptors};

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
