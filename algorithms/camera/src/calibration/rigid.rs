//! Where a camera sits on its vehicle.

use geometry::Transform;
use nalgebra::{Matrix3, Matrix4, Rotation3, UnitQuaternion, Vector3};

use super::CalibrationError;
use super::node::Node;

/// A 4×4 matrix, row by row.
pub fn read<Target, Source>(
    node: &Node,
    field: &'static str,
) -> Result<Transform<Target, Source>, CalibrationError> {
    let data = super::numbers(node, field)?;
    if data.len() != 16 {
        return Err(CalibrationError::Count {
            field: field.to_owned(),
            got: data.len(),
            expected: "16",
        });
    }
    let matrix = Matrix4::from_row_slice(&data);
    let linear: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    let error = (linear * linear.transpose() - Matrix3::identity()).norm()
        + (linear.determinant() - 1.0).abs();
    let translation: Vector3<f64> = matrix.fixed_view::<3, 1>(0, 3).into_owned();
    // Of numbers that are finite the products need not be.
    if error.is_nan() || error >= 1e-2 {
        return Err(CalibrationError::NotRigid { field, error });
    }
    // The nearest rotation in closed form: nalgebra's iterative `from_matrix` stays where it
    // starts for rotations by a half turn.
    let svd = linear.svd(true, true);
    let nearest = svd.u.unwrap_or_default() * svd.v_t.unwrap_or_default();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(nearest));
    Ok(Transform::new(rotation, translation))
}
