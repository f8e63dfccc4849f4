//! Names and numbers of a lens to its model.

use super::{CalibrationError, Field};
use crate::{Distortion, Intrinsics};

/// Coefficients with the name of the entry that holds them.
pub struct Coefficients<'a> {
    pub field: Field<'a>,
    pub values: &'a [f64],
}

/// Focal lengths and principal point as custom writes them, to those of [`Intrinsics`].
pub fn intrinsics([fx, fy, cx, cy]: [f64; 4], distortion: &Distortion) -> Intrinsics {
    let slope = distortion.customary_slope();
    Intrinsics {
        fx: fx * slope,
        fy: fy * slope,
        cx,
        cy,
    }
}

/// The model of this name, as EuRoC, Kalibr, ROS and OpenCV know it; without a name that with so
/// many coefficients, as OpenCV does.
pub fn distortion(
    model: Option<(&str, Field)>,
    coefficients: &Coefficients,
) -> Result<Distortion, CalibrationError> {
    let values = coefficients.values;
    let count_error = |expected| {
        Err(CalibrationError::Count {
            field: coefficients.field.to_string(),
            got: values.len(),
            expected,
        })
    };
    let Some((name, field)) = model else {
        return brown(values).map_or_else(|| count_error("4, 5 or 8"), Ok);
    };
    match name {
        "none" | "" if values.iter().all(|value| *value == 0.0) => Ok(Distortion::None),
        "none" | "" => count_error("0"),
        "radial-tangential" | "radtan" | "plumb_bob" | "rational_polynomial" | "rational" => {
            brown(values).map_or_else(|| count_error("4, 5 or 8"), Ok)
        }
        "equidistant" | "fisheye" | "kannala_brandt" => match *values {
            [k1, k2, k3, k4] => Ok(Distortion::Equidistant { k1, k2, k3, k4 }),
            _ => count_error("4"),
        },
        "fov" => match *values {
            [omega_rad] => Ok(Distortion::FieldOfView { omega_rad }),
            _ => count_error("1"),
        },
        _ => Err(CalibrationError::DistortionModel {
            field: field.to_string(),
            got: name.to_owned(),
        }),
    }
}

/// In OpenCV's order `k1 k2 p1 p2 k3 k4 k5 k6`; its coefficients for tilted and thin-prism lenses
/// may follow if they are zero.
fn brown(values: &[f64]) -> Option<Distortion> {
    let (used, rest) = values.split_at(values.len().min(8));
    if rest.iter().any(|value| *value != 0.0) {
        return None;
    }
    match *used {
        [] => Some(Distortion::None),
        [k1, k2, p1, p2] => Some(Distortion::RadialTangential {
            k1,
            k2,
            p1,
            p2,
            k3: 0.0,
        }),
        [k1, k2, p1, p2, k3] | [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0] => {
            Some(Distortion::RadialTangential { k1, k2, p1, p2, k3 })
        }
        [k1, k2, p1, p2, k3, k4, k5, k6] => Some(Distortion::Rational {
            radial: [k1, k2, k3, k4, k5, k6],
            p1,
            p2,
        }),
        _ => None,
    }
}
