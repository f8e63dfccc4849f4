//! One line of a file of fixes.

use anchor::{FixPosition, PositionFix};
use geodesy::Geodetic;
use geometry::Timestamp;
use nalgebra::{Matrix3, Vector3};

use crate::config::PositionConfig;
use crate::files::parse_seconds;

/// One fix; `None` if the line is none.
pub fn parse_line(line: &str, config: &PositionConfig) -> Option<PositionFix> {
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
