//! The space around a vehicle, cut as in the paper's Fig. 1: twelve lateral sectors, two forward
//! ones, a blind rear.

use nalgebra::Vector3;

/// Pairs of opposed lateral sectors.
pub const PAIR_COUNT: usize = 6;

/// Where in the heading frame a neighbour is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sector {
    /// Opposed sectors share the pair; it is named by its left one, upper 0–2 and lower 3–5.
    Left { pair: usize },
    /// The antipode of the left sector of the pair.
    Right { pair: usize },
    /// Up and ahead, or down and ahead.
    Forward { up: bool },
}

/// The borders of the sectors, as directions.
///
/// Sectors are half-open: `[30°, 70°)` and so on, and level belongs to the upper ones.
#[derive(Clone, Copy, Debug)]
pub struct Sectors {
    /// Horizontal directions at ξ₁ to ξ₄.
    borders: [[f64; 2]; 4],
    sin_elevation_max: f64,
    axes: [Vector3<f64>; PAIR_COUNT],
    forward_axes: [Vector3<f64>; 2],
}

/// Azimuths ξ₁ to ξ₄ of the paper.
const BORDERS_DEG: [f64; 4] = [30.0, 70.0, 110.0, 150.0];

impl Sectors {
    /// - `elevation_rad_max`: ν; what is higher or lower is not seen.
    pub fn new(elevation_rad_max: f64) -> Self {
        let direction_of = |azimuth_deg: f64, elevation_rad: f64| {
            let azimuth_rad = azimuth_deg.to_radians();
            Vector3::new(
                elevation_rad.cos() * azimuth_rad.cos(),
                elevation_rad.cos() * azimuth_rad.sin(),
                elevation_rad.sin(),
            )
        };
        let half_rad = 0.5 * elevation_rad_max;
        let axis_of = |pair: usize| {
            let azimuth_deg = 0.5 * (BORDERS_DEG[pair % 3] + BORDERS_DEG[pair % 3 + 1]);
            direction_of(azimuth_deg, if pair < 3 { half_rad } else { -half_rad })
        };
        Self {
            borders: BORDERS_DEG.map(|border| {
                let border_rad = border.to_radians();
                [border_rad.cos(), border_rad.sin()]
            }),
            sin_elevation_max: elevation_rad_max.sin(),
            axes: std::array::from_fn(axis_of),
            forward_axes: [half_rad, -half_rad]
                .map(|elevation_rad| direction_of(0.0, elevation_rad)),
        }
    }

    /// The centre of the left sector of the pair; that of the right one is its opposite.
    pub fn axis(&self, pair: usize) -> &Vector3<f64> {
        &self.axes[pair]
    }

    pub fn forward_axis(&self, up: bool) -> &Vector3<f64> {
        &self.forward_axes[usize::from(!up)]
    }

    /// The sector of a unit direction, unless it is behind, or too high or low.
    ///
    /// Sides of the borders instead of angles: this is the inner loop.
    pub fn sector_of(&self, direction: &Vector3<f64>) -> Option<Sector> {
        let (x, y) = (direction.x, direction.y);
        if direction.z.abs() > self.sin_elevation_max {
            return None;
        }
        let up = direction.z >= 0.0;
        // Whether the azimuth is within half a turn to the left of the border, which is at ξ, and
        // at -ξ if mirrored.
        let is_left_of = |border: usize| self.borders[border][0] * y >= self.borders[border][1] * x;
        let is_left_of_mirrored =
            |border: usize| self.borders[border][0] * y >= -self.borders[border][1] * x;
        if is_left_of(0) && !is_left_of(3) {
            let step = usize::from(is_left_of(1)) + usize::from(is_left_of(2));
            return Some(Sector::Left {
                pair: if up { step } else { 3 + step },
            });
        }
        if is_left_of_mirrored(3) && !is_left_of_mirrored(0) {
            let step = usize::from(is_left_of_mirrored(2)) + usize::from(is_left_of_mirrored(1));
            return Some(Sector::Right {
                pair: if up { 3 + step } else { step },
            });
        }
        (is_left_of_mirrored(0) && !is_left_of(0)).then_some(Sector::Forward { up })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The same by angles, as the specification is written.
    fn by_angles(azimuth_deg: f64, elevation_deg: f64) -> Option<Sector> {
        if elevation_deg.abs() > 80.0 {
            return None;
        }
        let up = elevation_deg >= 0.0;
        if (-30.0..30.0).contains(&azimuth_deg) {
            return Some(Sector::Forward { up });
        }
        if (30.0..150.0).contains(&azimuth_deg) {
            let step = ((azimuth_deg - 30.0) / 40.0).floor() as usize;
            let pair = if up { step } else { 3 + step };
            return Some(Sector::Left { pair });
        }
        if (-150.0..-30.0).contains(&azimuth_deg) {
            let step = ((azimuth_deg + 150.0) / 40.0).floor() as usize;
            let pair = if up { 3 + step } else { step };
            return Some(Sector::Right { pair });
        }
        None
    }

    fn direction(azimuth_deg: f64, elevation_deg: f64) -> Vector3<f64> {
        let (azimuth, elevation) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
        Vector3::new(
            elevation.cos() * azimuth.cos(),
            elevation.cos() * azimuth.sin(),
            elevation.sin(),
        )
    }

    proptest! {
        #[test]
        fn sides_of_borders_agree_with_angles(
            azimuth_deg in -180.0_f64..180.0,
            elevation_deg in -90.0_f64..90.0,
        ) {
            let sectors = Sectors::new(80_f64.to_radians());
            prop_assert_eq!(
                sectors.sector_of(&direction(azimuth_deg, elevation_deg)),
                by_angles(azimuth_deg, elevation_deg)
            );
        }

        #[test]
        fn opposed_directions_share_the_pair(
            azimuth_deg in 30.001_f64..149.999,
            elevation_deg in 0.001_f64..79.999,
        ) {
            let sectors = Sectors::new(80_f64.to_radians());
            let left = direction(azimuth_deg, elevation_deg);
            let Some(Sector::Left { pair }) = sectors.sector_of(&left) else {
                panic!("not left");
            };
            prop_assert_eq!(sectors.sector_of(&-left), Some(Sector::Right { pair }));
            // The axis is the centre: it lies in the sector itself.
            prop_assert_eq!(sectors.sector_of(sectors.axis(pair)), Some(Sector::Left { pair }));
        }
    }
}
