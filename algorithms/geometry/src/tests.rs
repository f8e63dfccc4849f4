//! Laws of the groups, each checked over random members, and derivatives against differences.

use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, Vector3, Vector6};
use proptest::prelude::*;

use crate::{
    Camera, DegenerateAlignment, Enu, Map, Matrix7, RobustKernel, Similarity, Tangent7, Timestamp,
    Transform, so3, umeyama,
};

fn vector(limit: f64) -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-limit..limit).prop_map(Vector3::from)
}

fn rotation_vector() -> impl Strategy<Value = Vector3<f64>> {
    prop_oneof![vector(1e-9), vector(1e-4), vector(2e-3), vector(1.7)]
}

fn tangent6() -> impl Strategy<Value = Vector6<f64>> {
    (rotation_vector(), vector(3.0)).prop_map(|(w, v)| Vector6::new(w.x, w.y, w.z, v.x, v.y, v.z))
}

fn tangent7() -> impl Strategy<Value = Tangent7> {
    let log_scale = prop_oneof![-1e-9..1e-9, -1e-3..1e-3, -2.0..2.0];
    (rotation_vector(), vector(3.0), log_scale)
        .prop_map(|(w, v, l)| Tangent7::from_column_slice(&[w.x, w.y, w.z, v.x, v.y, v.z, l]))
}

/// The exponential of a matrix by its series, after halving it until the series is short.
fn matrix_exponential(matrix: Matrix4<f64>) -> Matrix4<f64> {
    let halvings = 12;
    let small = matrix / f64::from(1 << halvings);
    let mut term = Matrix4::identity();
    let mut sum = Matrix4::identity();
    for order in 1..12 {
        term = term * small / f64::from(order);
        sum += term;
    }
    for _ in 0..halvings {
        sum *= sum;
    }
    sum
}

fn generator(tangent: &Tangent7) -> Matrix4<f64> {
    let mut matrix = Matrix4::zeros();
    let linear =
        so3::hat(&tangent.fixed_rows::<3>(0).into_owned()) + Matrix3::identity() * tangent[6];
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&linear);
    matrix
        .fixed_view_mut::<3, 1>(0, 3)
        .copy_from(&tangent.fixed_rows::<3>(3));
    matrix
}

fn numeric_jacobian<const N: usize>(
    function: impl Fn(&SVector<f64, N>) -> SVector<f64, N>,
) -> SMatrix<f64, N, N> {
    let step = 1e-6;
    SMatrix::from_columns(&std::array::from_fn::<_, N, _>(|axis| {
        let mut delta = SVector::<f64, N>::zeros();
        delta[axis] = step;
        (function(&delta) - function(&-delta)) / (2.0 * step)
    }))
}

proptest! {
    #[test]
    fn rotation_logarithm_undoes_the_exponential(omega in rotation_vector()) {
        prop_assert!((so3::log(&so3::exp(&omega)) - omega).norm() < 1e-12);
    }

    #[test]
    fn rotation_jacobians_match_differences(omega in rotation_vector()) {
        let start = so3::exp(&omega);
        let left = numeric_jacobian(|d| so3::log(&(so3::exp(&(omega + d)) * start.inverse())));
        let right = numeric_jacobian(|d| so3::log(&(start.inverse() * so3::exp(&(omega + d)))));
        prop_assert!((left - so3::left_jacobian(&omega)).norm() < 1e-7);
        prop_assert!((right - so3::right_jacobian(&omega)).norm() < 1e-7);
        let identity = so3::left_jacobian(&omega) * so3::left_jacobian_inverse(&omega);
        prop_assert!((identity - Matrix3::identity()).norm() < 1e-10);
    }

    #[test]
    fn rigid_group_axioms_hold(a in tangent6(), b in tangent6(), point in vector(5.0)) {
        let first = Transform::<Map, Map>::exp(&a);
        let second = Transform::<Map, Map>::exp(&b);
        prop_assert!((first.log() - a).norm() < 1e-9);
        prop_assert!((first * first.inverse() * point - point).norm() < 1e-10);
        prop_assert!(((first * second) * point - first * (second * point)).norm() < 1e-10);
        let moved = Transform::<Map, Map>::exp(&(first.adjoint() * b)) * first;
        prop_assert!(((moved * point) - (first * second * point)).norm() < 1e-8);
    }

    #[test]
    fn similarity_exponential_matches_the_matrix_series(tangent in tangent7()) {
        let ours = Similarity::<Map, Map>::exp(&tangent).to_matrix();
        let series = matrix_exponential(generator(&tangent));
        prop_assert!((ours - series).norm() < 1e-8 * series.norm(), "{ours} {series}");
    }

    #[test]
    fn similarity_group_axioms_hold(a in tangent7(), b in tangent7(), point in vector(5.0)) {
        let first = Similarity::<Map, Map>::exp(&a);
        let second = Similarity::<Map, Map>::exp(&b);
        prop_assert!((first.log() - a).norm() < 1e-8);
        prop_assert!((first.inverse() * (first * point) - point).norm() < 1e-9);
        let chained = first * (second * point);
        let tolerance = 1e-10 * (1.0 + chained.norm());
        prop_assert!(((first * second) * point - chained).norm() < tolerance);
    }

    #[test]
    fn similarity_adjoint_matches_differences(tangent in tangent7()) {
        let s = Similarity::<Map, Map>::exp(&tangent);
        let numeric: Matrix7 =
            numeric_jacobian(|d| (s * Similarity::<Map, Map>::exp(d) * s.inverse()).log());
        prop_assert!((numeric - s.adjoint()).norm() < 1e-5 * (1.0 + s.adjoint().norm()));
    }

    #[test]
    fn umeyama_recovers_the_similarity(
        tangent in tangent7(),
        points in prop::collection::vec(vector(4.0), 4..30),
    ) {
        let truth: Similarity<Enu, Map> = Similarity::<Map, Map>::exp(&tangent).relabel();
        let pairs = points.iter().map(|p| (truth * *p, *p, 1.0));
        let found = umeyama::<Enu, Map>(pairs.clone(), true).unwrap();
        let worst = pairs.map(|(t, p, _)| (found * p - t).norm()).fold(0.0, f64::max);
        prop_assert!(worst < 1e-7 * (1.0 + truth.scale()), "{worst}");
    }

    #[test]
    fn robust_weight_is_the_slope_of_the_cost(r2 in 0.01_f64..40.0, threshold in 0.5_f64..4.0) {
        for kernel in [
            RobustKernel::None,
            RobustKernel::Huber { threshold },
            RobustKernel::Cauchy { threshold },
            RobustKernel::GemanMcClure { threshold },
            RobustKernel::Tukey { threshold },
        ] {
            let step = 1e-5 * r2;
            let slope = (kernel.cost(r2 + step) - kernel.cost(r2 - step)) / (2.0 * step);
            prop_assert!((slope - kernel.weight(r2)).abs() < 1e-4, "{kernel:?}");
        }
    }

    #[test]
    fn timestamps_print_exactly(nanoseconds in any::<i64>()) {
        let text = Timestamp::from_nanoseconds(nanoseconds).to_string();
        let digits: String = text.chars().filter(|c| *c != '.').collect();
        prop_assert_eq!(digits.parse::<i128>().unwrap(), i128::from(nanoseconds));
    }
}

#[test]
fn a_pose_moved_by_a_similarity_maps_the_cameras_axes() {
    let enu_from_map: Similarity<Enu, Map> = Similarity::new(
        3.0,
        so3::exp(&Vector3::new(0.1, 0.2, 0.3)),
        Vector3::new(1.0, 2.0, 3.0),
    );
    let map_from_camera: Transform<Map, Camera> = Transform::new(
        so3::exp(&Vector3::new(0.0, 0.4, 0.0)),
        Vector3::new(0.5, 0.0, 0.1),
    );
    let enu_from_camera = enu_from_map.transform_pose(&map_from_camera);
    let origin = enu_from_map * *map_from_camera.translation();
    assert!((enu_from_camera.translation() - origin).norm() < 1e-12);
    let axis = Vector3::z();
    let mapped = enu_from_map * (map_from_camera * axis) - origin;
    assert!((enu_from_camera.rotation() * axis - mapped / 3.0).norm() < 1e-12);
}

#[test]
fn umeyama_refuses_what_it_cannot_know() {
    let line = (0..9).map(|i| {
        let p = Vector3::new(f64::from(i), 0.0, 0.0);
        (p, p, 1.0)
    });
    assert_eq!(
        umeyama::<Enu, Map>(line.clone(), true),
        Err(DegenerateAlignment::Collinear)
    );
    assert_eq!(
        umeyama::<Enu, Map>(line.take(2), true),
        Err(DegenerateAlignment::TooFewPairs)
    );
    let weightless = (0..9).map(|_| (Vector3::zeros(), Vector3::zeros(), 0.0));
    assert_eq!(
        umeyama::<Enu, Map>(weightless, true),
        Err(DegenerateAlignment::TooFewPairs)
    );
}

#[test]
fn timestamps_refuse_what_no_clock_shows() {
    assert_eq!(Timestamp::from_seconds(f64::NAN), None);
    assert_eq!(Timestamp::from_seconds(1e300), None);
    assert_eq!(
        Timestamp::from_seconds(1.5),
        Some(Timestamp::from_nanoseconds(1_500_000_000))
    );
}
