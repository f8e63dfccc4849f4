//! Detection, wrong pairs and accuracy for each kind of light.
//!
//! `MARKER_PICTURES=1000 cargo test -p keeping matrix_of -- --nocapture` prints the table.

use camera::Image;
use geometry::Timestamp;
use sim::marker_light::{MarkerFrame, MarkerScene, TruePair};

use crate::markers::{FinderSettings, PairFinder, PaperPipeline, PaperPipelineSettings};

/// A pair found in a picture.
struct Found {
    center_px: [f64; 2],
    separation_px: f64,
    sigma_separation_px: f64,
}

/// What a pipeline makes of many pictures of one kind.
#[derive(Default)]
struct Tally {
    true_count: usize,
    detected: usize,
    /// Pictures with a pair that is none.
    wrong: usize,
    false_pairs_empty: usize,
    picture_count: usize,
    squared_error: f64,
    squared_error_in_sigmas: f64,
}

impl Tally {
    fn add(&mut self, frame: &MarkerFrame, found: &[Found]) {
        self.picture_count += 1;
        self.true_count += frame.pairs.len();
        let fits = |pair: &TruePair, found: &Found| {
            let center_px = pair.center_px();
            let offset = [0, 1].map(|axis| center_px[axis] - found.center_px[axis]);
            let error_px = found.separation_px - pair.separation_px();
            offset[0].hypot(offset[1]) < 2.0 && error_px.abs() < 2.0
        };
        for pair in &frame.pairs {
            if let Some(found) = found.iter().find(|found| fits(pair, found)) {
                self.detected += 1;
                let error_px = found.separation_px - pair.separation_px();
                self.squared_error += error_px.powi(2);
                self.squared_error_in_sigmas += (error_px / found.sigma_separation_px).powi(2);
            }
        }
        let is_wrong = |found: &Found| !frame.pairs.iter().any(|pair| fits(pair, found));
        self.wrong += usize::from(found.iter().any(is_wrong));
    }

    fn detected(&self) -> f64 {
        self.detected as f64 / self.true_count as f64
    }

    fn wrong(&self) -> f64 {
        self.wrong as f64 / self.picture_count as f64
    }

    fn false_pairs(&self) -> f64 {
        self.false_pairs_empty as f64 / self.picture_count as f64
    }

    fn rmse_px(&self) -> f64 {
        (self.squared_error / self.detected as f64).sqrt()
    }

    /// One if the stated sigma is right.
    fn error_sigmas(&self) -> f64 {
        (self.squared_error_in_sigmas / self.detected as f64).sqrt()
    }
}

fn run(
    scene: &MarkerScene,
    picture_count: u64,
    mut find: impl FnMut(&Image) -> Vec<Found>,
) -> Tally {
    let mut tally = Tally::default();
    let empty = scene.without_pairs();
    for seed in 0..picture_count {
        let frame = scene.draw(seed);
        tally.add(&frame, &find(&frame.image));
        let frame = empty.draw(seed + 1_000_000);
        tally.false_pairs_empty += usize::from(!find(&frame.image).is_empty());
    }
    tally
}

fn run_robust(scene: &MarkerScene, picture_count: u64) -> Tally {
    let mut finder = PairFinder::new(FinderSettings::default(), 324);
    run(scene, picture_count, |image| {
        let pairs = finder.find(image).pairs.iter();
        pairs
            .map(|pair| Found {
                center_px: pair.center_px,
                separation_px: pair.separation_px,
                sigma_separation_px: pair.sigma_separation_px,
            })
            .collect()
    })
}

fn run_paper(scene: &MarkerScene, picture_count: u64) -> Tally {
    run(scene, picture_count, |image| {
        // Pictures are unrelated: each is a first one.
        let mut pipeline = PaperPipeline::new(PaperPipelineSettings::default());
        let pair = pipeline.find(image, Timestamp::from_nanoseconds(0));
        let found = pair.map(|pair| Found {
            center_px: [0, 1]
                .map(|axis| 0.5 * (pair.markers_px[0][axis] + pair.markers_px[1][axis])),
            separation_px: pair.separation_raw_px,
            sigma_separation_px: f64::NAN,
        });
        found.into_iter().collect()
    })
}

fn print_row(name: &str, paper: &Tally, robust: &Tally) {
    let cells = |tally: &Tally| {
        format!(
            "{:6.3} {:6.3} {:7.4} {:6.3}",
            tally.detected(),
            tally.wrong(),
            tally.rmse_px(),
            tally.false_pairs()
        )
    };
    println!(
        "{name:16} | {} | {} {:5.2}",
        cells(paper),
        cells(robust),
        robust.error_sigmas()
    );
}

/// What a row must reach, where physics allows it.
struct Bar {
    detected_min: f64,
    wrong_max: f64,
    false_pairs_max: f64,
    rmse_px_max: f64,
}

fn bar(name: &str) -> Bar {
    let bar = Bar {
        detected_min: 0.99,
        wrong_max: 0.001,
        false_pairs_max: 0.001,
        rmse_px_max: 0.2,
    };
    match name {
        "lab" => Bar {
            rmse_px_max: 0.06,
            ..bar
        },
        "noise 15" | "blur 3" => Bar {
            rmse_px_max: 0.12,
            ..bar
        },
        // Nothing is brighter than a clipped window.
        "window in front" => Bar {
            detected_min: 0.0,
            ..bar
        },
        // Lights of two drones one above the other may look like a pair.
        "two drones" => Bar {
            wrong_max: 0.005,
            ..bar
        },
        // One picture cannot tell which of many lights belong together; tracks can.
        "3 distractors" | "8 distractors" => Bar {
            wrong_max: 1.0,
            false_pairs_max: 1.0,
            ..bar
        },
        _ => bar,
    }
}

/// Enough to see a broken row; the numbers of `BENCHMARKS.md` need a thousand.
const PICTURE_COUNT: u64 = 40;

#[test]
fn the_matrix_of_lights_is_met() {
    let wanted = std::env::var("MARKER_PICTURES").ok();
    let picture_count = wanted.map_or(PICTURE_COUNT, |count| count.parse().unwrap());
    println!(
        "{picture_count} pictures   | paper: detected, wrong, rmse px, false in empty | robust"
    );
    let mut failures = Vec::new();
    for (name, scene) in MarkerScene::matrix() {
        let paper = run_paper(&scene, picture_count);
        let robust = run_robust(&scene, picture_count);
        print_row(&name, &paper, &robust);
        let bar = bar(&name);
        let is_met = robust.detected() >= bar.detected_min
            && robust.wrong() <= bar.wrong_max
            && robust.false_pairs() <= bar.false_pairs_max
            && robust.rmse_px() <= bar.rmse_px_max
            // The stated sigma is neither boast nor excuse.
            && (0.3..3.0).contains(&robust.error_sigmas());
        if !is_met {
            failures.push(name);
        }
    }
    assert!(failures.is_empty(), "rows below their bar: {failures:?}");
}
