//! What a weak analogue link does to a picture.

use camera::Image;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Frames for which the link stays as it is.
const SPELL_FRAMES: usize = 5;
/// So many spells are disturbed.
const SPELL_SHARE: f64 = 0.3;

/// Tears lines sideways, and puts snow on some.
pub fn disturb(image: &mut Image, seed: u64, frame_idx: usize) {
    let spell = (frame_idx / SPELL_FRAMES) as u64;
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0030 ^ (spell << 32));
    if !rng.random_bool(SPELL_SHARE) {
        return;
    }
    let severity: f64 = rng.random_range(0.1..1.0);
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1ab0_0031 ^ ((frame_idx as u64) << 32));
    let height = image.height();
    for _ in 0..rng.random_range(1..2 + (5.0 * severity) as usize) {
        let from = rng.random_range(0..height);
        let length = rng.random_range(3..4 + (0.12 * severity * height as f64) as usize);
        tear(image, from..(from + length).min(height), &mut rng);
    }
    for y in 0..height {
        if rng.random_bool(0.06 * severity) {
            snow(image, y, &mut rng);
        }
    }
}

/// Shifts lines by up to an eighth of the width, leaning as a sync that slips does.
fn tear(image: &mut Image, lines: std::ops::Range<usize>, rng: &mut impl Rng) {
    let width = image.width();
    let limit_px = width as f64 / 8.0;
    let shift_px = rng.random_range(-limit_px..limit_px);
    let first = lines.start;
    let count = lines.len() as f64;
    for y in lines {
        let left = 1.0 - (y - first) as f64 / count;
        let steps = (shift_px * left).round() as isize;
        let row = &mut image.pixels_mut()[y * width..][..width];
        row.rotate_right(steps.rem_euclid(width as isize) as usize);
    }
}

/// White and black dashes on one line.
fn snow(image: &mut Image, y: usize, rng: &mut impl Rng) {
    let width = image.width();
    let row = &mut image.pixels_mut()[y * width..][..width];
    let mut x = rng.random_range(0..width / 2);
    while x < width {
        let length = rng.random_range(2..24).min(width - x);
        let shade = if rng.random_bool(0.6) { 235 } else { 20 };
        for pixel in &mut row[x..x + length] {
            let noise: i32 = rng.random_range(-20..20);
            *pixel = (shade + noise).clamp(0, 255) as u8;
        }
        x += length + rng.random_range(4..width / 4);
    }
}
