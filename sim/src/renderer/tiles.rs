//! Which facets each tile of pixels sees, and what their pixels look like.

use super::LazyPicture;
use super::TILE_PX;
use super::facets::{Cover, EDGE_TOLERANCE, Facet, Form};
use super::lens::{Lens, Window};
use crate::picture::{LANES, Lanes, Picture};

/// Samples of a pixel, in pixels from its centre: a square turned so that none share a row.
const SAMPLES_PX: [[f32; 2]; 4] = [
    [-0.125, -0.375],
    [0.375, -0.125],
    [0.125, 0.375],
    [-0.375, 0.125],
];

pub struct Tiles {
    windows: Vec<Window>,
    column_windows: Vec<Window>,
    row_windows: Vec<Window>,
    candidates: Vec<Vec<Candidate>>,
    /// 1/z in the middle of each tile, for motion blur.
    inverse_depths: Vec<f32>,
    contenders: Vec<Contender>,
}

#[derive(Clone, Copy)]
struct Candidate {
    facet_idx: u32,
    cover: Cover,
}

/// A facet in a tile that several share, with the steps of its forms from a pixel's centre to
/// its samples.
struct Contender {
    facet_idx: u32,
    forms: [Form; 5],
    steps: [[f32; 4]; 5],
}

impl Tiles {
    pub fn new(lens: &Lens) -> Self {
        let (columns, rows) = (lens.tile_columns(), lens.tile_rows());
        let windows: Vec<Window> = (0..columns * rows)
            .map(|tile_idx| lens.tile_window(tile_idx))
            .collect();
        let mut column_windows = vec![Window::EMPTY; columns];
        let mut row_windows = vec![Window::EMPTY; rows];
        for (tile_idx, window) in windows.iter().enumerate() {
            column_windows[tile_idx % columns].unite(window);
            row_windows[tile_idx / columns].unite(window);
        }
        Self {
            candidates: vec![Vec::new(); windows.len()],
            inverse_depths: vec![0.0; windows.len()],
            contenders: Vec::new(),
            windows,
            column_windows,
            row_windows,
        }
    }

    /// 1/z of what is seen in the middle of a tile.
    pub fn inverse_depth(&self, tile_idx: usize) -> f32 {
        self.inverse_depths[tile_idx]
    }

    /// Whether a sorted facet hides a point on a ray with this 1/z from a pixel inside.
    pub fn hides(
        &self,
        facets: &[Facet],
        [x, y]: [usize; 2],
        ray: [f32; 2],
        inverse_depth: f32,
    ) -> bool {
        let tile_idx = y / TILE_PX * self.column_windows.len() + x / TILE_PX;
        self.candidates[tile_idx]
            .iter()
            .any(|candidate| facets[candidate.facet_idx as usize].hides(ray, inverse_depth))
    }

    /// Finds the facets that each tile may see, without those behind one that fills it.
    pub fn sort(&mut self, facets: &[Facet]) {
        for candidates in &mut self.candidates {
            candidates.clear();
        }
        let column_count = self.column_windows.len();
        for (facet_idx, facet) in facets.iter().enumerate() {
            let columns = touched(&self.column_windows, &facet.window, 0);
            for row in touched(&self.row_windows, &facet.window, 1) {
                for column in columns.clone() {
                    let tile_idx = row * column_count + column;
                    if let Some(cover) = facet.cover(&self.windows[tile_idx]) {
                        let facet_idx = facet_idx as u32;
                        self.candidates[tile_idx].push(Candidate { facet_idx, cover });
                    }
                }
            }
        }
        for candidates in &mut self.candidates {
            let hidden_below = candidates
                .iter()
                .filter(|candidate| candidate.cover.fills)
                .map(|candidate| candidate.cover.inverse_depth_min)
                .fold(0.0, f32::max);
            candidates.retain(|candidate| candidate.cover.inverse_depth_max >= hidden_below);
        }
    }

    /// Writes the shade of every pixel.
    pub fn shade(
        &mut self,
        facets: &[Facet],
        pictures: &[LazyPicture],
        lens: &Lens,
        shades: &mut [f32],
    ) {
        for tile_idx in 0..self.windows.len() {
            let candidates = &self.candidates[tile_idx];
            self.inverse_depths[tile_idx] = match candidates.as_slice() {
                [only] if only.cover.fills => {
                    let facet = &facets[only.facet_idx as usize];
                    let picture = &pictures[facet.picture_idx];
                    shade_filled(facet, picture, lens, tile_idx, shades);
                    0.5 * (only.cover.inverse_depth_min + only.cover.inverse_depth_max)
                }
                _ => {
                    self.contenders.clear();
                    let contend = |c: &Candidate| Contender::new(c.facet_idx, facets, lens);
                    self.contenders.extend(candidates.iter().map(contend));
                    let shared = SharedTile {
                        contenders: &self.contenders,
                        facets,
                        pictures,
                        lens,
                    };
                    shared.shade(tile_idx, shades)
                }
            };
        }
    }
}

fn touched(windows: &[Window], seen: &Window, axis: usize) -> std::ops::Range<usize> {
    // Tiles follow each other, so the touched ones are neighbours.
    let is_touched =
        |window: &&Window| window.to[axis] >= seen.from[axis] && window.from[axis] <= seen.to[axis];
    let first = windows
        .iter()
        .take_while(|window| !is_touched(window))
        .count();
    let count = windows[first..].iter().take_while(is_touched).count();
    first..first + count
}

fn shade_filled(
    facet: &Facet,
    picture: &Picture,
    lens: &Lens,
    tile_idx: usize,
    shades: &mut [f32],
) {
    let [xs, ys] = lens.tile_pixels(tile_idx);
    for y in ys {
        let row = &mut shades[lens.place(xs.start, y)..][..TILE_PX];
        row.fill(0.0);
        let rays = lens.ray_lanes(xs.start, y);
        facet.add_shades(picture, rays, &[1.0; LANES], row);
    }
}

impl Contender {
    fn new(facet_idx: u32, facets: &[Facet], lens: &Lens) -> Self {
        let facet = &facets[facet_idx as usize];
        let [left, top, right, bottom] = facet.edges;
        let forms = [facet.inverse_depth, left, top, right, bottom];
        let steps = forms.map(|form| {
            SAMPLES_PX.map(|[x, y]| {
                form.x_slope * x / lens.focal_px[0] + form.y_slope * y / lens.focal_px[1]
            })
        });
        Self {
            facet_idx,
            forms,
            steps,
        }
    }
}

/// A tile whose pixels see more than one facet.
struct SharedTile<'a> {
    contenders: &'a [Contender],
    facets: &'a [Facet],
    pictures: &'a [LazyPicture],
    lens: &'a Lens,
}

/// Marks a sample that hit nothing.
const NOTHING: u32 = u32::MAX;

impl SharedTile<'_> {
    /// Returns 1/z of what is seen near the middle.
    fn shade(&self, tile_idx: usize, shades: &mut [f32]) -> f32 {
        let [xs, ys] = self.lens.tile_pixels(tile_idx);
        let middle = ys.start.midpoint(ys.end);
        let mut inverse_depth = 0.0;
        for y in ys {
            let row = &mut shades[self.lens.place(xs.start, y)..][..TILE_PX];
            let nearest = self.shade_row([xs.start, y], row);
            if y <= middle {
                inverse_depth = nearest[LANES / 2];
            }
        }
        inverse_depth
    }

    /// Shades each facet once per pixel, at its centre, weighted by the samples that it wins.
    fn shade_row(&self, [x, y]: [usize; 2], row: &mut [f32]) -> Lanes {
        let rays = self.lens.ray_lanes(x, y);
        let mut hits = [[NOTHING; 4]; LANES];
        let mut nearest = [0.0; LANES];
        for lane in 0..LANES {
            (hits[lane], nearest[lane]) = self.hits([rays[0][lane], rays[1][lane]]);
        }
        row.fill(0.0);
        let samples =
            |hits: &[u32; 4], wanted: u32| hits.iter().filter(|hit| **hit == wanted).count() as f32;
        let hit_counts = hits.map(|hits| 4.0 - samples(&hits, NOTHING));
        for contender in self.contenders {
            let facet = &self.facets[contender.facet_idx as usize];
            let mut weights = [0.0; LANES];
            for lane in 0..LANES {
                // Samples that slip through a seam count as what the others hit.
                let count = samples(&hits[lane], contender.facet_idx);
                weights[lane] = count / hit_counts[lane].max(1.0);
            }
            if weights.iter().sum::<f32>() > 0.0 {
                facet.add_shades(&self.pictures[facet.picture_idx], rays, &weights, row);
            }
        }
        nearest
    }

    /// The nearest facet at each sample, and the largest 1/z of them.
    #[inline]
    fn hits(&self, ray: [f32; 2]) -> ([u32; 4], f32) {
        let mut nearest = [0.0_f32; 4];
        let mut hits = [NOTHING; 4];
        for contender in self.contenders {
            let at_centre = contender.forms.map(|form| form.at(ray));
            for sample in 0..4 {
                let value = |form: usize| at_centre[form] + contender.steps[form][sample];
                let inverse_depth = value(0);
                let inside = value(1).min(value(2)).min(value(3).min(value(4)));
                if inside >= -EDGE_TOLERANCE && inverse_depth > nearest[sample] {
                    nearest[sample] = inverse_depth;
                    hits[sample] = contender.facet_idx;
                }
            }
        }
        (hits, nearest.into_iter().fold(0.0, f32::max))
    }
}
