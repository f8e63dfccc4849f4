//! Position fixes from files: a trajectory of a site, or a table of geodetic positions.

use std::path::{Path, PathBuf};

use anchor::{FixPosition, PositionFix};
use geodesy::Geodetic;
use geometry::Timestamp;
use nalgebra::{Matrix3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::config::PositionConfig;
use crate::files::parse_seconds;

/// Why a file brings no fixes.
#[derive(Debug, thiserror::Error)]
pub enum PositionError {
    #[error("cannot read the fixes: {error}: {path}")]
    Unreadable {
        error: std::io::Error,
        path: PathBuf,
    },
    #[error(
        "no usable line of {line_count}; expected TUM (`timestamp tx ty tz …`) or CSV \
         (`timestamp,latitude_deg,longitude_deg,altitude_m[,sigma_m]`): {path}"
    )]
    NoFixes { line_count: usize, path: PathBuf },
}

/// The fixes of a file in the order of time, and what was left out.
#[derive(Debug, Default)]
pub struct FixFile {
    pub fixes: Vec<PositionFix>,
    /// Lines that are no fix, for example with NaN in them.
    pub malformed_count: usize,
    /// Lines that are not newer than the one before.
    pub out_of_order_count: usize,
}

/// Reads fixes. Of a trajectory only the positions are read, never the orientations.
pub fn read_fixes(config: &PositionConfig, path: &Path) -> Result<FixFile, PositionError> {
    let text = std::fs::read_to_string(path).map_err(|error| PositionError::Unreadable {
        error,
        path: path.to_owned(),
    })?;
    let mut file = FixFile::default();
    let mut line_count = 0;
    let mut newest: Option<Timestamp> = None;
    for line in text.lines().map(str::trim) {
        if line.is_empty() || line.starts_with(|first: char| first == '#' || first.is_alphabetic())
        {
            continue;
        }
        line_count += 1;
        match parse_line(line, config) {
            None => file.malformed_count += 1,
            Some(fix) if newest.is_some_and(|newest| fix.captured_at <= newest) => {
                file.out_of_order_count += 1;
            }
            Some(fix) => {
                newest = Some(fix.captured_at);
                file.fixes.push(disturbed(fix, config));
            }
        }
    }
    if file.fixes.is_empty() {
        return Err(PositionError::NoFixes {
            line_count,
            path: path.to_owned(),
        });
    }
    Ok(file)
}

fn parse_line(line: &str, config: &PositionConfig) -> Option<PositionFix> {
    let (captured_at, position, sigma_m) = if line.contains(',') {
        parse_geodetic(line)?
    } else {
        parse_site(line)?
    };
    let stated_m = sigma_m.unwrap_or(config.sigma_m);
    let sigma_m = stated_m.hypot(config.noise_m);
    let fix = PositionFix {
        captured_at,
        position,
        covariance: Matrix3::identity() * (sigma_m * sigma_m),
        heading: None,
    };
    fix.is_well_formed().then_some(fix)
}

type ParsedLine = (Timestamp, FixPosition, Option<f64>);

fn parse_site(line: &str) -> Option<ParsedLine> {
    let mut fields = line.split_whitespace();
    let captured_at = parse_seconds(fields.next()?)?;
    let mut coordinate = || finite(fields.next()?);
    let point = Vector3::new(coordinate()?, coordinate()?, coordinate()?);
    // What follows is an orientation, and is left alone.
    Some((captured_at, FixPosition::Local(point), None))
}

fn parse_geodetic(line: &str) -> Option<ParsedLine> {
    let fields: Vec<&str> = line.split(',').map(str::trim).collect();
    let &[stamp, latitude, longitude, height, ref rest @ ..] = fields.as_slice() else {
        return None;
    };
    let position =
        Geodetic::from_degrees(finite(latitude)?, finite(longitude)?, finite(height)?).ok()?;
    let sigma_m = match rest {
        [] | [""] => None,
        [sigma_m, ..] => Some(finite(sigma_m).filter(|sigma_m| *sigma_m > 0.0)?),
    };
    Some((
        parse_seconds(stamp)?,
        FixPosition::Geodetic(position),
        sigma_m,
    ))
}

fn finite(text: &str) -> Option<f64> {
    text.parse().ok().filter(|value: &f64| value.is_finite())
}

/// The fix with noise that depends on nothing but the seed and its own stamp, so that fixes that
/// are removed change nothing else.
fn disturbed(fix: PositionFix, config: &PositionConfig) -> PositionFix {
    if config.noise_m == 0.0 {
        return fix;
    }
    let mut seed = [0; 32];
    seed[..8].copy_from_slice(&config.noise_seed.to_le_bytes());
    seed[8..16].copy_from_slice(&fix.captured_at.nanoseconds().to_le_bytes());
    let mut rng = ChaCha8Rng::from_seed(seed);
    let noise = Vector3::from_fn(|_, _| {
        let normal: f64 = StandardNormal.sample(&mut rng);
        normal * config.noise_m
    });
    let position = match fix.position {
        FixPosition::Local(point) => FixPosition::Local(point + noise),
        FixPosition::Geodetic(position) => {
            let moved = position.ecef_from_enu() * noise;
            FixPosition::Geodetic(Geodetic::from_ecef(&moved).unwrap_or(position))
        }
    };
    PositionFix { position, ..fix }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, noise_m: f64) -> Result<FixFile, PositionError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fixes.txt");
        std::fs::write(&path, text).unwrap();
        let config = PositionConfig {
            sigma_m: 0.1,
            noise_m,
            noise_seed: 3,
            ..PositionConfig::default()
        };
        read_fixes(&config, &path)
    }

    #[test]
    fn orientations_are_not_read() {
        let plain = read("0.5 1 2 3\n", 0.0).unwrap();
        let turned = read("0.5 1 2 3 0.1 0.2 0.3 0.9\n", 0.0).unwrap();
        let nonsense = read("0.5 1 2 3 nan nan x y\n", 0.0).unwrap();
        assert_eq!(plain.fixes, turned.fixes);
        assert_eq!(plain.fixes, nonsense.fixes);
    }

    #[test]
    fn bad_lines_are_counted_and_skipped() {
        let text = "# stamp\n0 1 2 3\n1 nan 2 3\n0.5 1 2 3\n0.5 1 2 3\n0.2 1 2 3\n2 1\n3 1 2 3\n";
        let file = read(text, 0.0).unwrap();
        assert_eq!(file.fixes.len(), 3);
        assert_eq!((file.malformed_count, file.out_of_order_count), (2, 2));
        assert!(read("nothing here\n", 0.0).is_err());
    }

    #[test]
    fn reads_geodetic_positions_with_their_sigma() {
        let file = read(
            "timestamp,latitude_deg\n0,52.1,13.2,40\n1,52.1,13.2,40,0.5\n",
            0.0,
        );
        let fixes = file.unwrap().fixes;
        assert!((fixes[0].sigma_m() - 0.1).abs() < 1e-12);
        assert!((fixes[1].sigma_m() - 0.5).abs() < 1e-12);
        assert!(matches!(fixes[1].position, FixPosition::Geodetic(_)));
    }

    #[test]
    fn noise_of_a_fix_depends_on_its_stamp_alone() {
        let all = read("0 1 2 3\n1 1 2 3\n2 1 2 3\n", 0.5).unwrap().fixes;
        let some = read("0 1 2 3\n2 1 2 3\n", 0.5).unwrap().fixes;
        assert_eq!(all[0], some[0]);
        assert_eq!(all[2], some[1]);
        assert_ne!(all[0].position, all[1].position);
    }
}
