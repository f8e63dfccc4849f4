#![doc = include_str!("../README.md")]
#![warn(missing_docs)]

mod arrays;
mod chunk;
mod codec;
mod have;
mod ids;
pub mod keys;
mod manifest;
mod placement;
mod pose;
mod ranges;
pub mod sync;
mod wire;

pub use chunk::{Chunk, ChunkCamera, ChunkHeader, ChunkPoint, CutRefusal, MAX_POINTS_PER_CHUNK};
pub use codec::{DecodeError, Message, VERSION, decode, encode};
pub use have::{Have, HaveEntry, MAX_BEACON_BYTES};
pub use ids::{CHUNKS_PER_PAGE, ChunkId, ChunkNumber, Epoch, IdError, MapId, VehicleId};
pub use manifest::{BoundingBox, Manifest};
pub use placement::{ChunkPlacement, Placement, PlacementPage};
pub use pose::{GlobalPose, Pose, VehicleState};
pub use ranges::Ranges;
pub use wire::{PROVENANCE_COUNT_MAX, Reference};

#[cfg(test)]
mod tests;
