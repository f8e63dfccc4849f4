//! Points in the cubes of a grid, found by hashing.

use crate::Point;

/// Finds points within a distance that is the cubes' edge: in the cube of the question and the 26
/// around it.
pub struct HashedCubes {
    edge: f32,
    /// Open addressing: the cube's key, and where its points start and end.
    table: Vec<Option<(u64, u32, u32)>>,
    points: Vec<Point>,
}

/// Bits of a key along each axis; cubes are counted from the middle.
const AXIS_BITS: u32 = 21;

impl HashedCubes {
    pub fn new(points: &[Point], edge: f32) -> Self {
        let mut order: Vec<(u64, Point)> = points
            .iter()
            .map(|point| (packed(cube(*point, edge)), *point))
            .collect();
        order.sort_unstable_by_key(|(key, _)| *key);
        let cube_count = order.chunk_by(|a, b| a.0 == b.0).count();
        let mut cubes = Self {
            edge,
            table: vec![None; (2 * cube_count + 1).next_power_of_two()],
            points: order.iter().map(|(_, point)| *point).collect(),
        };
        let mut start = 0;
        for members in order.chunk_by(|a, b| a.0 == b.0) {
            let end = start + members.len() as u32;
            let slot = cubes.slot(members[0].0);
            cubes.table[slot] = Some((members[0].0, start, end));
            start = end;
        }
        cubes
    }

    /// Where a key is, or would be.
    fn slot(&self, key: u64) -> usize {
        let mask = self.table.len() - 1;
        let mut slot = (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 20) as usize & mask;
        while self.table[slot].is_some_and(|(other, ..)| other != key) {
            slot = (slot + 1) & mask;
        }
        slot
    }

    /// Whether the nearest point is within the edge.
    pub fn has_near(&self, query: Point) -> bool {
        let middle = cube(query, self.edge);
        let mut nearest = f32::INFINITY;
        for neighbour in 0..27 {
            let offset = [neighbour % 3 - 1, neighbour / 3 % 3 - 1, neighbour / 9 - 1];
            let key = packed(std::array::from_fn(|axis| middle[axis] + offset[axis]));
            let Some((_, start, end)) = self.table[self.slot(key)] else {
                continue;
            };
            for point in &self.points[start as usize..end as usize] {
                let [x, y, z]: Point = std::array::from_fn(|axis| point[axis] - query[axis]);
                nearest = nearest.min(x * x + y * y + z * z);
            }
        }
        nearest < self.edge * self.edge
    }
}

fn cube(point: Point, edge: f32) -> [i64; 3] {
    point.map(|value| (value / edge).floor() as i64)
}

fn packed(cube: [i64; 3]) -> u64 {
    cube.into_iter().fold(0, |key, along| {
        (key << AXIS_BITS) | ((along + (1 << (AXIS_BITS - 1))) as u64 & ((1 << AXIS_BITS) - 1))
    })
}
