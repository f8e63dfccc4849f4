//! The ellipsoid: latitude, longitude, height to Earth-centred coordinates and back.

use geometry::{Ecef, Enu, Transform};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::GeodesyError;

/// Equatorial radius (m), defining constant of WGS84.
const SEMI_MAJOR_M: f64 = 6_378_137.0;
/// Flattening, defining constant of WGS84.
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// First eccentricity squared.
const ECCENTRICITY_SQUARED: f64 = FLATTENING * (2.0 - FLATTENING);
const SEMI_MINOR_M: f64 = SEMI_MAJOR_M * (1.0 - FLATTENING);
/// Heights (m) outside are refused: nothing that flies with a camera map is there.
const HEIGHT_RANGE_M: (f64, f64) = (-12_000.0, 100_000.0);

/// A position on or near the WGS84 ellipsoid: latitude, longitude, ellipsoidal height, all valid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    latitude_deg: f64,
    longitude_deg: f64,
    height_m: f64,
}

impl Geodetic {
    /// The position, or why it is none: latitude ±90°, longitude ±180°, height −12 to 100 km.
    pub fn from_degrees(
        latitude_deg: f64,
        longitude_deg: f64,
        height_m: f64,
    ) -> Result<Self, GeodesyError> {
        check("latitude_deg", latitude_deg, (-90.0, 90.0))?;
        check("longitude_deg", longitude_deg, (-180.0, 180.0))?;
        check("height_m", height_m, HEIGHT_RANGE_M)?;
        Ok(Self {
            latitude_deg,
            longitude_deg,
            height_m,
        })
    }

    /// The position of a point in Earth-centred coordinates (m).
    ///
    /// Bowring's iteration on the parametric latitude (Bowring 1976), to the last bit in the
    /// range of heights that is accepted.
    pub fn from_ecef(point_in_ecef: &Vector3<f64>) -> Result<Self, GeodesyError> {
        let radius_m = point_in_ecef.norm();
        check(
            "distance from the Earth's centre",
            radius_m,
            (
                SEMI_MINOR_M + HEIGHT_RANGE_M.0,
                SEMI_MAJOR_M + HEIGHT_RANGE_M.1,
            ),
        )?;
        let equatorial_m = point_in_ecef.x.hypot(point_in_ecef.y);
        let second_eccentricity_squared = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED);
        let mut parametric = (point_in_ecef.z * SEMI_MAJOR_M).atan2(equatorial_m * SEMI_MINOR_M);
        let mut latitude = 0.0;
        for _ in 0..4 {
            let (sine, cosine) = parametric.sin_cos();
            latitude = (point_in_ecef.z
                + second_eccentricity_squared * SEMI_MINOR_M * sine.powi(3))
            .atan2(equatorial_m - ECCENTRICITY_SQUARED * SEMI_MAJOR_M * cosine.powi(3));
            let (sine, cosine) = f64::sin_cos(latitude);
            parametric = (SEMI_MINOR_M * sine).atan2(SEMI_MAJOR_M * cosine);
        }
        let (sine, cosine) = f64::sin_cos(latitude);
        // This form of the height has no singularity at the poles.
        let height_m = equatorial_m * cosine + point_in_ecef.z * sine
            - SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQUARED * sine * sine).sqrt();
        let longitude = point_in_ecef.y.atan2(point_in_ecef.x);
        Self::from_degrees(latitude.to_degrees(), longitude.to_degrees(), height_m)
    }

    /// This position in Earth-centred coordinates (m).
    pub fn to_ecef(&self) -> Vector3<f64> {
        let (sine, cosine) = self.latitude_rad().sin_cos();
        let (sine_longitude, cosine_longitude) = self.longitude_rad().sin_cos();
        let normal_m = SEMI_MAJOR_M / (1.0 - ECCENTRICITY_SQUARED * sine * sine).sqrt();
        let equatorial_m = (normal_m + self.height_m) * cosine;
        Vector3::new(
            equatorial_m * cosine_longitude,
            equatorial_m * sine_longitude,
            (normal_m * (1.0 - ECCENTRICITY_SQUARED) + self.height_m) * sine,
        )
    }

    /// The frame with its origin here and its axes east, north and up.
    pub fn ecef_from_enu(&self) -> Transform<Ecef, Enu> {
        let (sine, cosine) = self.latitude_rad().sin_cos();
        let (sine_longitude, cosine_longitude) = self.longitude_rad().sin_cos();
        let east = Vector3::new(-sine_longitude, cosine_longitude, 0.0);
        let up = Vector3::new(cosine * cosine_longitude, cosine * sine_longitude, sine);
        let axes = Matrix3::from_columns(&[east, up.cross(&east), up]);
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        Transform::new(rotation, self.to_ecef())
    }

    pub fn latitude_deg(&self) -> f64 {
        self.latitude_deg
    }

    pub fn longitude_deg(&self) -> f64 {
        self.longitude_deg
    }

    pub fn latitude_rad(&self) -> f64 {
        self.latitude_deg.to_radians()
    }

    pub fn longitude_rad(&self) -> f64 {
        self.longitude_deg.to_radians()
    }

    /// Height above the ellipsoid, not above the sea.
    pub fn height_m(&self) -> f64 {
        self.height_m
    }
}

fn check(
    quantity: &'static str,
    got: f64,
    (minimum, maximum): (f64, f64),
) -> Result<(), GeodesyError> {
    // Written so that NaN is refused too.
    if got >= minimum && got <= maximum {
        return Ok(());
    }
    Err(GeodesyError::OutOfRange {
        quantity,
        got,
        minimum,
        maximum,
    })
}
