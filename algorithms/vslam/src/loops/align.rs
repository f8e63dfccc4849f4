//! The similarity between two parts of maps that show the same place.

use geometry::{Camera, Map, Matrix7, Similarity, Tangent7, Transform, so3, umeyama};
use nalgebra::{Matrix2x3, SMatrix, Vector2, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

type Matrix2x7 = SMatrix<f64, 2, 7>;

/// χ² of two degrees of freedom that 99 % of good sightings stay below.
pub(super) const CHI_SQUARED_MAX: f64 = 9.21;
/// Draws of three pairs at most.
const DRAWS_MAX: usize = 300;
/// Draws are enough when all of three are good with this certainty.
const CERTAINTY: f64 = 0.999;
const REFINE_ROUNDS: usize = 10;
/// Points nearer to a camera than this are not in front of it.
const DEPTH_MIN: f64 = 1e-6;

/// A point of one map where a camera of the other map sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sighting {
    pub(super) point: Vector3<f64>,
    pub(super) camera_from_map: Transform<Camera, Map>,
    pub(super) position: Vector2<f64>,
    pub(super) sigma: f64,
    pub(super) side: Side,
}

/// In which map the camera is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    /// The point is of the source map.
    Target,
    /// The point is of the target map.
    Source,
}

/// One thing that both maps have as a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    pub(super) in_target: Sighting,
    pub(super) in_source: Sighting,
}

impl Pair {
    fn point_in_source(&self) -> Vector3<f64> {
        self.in_target.point
    }

    fn point_in_target(&self) -> Vector3<f64> {
        self.in_source.point
    }

    /// Whether each camera sees the other map's point where it is.
    pub(super) fn agrees(&self, target_from_source: &Similarity<Map, Map>) -> bool {
        [&self.in_target, &self.in_source]
            .into_iter()
            .all(|one| one.agrees(target_from_source))
    }
}

/// A similarity and how well it is known.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refined {
    pub(super) target_from_source: Similarity<Map, Map>,
    /// One standard deviation of the logarithm of its scale, points taken as exact.
    pub(super) log_scale_sigma: f64,
}

impl Sighting {
    pub(super) fn agrees(&self, target_from_source: &Similarity<Map, Map>) -> bool {
        self.residual(target_from_source)
            .is_some_and(|(residual, _)| residual.norm_squared() <= CHI_SQUARED_MAX)
    }

    /// The whitened error on the ideal plane, and its derivative by a right perturbation of the
    /// similarity.
    pub(super) fn residual(
        &self,
        target_from_source: &Similarity<Map, Map>,
    ) -> Option<(Vector2<f64>, Matrix2x7)> {
        let (moved, d_moved_d_tangent) = match self.side {
            Side::Target => {
                let linear = target_from_source.linear_matrix();
                let about = motion_of(&self.point);
                (*target_from_source * self.point, linear * about)
            }
            Side::Source => {
                let moved = target_from_source.inverse() * self.point;
                (moved, -motion_of(&moved))
            }
        };
        let point_in_camera = self.camera_from_map * moved;
        let depth = point_in_camera.z;
        if depth.is_nan() || depth <= DEPTH_MIN {
            return None;
        }
        let position = point_in_camera.xy() / depth;
        let d_position_d_point = Matrix2x3::new(
            1.0,
            0.0,
            -position.x, //
            0.0,
            1.0,
            -position.y,
        ) / depth;
        let d_position_d_tangent =
            d_position_d_point * self.camera_from_map.rotation_matrix() * d_moved_d_tangent;
        Some((
            (position - self.position) / self.sigma,
            d_position_d_tangent / self.sigma,
        ))
    }
}

/// How a point moves with `[ω; ν; ln s]`.
fn motion_of(point: &Vector3<f64>) -> SMatrix<f64, 3, 7> {
    let mut motion = SMatrix::<f64, 3, 7>::zeros();
    motion
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&-so3::hat(point));
    motion.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
    motion.fixed_view_mut::<3, 1>(0, 6).copy_from(point);
    motion
}

/// The similarity that most pairs agree with, from the best of many draws of three.
pub(super) fn ransac(
    pairs: &[Pair],
    inliers_min: usize,
    rng: &mut ChaCha8Rng,
) -> Option<Similarity<Map, Map>> {
    if pairs.len() < inliers_min.max(3) {
        return None;
    }
    let (mut best, mut best_count) = (None, inliers_min - 1);
    let mut draws_max = DRAWS_MAX;
    let mut draw = 0;
    while draw < draws_max {
        draw += 1;
        let chosen: [usize; 3] = std::array::from_fn(|_| rng.random_range(0..pairs.len()));
        let drawn = chosen.iter().map(|&idx| {
            let pair = &pairs[idx];
            (pair.point_in_target(), pair.point_in_source(), 1.0)
        });
        // One drawn twice lies on a line with the third.
        let Ok(similarity) = umeyama::<Map, Map>(drawn, true) else {
            continue;
        };
        let count = pairs.iter().filter(|pair| pair.agrees(&similarity)).count();
        if count > best_count {
            (best, best_count) = (Some(similarity), count);
            let all_good = (count as f64 / pairs.len() as f64).powi(3);
            let needed = (1.0 - CERTAINTY).ln() / (1.0 - all_good).max(1e-12).ln();
            draws_max = draws_max.min(needed.ceil().max(1.0) as usize);
        }
    }
    best
}

/// The similarity under which all sightings fit best, robust by Huber's kernel.
///
/// Levenberg–Marquardt; `None` where the sightings do not determine it.
pub(super) fn refine(start: &Similarity<Map, Map>, sightings: &[Sighting]) -> Option<Refined> {
    let mut current = *start;
    let mut system = System::around(&current, sightings);
    let mut damping = 1e-4;
    for _ in 0..REFINE_ROUNDS {
        let mut damped = system.hessian;
        for axis in 0..7 {
            damped[(axis, axis)] *= 1.0 + damping;
        }
        let step: Tangent7 = damped.cholesky()?.solve(&-system.gradient);
        // A scale that changes by e² in one step is no step but an escape.
        let moved = current.perturbed(&step);
        let bounded = step[6].abs() < 2.0;
        let next = bounded.then(|| System::around(&moved, sightings));
        match next.filter(|next| next.cost <= system.cost) {
            Some(next) => {
                let converged = system.cost - next.cost < 1e-6 * system.cost;
                (current, system) = (moved, next);
                damping *= 0.1;
                if converged {
                    break;
                }
            }
            None => damping *= 10.0,
        }
    }
    let covariance = system.hessian.try_inverse()?;
    let log_scale_sigma = covariance[(6, 6)].max(0.0).sqrt();
    log_scale_sigma.is_finite().then_some(Refined {
        target_from_source: current,
        log_scale_sigma,
    })
}

/// The normal equations about a similarity.
struct System {
    hessian: Matrix7,
    gradient: Tangent7,
    cost: f64,
}

impl System {
    fn around(similarity: &Similarity<Map, Map>, sightings: &[Sighting]) -> Self {
        let threshold = CHI_SQUARED_MAX.sqrt();
        let mut system = Self {
            hessian: Matrix7::zeros(),
            gradient: Tangent7::zeros(),
            cost: 0.0,
        };
        for sighting in sightings {
            let Some((residual, jacobian)) = sighting.residual(similarity) else {
                // Behind the camera: as bad as anything.
                system.cost += 1e3;
                continue;
            };
            let norm = residual.norm();
            let weight = (threshold / norm.max(1e-12)).min(1.0);
            system.cost += if norm <= threshold {
                norm * norm
            } else {
                threshold * (2.0 * norm - threshold)
            };
            system.hessian += jacobian.tr_mul(&jacobian) * weight;
            system.gradient += jacobian.tr_mul(&residual) * weight;
        }
        system
    }
}
