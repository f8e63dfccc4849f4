//! Swarm-keeping: hold together by sight alone.
//!
//! A camera sees the two lights of each neighbour; what it sees becomes a small velocity
//! correction.
//! No map, no network, no clock: images and measurements in, tracks and velocities out.
//!
//! Directions are in the heading frame, gravity-aligned with x forward and y left, unless their
//! name says `in_level`: the same without the vehicle's turns about the vertical.

mod bounded;
mod follower;
pub mod gabriel_rule;
mod guarded_follower;
mod keeper;
pub mod markers;
pub mod mount;
mod own_motion;
pub mod paper_rule;
pub mod safety;
mod sectors;
mod sighting;
mod tracks;
mod turn;
mod view;

pub use bounded::Bounded;
pub use follower::{
    FeedForward, Follower, FollowerCommand, FollowerSettings, LightPair, PlanarVelocity,
};
pub use gabriel_rule::GabrielSettings;
pub use guarded_follower::{GuardedCommand, GuardedFollower, GuardedFollowerSettings};
pub use keeper::{Command, HeadingRule, Keeper, KeeperSettings, Perception};
pub use mount::CameraMount;
pub use own_motion::{OwnMotion, held};
pub use paper_rule::{PaperRule, PaperRuleSettings, Placed};
pub use safety::{Obstacle, SafetySettings};
pub use sectors::{Sector, Sectors};
pub use sighting::{Baseline, MarkerModel, Range, Separation, Sighting};
pub use tracks::{TRACK_COUNT_MAX, Track, TrackSettings, Tracks};
pub use view::{Coverage, FieldOfView};
