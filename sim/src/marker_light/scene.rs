//! Seeded pictures of marker pairs: one scene for each kind of light that they are seen in.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::ops::Range;

use camera::Image;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Irradiance, LENS_SIGMA_PX, LightSpot, Sensor};

/// A kind of picture; the same scene and seed give the same bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerScene {
    pub size_px: [usize; 2],
    /// Levels of walls, furniture and cables.
    pub background: Range<f64>,
    /// A window of this size that the sensor cannot resolve.
    pub window_px: Option<[usize; 2]>,
    /// Lights may be in front of the window, where nothing can see them.
    pub before_window: bool,
    pub sensor: Sensor,
    /// Length of the streak that motion makes of each light, in a random direction.
    pub blur_px: f64,
    pub sigma_px: f64,
    /// Level of the lights above what is behind; the two of a pair differ by up to 10 %.
    pub peak: Range<f64>,
    /// Separations of the pairs to draw, one each.
    pub separations_px: Vec<f64>,
    /// Largest angle between a pair and the vertical.
    pub tilt_max_rad: f64,
    /// Lights that belong to no pair.
    pub distractor_count: usize,
}

/// Where a pair is, its upper light first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruePair {
    pub lights_px: [[f64; 2]; 2],
}

/// A picture and what is in it.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerFrame {
    pub image: Image,
    pub pairs: Vec<TruePair>,
}

impl TruePair {
    pub fn separation_px(&self) -> f64 {
        let [a, b] = self.lights_px;
        (a[0] - b[0]).hypot(a[1] - b[1])
    }

    pub fn center_px(&self) -> [f64; 2] {
        let [a, b] = self.lights_px;
        [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]
    }
}

/// Lights keep this far from the edge of the picture and of the window.
const MARGIN_PX: f64 = 12.0;
/// Lights of different pairs, and distractors, keep this far from each other.
const APART_PX: f64 = 8.0;
/// Places are drawn until one is free, at most this often.
const DRAW_COUNT_MAX: usize = 1000;

impl MarkerScene {
    /// A lab with one pair 10 px apart; the other scenes differ from it in one thing.
    pub fn lab() -> Self {
        Self {
            size_px: [324, 244],
            background: 15.0..50.0,
            window_px: None,
            before_window: false,
            sensor: Sensor {
                exposure: 1.0,
                noise: 3.0,
            },
            blur_px: 0.0,
            sigma_px: LENS_SIGMA_PX,
            peak: 300.0..450.0,
            separations_px: vec![10.0],
            tilt_max_rad: 0.25,
            distractor_count: 0,
        }
    }

    /// Every kind of light that the markers must be seen in, with its name.
    pub fn matrix() -> Vec<(String, Self)> {
        let named = |(name, scene): (&str, Self)| (name.to_owned(), scene);
        let mut rows: Vec<(String, Self)> = Self::surroundings().map(named).into();
        rows.extend(Self::sensors().map(named));
        rows.extend([0.25, 0.5, 2.0, 4.0].map(|exposure| {
            let mut scene = Self::lab();
            scene.sensor.exposure = exposure;
            (format!("exposure {exposure}"), scene)
        }));
        let saturated = Self {
            sigma_px: 1.5,
            peak: 900.0..1400.0,
            ..Self::lab()
        };
        rows.push(("saturated 1.5".to_owned(), saturated));
        rows.extend([4.0, 5.0, 6.0, 8.0, 20.0].map(|separation_px| {
            let mut scene = Self::lab();
            scene.separations_px = vec![separation_px];
            (format!("separation {separation_px}"), scene)
        }));
        let two_drones = Self {
            separations_px: vec![10.0, 7.0],
            ..Self::lab()
        };
        rows.push(("two drones".to_owned(), two_drones));
        rows.extend([1, 3, 8].map(|distractor_count| {
            let scene = Self {
                distractor_count,
                ..Self::lab()
            };
            (format!("{distractor_count} distractors"), scene)
        }));
        rows
    }

    fn surroundings() -> [(&'static str, Self); 5] {
        let with_background = |background| Self {
            background,
            ..Self::lab()
        };
        let with_window = |before_window| Self {
            window_px: Some([80, 60]),
            before_window,
            ..Self::lab()
        };
        [
            ("lab", Self::lab()),
            ("dark", with_background(0.0..8.0)),
            ("bright", with_background(120.0..225.0)),
            ("window", with_window(false)),
            ("window in front", with_window(true)),
        ]
    }

    fn sensors() -> [(&'static str, Self); 5] {
        let with_blur = |blur_px| Self {
            blur_px,
            ..Self::lab()
        };
        let with_peak = |peak: f64| Self {
            peak: peak..peak + 0.1,
            ..Self::lab()
        };
        let mut noisy = Self::lab();
        noisy.sensor.noise = 15.0;
        [
            ("noise 15", noisy),
            ("blur 3", with_blur(3.0)),
            ("blur 6", with_blur(6.0)),
            ("weak 200", with_peak(200.0)),
            ("weak 150", with_peak(150.0)),
        ]
    }

    /// The same scene without pairs.
    pub fn without_pairs(&self) -> Self {
        Self {
            separations_px: Vec::new(),
            ..self.clone()
        }
    }

    /// One picture.
    pub fn draw(&self, seed: u64) -> MarkerFrame {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut picture = self.paint_background(&mut rng);
        let window = self.paint_window(&mut picture, &mut rng);
        let streak_angle = rng.random_range(0.0..TAU);
        let streak_px = [streak_angle.cos(), streak_angle.sin()].map(|part| part * self.blur_px);
        let mut taken = Vec::new();
        let mut pairs = Vec::new();
        for separation_px in &self.separations_px {
            let Some(pair) = self.place_pair(*separation_px, &taken, window, &mut rng) else {
                continue;
            };
            let peak = rng.random_range(self.peak.clone());
            for center_px in pair.lights_px {
                taken.push(center_px);
                let peak = peak * rng.random_range(0.95..1.05);
                picture.add_spot(&self.spot(center_px, peak, streak_px));
            }
            pairs.push(pair);
        }
        for _ in 0..self.distractor_count {
            let place = |rng: &mut ChaCha8Rng| [self.draw_place(rng)].to_vec();
            let Some(places) = self.draw_free(place, &taken, window, &mut rng) else {
                continue;
            };
            let peak = rng.random_range(0.5 * self.peak.start..self.peak.end);
            taken.push(places[0]);
            picture.add_spot(&self.spot(places[0], peak, streak_px));
        }
        MarkerFrame {
            image: picture.expose(&self.sensor, &mut rng),
            pairs,
        }
    }

    /// What is behind the lights, without them.
    pub fn backdrop(&self, seed: u64) -> Irradiance {
        self.paint_background(&mut ChaCha8Rng::seed_from_u64(seed))
    }

    fn spot(&self, center_px: [f64; 2], peak: f64, streak_px: [f64; 2]) -> LightSpot {
        LightSpot {
            center_px,
            sigma_px: self.sigma_px,
            peak,
            streak_px,
        }
    }

    /// Slanting light over a wall, furniture, and cables one or two pixels wide.
    fn paint_background(&self, rng: &mut impl Rng) -> Irradiance {
        let [width, height] = self.size_px;
        let mut shade = || rng.random_range(self.background.clone());
        let (base, slope_x, slope_y) = (shade(), shade() - shade(), shade() - shade());
        let mut picture = Irradiance::filled(width, height, base);
        for idx in 0..20 {
            let is_cable = idx >= 14;
            let side = |rng: &mut _, long: bool| -> usize {
                match (is_cable, long) {
                    (true, false) => Rng::next_u32(rng) as usize % 2 + 1,
                    _ => Rng::next_u32(rng) as usize % 80 + 14,
                }
            };
            let is_long_across = rng.random::<bool>();
            let size = [side(rng, is_long_across), side(rng, !is_long_across)];
            let corner = [rng.random_range(0..width), rng.random_range(0..height)];
            picture.fill_rectangle(corner, size, rng.random_range(self.background.clone()));
        }
        let (low, high) = (self.background.start, self.background.end);
        picture.map(|x, y, level| {
            let across = x as f64 / width as f64 - 0.5;
            let down = y as f64 / height as f64 - 0.5;
            (level + slope_x * across + slope_y * down).clamp(low, high)
        });
        picture.blur(self.sigma_px);
        picture
    }

    /// Left, top, right and bottom of the window.
    fn paint_window(&self, picture: &mut Irradiance, rng: &mut impl Rng) -> Option<[f64; 4]> {
        let size = self.window_px?;
        let corner = [0, 1].map(|axis| {
            let room = self.size_px[axis].saturating_sub(size[axis]).max(1);
            rng.random_range(0..room)
        });
        picture.fill_rectangle(corner, size, 400.0);
        picture.blur(self.sigma_px);
        let [left, top] = corner.map(|value| value as f64);
        Some([left, top, left + size[0] as f64, top + size[1] as f64])
    }

    fn place_pair(
        &self,
        separation_px: f64,
        taken: &[[f64; 2]],
        window: Option<[f64; 4]>,
        rng: &mut ChaCha8Rng,
    ) -> Option<TruePair> {
        let place = |rng: &mut ChaCha8Rng| {
            let tilt = rng.random_range(-1.0..1.0) * self.tilt_max_rad;
            let (sin, cos) = (FRAC_PI_2 + tilt).sin_cos();
            let half = [cos, sin].map(|part| 0.5 * separation_px * part);
            let center = self.draw_place(rng);
            [-1.0, 1.0]
                .map(|side| [center[0] + side * half[0], center[1] + side * half[1]])
                .to_vec()
        };
        let places = self.draw_free(place, taken, window, rng)?;
        Some(TruePair {
            lights_px: [places[0], places[1]],
        })
    }

    fn draw_place(&self, rng: &mut ChaCha8Rng) -> [f64; 2] {
        self.size_px.map(|side| rng.random::<f64>() * side as f64)
    }

    /// Draws places until they are inside, clear of the window and of other lights.
    fn draw_free(
        &self,
        place: impl Fn(&mut ChaCha8Rng) -> Vec<[f64; 2]>,
        taken: &[[f64; 2]],
        window: Option<[f64; 4]>,
        rng: &mut ChaCha8Rng,
    ) -> Option<Vec<[f64; 2]>> {
        let inside = |at: &[f64; 2]| {
            (0..2).all(|axis| {
                at[axis] >= MARGIN_PX && at[axis] < self.size_px[axis] as f64 - MARGIN_PX
            })
        };
        let window = window.filter(|_| !self.before_window);
        let clear = |at: &[f64; 2]| {
            window.is_none_or(|[left, top, right, bottom]| {
                at[0] < left - MARGIN_PX
                    || at[0] > right + MARGIN_PX
                    || at[1] < top - MARGIN_PX
                    || at[1] > bottom + MARGIN_PX
            })
        };
        let apart = |at: &[f64; 2]| {
            taken
                .iter()
                .all(|other| (at[0] - other[0]).hypot(at[1] - other[1]) >= APART_PX)
        };
        (0..DRAW_COUNT_MAX)
            .map(|_| place(rng))
            .find(|places| places.iter().all(|at| inside(at) && clear(at) && apart(at)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_gives_the_same_picture() {
        for (name, scene) in MarkerScene::matrix() {
            let frame = scene.draw(7);
            assert_eq!(frame, scene.draw(7), "{name}");
            assert_eq!(frame.pairs.len(), scene.separations_px.len(), "{name}");
            for (pair, separation_px) in frame.pairs.iter().zip(&scene.separations_px) {
                assert!((pair.separation_px() - separation_px).abs() < 1e-9);
                assert!(pair.lights_px[0][1] < pair.lights_px[1][1]);
            }
        }
    }
}
