//! Pictures in the style of the paper's Figs. 2, 3 and 5.

use std::fmt::Write;

use keeping::FollowerSettings;
use nalgebra::Vector3;
use sim::swarm::STEP_S;

use super::flight::FlightRecord;
use super::following::{FollowingMoment, FollowingSettings, follow};
use super::trace::Trace;
use crate::plot::{Chart, ChartPanel, Color, Curve, Layer, Mark, Plot};

const COLORS: [Color; 6] = [
    Color::BLUE,
    Color::RED,
    Color([230, 150, 20]),
    Color::GREEN,
    Color::PURPLE,
    Color::GREY,
];
/// More curves than this hide each other, and make files large.
const CURVE_COUNT_MAX: usize = 300;
const TRACE_COUNT_MAX: usize = 60;
/// Curves have about so many points.
const POINT_COUNT: usize = 300;

/// Fig. 2, above: where the drones of the first run flew.
pub fn trajectories(trace: &Trace) -> Plot {
    let drones = trace.positions.iter().take(TRACE_COUNT_MAX);
    let mut layers: Vec<Layer> = drones
        .clone()
        .enumerate()
        .map(|(drone, positions)| Layer {
            name: format!("drone {}", drone + 1),
            color: color_of(drone),
            mark: Mark::Line,
            points: positions.clone(),
        })
        .collect();
    // Names of large swarms fill the page.
    if layers.len() > COLORS.len() {
        layers.iter_mut().for_each(|layer| layer.name.clear());
    }
    let ends: Vec<Vector3<f64>> = drones
        .filter_map(|positions| positions.last().copied())
        .collect();
    layers.push(Layer {
        name: "end".to_owned(),
        color: Color::BLACK,
        mark: Mark::LargeDots,
        points: ends,
    });
    Plot {
        title: "Trajectories of the first run".to_owned(),
        layers,
    }
}

/// Fig. 2, inset and below: distances and speed corrections of the first run.
pub fn corrections(trace: &Trace, record: &FlightRecord) -> Chart {
    let over_time = |values: &[f64]| -> Vec<[f64; 2]> {
        let times = trace.times_s.iter().copied();
        times
            .zip(values.iter().copied())
            .map(<[f64; 2]>::from)
            .collect()
    };
    let distances = record.curves.iter().enumerate().map(|(idx, curve)| Curve {
        name: if trace.positions.len() <= PAIRS.len() {
            format!("drones {}", PAIRS[idx])
        } else {
            "nearest, mean".to_owned()
        },
        color: color_of(idx),
        width_px: 1.8,
        points: thinned(curve).collect(),
    });
    let mut panels = vec![ChartPanel {
        title: "Distance [m]".to_owned(),
        across_label: "time [s]".to_owned(),
        curves: distances.collect(),
    }];
    for (axis, name) in ["forward", "left", "up"].into_iter().enumerate() {
        let drones = trace.corrections.iter().take(TRACE_COUNT_MAX).enumerate();
        let is_named = drones.len() <= COLORS.len();
        let curves = drones.map(|(drone, corrections)| {
            let values: Vec<f64> = corrections.iter().map(|value| value[axis]).collect();
            Curve {
                name: if is_named {
                    format!("drone {}", drone + 1)
                } else {
                    String::new()
                },
                color: color_of(drone),
                width_px: 1.3,
                points: over_time(&values),
            }
        });
        panels.push(ChartPanel {
            title: format!("Speed correction {name} [m/s]"),
            across_label: "time [s]".to_owned(),
            curves: curves.collect(),
        });
    }
    Chart {
        title: "Distances and speed corrections of the first run".to_owned(),
        panels,
    }
}

const PAIRS: [&str; 3] = ["1-2", "1-3", "2-3"];

/// Fig. 3: distances of all runs less their ends, and their mean and variance.
pub fn settling(records: &[FlightRecord]) -> Chart {
    let differences = differences_of(records);
    let all = differences.iter().take(CURVE_COUNT_MAX).enumerate();
    let curves = all.map(|(idx, points)| Curve {
        name: String::new(),
        color: color_of(idx),
        width_px: 0.8,
        points: points.clone(),
    });
    let (mean, variance) = moments_of(&differences);
    let moment = |name: &str, color, points| Curve {
        name: name.to_owned(),
        color,
        width_px: 2.0,
        points,
    };
    Chart {
        title: format!("Settling over {} runs", records.len()),
        panels: vec![
            ChartPanel {
                title: "Distance less its end [m], every run".to_owned(),
                across_label: "time [s]".to_owned(),
                curves: curves.collect(),
            },
            ChartPanel {
                title: "Sample mean [m] and variance [m squared]".to_owned(),
                across_label: "time [s]".to_owned(),
                curves: vec![
                    moment("mean", Color::BLUE, mean),
                    moment("variance", Color::RED, variance),
                ],
            },
        ],
    }
}

/// The lower half of Fig. 3 as a table: time, mean and variance.
pub fn settling_table(records: &[FlightRecord]) -> String {
    let (mean, variance) = moments_of(&differences_of(records));
    let mut table = String::from("time_s,mean_m,variance_m2\n");
    for ([time_s, mean], [_, variance]) in mean.iter().zip(&variance) {
        writeln!(table, "{time_s:.1},{mean:.6},{variance:.6}")
            .expect("writing to a string does not fail");
    }
    table
}

/// Every run's distances less their ends.
fn differences_of(records: &[FlightRecord]) -> Vec<Vec<[f64; 2]>> {
    records
        .iter()
        .flat_map(|record| record.curves.iter().zip(&record.final_m))
        .map(|(curve, end)| {
            let points = thinned(curve);
            points
                .map(|[time_s, value]| [time_s, value - end])
                .collect()
        })
        .collect()
}

fn moments_of(differences: &[Vec<[f64; 2]>]) -> (Vec<[f64; 2]>, Vec<[f64; 2]>) {
    let Some(first) = differences.first() else {
        return (Vec::new(), Vec::new());
    };
    let count = differences.len() as f64;
    let both = first.iter().enumerate().map(|(idx, [time_s, _])| {
        let values = differences.iter().map(|curve| curve[idx][1]);
        let mean = values.clone().sum::<f64>() / count;
        let variance = values.map(|value| (value - mean).powi(2)).sum::<f64>() / count;
        ([*time_s, mean], [*time_s, variance])
    });
    both.unzip()
}

/// Fig. 5: what the follower of the flight test commanded, measured and smoothed.
pub fn following(setpoint: LateralSetpoint, seed: u64) -> Chart {
    let settings = FollowingSettings::default();
    let follower = match setpoint {
        LateralSetpoint::Calibrated => FollowerSettings::calibrated(settings.principal_px),
        LateralSetpoint::Paper => FollowerSettings::paper(),
    };
    let moments = follow(&settings, follower, seed);
    let end_s = settings.duration_s;
    let panel = |title: &str, commanded_px: f64, value: fn(&FollowingMoment) -> [f64; 2]| {
        let curve = |name: &str, color, width_px, points| Curve {
            name: name.to_owned(),
            color,
            width_px,
            points,
        };
        let part = |idx: usize| {
            moments
                .iter()
                .map(|moment| [moment.time_s, value(moment)[idx]])
                .collect()
        };
        ChartPanel {
            title: title.to_owned(),
            across_label: "time [s]".to_owned(),
            curves: vec![
                curve("measured", Color([150, 180, 230]), 1.0, part(0)),
                curve("smoothed", Color::BLUE, 2.0, part(1)),
                curve(
                    "commanded",
                    Color::RED,
                    1.5,
                    vec![[0.0, commanded_px], [end_s, commanded_px]],
                ),
            ],
        }
    };
    let separation = |moment: &FollowingMoment| {
        [moment.measured, moment.smoothed]
            .map(|lights| lights.map_or(f64::NAN, |lights| lights.separation_px))
    };
    let lateral = |moment: &FollowingMoment| {
        [moment.measured, moment.smoothed]
            .map(|lights| lights.map_or(f64::NAN, |lights| lights.lateral_px))
    };
    Chart {
        title: "Following another drone by its two lights".to_owned(),
        panels: vec![
            panel(
                "Separation of the lights [px]",
                follower.separation_px,
                separation,
            ),
            panel(
                "Middle of the lights, from the left border [px]",
                follower.lateral_px,
                lateral,
            ),
        ],
    }
}

/// Where between left and right the follower holds the lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LateralSetpoint {
    /// On the optical axis.
    Calibrated,
    /// In the middle of the image, as the paper does.
    Paper,
}

/// A curve over time with fewer points.
fn thinned(curve: &[f32]) -> impl Iterator<Item = [f64; 2]> + '_ {
    let stride = curve.len().div_ceil(POINT_COUNT).max(1);
    let values = curve.iter().enumerate().step_by(stride);
    values.map(|(idx, value)| [idx as f64 * STEP_S, f64::from(*value)])
}

fn color_of(idx: usize) -> Color {
    COLORS[idx % COLORS.len()]
}
