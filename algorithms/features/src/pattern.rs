//! Which pixels around a corner are compared.

use crate::Descriptor;
use crate::plane::Plane;

/// No sample lies further from the corner.
pub(crate) const PATCH_RADIUS_PX: usize = 15;
const PAIR_COUNT: usize = Descriptor::BIT_COUNT as usize;
/// Steps of the turn; half a step moves the outermost sample by 0.37 px.
const ANGLE_COUNT: usize = 128;

/// The sampling pattern at every turn, as offsets into planes of one stride.
#[derive(Clone, Debug, Default)]
pub(crate) struct TurnedPattern {
    stride: usize,
    offsets: Vec<[i32; 2]>,
}

impl TurnedPattern {
    /// Prepares for planes of this stride; free if it is the same as before.
    pub(crate) fn prepare(&mut self, stride: usize) {
        if self.stride == stride && !self.offsets.is_empty() {
            return;
        }
        self.stride = stride;
        self.offsets.clear();
        let pairs = pairs();
        for angle_idx in 0..ANGLE_COUNT {
            let angle = angle_idx as f64 / ANGLE_COUNT as f64 * std::f64::consts::TAU;
            let (sine, cosine) = angle.sin_cos();
            let turned = pairs.map(|pair| {
                pair.map(|[x, y]| {
                    let turned_x = (cosine * x - sine * y).round() as i32;
                    let turned_y = (sine * x + cosine * y).round() as i32;
                    turned_y * stride as i32 + turned_x
                })
            });
            self.offsets.extend(turned);
        }
    }

    /// Compares the pairs of samples around a pixel of a smoothed plane.
    pub(crate) fn describe(&self, plane: &Plane, x: usize, y: usize, angle_rad: f32) -> Descriptor {
        let turns = angle_rad / std::f32::consts::TAU;
        let angle_idx = (turns * ANGLE_COUNT as f32).round() as i32;
        let angle_idx = angle_idx.rem_euclid(ANGLE_COUNT as i32) as usize;
        let offsets = &self.offsets[angle_idx * PAIR_COUNT..][..PAIR_COUNT];
        let centre = (y * plane.stride() + x) as i32;
        let pixels = plane.pixels();
        let mut words = [0_u64; 4];
        for (word, offsets) in words.iter_mut().zip(offsets.as_chunks::<64>().0) {
            for (bit, offset) in offsets.iter().enumerate() {
                let [first, second] = offset.map(|offset| pixels[(centre + offset) as usize]);
                *word |= u64::from(first < second) << bit;
            }
        }
        Descriptor(words)
    }
}

/// Pairs of points around the corner, in pixels.
fn pairs() -> [[[f64; 2]; 2]; PAIR_COUNT] {
    let mut state = 0x5eed_u64;
    let mut uniform = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 40) as f64 / f64::from(1 << 24)
    };
    let mut point = || {
        loop {
            let radius = 6.2 * (-2.0 * (1.0 - uniform()).ln()).sqrt();
            let (sine, cosine) = (uniform() * std::f64::consts::TAU).sin_cos();
            if radius <= PATCH_RADIUS_PX as f64 - 0.5 {
                return [radius * cosine, radius * sine];
            }
        }
    };
    std::array::from_fn(|_| [point(), point()])
}
