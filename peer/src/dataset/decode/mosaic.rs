//! Mosaics of colours to grey.

use camera::Image;

/// The grey of a Bayer mosaic at its full size, whichever colour comes first.
///
/// A binomial filter of 3×3 pixels: under it every pixel of a mosaic is (R + 2G + B) / 4, so that
/// an evenly lit surface of any colour stays even. The border is mirrored, which keeps the colours'
/// order.
pub fn grey_from_mosaic(mosaic: &Image) -> Image {
    let (width, height) = (mosaic.width(), mosaic.height());
    if width < 2 || height < 2 {
        return mosaic.clone();
    }
    let pixels = mosaic.pixels();
    let mut sums = vec![0_u16; width];
    let mut grey = Vec::with_capacity(width * height);
    for y in 0..height {
        let above = if y == 0 { 1 } else { y - 1 };
        let below = if y + 1 == height { height - 2 } else { y + 1 };
        let row = |y: usize| &pixels[y * width..(y + 1) * width];
        let rows = row(above).iter().zip(row(y)).zip(row(below));
        for (sum, ((above, middle), below)) in sums.iter_mut().zip(rows) {
            *sum = u16::from(*above) + 2 * u16::from(*middle) + u16::from(*below);
        }
        for x in 0..width {
            let left = if x == 0 { 1 } else { x - 1 };
            let right = if x + 1 == width { width - 2 } else { x + 1 };
            let sum = sums[left] + 2 * sums[x] + sums[right];
            grey.push(((sum + 8) / 16) as u8);
        }
    }
    Image::from_pixels(width, height, grey).expect("one value was made for each pixel")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Red, green, green and blue, beginning with any of them.
    fn mosaic(
        width: usize,
        height: usize,
        phase: usize,
        colour: impl Fn(usize) -> [u8; 3],
    ) -> Image {
        let mut image = Image::filled(width, height, 0);
        for y in 0..height {
            for x in 0..width {
                let place = ((y + phase / 2) % 2) * 2 + (x + phase) % 2;
                let channel = [0, 1, 1, 2][place];
                image.pixels_mut()[y * width + x] = colour(x)[channel];
            }
        }
        image
    }

    #[test]
    fn a_plain_colour_becomes_one_grey_for_every_order_of_the_colours() {
        for phase in 0..4 {
            for (width, height) in [(8, 6), (7, 5), (2, 2)] {
                let grey = grey_from_mosaic(&mosaic(width, height, phase, |_| [200, 40, 120]));
                let expected = 100; // (200 + 2 · 40 + 120) / 4.
                assert!(
                    grey.pixels().iter().all(|shade| *shade == expected),
                    "{phase} {width}×{height}: {grey:?}"
                );
            }
        }
    }

    #[test]
    fn an_edge_stays_where_it_is() {
        let step = |x| if x < 8 { [0, 0, 0] } else { [240, 240, 240] };
        let grey = grey_from_mosaic(&mosaic(16, 6, 0, step));
        let expected = [0, 0, 60, 180, 240, 240];
        assert_eq!(grey.pixels()[3 * 16 + 5..3 * 16 + 11], expected);
    }
}
