//! Similarity transforms: what relates maps that have no metric scale.

use std::marker::PhantomData;
use std::ops::Mul;

use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, UnitQuaternion, Vector3};

use crate::{Transform, so3};

/// A tangent of Sim(3): `[ω; ν; ln s]`.
pub type Tangent7 = SVector<f64, 7>;
/// A 7×7 matrix over `[ω; ν; ln s]`.
pub type Matrix7 = SMatrix<f64, 7, 7>;

/// A similarity that maps points of `Source` into `Target`: `p_target = s R p_source + t`, `s > 0`.
///
/// Tangent vectors are `[ω; ν; ln s]` and perturb on the right: `similarity * exp(delta)`.
pub struct Similarity<Target, Source> {
    scale: f64,
    rotation: UnitQuaternion<f64>,
    translation: Vector3<f64>,
    frames: PhantomData<fn() -> (Target, Source)>,
}

impl<Target, Source> Similarity<Target, Source> {
    /// The similarity with these parts.
    ///
    /// # Panics
    /// If `scale` is not positive and finite: that is a bug of the caller.
    pub fn new(scale: f64, rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        assert!(
            scale > 0.0 && scale.is_finite(),
            "a similarity's scale is positive, got {scale}"
        );
        Self {
            scale,
            rotation,
            translation,
            frames: PhantomData,
        }
    }

    /// The similarity between two frames that coincide.
    pub fn identity() -> Self {
        Self::new(1.0, UnitQuaternion::identity(), Vector3::zeros())
    }

    /// Length in the target per length in the source.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// The rotation from the source's axes to the target's.
    pub fn rotation(&self) -> &UnitQuaternion<f64> {
        &self.rotation
    }

    /// The source's origin, in the target frame.
    pub fn translation(&self) -> &Vector3<f64> {
        &self.translation
    }

    /// `s R`, the upper left of [`Similarity::to_matrix`].
    pub fn linear_matrix(&self) -> Matrix3<f64> {
        self.rotation.to_rotation_matrix().matrix() * self.scale
    }

    /// `source_from_target`.
    pub fn inverse(&self) -> Similarity<Source, Target> {
        let rotation = self.rotation.inverse();
        let scale = 1.0 / self.scale;
        Similarity::new(scale, rotation, -(rotation * self.translation) * scale)
    }

    /// The 4×4 homogeneous matrix, `s R` in the upper left.
    pub fn to_matrix(&self) -> Matrix4<f64> {
        let mut matrix = Matrix4::identity();
        matrix
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&self.linear_matrix());
        matrix
            .fixed_view_mut::<3, 1>(0, 3)
            .copy_from(&self.translation);
        matrix
    }

    /// The adjoint: `exp(Ad ξ) S = S exp(ξ)` for `[ω; ν; ln s]`.
    pub fn adjoint(&self) -> Matrix7 {
        let rotation = *self.rotation.to_rotation_matrix().matrix();
        let mut adjoint = Matrix7::zeros();
        adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        adjoint
            .fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&(so3::hat(&self.translation) * rotation));
        adjoint
            .fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&(rotation * self.scale));
        adjoint
            .fixed_view_mut::<3, 1>(3, 6)
            .copy_from(&-self.translation);
        adjoint[(6, 6)] = 1.0;
        adjoint
    }

    /// Moves a rigid pose: the rotation is turned, the position mapped, the scale kept out.
    pub fn transform_pose<Other>(
        &self,
        pose: &Transform<Source, Other>,
    ) -> Transform<Target, Other> {
        Transform::new(self.rotation * pose.rotation(), *self * *pose.translation())
    }

    /// The same numbers between other frames: a named statement that the frames coincide.
    pub fn relabel<OtherTarget, OtherSource>(&self) -> Similarity<OtherTarget, OtherSource> {
        Similarity::new(self.scale, self.rotation, self.translation)
    }

    /// The rigid transform with the same rotation and translation, where the scale is known to
    /// be one.
    pub fn rigid_part(&self) -> Transform<Target, Source> {
        Transform::new(self.rotation, self.translation)
    }

    /// The tangent `[ω; ν; ln s]` of which this is the exponential, ignoring the frames.
    pub fn log(&self) -> Tangent7 {
        let omega = so3::log(&self.rotation);
        let log_scale = self.scale.ln();
        let inverse = translation_factor(&omega, log_scale)
            .try_inverse()
            .expect("the factor is singular only at |ω| = 2π, and log gives at most π");
        let nu = inverse * self.translation;
        Tangent7::from_column_slice(&[omega.x, omega.y, omega.z, nu.x, nu.y, nu.z, log_scale])
    }

    /// This similarity moved by a tangent step in its source frame: `self * exp(delta)`.
    pub fn perturbed(&self, delta: &Tangent7) -> Self {
        *self * Similarity::<Source, Source>::exp(delta)
    }
}

impl<Frame> Similarity<Frame, Frame> {
    /// The similarity with the tangent `[ω; ν; ln s]`.
    pub fn exp(tangent: &Tangent7) -> Self {
        let omega = tangent.fixed_rows::<3>(0).into_owned();
        let nu = tangent.fixed_rows::<3>(3).into_owned();
        let log_scale = tangent[6];
        let translation = translation_factor(&omega, log_scale) * nu;
        Self::new(log_scale.exp(), so3::exp(&omega), translation)
    }
}

/// `W = ∫₀¹ e^{σu} exp(u [ω]×) du`, so that the translation of `exp` is `W ν`
/// (Strasdat 2012, appendix A.3, written as a complex integral).
fn translation_factor(omega: &Vector3<f64>, log_scale: f64) -> Matrix3<f64> {
    let angle = omega.norm();
    let omega_hat = so3::hat(omega);
    if angle < 1e-3 {
        let moment = |power: u32| exponential_moment(log_scale, power);
        let square = omega_hat * omega_hat;
        let (c, d) = (
            moment(1) - angle * angle * moment(3) / 6.0,
            moment(2) / 2.0 - angle * angle * moment(4) / 24.0,
        );
        return Matrix3::identity() * moment(0) + omega_hat * c + square * d;
    }
    // ∫ e^{(σ + iθ)u} du = (e^{σ + iθ} − 1) / (σ + iθ)
    let (sine, cosine) = angle.sin_cos();
    let scale = log_scale.exp();
    let (real, imaginary) = (scale * cosine - 1.0, scale * sine);
    let norm_squared = log_scale * log_scale + angle * angle;
    let cosine_integral = (real * log_scale + imaginary * angle) / norm_squared;
    let sine_integral = (imaginary * log_scale - real * angle) / norm_squared;
    let unit_integral = exponential_moment(log_scale, 0);
    Matrix3::identity() * unit_integral
        + omega_hat * (sine_integral / angle)
        + omega_hat * omega_hat * ((unit_integral - cosine_integral) / (angle * angle))
}

/// `∫₀¹ uᵏ e^{σu} du`, as a series where the closed form would cancel.
fn exponential_moment(log_scale: f64, power: u32) -> f64 {
    if log_scale.abs() < 1.0 {
        let mut term = 1.0;
        let mut sum = 0.0;
        for order in 0..20_u32 {
            sum += term / f64::from(order + power + 1);
            term *= log_scale / f64::from(order + 1);
        }
        return sum;
    }
    let mut moment = log_scale.exp_m1() / log_scale;
    for k in 1..=power {
        moment = (log_scale.exp() - f64::from(k) * moment) / log_scale;
    }
    moment
}

impl<A, B, C> Mul<Similarity<B, C>> for Similarity<A, B> {
    type Output = Similarity<A, C>;

    fn mul(self, right: Similarity<B, C>) -> Similarity<A, C> {
        let mut rotation = self.rotation * right.rotation;
        rotation.renormalize_fast();
        Similarity::new(self.scale * right.scale, rotation, self * right.translation)
    }
}

impl<A, B, C> Mul<Transform<B, C>> for Similarity<A, B> {
    type Output = Similarity<A, C>;

    fn mul(self, right: Transform<B, C>) -> Similarity<A, C> {
        self * Similarity::from(right)
    }
}

impl<A, B, C> Mul<Similarity<B, C>> for Transform<A, B> {
    type Output = Similarity<A, C>;

    fn mul(self, right: Similarity<B, C>) -> Similarity<A, C> {
        Similarity::from(self) * right
    }
}

impl<Target, Source> Mul<Vector3<f64>> for Similarity<Target, Source> {
    type Output = Vector3<f64>;

    /// Maps a point.
    fn mul(self, point_in_source: Vector3<f64>) -> Vector3<f64> {
        self.rotation * point_in_source * self.scale + self.translation
    }
}

impl<Target, Source> From<Transform<Target, Source>> for Similarity<Target, Source> {
    fn from(rigid: Transform<Target, Source>) -> Self {
        Self::new(1.0, *rigid.rotation(), *rigid.translation())
    }
}

impl<Target, Source> Clone for Similarity<Target, Source> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<Target, Source> Copy for Similarity<Target, Source> {}

impl<Target, Source> PartialEq for Similarity<Target, Source> {
    fn eq(&self, other: &Self) -> bool {
        self.scale == other.scale
            && self.rotation == other.rotation
            && self.translation == other.translation
    }
}

impl<Target, Source> std::fmt::Debug for Similarity<Target, Source> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "Similarity {{ s: {}, {:?} }}",
            self.scale,
            self.rigid_part()
        )
    }
}
