//! What a vehicle's ENU coordinates are relative to.

use std::fmt;

use geometry::{Ecef, Enu, Transform};
use nalgebra::Vector3;

use crate::{GeodesyError, Geodetic};

/// The origin of a global frame: a point on the Earth, or a named site such as a motion-capture
/// room whose own axes play ENU's part.
#[derive(Clone, Debug, PartialEq)]
pub enum Datum {
    Wgs84(Geodetic),
    Site(SiteName),
}

/// A site's name: 1 to 32 letters, digits, `-`, `_` or `.`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SiteName(String);

/// Where a site stands on the Earth.
#[derive(Clone, Debug, PartialEq)]
pub struct SiteSurvey {
    pub site: SiteName,
    pub ecef_from_site: Transform<Ecef, Enu>,
}

impl Datum {
    /// The site with this name.
    pub fn site(name: &str) -> Result<Self, GeodesyError> {
        Ok(Self::Site(SiteName::new(name)?))
    }

    /// Where this datum's frame stands on the Earth; `None` for a site that was not surveyed.
    pub fn ecef_from_enu(&self, surveys: &[SiteSurvey]) -> Option<Transform<Ecef, Enu>> {
        match self {
            Self::Wgs84(origin) => Some(origin.ecef_from_enu()),
            Self::Site(name) => surveys
                .iter()
                .find(|survey| survey.site == *name)
                .map(|survey| survey.ecef_from_site),
        }
    }

    /// A geodetic position in this datum's frame (m).
    pub fn point_in_enu(
        &self,
        position: &Geodetic,
        surveys: &[SiteSurvey],
    ) -> Result<Vector3<f64>, GeodesyError> {
        let ecef_from_enu = self
            .ecef_from_enu(surveys)
            .ok_or_else(|| not_surveyed(self, &"a geodetic position"))?;
        Ok(ecef_from_enu.inverse() * position.to_ecef())
    }

    /// The geodetic position of a point in this datum's frame (m).
    pub fn geodetic(
        &self,
        point_in_enu: &Vector3<f64>,
        surveys: &[SiteSurvey],
    ) -> Result<Geodetic, GeodesyError> {
        let ecef_from_enu = self
            .ecef_from_enu(surveys)
            .ok_or_else(|| not_surveyed(self, &"a geodetic position"))?;
        Geodetic::from_ecef(&(ecef_from_enu * *point_in_enu))
    }
}

/// Maps coordinates about `source` to coordinates about `target`, through the Earth's centre.
///
/// Equal data give the identity exactly. A site relates to anything else only where it was
/// surveyed.
pub fn enu_from_enu(
    target: &Datum,
    source: &Datum,
    surveys: &[SiteSurvey],
) -> Result<Transform<Enu, Enu>, GeodesyError> {
    if target == source {
        return Ok(Transform::identity());
    }
    let place = |datum: &Datum, other: &Datum| {
        datum
            .ecef_from_enu(surveys)
            .ok_or_else(|| not_surveyed(datum, other))
    };
    Ok(place(target, source)?.inverse() * place(source, target)?)
}

impl SiteName {
    /// The name, or why it is none.
    pub fn new(name: &str) -> Result<Self, GeodesyError> {
        let legal = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        if name.is_empty() || name.len() > 32 || !name.chars().all(legal) {
            let got = name.chars().take(40).collect();
            return Err(GeodesyError::SiteName { got });
        }
        Ok(Self(name.to_owned()))
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Datum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Wgs84(origin) => write!(
                f,
                "wgs84 {:.7} {:.7} {:.3}",
                origin.latitude_deg(),
                origin.longitude_deg(),
                origin.height_m()
            ),
            Self::Site(name) => write!(f, "site {}", name.as_str()),
        }
    }
}

fn not_surveyed(datum: &Datum, other: &dyn fmt::Display) -> GeodesyError {
    GeodesyError::NotSurveyed {
        site: datum.to_string(),
        other: other.to_string(),
    }
}
