#![doc = include_str!("../README.md")]

mod block_cholesky;
pub mod bundle;
mod frame;
mod held;
mod inertia;
mod look;
mod loops;
mod map;
mod mapping;
mod optics;
mod places;
mod plane_grid;
pub mod pose_graph;
mod relocalise;
mod report;
mod search;
mod settings;
mod slam;
mod start;
mod tracking;
mod trajectory;
pub mod triangulation;
pub mod two_view;

pub use inertia::{GyroFault, GyroState, ImuSample};
pub use map::{
    Keyframe, KeyframeId, KeyframeParts, KeypointParts, MapId, MapParts, MapPartsError, MapPoint,
    Observation, PointId, PointParts, View, ViewParts, VslamMap,
};
pub use report::{
    FrameRefusal, FrameReport, ImageFault, LostReason, MappingReport, StartReason, TrackingState,
    TrajectoryEntry,
};
pub use settings::{Background, VslamSettings};
pub use slam::{ExtractedFrame, FrontEnd, Vslam};
