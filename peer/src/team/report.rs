//! A team's flight as JSON and as a table.

use serde::Serialize;

use crate::evaluate::VehicleScore;
use crate::process::VehicleSummary;

/// One vehicle in the JSON of `team` and `demo`. Unknown numbers are null.
#[derive(Clone, Debug, Serialize)]
pub struct VehicleReport {
    pub id: String,
    pub role: String,
    pub state: String,
    pub reason: String,
    pub global_share: Option<f64>,
    pub first_global_s: Option<f64>,
    /// Metres per unit of the own map.
    pub scale: Option<f64>,
    /// What only the truth can tell; absent without it.
    #[serde(flatten)]
    pub score: Option<VehicleScore>,
    pub chunks_received: u64,
    pub bytes_received: u64,
    pub bytes_sent: u64,
    pub without_link_s: f64,
    pub jumps: u64,
    /// Messages that are none.
    pub malformed: u64,
    /// Images that could not be used.
    pub unreadable_images: u64,
    /// Fixes that could not be used.
    pub skipped_fixes: u64,
    /// Messages for which there was no room.
    pub dropped_messages: u64,
    pub ms_per_frame_p50: Option<f64>,
}

impl VehicleReport {
    pub fn new(summary: &VehicleSummary, score: Option<VehicleScore>) -> Self {
        Self {
            id: summary.id.clone(),
            role: summary.role.clone(),
            state: summary.state.clone(),
            reason: summary.reason.clone(),
            global_share: summary.global_share,
            first_global_s: summary.first_global_s,
            scale: summary.scale,
            score,
            chunks_received: summary.counters.chunks_received,
            bytes_received: summary.bytes_received,
            bytes_sent: summary.bytes_sent,
            without_link_s: summary.without_link_s,
            jumps: summary.counters.jumps,
            malformed: summary.counters.malformed,
            unreadable_images: summary.unreadable_count,
            skipped_fixes: summary.skipped_fix_count,
            dropped_messages: summary.dropped_count,
            ms_per_frame_p50: summary.ms_per_frame_p50,
        }
    }
}

/// The vehicles as lines of a table, the head first; nothing without a vehicle.
pub fn table(vehicles: &[VehicleReport]) -> Vec<String> {
    if vehicles.is_empty() {
        return Vec::new();
    }
    let with_truth = vehicles.iter().any(|vehicle| vehicle.score.is_some());
    let mut head = vec![
        "vehicle", "role", "state", "global", "scale", "chunks", "sent", "no link",
    ];
    if with_truth {
        head.extend(["rmse", "final", "ratio", "ideal", "in 3σ"]);
    }
    head.push("reason");
    let mut rows = vec![head.into_iter().map(str::to_owned).collect()];
    rows.extend(vehicles.iter().map(|vehicle| row(vehicle, with_truth)));
    align(&rows)
}

fn row(vehicle: &VehicleReport, with_truth: bool) -> Vec<String> {
    let percent = |share: Option<f64>| number(share.map(|share| share * 100.0), 0, " %");
    let mut row = vec![
        vehicle.id.clone(),
        vehicle.role.clone(),
        vehicle.state.clone(),
        percent(vehicle.global_share),
        number(vehicle.scale, 3, ""),
        vehicle.chunks_received.to_string(),
        format!("{} kB", vehicle.bytes_sent / 1000),
        format!("{:.1} s", vehicle.without_link_s),
    ];
    if with_truth {
        let score = vehicle.score.as_ref();
        row.extend([
            number(score.and_then(|score| score.rmse_m), 3, " m"),
            number(score.and_then(|score| score.rmse_final_m), 3, " m"),
            number(score.and_then(|score| score.ratio), 1, ""),
            number(score.and_then(|score| score.ratio_ideal), 1, ""),
            percent(score.and_then(|score| score.inside_3sigma_share)),
        ]);
    }
    row.push(vehicle.reason.clone());
    row
}

fn number(value: Option<f64>, decimals: usize, unit: &str) -> String {
    value.map_or("–".to_owned(), |value| {
        format!("{value:.decimals$}{unit}")
    })
}

fn align(rows: &[Vec<String>]) -> Vec<String> {
    let column_count = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..column_count).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths);
        let cells = cells.map(|(cell, width)| format!("{cell:<width$}"));
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_table_of_nobody_has_no_head() {
        assert!(super::table(&[]).is_empty());
    }
}
