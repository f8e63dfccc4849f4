//! Where two vehicles stand, so that their views of one place differ by as much as was asked for.

use nalgebra::{Vector2, Vector3};
use rand::{Rng, RngExt};

use super::{Standpoint, WAY_M};
use crate::world::{FURNITURE_DEPTH_M, Surroundings, World};

/// How different two views are to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncounterSettings {
    /// Of the two cameras above the floor.
    pub heights_m: [f64; 2],
    /// The least and the largest angle between the directions in which they see the place.
    pub angle_rad: [f64; 2],
    /// How far apart the places lie that they look at, in widths of the second one's view.
    pub shift: f64,
}

/// Two standpoints before one wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encounter {
    pub standpoints: [Standpoint; 2],
}

/// What is looked at is this high.
const FOCUS_M: f64 = 0.9;
/// Of the place's distance.
const VIEW_WIDTH: f64 = 1.42;
const DISTANCE_M_MIN: f64 = 1.8;
const DISTANCE_M_MAX: f64 = 6.5;
const AZIMUTH_RAD_MAX: f64 = 1.0;
/// Of a camera from all that stands around.
const CLEARANCE_M: f64 = 0.3;
/// Around a camera.
const RAY_COUNT: u32 = 12;
const DRAW_COUNT_MAX: usize = 4000;
/// Of the sight lines to places around the focus, those that must be free.
const FREE_SHARE_MIN: f64 = 0.65;

impl Encounter {
    /// Draws where to stand; `None` if the room has no such places.
    pub fn draw(
        world: &World,
        surroundings: &Surroundings,
        settings: &EncounterSettings,
        rng: &mut impl Rng,
    ) -> Option<Self> {
        (0..DRAW_COUNT_MAX).find_map(|_| {
            let wall = Wall::draw(world, rng);
            let first = wall.standpoint(world, settings.heights_m[0], 0.0, rng)?;
            let second = wall.standpoint(world, settings.heights_m[1], settings.shift, rng)?;
            let encounter = Self {
                standpoints: [first, second],
            };
            encounter
                .is_as_asked(&wall, surroundings, settings)
                .then_some(encounter)
        })
    }

    /// Draws where a second vehicle stands whose views differ from the first one's.
    pub fn draw_second(
        &self,
        world: &World,
        surroundings: &Surroundings,
        settings: &EncounterSettings,
        rng: &mut impl Rng,
    ) -> Option<Self> {
        let first = self.standpoints[0];
        let wall = Wall::before(world, &first.focus);
        (0..DRAW_COUNT_MAX).find_map(|_| {
            let second = wall.standpoint(world, settings.heights_m[1], settings.shift, rng)?;
            let encounter = Self {
                standpoints: [first, second],
            };
            encounter
                .is_as_asked(&wall, surroundings, settings)
                .then_some(encounter)
        })
    }

    fn is_as_asked(
        &self,
        wall: &Wall,
        surroundings: &Surroundings,
        settings: &EncounterSettings,
    ) -> bool {
        let sights = self.standpoints.map(|one| one.place - wall.focus);
        let angle_rad = sights[0].angle(&sights[1]);
        (settings.angle_rad[0]..settings.angle_rad[1]).contains(&angle_rad)
            && self
                .standpoints
                .iter()
                .all(|one| wall.is_in_sight(one, surroundings))
    }
}

/// Whether nothing stands so near at the camera's height; the floor may be near.
fn is_clear(place: &Vector3<f64>, distance_m: f64, surroundings: &Surroundings) -> bool {
    (0..RAY_COUNT).all(|idx| {
        let angle_rad = std::f64::consts::TAU * f64::from(idx) / f64::from(RAY_COUNT);
        let ray = Vector3::new(angle_rad.cos(), angle_rad.sin(), 0.0);
        let free_m = surroundings.ray_length_m(place, &ray);
        free_m.is_none_or(|free_m| free_m > distance_m)
    })
}

/// A wall and a place on it.
struct Wall {
    along: Vector3<f64>,
    inward: Vector3<f64>,
    focus: Vector3<f64>,
}

impl Wall {
    fn draw(world: &World, rng: &mut impl Rng) -> Self {
        let turns = rng.random_range(0..4);
        let along_share = rng.random_range(-0.6..0.6);
        Self::new(world, turns, along_share)
    }

    fn new(world: &World, quarter_turns: usize, along_share: f64) -> Self {
        let (inward, along) = match quarter_turns {
            0 => (Vector3::y(), Vector3::x()),
            1 => (-Vector3::x(), Vector3::y()),
            2 => (-Vector3::y(), -Vector3::x()),
            _ => (Vector3::x(), -Vector3::y()),
        };
        let half = world.size_m * 0.5;
        let middle = -inward * inward.abs().dot(&half);
        let focus = middle + along * (along_share * along.abs().dot(&half));
        Self {
            along,
            inward,
            focus: focus + Vector3::z() * FOCUS_M,
        }
    }

    /// The one on which a place lies.
    fn before(world: &World, focus: &Vector3<f64>) -> Self {
        let walls = (0..4).map(|turns| Self::new(world, turns, 0.0));
        let distance = |wall: &Self| (focus - wall.focus).dot(&wall.inward).abs();
        let nearest = walls.min_by(|a, b| distance(a).total_cmp(&distance(b)));
        Self {
            focus: *focus,
            ..nearest.expect("a room has four walls")
        }
    }

    /// - `shift`: of what is looked at along the wall, to either side, in widths of the view.
    fn standpoint(
        &self,
        world: &World,
        height_m: f64,
        shift: f64,
        rng: &mut impl Rng,
    ) -> Option<Standpoint> {
        let distance_m = rng.random_range(DISTANCE_M_MIN..DISTANCE_M_MAX);
        let azimuth_rad: f64 = rng.random_range(-AZIMUTH_RAD_MAX..AZIMUTH_RAD_MAX);
        let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let sight = self.inward * azimuth_rad.cos() + self.along * azimuth_rad.sin();
        let moved = self.along * (side * shift * VIEW_WIDTH * distance_m);
        let mut place = self.focus + sight * distance_m + moved * rng.random_range(0.0..1.0);
        place.z = height_m;
        let standpoint = Standpoint {
            place,
            focus: self.focus + moved,
        };
        let room = world.size_m.xy() * 0.5 - Vector2::repeat(FURNITURE_DEPTH_M);
        let is_inside = |point: &Vector3<f64>| point.x.abs() < room.x && point.y.abs() < room.y;
        let on_wall = standpoint.focus.xy().abs();
        let half = world.size_m.xy() * 0.5 + Vector2::repeat(0.01);
        (is_inside(&place) && on_wall.x < half.x && on_wall.y < half.y).then_some(standpoint)
    }

    /// Whether the whole way is free, and most of what is to be seen.
    fn is_in_sight(&self, standpoint: &Standpoint, surroundings: &Surroundings) -> bool {
        let ways = [-1.0, -0.5, 0.0, 0.5, 1.0];
        let is_free = ways.iter().all(|sideways| {
            let place = standpoint.on_way([*sideways, 0.0]);
            is_clear(&place, CLEARANCE_M + WAY_M[1], surroundings)
        });
        if !is_free {
            return false;
        }
        let before = standpoint.focus + self.inward * (FURNITURE_DEPTH_M + 0.1);
        let mut free_count = 0;
        for along_m in [-0.7, 0.0, 0.7] {
            for up_m in [-0.4, 0.1, 0.6] {
                let point = before + self.along * along_m + Vector3::z() * up_m;
                free_count += usize::from(surroundings.sees(&standpoint.place, &point));
            }
        }
        free_count as f64 >= FREE_SHARE_MIN * 9.0
    }
}
