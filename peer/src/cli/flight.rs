//! What `demo` and `team` tell of a flight in the same way.

use serde::Serialize;

use super::output;
use crate::evaluate::SwarmScore;
use crate::team::{VehicleReport, table};

/// How it went; the names are those of the command line's contract.
#[derive(Serialize)]
pub struct FlightSummary {
    /// The exit code is 0.
    pub ok: bool,
    pub realtime_factor: Option<f64>,
    pub vehicles: Vec<VehicleReport>,
    /// How those that carry lights held together; absent where nobody does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub swarm: Option<SwarmScore>,
}

impl FlightSummary {
    /// One JSON object, or a table for a reader.
    pub fn print(&self, json: bool) -> anyhow::Result<()> {
        if json {
            return output::print_json(self);
        }
        for line in table(&self.vehicles) {
            output::print_line(&line);
        }
        if let Some(swarm) = &self.swarm {
            output::print_line(&together(swarm));
        }
        if let Some(realtime_factor) = self.realtime_factor {
            output::print_line(&format!("{realtime_factor:.2} times real time"));
        }
        Ok(())
    }
}

fn together(swarm: &SwarmScore) -> String {
    let number = |value: Option<f64>, decimals: usize| {
        value.map_or("–".to_owned(), |value| format!("{value:.decimals$}"))
    };
    let seen_percent = number(swarm.marker_seen_share.map(|share| 100.0 * share), 0);
    format!(
        "held together by sight: {} m apart on average, never nearer than {} m, collisions: {}, \
         lights seen in {seen_percent} % of the images",
        number(swarm.nn_mean_m, 2),
        number(swarm.min_distance_m, 2),
        swarm.collisions,
    )
}

/// The progress bar of a flight, once it has begun.
#[derive(Default)]
pub struct FlightBar {
    bar: Option<output::Progress>,
}

impl FlightBar {
    /// One more step of so many is done.
    pub fn advance(&mut self, step_count: usize) {
        self.bar
            .get_or_insert_with(|| output::Progress::start("flying", step_count as u64))
            .advance(1);
    }

    /// Tells what a vehicle said; the flight is over by then.
    pub fn say(&mut self, vehicle: &str, line: &str) {
        self.finish();
        output::diagnose(&format!("{vehicle}: {line}"));
    }

    pub fn finish(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish();
        }
    }
}
