//! What of the own map stands around the vehicle, where it may fly to.

use geometry::{Enu, Map, Similarity, Timestamp};
use keeping::Obstacle;
use nalgebra::{Rotation3, Vector3};
use vslam::VslamMap;

use super::{FramePose, Node};

/// All around in sectors of 22.5°.
const SECTOR_COUNT: usize = 16;
/// What is so much higher or lower is passed.
const HALF_HEIGHT_M: f64 = 0.35;
/// What is farther away does not matter yet.
const REACH_M: f64 = 4.0;
/// A sector is as near as its point of this rank: single points may be wrong.
const POINT_RANK: usize = 4;
/// Points that fewer keyframes saw are not trusted.
const VIEW_COUNT_MIN: usize = 3;

impl Node {
    /// Obstacles from the own map about a pose, in the vehicle's heading frame, the nearest first.
    /// None until the map has been tied to the Earth for the first time: before, nobody knows its
    /// scale, or what is level. A tie that has grown old is good enough.
    pub fn obstacles(&self, pose: &FramePose, now: Timestamp) -> Vec<Obstacle> {
        let map = self.slam.map();
        let map_from_camera = pose.map_from_camera.filter(|_| pose.map_id == map.id());
        let tie = map_from_camera.zip(self.enu_from_map(now));
        let Some((map_from_camera, enu_from_map)) = tie else {
            return Vec::new();
        };
        let map_from_body =
            *map_from_camera.rotation() * self.calibration.body_from_camera.rotation().inverse();
        let ahead = enu_from_map.linear_matrix() * (map_from_body * Vector3::x());
        let centre = map_from_camera.translation();
        around(trusted(map), centre, &enu_from_map, ahead.y.atan2(ahead.x))
    }
}

fn trusted(map: &VslamMap) -> impl Iterator<Item = &Vector3<f64>> {
    let points = map.points();
    points
        .filter(|point| point.has_range() && point.view_count() >= VIEW_COUNT_MIN)
        .map(|point| point.position_in_map())
}

/// - `heading_rad`: of the vehicle, from east to north.
fn around<'a>(
    points_in_map: impl Iterator<Item = &'a Vector3<f64>>,
    centre_in_map: &Vector3<f64>,
    enu_from_map: &Similarity<Enu, Map>,
    heading_rad: f64,
) -> Vec<Obstacle> {
    let heading_from_enu = Rotation3::from_axis_angle(&Vector3::z_axis(), -heading_rad);
    let heading_from_map = heading_from_enu.matrix() * enu_from_map.linear_matrix();
    // The nearest of each sector, nearest first; distances in the level plane.
    let mut nearest = [[(f64::INFINITY, Vector3::zeros()); POINT_RANK]; SECTOR_COUNT];
    for point in points_in_map {
        let place = heading_from_map * (point - centre_in_map);
        let distance_m = place.x.hypot(place.y);
        if place.z.abs() > HALF_HEIGHT_M || !(1e-3..REACH_M).contains(&distance_m) {
            continue;
        }
        let turns = place.y.atan2(place.x) / std::f64::consts::TAU;
        let sector = (turns.rem_euclid(1.0) * SECTOR_COUNT as f64) as usize;
        let ranked = &mut nearest[sector.min(SECTOR_COUNT - 1)];
        let rank = ranked.partition_point(|(known_m, _)| *known_m <= distance_m);
        if rank < POINT_RANK {
            ranked[rank..].rotate_right(1);
            ranked[rank] = (distance_m, place);
        }
    }
    let mut obstacles: Vec<Obstacle> = nearest
        .iter()
        .map(|ranked| ranked[POINT_RANK - 1])
        .filter(|(distance_m, _)| distance_m.is_finite())
        .map(|(clearance_m, place)| Obstacle {
            direction: Vector3::new(place.x, place.y, 0.0) / clearance_m,
            clearance_m,
        })
        .collect();
    obstacles.sort_by(|a, b| a.clearance_m.total_cmp(&b.clearance_m));
    obstacles
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    /// A wall at x = 3 of the site, and a map that stands turned, shifted and at half the scale.
    fn wall() -> (Vec<Vector3<f64>>, Similarity<Enu, Map>) {
        let rotation = UnitQuaternion::from_euler_angles(0.4, -0.7, 1.1);
        let enu_from_map = Similarity::new(2.0, rotation, Vector3::new(5.0, -2.0, 0.3));
        let map_from_enu = enu_from_map.inverse();
        let mut points = Vec::new();
        for y in -20..=20 {
            for z in -10..=10 {
                let point = Vector3::new(3.0, 0.1 * f64::from(y), 1.0 + 0.1 * f64::from(z));
                points.push(map_from_enu * point);
            }
        }
        (points, enu_from_map)
    }

    #[test]
    fn a_wall_stands_where_it_is_from_the_vehicle() {
        let (points, enu_from_map) = wall();
        let centre = enu_from_map.inverse() * Vector3::new(1.5, 0.0, 1.0);
        // Heading north: the wall in the east is on the right.
        let north_rad = std::f64::consts::FRAC_PI_2;
        let obstacles = around(points.iter(), &centre, &enu_from_map, north_rad);
        let nearest = obstacles.first().unwrap();
        assert!((nearest.clearance_m - 1.5).abs() < 0.02, "{nearest:?}");
        assert!(nearest.direction.y < -0.95, "{nearest:?}");
        let is_sorted = |pair: &[Obstacle]| pair[0].clearance_m <= pair[1].clearance_m;
        assert!(obstacles.windows(2).all(is_sorted));
        assert!(obstacles.iter().all(|one| one.direction.y < 0.1));
        for obstacle in &obstacles {
            assert!((obstacle.direction.norm() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn single_points_and_what_is_above_are_no_obstacles() {
        let enu_from_map = Similarity::identity();
        let near = [Vector3::new(0.5, 0.0, 0.0); POINT_RANK - 1];
        assert!(around(near.iter(), &Vector3::zeros(), &enu_from_map, 0.0).is_empty());
        let above = [Vector3::new(0.5, 0.1, 0.8); 9];
        assert!(around(above.iter(), &Vector3::zeros(), &enu_from_map, 0.0).is_empty());
    }
}
