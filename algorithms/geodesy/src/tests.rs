//! Reference values, round trips and refusals.

use geometry::Transform;
use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;

use crate::{Datum, GeodesyError, Geodetic, SiteName, SiteSurvey, enu_from_enu};

fn geodetic() -> impl Strategy<Value = Geodetic> {
    (-90.0..=90.0_f64, -180.0..180.0_f64, -10_000.0..90_000.0_f64)
        .prop_map(|(lat, lon, h)| Geodetic::from_degrees(lat, lon, h).unwrap())
}

#[test]
fn earth_centred_coordinates_match_the_ellipsoid() {
    // On the axes the coordinates are the semi-axes of WGS84: a = 6378137 m, b = 6356752.314245 m.
    let cases = [
        ((0.0, 0.0, 0.0), [6_378_137.0, 0.0, 0.0]),
        ((0.0, 90.0, 100.0), [0.0, 6_378_237.0, 0.0]),
        ((90.0, 0.0, 0.0), [0.0, 0.0, 6_356_752.314_245]),
        ((-90.0, 0.0, 10.0), [0.0, 0.0, -6_356_762.314_245]),
        // At 45° the normal's length is a/√(1 − e²/2): x = N cos 45°, z = N (1 − e²) sin 45°.
        (
            (45.0, 0.0, 0.0),
            [4_517_590.878_849, 0.0, 4_487_348.408_866],
        ),
    ];
    for ((latitude, longitude, height), expected) in cases {
        let position = Geodetic::from_degrees(latitude, longitude, height).unwrap();
        let error = position.to_ecef() - Vector3::from(expected);
        assert!(error.norm() < 1e-5, "{position:?}: {error}");
    }
}

#[test]
fn a_degree_along_the_meridian_has_its_known_length() {
    // The meridian's radius of curvature at the equator is a (1 − e²) = 6335439.327 m.
    let datum = Datum::Wgs84(Geodetic::from_degrees(0.0, 7.0, 0.0).unwrap());
    let north = Geodetic::from_degrees(1e-3, 7.0, 0.0).unwrap();
    let point = datum.point_in_enu(&north, &[]).unwrap();
    assert!((point.y - 6_335_439.327 * 1e-3_f64.to_radians()).abs() < 1e-6);
    assert!(point.x.abs() < 1e-8 && point.z < 0.0 && point.z > -0.002);
}

proptest! {
    #[test]
    fn geodetic_survives_the_round_trip(position in geodetic()) {
        let back = Geodetic::from_ecef(&position.to_ecef()).unwrap();
        prop_assert!((back.to_ecef() - position.to_ecef()).norm() < 1e-7);
        let tolerance = 1e-9;
        prop_assert!((back.latitude_rad() - position.latitude_rad()).abs() < tolerance);
        prop_assert!((back.height_m() - position.height_m()).abs() < 1e-6);
        let turned = (back.longitude_rad() - position.longitude_rad()).sin().abs();
        prop_assert!(turned * position.latitude_rad().cos() < tolerance);
    }

    #[test]
    fn enu_axes_point_east_north_and_up(position in geodetic()) {
        prop_assume!(position.latitude_deg().abs() < 89.0 && position.longitude_deg() < 179.0);
        let datum = Datum::Wgs84(position);
        let step = |latitude: f64, longitude: f64, height: f64| {
            let moved = Geodetic::from_degrees(
                position.latitude_deg() + latitude,
                position.longitude_deg() + longitude,
                position.height_m() + height,
            );
            datum.point_in_enu(&moved.unwrap(), &[]).unwrap().normalize()
        };
        prop_assert!((step(0.0, 1e-4, 0.0) - Vector3::x()).norm() < 1e-3);
        prop_assert!((step(1e-4, 0.0, 0.0) - Vector3::y()).norm() < 1e-3);
        prop_assert!((step(0.0, 0.0, 10.0) - Vector3::z()).norm() < 1e-6);
    }

    #[test]
    fn going_through_another_datum_changes_nothing(a in geodetic(), b in geodetic()) {
        let (first, second) = (Datum::Wgs84(a), Datum::Wgs84(b));
        let point = Vector3::new(120.0, -40.0, 15.0);
        let there = enu_from_enu(&second, &first, &[]).unwrap() * point;
        let position = first.geodetic(&point, &[]);
        prop_assume!(position.is_ok());
        let direct = second.point_in_enu(&position.unwrap(), &[]).unwrap();
        prop_assert!((there - direct).norm() < 1e-6);
        let back = enu_from_enu(&first, &second, &[]).unwrap() * there;
        prop_assert!((back - point).norm() < 1e-6);
    }
}

#[test]
fn refuses_what_is_no_position() {
    for (latitude, longitude, height) in [
        (f64::NAN, 0.0, 0.0),
        (91.0, 0.0, 0.0),
        (0.0, 180.1, 0.0),
        (0.0, f64::INFINITY, 0.0),
        (0.0, 0.0, f64::NAN),
        (0.0, 0.0, 1e6),
    ] {
        let refused = Geodetic::from_degrees(latitude, longitude, height);
        assert!(matches!(refused, Err(GeodesyError::OutOfRange { .. })));
    }
    for point in [
        Vector3::zeros(),
        Vector3::new(f64::NAN, 0.0, 6.4e6),
        Vector3::new(1e9, 0.0, 0.0),
    ] {
        assert!(Geodetic::from_ecef(&point).is_err());
    }
    for name in ["", "a/b", "a b", "*", &"x".repeat(33)] {
        assert!(SiteName::new(name).is_err(), "{name}");
    }
}

#[test]
fn a_site_meets_the_earth_only_where_it_was_surveyed() {
    let site = Datum::site("lab").unwrap();
    let earth = Datum::Wgs84(Geodetic::from_degrees(52.0, 13.0, 40.0).unwrap());
    let refused = enu_from_enu(&earth, &site, &[]);
    assert!(matches!(refused, Err(GeodesyError::NotSurveyed { .. })));
    assert_eq!(enu_from_enu(&site, &site, &[]), Ok(Transform::identity()));

    let rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.3);
    let earth_from_site = Transform::new(rotation, Vector3::new(5.0, 6.0, 7.0));
    let survey = SiteSurvey {
        site: SiteName::new("lab").unwrap(),
        ecef_from_site: earth.ecef_from_enu(&[]).unwrap() * earth_from_site,
    };
    let found = enu_from_enu(&earth, &site, &[survey]).unwrap();
    let point = Vector3::new(1.0, 2.0, 3.0);
    assert!((found * point - earth_from_site * point).norm() < 1e-6);
}
