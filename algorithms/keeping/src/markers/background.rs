//! What is around and behind a light.

use camera::Image;

use super::runs::Component;

/// Components wider or higher than this are no lights; also bounds the work on each.
pub(super) const BOX_SIDE_MAX_PX: u16 = 24;
/// From a component's edge to its ring: two free pixels.
pub(super) const RING_MARGIN_PX: u16 = 3;
/// Of a ring, and of all that is inside it.
pub(super) const RING_SIDE_MAX_PX: usize = (BOX_SIDE_MAX_PX + 2 * RING_MARGIN_PX) as usize;
const RING_PIXEL_COUNT_MAX: usize = 4 * RING_SIDE_MAX_PX;
/// A fifth of the ring is brighter than `upper`, a fifth darker than `lower`; another light covers
/// less than that.
const OUTER_SHARE: f64 = 0.2;
/// Both sides of an edge differ by more sigmas of the noise than this.
const EDGE_SIGMAS: f64 = 4.0;
const OCTANT_COUNT: usize = 8;

/// Grey levels behind a light, as far as the ring around it shows them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Background {
    /// Of the ring's middle half.
    pub level: f64,
    /// The level that a fifth of the ring exceeds.
    pub upper: f64,
    edge: f64,
    /// In front of an edge there is another level in each direction.
    octants: Option<[f64; OCTANT_COUNT]>,
}

impl Background {
    /// What two sides of an edge behind the light differ by, or zero if there is none.
    pub fn edge(&self) -> f64 {
        self.edge
    }

    /// The level behind a pixel, given its offset from the light.
    pub fn behind(&self, dx: f64, dy: f64) -> f64 {
        match &self.octants {
            Some(levels) => levels[octant(dx, dy)],
            None => self.level,
        }
    }
}

/// The eighth of the plane that an offset points into.
fn octant(dx: f64, dy: f64) -> usize {
    let steep = usize::from(dy.abs() > dx.abs());
    steep | usize::from(dx < 0.0) << 1 | usize::from(dy < 0.0) << 2
}

/// A rectangle of pixels, edges included.
#[derive(Clone, Copy)]
pub(super) struct PixelBox {
    pub left: usize,
    pub top: usize,
    pub right: usize,
    pub bottom: usize,
}

impl PixelBox {
    pub fn around(component: &Component, margin_px: u16, image: &Image) -> Self {
        let low = |value: u16| usize::from(value.saturating_sub(margin_px));
        let high = |value: u16, side: usize| usize::from(value + margin_px).min(side - 1);
        Self {
            left: low(component.left),
            top: low(component.top),
            right: high(component.right, image.width()),
            bottom: high(component.bottom, image.height()),
        }
    }

    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        (self.left as f64..=self.right as f64).contains(&x)
            && (self.top as f64..=self.bottom as f64).contains(&y)
    }
}

/// The pixels around a component.
struct Ring {
    center_px: [f64; 2],
    pixels: [u8; RING_PIXEL_COUNT_MAX],
    octants: [u8; RING_PIXEL_COUNT_MAX],
    count: usize,
}

/// The background of a component no larger than [`BOX_SIDE_MAX_PX`].
pub(super) fn around(image: &Image, component: &Component, noise: f64) -> Background {
    let ring = Ring::around(image, component);
    let mut sorted = ring.pixels;
    let sorted = &mut sorted[..ring.count];
    sorted.sort_unstable();
    let count = sorted.len();
    if count == 0 {
        return Background {
            level: 0.0,
            upper: 0.0,
            edge: 0.0,
            octants: None,
        };
    }
    let outer = (OUTER_SHARE * count as f64) as usize;
    let [lower, upper] = [sorted[outer], sorted[count - 1 - outer]];
    // The mean of the middle half: as robust as the median, and finer than a grey level.
    let middle = &sorted[count / 4..count - count / 4];
    let sum: u32 = middle.iter().copied().map(u32::from).sum();
    let level = f64::from(sum) / middle.len() as f64;
    let difference = f64::from(upper - lower);
    let has_edge = difference > EDGE_SIGMAS * noise.max(1.0);
    Background {
        level,
        upper: f64::from(upper),
        edge: if has_edge { difference } else { 0.0 },
        octants: has_edge.then(|| ring.octant_levels(upper, level)),
    }
}

impl Ring {
    fn around(image: &Image, component: &Component) -> Self {
        let PixelBox {
            left,
            top,
            right,
            bottom,
        } = PixelBox::around(component, RING_MARGIN_PX, image);
        let middle = |low: u16, high: u16| 0.5 * (f64::from(low) + f64::from(high));
        let mut ring = Self {
            center_px: [
                middle(component.left, component.right),
                middle(component.top, component.bottom),
            ],
            pixels: [0; RING_PIXEL_COUNT_MAX],
            octants: [0; RING_PIXEL_COUNT_MAX],
            count: 0,
        };
        // Where the image ends, its edge is no ring.
        let goes_on = |last: u16, side: usize| usize::from(last + RING_MARGIN_PX) < side;
        for x in left..=right {
            if component.top >= RING_MARGIN_PX {
                ring.push(image, x, top);
            }
            if goes_on(component.bottom, image.height()) {
                ring.push(image, x, bottom);
            }
        }
        for y in top + 1..bottom {
            if component.left >= RING_MARGIN_PX {
                ring.push(image, left, y);
            }
            if goes_on(component.right, image.width()) {
                ring.push(image, right, y);
            }
        }
        ring
    }

    fn push(&mut self, image: &Image, x: usize, y: usize) {
        self.pixels[self.count] = image.get(x, y);
        let [center_x, center_y] = self.center_px;
        self.octants[self.count] = octant(x as f64 - center_x, y as f64 - center_y) as u8;
        self.count += 1;
    }

    /// The mean level of each octant; what is brighter than `upper` is another light.
    fn octant_levels(&self, upper: u8, level: f64) -> [f64; OCTANT_COUNT] {
        let (mut sums, mut counts) = ([0_u32; OCTANT_COUNT], [0_u32; OCTANT_COUNT]);
        for (pixel, octant) in self.pixels.iter().zip(&self.octants).take(self.count) {
            sums[usize::from(*octant)] += u32::from(*pixel.min(&upper));
            counts[usize::from(*octant)] += 1;
        }
        std::array::from_fn(|idx| match counts[idx] {
            0 => level,
            count => f64::from(sums[idx]) / f64::from(count),
        })
    }
}
