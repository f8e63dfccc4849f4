//! What an image looks like as a whole, and what is wrong with one that shows nothing known.

use camera::Image;

use crate::ImageFault;

/// Brightness, contrast and sharpness of an image, from a sample of its pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Look {
    mean: f64,
    variance: f64,
    /// Part of the pixels that are white.
    white_share: f64,
    /// Mean squared difference of neighbours along rows and columns, in variances: of noise about
    /// two, of a scene far less, and less along the way of a camera that moved while it exposed.
    roughness: [f64; 2],
}

/// What images in which the camera was found look like.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct UsualLook {
    mean: f64,
    roughness: [f64; 2],
    frame_count: u32,
}

/// Every so many pixels are looked at, along rows and columns.
const STEP_PX: usize = 4;
const WHITE: u8 = 250;
/// A mean shade below this is night, or a covered lens.
const DARK_MEAN: f64 = 20.0;
/// More white than this leaves too little to see.
const WHITE_SHARE_MAX: f64 = 0.6;
/// The contrast below which sharpness is that of the noise.
const VARIANCE_MIN: f64 = 4.0;
/// An image with less than this part of the usual roughness is blurred.
const BLURRED_RATIO: f64 = 0.4;
/// One with more than this of it is noisy.
const NOISY_RATIO: f64 = 2.5;
/// The factor by which the mean shade may change.
const EXPOSURE_RATIO: f64 = 1.7;
/// Frames until there is something usual.
const USUAL_FRAMES_MIN: u32 = 5;
/// How much each frame says about what is usual.
const USUAL_GAIN: f64 = 0.1;

impl Look {
    pub(crate) fn of(image: &Image) -> Self {
        let (width, height) = (image.width(), image.height());
        let (mut count, mut sum, mut square_sum, mut white_count) = (0_u64, 0_u64, 0_u64, 0_u64);
        let mut difference_sums = [0_u64; 2];
        for y in (0..height.saturating_sub(1)).step_by(STEP_PX) {
            let (row, below) = (image.row(y), image.row(y + 1));
            for x in (0..width.saturating_sub(1)).step_by(STEP_PX) {
                let shade = u64::from(row[x]);
                count += 1;
                sum += shade;
                square_sum += shade * shade;
                white_count += u64::from(row[x] >= WHITE);
                for (sum, neighbour) in difference_sums.iter_mut().zip([row[x + 1], below[x]]) {
                    *sum += shade.abs_diff(u64::from(neighbour)).pow(2);
                }
            }
        }
        let share = |sum: u64| sum as f64 / count.max(1) as f64;
        let mean = share(sum);
        let variance = share(square_sum) - mean * mean;
        Self {
            mean,
            variance,
            white_share: share(white_count),
            roughness: difference_sums.map(|sum| share(sum) / variance.max(VARIANCE_MIN)),
        }
    }

    /// What is wrong with the image, if that can be seen without knowing the scene.
    pub(crate) fn fault(&self, usual: &UsualLook) -> Option<ImageFault> {
        if self.mean < DARK_MEAN {
            return Some(ImageFault::Dark);
        }
        if self.white_share > WHITE_SHARE_MAX {
            return Some(ImageFault::Overexposed);
        }
        if usual.frame_count < USUAL_FRAMES_MIN || self.variance < VARIANCE_MIN {
            return None;
        }
        let ratios = [0, 1].map(|axis| self.roughness[axis] / usual.roughness[axis].max(1e-6));
        let brightness = self.mean / usual.mean.max(1.0);
        if ratios.iter().any(|ratio| *ratio < BLURRED_RATIO) {
            Some(ImageFault::Blurred)
        } else if ratios.iter().all(|ratio| *ratio > NOISY_RATIO) {
            Some(ImageFault::Noisy)
        } else if !(1.0 / EXPOSURE_RATIO..EXPOSURE_RATIO).contains(&brightness) {
            Some(ImageFault::ExposureChanged)
        } else {
            None
        }
    }
}

impl UsualLook {
    /// Takes the look of an image in which the camera was found.
    pub(crate) fn learn(&mut self, look: &Look) {
        let gain = if self.frame_count == 0 {
            1.0
        } else {
            USUAL_GAIN
        };
        self.frame_count = self.frame_count.saturating_add(1);
        let towards = |usual: f64, new: f64| usual + gain * (new - usual);
        self.mean = towards(self.mean, look.mean);
        for axis in 0..2 {
            self.roughness[axis] = towards(self.roughness[axis], look.roughness[axis]);
        }
    }
}
