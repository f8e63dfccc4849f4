//! Files that other tools read and write, trajectories and point clouds; and maps of our own.

mod cloud;
mod covariance;
mod destination;
mod error;
mod imu;
mod npz;
mod pcd;
mod ply;
mod point_cloud;
mod slam_map;
mod stamp;
mod tum;
mod xyz;

pub use cloud::{check_cloud_name, read_cloud, write_cloud};
pub use covariance::{
    COVARIANCE_HEADER, format_covariance_line, read_covariances, write_covariances,
};
pub use destination::{Clash, NamedFile, check_destination, check_distinct, create_folder};
pub use error::FileError;
pub use imu::{ImuReading, ImuReadings, imu_mounting, read_imu};
pub use point_cloud::PointCloud;
pub use slam_map::{read_slam_map, write_slam_map};
pub use stamp::parse_seconds;
pub use tum::{StampedPose, format_tum_line, parse_tum_line, read_tum, write_tum};

#[cfg(test)]
mod tests;
