//! One point per cube, and what the cube's points say of the surface there.

use nalgebra::{Matrix3, Vector3};

use super::{Cloud, Descriptors, bounds};

/// The points in one cube.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moments {
    pub count: f64,
    pub mean: Vector3<f64>,
    /// Squared offsets from the mean, added up.
    pub scatter: Matrix3<f64>,
}

/// A cloud cut into cubes, in the order of their corners.
#[derive(Clone, Debug)]
pub(super) struct Cubes {
    keys: Vec<[i64; 3]>,
    pub moments: Vec<Moments>,
    /// The first point in each cube.
    firsts: Vec<usize>,
}

/// Numbers the cubes of a grid that holds all points.
struct Keys {
    per_m: f64,
    lowest: [f64; 3],
    /// How many bits number the cubes along each axis.
    bits: [u32; 3],
}

/// A grid has at most so many cubes along an axis; smaller cubes are made larger.
const CUBE_COUNT_MAX: f64 = 4e9;

impl Keys {
    fn extent(points: &[Vector3<f64>]) -> f64 {
        let (lowest, highest) = bounds(points.iter().copied());
        (highest - lowest).amax()
    }

    /// How many cubes hold points.
    fn count(&self, points: &[Vector3<f64>]) -> usize {
        let mut all: Vec<u128> = points.iter().map(|point| self.packed(point)).collect();
        all.sort_unstable();
        all.dedup();
        all.len()
    }

    fn over(points: &[Vector3<f64>], edge_m: f64) -> Self {
        let (lowest, highest) = bounds(points.iter().copied());
        let extent = (highest - lowest).amax();
        let per_m = 1.0 / edge_m.max(extent / CUBE_COUNT_MAX);
        let lowest = lowest.map(|one| (one * per_m).floor());
        let keys = Self {
            per_m,
            lowest: lowest.into(),
            bits: [0; 3],
        };
        let count_of = |key: i64| u64::BITS - (key as u64).leading_zeros();
        Self {
            bits: keys.key(&highest).map(count_of),
            ..keys
        }
    }

    fn key(&self, point: &Vector3<f64>) -> [i64; 3] {
        // No point lies below the lowest cube, so that leaving out the digits rounds down.
        std::array::from_fn(|axis| (point[axis] * self.per_m - self.lowest[axis]) as i64)
    }

    /// In the order of the keys.
    fn packed(&self, point: &Vector3<f64>) -> u128 {
        let [x, y, z] = self.key(point).map(|one| u128::from(one as u32));
        (x << 64) | (y << 32) | z
    }

    /// The points in the order of the keys, and in their own within a cube.
    fn sorted(&self, points: &[Vector3<f64>]) -> Vec<u32> {
        let [x_bits, y_bits, z_bits] = self.bits;
        if x_bits + y_bits + z_bits <= u32::BITS {
            // Key above, index below: one number sorts by both.
            let number = |(point, idx): (&Vector3<f64>, u64)| {
                let [x, y, z] = self.key(point).map(|one| one as u64);
                (((((x << y_bits) | y) << z_bits) | z) << 32) | idx
            };
            let all = points.iter().zip(0_u64..).map(number).collect();
            let all = sorted_above(all, x_bits + y_bits + z_bits);
            return all.into_iter().map(|one| one as u32).collect();
        }
        let mut all: Vec<(u128, u32)> = points
            .iter()
            .zip(0_u32..)
            .map(|(point, idx)| (self.packed(point), idx))
            .collect();
        all.sort_unstable();
        all.into_iter().map(|(_, idx)| idx).collect()
    }
}

/// Digits of a number that are sorted by at once.
const DIGIT_BITS: u32 = 9;

/// Sorts by the `bit_count` bits above the lower 32, digit by digit from the least; what is equal
/// in them stays in order.
fn sorted_above(mut all: Vec<u64>, bit_count: u32) -> Vec<u64> {
    let mut other = vec![0; all.len()];
    for digit in 0..bit_count.div_ceil(DIGIT_BITS) {
        let place_of = |one: u64| {
            let shift = u32::BITS + digit * DIGIT_BITS;
            (one >> shift) as usize & ((1 << DIGIT_BITS) - 1)
        };
        let mut starts = [0; 1 << DIGIT_BITS];
        for one in &all {
            starts[place_of(*one)] += 1;
        }
        let mut start = 0;
        for count in &mut starts {
            start += std::mem::replace(count, start);
        }
        for one in &all {
            let place = &mut starts[place_of(*one)];
            other[*place] = *one;
            *place += 1;
        }
        std::mem::swap(&mut all, &mut other);
    }
    all
}

/// The mean of the points in each cube of this edge.
pub(crate) fn thinned(points: &[Vector3<f64>], edge: f64) -> Vec<Vector3<f64>> {
    let cubes = Cubes::of(points, edge);
    cubes.moments.iter().map(|cube| cube.mean).collect()
}

impl Moments {
    const EMPTY: Self = Self {
        count: 0.0,
        mean: Vector3::new(0.0, 0.0, 0.0),
        scatter: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    pub fn of<'a>(mut points: impl Iterator<Item = &'a Vector3<f64>>) -> Self {
        let Some(first) = points.next() else {
            return Self::EMPTY;
        };
        // About the first point, which is near the mean, so that little is lost to rounding.
        let (mut count, mut sum) = (1.0, Vector3::zeros());
        let [mut xx, mut xy, mut xz, mut yy, mut yz, mut zz] = [0.0; 6];
        for point in points {
            let offset = point - first;
            count += 1.0;
            sum += offset;
            xx += offset.x * offset.x;
            xy += offset.x * offset.y;
            xz += offset.x * offset.z;
            yy += offset.y * offset.y;
            yz += offset.y * offset.z;
            zz += offset.z * offset.z;
        }
        let mean = sum / count;
        let squares = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        Self {
            count,
            mean: first + mean,
            scatter: squares - mean * sum.transpose(),
        }
    }

    /// The moments of both sets of points together.
    fn united(&self, other: &Self) -> Self {
        let count = self.count + other.count;
        let apart = other.mean - self.mean;
        let share = other.count / count;
        Self {
            count,
            mean: self.mean + apart * share,
            scatter: self.scatter
                + other.scatter
                + apart * apart.transpose() * (self.count * share),
        }
    }
}

impl Cubes {
    pub fn of(points: &[Vector3<f64>], edge_m: f64) -> Self {
        let keys = Keys::over(points, edge_m);
        let order = keys.sorted(points);
        let mut cubes = Self {
            keys: Vec::new(),
            moments: Vec::new(),
            firsts: Vec::new(),
        };
        let key_of = |idx: &u32| keys.key(&points[*idx as usize]);
        for cube in order.chunk_by(|a, b| key_of(a) == key_of(b)) {
            cubes.keys.push(key_of(&cube[0]));
            let members = cube.iter().map(|idx| &points[*idx as usize]);
            cubes.moments.push(Moments::of(members));
            cubes.firsts.push(cube[0] as usize);
        }
        cubes
    }

    /// The points of each cube and of the 26 around it.
    pub fn neighbourhoods(&self) -> Vec<Moments> {
        let mut united = vec![Moments::EMPTY; self.keys.len()];
        for x in -1..=1 {
            for y in -1..=1 {
                self.unite_column([x, y], &mut united);
            }
        }
        united
    }

    /// Adds the three cubes of a neighbouring column to each cube; keys are in order, so that the
    /// place in the column only ever moves on.
    fn unite_column(&self, [x, y]: [i64; 2], united: &mut [Moments]) {
        let mut start = 0;
        for (key, sum) in self.keys.iter().zip(united) {
            let lowest = [key[0] + x, key[1] + y, key[2] - 1];
            let highest = [lowest[0], lowest[1], key[2] + 1];
            while start < self.keys.len() && self.keys[start] < lowest {
                start += 1;
            }
            for idx in start..(start + 3).min(self.keys.len()) {
                if self.keys[idx] > highest {
                    break;
                }
                *sum = sum.united(&self.moments[idx]);
            }
        }
    }
}

/// Trials of [`Cloud::voxel_leaving`]; the number of cubes falls with their edge in a known way.
const TRIAL_COUNT: usize = 8;

impl Cloud {
    /// The edge of cubes that thin the cloud to about so many points, and not to more; `None`
    /// where it has no more.
    pub fn voxel_leaving(&self, point_count: usize) -> Option<f64> {
        if self.points.len() <= point_count || point_count == 0 {
            return None;
        }
        let extent = Keys::extent(&self.points);
        let mut edge_m = extent / (point_count as f64).sqrt();
        let mut least_m = None;
        for _ in 0..TRIAL_COUNT {
            let ratio =
                Keys::over(&self.points, edge_m).count(&self.points) as f64 / point_count as f64;
            if ratio <= 1.0 {
                least_m = Some(edge_m);
                if ratio > 0.85 {
                    break;
                }
            }
            // Cubes on a surface grow fewer with the square of their edge.
            edge_m *= (ratio * 1.08).sqrt();
        }
        Some(least_m.unwrap_or(extent))
    }

    /// One point per cube of this edge, the mean of the points in it; descriptors are those of
    /// the first point in each cube, and covariances are lost.
    pub fn thinned(&self, voxel_m: f64) -> Self {
        self.by_cubes(&Cubes::of(&self.points, voxel_m))
    }

    pub(super) fn by_cubes(&self, cubes: &Cubes) -> Self {
        let descriptors = match &self.descriptors {
            Descriptors::None => Descriptors::None,
            Descriptors::Binary(all) => {
                Descriptors::Binary(cubes.firsts.iter().map(|idx| all[*idx]).collect())
            }
            Descriptors::Histogram(all) => {
                Descriptors::Histogram(cubes.firsts.iter().map(|idx| all[*idx]).collect())
            }
        };
        Self {
            points: cubes.moments.iter().map(|cube| cube.mean).collect(),
            covariances: Vec::new(),
            descriptors,
            dropped_count: self.dropped_count,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Points of a wavy floor, denser towards its middle.
    fn floor(count: usize) -> Cloud {
        let point = |idx: usize| {
            let (turn, distance) = (idx as f64 * 2.4, (idx as f64 / count as f64) * 5.0);
            let (x, y) = (distance * turn.cos(), distance * turn.sin());
            Vector3::new(x, y, 0.1 * x.sin())
        };
        Cloud::from_points((0..count).map(point).collect())
    }

    #[test]
    fn a_voxel_leaves_as_many_points_as_are_wanted() {
        let cloud = floor(40_000);
        for wanted in [500, 5000, 20_000] {
            let left = cloud
                .thinned(cloud.voxel_leaving(wanted).unwrap())
                .points
                .len();
            assert!((wanted / 2..=wanted).contains(&left), "{left} of {wanted}");
        }
        assert!(cloud.voxel_leaving(40_000).is_none());
        let spot = Cloud::from_points(vec![Vector3::zeros(); 100]);
        assert_eq!(
            spot.thinned(spot.voxel_leaving(10).unwrap()).points.len(),
            1
        );
    }

    proptest! {
        #[test]
        fn sorting_by_digits_is_sorting(
            keys in prop::collection::vec(0_u64..1 << 32, 0..300),
            bit_count in 0_u32..=32,
        ) {
            let all: Vec<u64> = keys
                .iter()
                .zip(0_u64..)
                .map(|(key, idx)| ((key & ((1 << bit_count) - 1)) << 32) | idx)
                .collect();
            let mut expected = all.clone();
            expected.sort_unstable();
            prop_assert_eq!(sorted_above(all, bit_count), expected);
        }
    }

    /// Goal: cubes too many for one number are the same as those that fit.
    #[test]
    fn fine_cubes_are_in_order_too() {
        let cloud = floor(500);
        for edge_m in [0.3, 1e-7] {
            let cubes = Cubes::of(&cloud.points, edge_m);
            assert!(cubes.keys.is_sorted());
            let count: f64 = cubes.moments.iter().map(|cube| cube.count).sum();
            assert_eq!(count, 500.0);
        }
        let fine = Keys::over(&cloud.points, 1e-7);
        assert!(fine.bits.iter().sum::<u32>() > 32, "{:?}", fine.bits);
    }

    /// Goal: what lies around a cube is what a look at all points finds.
    #[test]
    fn neighbourhoods_are_those_of_27_cubes() {
        let cloud = floor(3000);
        let cubes = Cubes::of(&cloud.points, 0.3);
        let keys = Keys::over(&cloud.points, 0.3);
        for (own, around) in cubes.keys.iter().zip(cubes.neighbourhoods()) {
            let near = cloud.points.iter().filter(|point| {
                let key = keys.key(point);
                (0..3).all(|axis| (key[axis] - own[axis]).abs() <= 1)
            });
            let expected = Moments::of(near);
            assert_eq!(around.count, expected.count);
            assert!((around.mean - expected.mean).norm() < 1e-9);
            assert!((around.scatter - expected.scatter).norm() < 1e-9);
        }
    }
}
