//! What a vehicle says about its flight at the end.

use serde::{Deserialize, Serialize};

use super::KeepingSummary;
use crate::node::NodeCounters;

/// `{id}.json`. Unknown numbers are null.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VehicleSummary {
    pub id: String,
    pub role: String,
    pub state: String,
    pub reason: String,
    /// Frames given to the vehicle.
    pub frame_count: u64,
    /// Images that could not be used.
    pub unreadable_count: u64,
    /// Fixes that could not be used: with NaN, out of order, of another kind of frame.
    #[serde(default)]
    pub skipped_fix_count: u64,
    /// Why the input ended before its end; null if it did not.
    #[serde(default)]
    pub input_error: Option<String>,
    pub global_frame_count: u64,
    pub global_share: Option<f64>,
    /// From the first frame to the first global pose.
    pub first_global_s: Option<f64>,
    /// Metres per unit of the own map.
    pub scale: Option<f64>,
    pub keyframe_count: usize,
    pub point_count: usize,
    pub bytes_sent: u64,
    pub bytes_received: u64,
    /// Time without any neighbour, on the vehicle's clock.
    pub without_link_s: f64,
    /// Arrivals that found the inbox full.
    pub dropped_count: u64,
    /// Lines, recorded messages and files that could not be written, and holdings that are not on
    /// disk.
    #[serde(default)]
    pub unwritten_count: u64,
    /// Why the first of them could not; null if there is none.
    #[serde(default)]
    pub write_error: Option<String>,
    /// Input to published pose, wall clock.
    pub ms_per_frame_p50: Option<f64>,
    pub ms_per_frame_p99: Option<f64>,
    pub counters: NodeCounters,
    /// Null for a vehicle that holds no place.
    #[serde(default)]
    pub keeping: Option<KeepingSummary>,
}

impl VehicleSummary {
    /// What was lost on the way, for a person; `None` if everything counted and is written.
    pub fn loss(&self) -> Option<String> {
        let counts = [
            (self.unreadable_count, "images skipped"),
            (self.skipped_fix_count, "fixes skipped"),
            (self.dropped_count, "messages dropped"),
            (self.unwritten_count, "writes failed"),
        ];
        let counts = counts.iter().filter(|(count, _)| *count > 0);
        let counts = counts.map(|(count, what)| format!("{what}: {count}"));
        let errors = self.write_error.iter().chain(&self.input_error).cloned();
        let parts: Vec<String> = counts.chain(errors).collect();
        (!parts.is_empty()).then(|| parts.join(", "))
    }
}
