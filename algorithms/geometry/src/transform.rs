//! Rigid transforms between frames.

use std::marker::PhantomData;
use std::ops::Mul;

use nalgebra::{Matrix3, Matrix4, Matrix6, UnitQuaternion, Vector3, Vector6};

use crate::so3;

/// A rigid transform that maps points of `Source` into `Target`: `p_target = R p_source + t`.
///
/// Tangent vectors are `[ω; ν]`, rotation first, and perturb on the right: `pose * exp(delta)`.
pub struct Transform<Target, Source> {
    rotation: UnitQuaternion<f64>,
    translation: Vector3<f64>,
    frames: PhantomData<fn() -> (Target, Source)>,
}

impl<Target, Source> Transform<Target, Source> {
    /// The transform with this rotation, and with this position of the source's origin.
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        Self {
            rotation,
            translation,
            frames: PhantomData,
        }
    }

    /// The transform between two frames that coincide.
    pub fn identity() -> Self {
        Self::new(UnitQuaternion::identity(), Vector3::zeros())
    }

    /// The rotation from the source's axes to the target's.
    pub fn rotation(&self) -> &UnitQuaternion<f64> {
        &self.rotation
    }

    /// The source's origin, in the target frame.
    pub fn translation(&self) -> &Vector3<f64> {
        &self.translation
    }

    /// The rotation as a matrix.
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        *self.rotation.to_rotation_matrix().matrix()
    }

    /// `source_from_target`.
    pub fn inverse(&self) -> Transform<Source, Target> {
        let rotation = self.rotation.inverse();
        Transform::new(rotation, -(rotation * self.translation))
    }

    /// The 4×4 homogeneous matrix.
    pub fn to_matrix(&self) -> Matrix4<f64> {
        let mut matrix = Matrix4::identity();
        matrix
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&self.rotation_matrix());
        matrix
            .fixed_view_mut::<3, 1>(0, 3)
            .copy_from(&self.translation);
        matrix
    }

    /// The adjoint: `exp(Ad ξ) T = T exp(ξ)` for `[ω; ν]`.
    pub fn adjoint(&self) -> Matrix6<f64> {
        let rotation = self.rotation_matrix();
        let mut adjoint = Matrix6::zeros();
        adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        adjoint
            .fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&(so3::hat(&self.translation) * rotation));
        adjoint
    }

    /// The same numbers between other frames: a named statement that the frames coincide.
    pub fn relabel<OtherTarget, OtherSource>(&self) -> Transform<OtherTarget, OtherSource> {
        Transform::new(self.rotation, self.translation)
    }

    /// The tangent `[ω; ν]` of which this is the exponential, ignoring the frames.
    pub fn log(&self) -> Vector6<f64> {
        let omega = so3::log(&self.rotation);
        let nu = so3::left_jacobian_inverse(&omega) * self.translation;
        Vector6::new(omega.x, omega.y, omega.z, nu.x, nu.y, nu.z)
    }

    /// This pose moved by a tangent step in its source frame: `self * exp(delta)`.
    pub fn perturbed(&self, delta: &Vector6<f64>) -> Self {
        *self * Transform::<Source, Source>::exp(delta)
    }
}

impl<Frame> Transform<Frame, Frame> {
    /// The rigid motion with the tangent `[ω; ν]`.
    pub fn exp(tangent: &Vector6<f64>) -> Self {
        let omega = tangent.fixed_rows::<3>(0).into_owned();
        let nu = tangent.fixed_rows::<3>(3).into_owned();
        Self::new(so3::exp(&omega), so3::left_jacobian(&omega) * nu)
    }
}

impl<A, B, C> Mul<Transform<B, C>> for Transform<A, B> {
    type Output = Transform<A, C>;

    fn mul(self, right: Transform<B, C>) -> Transform<A, C> {
        let translation = self.rotation * right.translation + self.translation;
        let mut rotation = self.rotation * right.rotation;
        rotation.renormalize_fast();
        Transform::new(rotation, translation)
    }
}

impl<Target, Source> Mul<Vector3<f64>> for Transform<Target, Source> {
    type Output = Vector3<f64>;

    /// Maps a point.
    fn mul(self, point_in_source: Vector3<f64>) -> Vector3<f64> {
        self.rotation * point_in_source + self.translation
    }
}

impl<Target, Source> Clone for Transform<Target, Source> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<Target, Source> Copy for Transform<Target, Source> {}

impl<Target, Source> PartialEq for Transform<Target, Source> {
    fn eq(&self, other: &Self) -> bool {
        self.rotation == other.rotation && self.translation == other.translation
    }
}

impl<Target, Source> std::fmt::Debug for Transform<Target, Source> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let q = &self.rotation;
        let t = &self.translation;
        write!(
            f,
            "Transform {{ q_xyzw: [{}, {}, {}, {}], t: [{}, {}, {}] }}",
            q.i, q.j, q.k, q.w, t.x, t.y, t.z
        )
    }
}
