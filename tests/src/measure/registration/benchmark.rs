//! Ten correspondences without noise, up to three of them wrong: `cloud/teaser_benchmark`.

use std::path::Path;

use anyhow::{Context, Result};
use nalgebra::{Matrix3, Vector3};
use peer::files::read_cloud;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use registration::search::{ConsensusSettings, Correspondence, find_consensus};

use super::{Deviation, Tally, read_numbers, similarity};

pub(super) const NAME: &str = "ten correspondences without noise, three cases";
/// The files have 13 to 15 digits.
const BOUNDS: Deviation = Deviation {
    scale: 1e-9,
    rotation_deg: 1e-5,
    position: 1e-9,
};
/// What is not exact is wrong.
const INLIER_DISTANCE: f64 = 1e-3;

/// - `data`: the folder with all recordings.
pub(super) fn run(data: &Path) -> Result<Tally> {
    let mut tally = Tally::default();
    for case in 1..=3 {
        let folder = data.join(format!("cloud/teaser_benchmark/{case}"));
        tally.add(case, deviation(&folder)?, &BOUNDS);
    }
    Ok(tally)
}

fn deviation(folder: &Path) -> Result<Option<Deviation>> {
    let file = |name: &str| folder.join(name);
    let in_source = read_cloud(&file("src.ply"))?.points;
    let in_target = read_cloud(&file("dst.ply"))?.points;
    let pairs: Vec<Correspondence> = in_source
        .into_iter()
        .zip(in_target)
        .map(|(in_source, in_target)| Correspondence {
            in_target,
            in_source,
        })
        .collect();
    let [scale] = read_numbers(&file("s_ref.csv"))?;
    let rotation = Matrix3::from_row_slice(&read_numbers::<9>(&file("R_ref.csv"))?);
    let translation = Vector3::from(read_numbers::<3>(&file("t_ref.csv"))?);
    let truth = similarity(&(rotation * scale), translation);
    let settings = ConsensusSettings {
        inlier_distance: INLIER_DISTANCE,
        ..ConsensusSettings::default()
    };
    let found = find_consensus(&pairs, &settings, &mut ChaCha8Rng::seed_from_u64(1));
    let first = pairs.first().context("no points")?;
    Ok(found.first().map(|best| {
        let place = truth * first.in_source;
        Deviation::between(&best.target_from_source, &truth, &place, 1.0)
    }))
}
