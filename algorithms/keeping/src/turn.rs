//! Turns about the vertical.

use nalgebra::Vector3;

/// A turn to the left, prepared for many vectors.
#[derive(Clone, Copy, Debug)]
pub struct Turn {
    sin: f64,
    cos: f64,
}

impl Turn {
    pub fn by(angle_rad: f64) -> Self {
        let (sin, cos) = angle_rad.sin_cos();
        Self { sin, cos }
    }

    pub fn of(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(
            self.cos * vector.x - self.sin * vector.y,
            self.sin * vector.x + self.cos * vector.y,
            vector.z,
        )
    }
}
