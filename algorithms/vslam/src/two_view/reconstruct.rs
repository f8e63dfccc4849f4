//! From correspondences to a start, or to the reason why there is none.

use geometry::{Camera, Transform};
use nalgebra::{Matrix3, Vector3};
use rand::Rng;

use super::essential::Essential;
use super::homography::Homography;
use super::pair::{CHI_SQUARED_1_P95, CHI_SQUARED_2_P95, Pair};
use super::ransac::{Fit, Model, information_criterion, ransac};
use super::refine::{RefineRound, refine_relative_pose};
use super::rotation::Turn;
use super::{Correspondence, TwoView, TwoViewModel, TwoViewRefusal, TwoViewSettings};
use crate::triangulation::{Sighting, TriangulationSettings, triangulate};

/// The relative pose of two views and the points that both see.
///
/// Five-point and homography RANSAC in parallel (Nistér 2004; Ma et al. 2004), the model by
/// Torr's information criterion, every pose that a model allows refined on Sampson's error; the
/// one that explains the pairs best wins, if no other comes close.
///
/// Deterministic for a given `rng`.
pub fn reconstruct(
    correspondences: &[Correspondence],
    settings: &TwoViewSettings,
    rng: &mut impl Rng,
) -> Result<TwoView, TwoViewRefusal> {
    let required = settings.match_count_min.max(Essential::SAMPLE_SIZE);
    if correspondences.len() < required {
        return Err(TwoViewRefusal::TooFewMatches {
            found: correspondences.len(),
            required,
        });
    }
    let pairs: Vec<Pair> = correspondences.iter().map(Pair::from).collect();
    let fits = Fits::find(&pairs, settings, rng);
    let model = fits.choose_model(&pairs, settings)?;
    let best = choose_pose(fits.poses(&pairs), &pairs, settings)?;
    let points = Points::triangulate(&best.pose, correspondences, settings);
    let parallax_rad_median = points.gate(settings)?;
    Ok(TwoView {
        second_from_first: best.pose,
        points_in_first: points.points_in_first,
        point_count: points.parallaxes_rad.len(),
        model,
        parallax_rad_median,
    })
}

/// The best of each model.
struct Fits {
    essential: Option<Fit<Essential>>,
    homography: Option<Fit<Homography>>,
    turn: Option<Fit<Turn>>,
}

impl Fits {
    fn find(pairs: &[Pair], settings: &TwoViewSettings, rng: &mut impl Rng) -> Self {
        Self {
            essential: ransac(pairs, settings, rng),
            homography: ransac(pairs, settings, rng),
            turn: ransac(pairs, settings, rng),
        }
    }

    fn choose_model(
        &self,
        pairs: &[Pair],
        settings: &TwoViewSettings,
    ) -> Result<TwoViewModel, TwoViewRefusal> {
        let sigma = settings.sigma;
        let essential_count = self.essential.map_or(0, |fit| fit.inlier_count);
        let homography_count = self.homography.map_or(0, |fit| fit.inlier_count);
        let found = essential_count.max(homography_count);
        if found < settings.point_count_min {
            return Err(TwoViewRefusal::TooFewInliers {
                found,
                required: settings.point_count_min,
            });
        }
        let explained = self.explained(pairs, sigma);
        let essential = criterion(&self.essential, &explained, sigma);
        let homography = criterion(&self.homography, &explained, sigma);
        let turn = criterion(&self.turn, &explained, sigma);
        if turn <= essential.min(homography) || self.turn_nearly_explains(&explained, sigma) {
            return Err(TwoViewRefusal::PureRotation);
        }
        Ok(if homography < essential {
            TwoViewModel::Homography
        } else {
            TwoViewModel::Essential
        })
    }

    /// The pairs that either model explains: on outliers the models cannot be compared.
    fn explained(&self, pairs: &[Pair], sigma: f64) -> Vec<Pair> {
        let explained = |pair: &&Pair| {
            self.essential
                .is_some_and(|fit| fit.model.explains(pair, sigma))
                || self
                    .homography
                    .is_some_and(|fit| fit.model.explains(pair, sigma))
        };
        pairs.iter().filter(explained).copied().collect()
    }

    /// Whether the rotation misses most pairs by no more than noise may.
    fn turn_nearly_explains(&self, explained: &[Pair], sigma: f64) -> bool {
        self.turn.is_some_and(|fit| {
            let residuals: Vec<f64> = explained
                .iter()
                .map(|pair| fit.model.residual_squared(pair).sqrt())
                .collect();
            median(&residuals) < TURN_RESIDUAL_MIN * sigma
        })
    }

    /// Every pose that either model allows.
    fn poses(&self, pairs: &[Pair]) -> Vec<Transform<Camera, Camera>> {
        let mut poses = Vec::with_capacity(8);
        if let Some(fit) = &self.essential {
            poses.extend(fit.model.poses());
        }
        if let Some(fit) = &self.homography {
            poses.extend(fit.model.poses(pairs));
        }
        poses
    }
}

/// The median residual of a pure rotation is 1.2 sigmas. Below two, directions of translation
/// came out wrong by 20° and more.
const TURN_RESIDUAL_MIN: f64 = 2.0;

fn criterion<M: Model>(fit: &Option<Fit<M>>, explained: &[Pair], sigma: f64) -> f64 {
    fit.as_ref().map_or(f64::INFINITY, |fit| {
        information_criterion(&fit.model, explained, sigma)
    })
}

/// A pose, the pairs that it explains with a point in front of both cameras, and how well it
/// explains all of them.
struct Candidate {
    pose: Transform<Camera, Camera>,
    point_count: usize,
    cost: f64,
}

impl Candidate {
    fn new(pose: Transform<Camera, Camera>, pairs: &[Pair], sigma: f64) -> Self {
        let essential = Essential::of_pose(&pose);
        let rotation = pose.rotation_matrix();
        let mut candidate = Self {
            pose,
            point_count: 0,
            cost: 0.0,
        };
        for pair in pairs {
            let squared = essential.residual_squared(pair) / (sigma * sigma);
            let meeting = Meeting::of(&rotation, pose.translation(), pair);
            let fits = squared <= Essential::CHI_SQUARED_MAX;
            candidate.point_count += usize::from(fits && meeting == Meeting::InFront);
            candidate.cost += if fits && meeting != Meeting::Behind {
                squared
            } else {
                Essential::CHI_SQUARED_MAX
            };
        }
        candidate
    }

    fn is_close_to(&self, other: &Self) -> bool {
        let rotation_rad = self.pose.rotation().angle_to(other.pose.rotation());
        let direction_rad = self.pose.translation().angle(other.pose.translation());
        rotation_rad < 2.0_f64.to_radians() && direction_rad < 10.0_f64.to_radians()
    }
}

/// Where the rays of a pair meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Meeting {
    /// Clearly, before both cameras.
    InFront,
    /// Clearly, behind one of them at least.
    Behind,
    /// Nowhere that noise would leave them. That speaks for no pose and against none: if it did
    /// speak against, of a camera that hardly moved the pose would win that invents parallax.
    FarAway,
}

impl Meeting {
    /// Rays closer to parallel than this have no say: noise decides where they meet.
    const PARALLAX_SINE_MIN: f64 = 0.003;

    fn of(rotation: &Matrix3<f64>, translation: &Vector3<f64>, pair: &Pair) -> Self {
        let turned = rotation * pair.first;
        let normal = pair.second.cross(&turned);
        let lengths_squared = turned.norm_squared() * pair.second.norm_squared();
        let sine_squared = normal.norm_squared() / lengths_squared;
        if sine_squared <= Self::PARALLAX_SINE_MIN * Self::PARALLAX_SINE_MIN {
            return Self::FarAway;
        }
        // λ₂ q = λ₁ R p + t, crossed with q and with R p.
        let first_depth = -pair.second.cross(translation).dot(&normal);
        let second_depth = -turned.cross(translation).dot(&normal);
        if first_depth > 0.0 && second_depth > 0.0 {
            Self::InFront
        } else {
            Self::Behind
        }
    }
}

/// The refined pose that explains the pairs best, if no other pose comes close.
fn choose_pose(
    poses: Vec<Transform<Camera, Camera>>,
    pairs: &[Pair],
    settings: &TwoViewSettings,
) -> Result<Candidate, TwoViewRefusal> {
    let sigma = settings.sigma;
    let mut candidates: Vec<Candidate> = poses
        .into_iter()
        .map(|pose| Candidate::new(pose, pairs, sigma))
        .collect();
    let most = candidates.iter().map(|c| c.point_count).max().unwrap_or(0);
    // What has few points now will not have the most after refinement.
    candidates.retain(|candidate| 2 * candidate.point_count >= most);
    for candidate in &mut candidates {
        if let Some(refined) = refine_relative_pose(&candidate.pose, pairs, sigma, &ROUNDS) {
            let refined = Candidate::new(refined, pairs, sigma);
            if refined.cost < candidate.cost {
                *candidate = refined;
            }
        }
    }
    candidates.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut ranked = candidates.into_iter();
    let best = ranked.next().ok_or(TwoViewRefusal::TooFewInliers {
        found: 0,
        required: settings.point_count_min,
    })?;
    let second = ranked.find(|candidate| !candidate.is_close_to(&best));
    match second {
        Some(second) if is_ambiguous(&best, &second) => Err(TwoViewRefusal::Ambiguous {
            best: best.point_count,
            second: second.point_count,
        }),
        _ => Ok(best),
    }
}

const ROUNDS: [RefineRound; 2] = [
    RefineRound {
        chi_squared_max: 4.0 * CHI_SQUARED_1_P95,
        iteration_count: 6,
    },
    RefineRound {
        chi_squared_max: CHI_SQUARED_1_P95,
        iteration_count: 6,
    },
];

/// The second explains nearly as many pairs, nearly as well.
fn is_ambiguous(best: &Candidate, second: &Candidate) -> bool {
    let count_close = second.point_count as f64 > 0.8 * best.point_count as f64;
    count_close && second.cost - best.cost < 0.2 * best.point_count as f64
}

/// The triangulated points.
struct Points {
    points_in_first: Vec<Option<Vector3<f64>>>,
    /// Of the points that are kept.
    parallaxes_rad: Vec<f64>,
    /// Of the points that were in front and accurate but too close to parallel as well.
    parallaxes_rad_all: Vec<f64>,
}

impl Points {
    fn triangulate(
        pose: &Transform<Camera, Camera>,
        correspondences: &[Correspondence],
        settings: &TwoViewSettings,
    ) -> Self {
        let accept_all = TriangulationSettings {
            parallax_rad_min: 0.0,
            chi_squared_max: CHI_SQUARED_2_P95,
        };
        let mut points = Self {
            points_in_first: Vec::with_capacity(correspondences.len()),
            parallaxes_rad: Vec::new(),
            parallaxes_rad_all: Vec::new(),
        };
        for correspondence in correspondences {
            // The first camera plays the map's part.
            let sighting = |camera_from_map, position| Sighting {
                camera_from_map,
                position,
                sigma: settings.sigma,
            };
            let sightings = [
                sighting(Transform::identity(), correspondence.first),
                sighting(pose.relabel(), correspondence.second),
            ];
            let found = triangulate(&sightings, &accept_all).ok();
            points
                .parallaxes_rad_all
                .extend(found.map(|point| point.parallax_rad));
            // A point with half the parallax still has a depth; with less it is noise.
            let kept = found.filter(|p| p.parallax_rad >= 0.5 * settings.parallax_rad_min);
            points
                .parallaxes_rad
                .extend(kept.map(|point| point.parallax_rad));
            points
                .points_in_first
                .push(kept.map(|point| point.point_in_map));
        }
        points
    }

    /// The median parallax, if it and the number of points suffice.
    fn gate(&self, settings: &TwoViewSettings) -> Result<f64, TwoViewRefusal> {
        let required = settings.point_count_min;
        let found = self.parallaxes_rad.len();
        if found < required && self.parallaxes_rad_all.len() < required {
            return Err(TwoViewRefusal::TooFewPoints { found, required });
        }
        if found < required {
            return Err(TwoViewRefusal::LowParallax {
                parallax_rad_median: median(&self.parallaxes_rad_all),
            });
        }
        let parallax_rad_median = median(&self.parallaxes_rad);
        if parallax_rad_median < settings.parallax_rad_min {
            return Err(TwoViewRefusal::LowParallax {
                parallax_rad_median,
            });
        }
        Ok(parallax_rad_median)
    }
}

/// Zero for no values.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector2};

    use super::*;

    /// What cameras see that stand 2 cm apart: points 20 m away, and a few at 2 m.
    fn pairs(pose: &Transform<Camera, Camera>) -> Vec<Pair> {
        let position = |idx: usize| Vector2::new((idx % 10) as f64, (idx / 10) as f64) * 0.05;
        let pair = |idx: usize| {
            let depth = if idx.is_multiple_of(10) { 2.0 } else { 20.0 };
            let first = position(idx);
            let in_second = *pose * (first.push(1.0) * depth);
            Pair::from(&Correspondence {
                first,
                second: in_second.xy() / in_second.z,
            })
        };
        (0..100).map(pair).collect()
    }

    #[test]
    fn what_shows_no_parallax_speaks_neither_for_a_pose_nor_against_it() {
        let pose = Transform::new(UnitQuaternion::identity(), Vector3::x() * 0.02);
        let pairs = pairs(&pose);
        let right = Candidate::new(pose, &pairs, 1e-3);
        assert_eq!(right.point_count, 10);
        assert!(right.cost < 1e-9);
        // Those that show some are behind the camera of this one.
        let opposite = Transform::new(UnitQuaternion::identity(), Vector3::x() * -0.02);
        let wrong = Candidate::new(opposite, &pairs, 1e-3);
        assert_eq!(wrong.point_count, 0);
        assert!((wrong.cost - 10.0 * Essential::CHI_SQUARED_MAX).abs() < 1e-9);
    }
}
