//! How often registration finds the right alignment from nothing, and how often a wrong one.

mod benchmark;
mod common_view;
mod correspondences;
mod pairs;
mod tables;
mod trial;
mod two_maps;
mod vehicle_map;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use geometry::Similarity;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3, Vector4};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use registration::{Source, Target};

/// How much is measured.
#[derive(Clone, Debug)]
pub struct RegistrationSettings {
    /// Of each row of generated correspondences.
    pub correspondence_seed_count: u64,
    /// Of each row of real maps.
    pub map_seed_count: u64,
    /// Of maps of two vehicles in rendered rooms.
    pub vehicle_seeds: Vec<u64>,
    /// Where these maps are kept, and found if they are there already.
    pub maps: Option<PathBuf>,
    pub thread_count: usize,
    /// Whether to tell of each pair of those maps.
    pub verbose: bool,
    /// Only rows whose name has one of these in it; all if there is none.
    pub only: Vec<String>,
}

/// What came of a row's seeds.
#[derive(Clone, Debug, Default)]
struct Tally {
    seed_count: usize,
    right_count: usize,
    /// Accepted, but not within the bounds, with the seeds.
    wrong_seeds: Vec<u64>,
    /// The worst of the right ones.
    worst: Deviation,
}

/// How far an alignment is from the truth.
#[derive(Clone, Copy, Debug, Default)]
struct Deviation {
    /// Of the scale's logarithm.
    scale: f64,
    rotation_deg: f64,
    /// Of the target's middle, relative to its extent.
    position: f64,
}

impl Deviation {
    /// - `place`: where positions are compared, in the target.
    fn between(
        found: &Similarity<Target, Source>,
        truth: &Similarity<Target, Source>,
        place: &Vector3<f64>,
        extent: f64,
    ) -> Self {
        let moved = *found * (truth.inverse() * *place);
        Self {
            scale: (found.scale() / truth.scale()).ln().abs(),
            rotation_deg: found.rotation().angle_to(truth.rotation()).to_degrees(),
            position: (moved - place).norm() / extent,
        }
    }

    fn is_within(&self, bounds: &Self) -> bool {
        self.scale < bounds.scale
            && self.rotation_deg < bounds.rotation_deg
            && self.position < bounds.position
    }
}

impl Tally {
    /// - `found`: `None` where it was refused.
    fn add(&mut self, seed: u64, found: Option<Deviation>, bounds: &Deviation) {
        self.seed_count += 1;
        match found {
            Some(deviation) if deviation.is_within(bounds) => {
                self.right_count += 1;
                let worst = &mut self.worst;
                worst.scale = worst.scale.max(deviation.scale);
                worst.rotation_deg = worst.rotation_deg.max(deviation.rotation_deg);
                worst.position = worst.position.max(deviation.position);
            }
            Some(_) => self.wrong_seeds.push(seed),
            None => {}
        }
    }

    fn line(&self, name: &str) -> String {
        let mut line = format!(
            "| {name} | {} of {} | {} | {:.3} % | {:.3}° | {:.3} % |",
            self.right_count,
            self.seed_count,
            self.wrong_seeds.len(),
            100.0 * self.worst.scale,
            self.worst.rotation_deg,
            100.0 * self.worst.position
        );
        if !self.wrong_seeds.is_empty() {
            line += &format!(" <!-- wrong: seeds {:?} -->", self.wrong_seeds);
        }
        line
    }
}

const HEADER: [&str; 2] = [
    "| what | right | wrong | worst scale | worst turn | worst place |",
    "|---|---|---|---|---|---|",
];

/// What `--only` calls the maps of two vehicles.
const VEHICLES: &str = "vehicles in rendered rooms";

/// Measures every row in turn; `report` sees each line of the table as soon as it is known.
/// Returns whether no vehicle's map was accepted at a wrong place.
pub fn measure(
    settings: &RegistrationSettings,
    data: Option<&Path>,
    mut report: impl FnMut(&str),
) -> Result<bool> {
    let is_wanted = |name: &str| {
        settings.only.is_empty() || settings.only.iter().any(|part| name.contains(part))
    };
    HEADER.iter().for_each(|line| report(line));
    for case in correspondences::cases() {
        if is_wanted(&case.name()) {
            let tally = case.run(settings.correspondence_seed_count);
            report(&tally.line(&case.name()));
        }
    }
    if is_wanted(benchmark::NAME) {
        match data {
            Some(data) => report(&benchmark::run(data)?.line(benchmark::NAME)),
            None => report(&format!(
                "| {} | skipped: no data | | | | |",
                benchmark::NAME
            )),
        }
    }
    let maps = data.map(two_maps::TwoMaps::read).transpose()?;
    for case in two_maps::cases() {
        if !is_wanted(case.name) {
            continue;
        }
        match &maps {
            Some(maps) => report(&maps.run(&case, settings.map_seed_count).line(case.name)),
            None => report(&format!("| {} | skipped: no data | | | | |", case.name)),
        }
    }
    if !is_wanted(VEHICLES) {
        return Ok(true);
    }
    report("");
    if let Some(maps) = &settings.maps {
        fs::create_dir_all(maps).with_context(|| format!("cannot make {}", maps.display()))?;
    }
    Ok(pairs::measure(settings, report))
}

/// Evenly distributed over all rotations.
fn random_rotation(rng: &mut ChaCha8Rng) -> UnitQuaternion<f64> {
    loop {
        let point = Vector4::from_fn(|_, _| 2.0 * rng.random::<f64>() - 1.0);
        if (0.01..1.0).contains(&point.norm_squared()) {
            return UnitQuaternion::from_quaternion(Quaternion::from(point));
        }
    }
}

/// Nearly normal: a sum of uniform draws with a standard deviation of one.
fn random_normal(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    (0..12)
        .map(|_| Vector3::from_fn(|_, _| rng.random::<f64>() - 0.5))
        .sum()
}

/// The numbers of a text file, as many as expected.
fn read_numbers<const COUNT: usize>(path: &Path) -> Result<[f64; COUNT]> {
    let text =
        fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let words = text.split(|letter: char| letter.is_whitespace() || letter == ',');
    let numbers: Vec<f64> = words
        .filter(|word| !word.is_empty())
        .map(str::parse)
        .collect::<Result<_, _>>()
        .with_context(|| format!("no number in {}", path.display()))?;
    let count = numbers.len();
    let expected = numbers.try_into().ok();
    expected.with_context(|| format!("{count} numbers, expected {COUNT}: {}", path.display()))
}

/// - `linear`: scale times rotation.
fn similarity(linear: &Matrix3<f64>, translation: Vector3<f64>) -> Similarity<Target, Source> {
    let scale = linear.determinant().cbrt();
    let rotation = UnitQuaternion::from_matrix(&(linear / scale));
    Similarity::new(scale, rotation, translation)
}
