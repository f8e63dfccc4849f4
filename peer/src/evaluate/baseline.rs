//! What a vehicle would have without the shared map: its own trajectory, placed once.
//!
//! Both baselines are measured over exactly the frames of the causal trajectory, so that dividing
//! them by its error compares like with like. A frame that has no pose in the vehicle's own map
//! takes the last one before it, as dead reckoning would.

use geometry::{Enu, Map, Similarity};
use nalgebra::{Quaternion, SymmetricEigen, Unit, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, UnitSphere};

use super::trajectory_error::{median, root_mean_square};
use super::{Alignment, Pair, associate, trajectory_error};
use crate::files::StampedPose;

/// How wrong a rough start is, and how long the truth helps an ideal one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaselineSettings {
    /// The distance between the rough and the true start, metres.
    pub offset_m: f64,
    /// The angle between the rough and the true orientation, radians.
    pub turn_rad: f64,
    /// The rough scale is the true one times or divided by this.
    pub scale_factor: f64,
    /// How many rough starts are drawn; the median counts.
    pub draw_count: usize,
    pub seed: u64,
    /// An ideal start is placed by the truth of this time from its first frame on, seconds…
    pub ideal_duration_s: f64,
    /// … and on, until this distance has been travelled, metres.
    pub ideal_distance_m: f64,
}

impl Default for BaselineSettings {
    fn default() -> Self {
        Self {
            offset_m: 0.5,
            turn_rad: 15_f64.to_radians(),
            scale_factor: 1.1,
            draw_count: 20,
            seed: 1,
            ideal_duration_s: 2.0,
            ideal_distance_m: 0.5,
        }
    }
}

/// The error of the own trajectory from a rough start, the median over seeded draws.
///
/// The true placement maps the first own frame that has a truth onto it, with the scale of the
/// Sim(3) alignment of all own frames to the truth. A draw is off from that by exactly
/// `offset_m`, `turn_rad` and `scale_factor`, in a random direction, about a random axis through
/// the true start, and up or down.
///
/// `None` without an own frame, or where too few or collinear positions tell no scale.
pub fn rough_start_rmse_m(
    truth: &[StampedPose<Enu>],
    own: &[StampedPose<Map>],
    causal: &[StampedPose<Enu>],
    settings: &BaselineSettings,
) -> Option<f64> {
    let start = *associate(truth, own).first()?;
    let enu_from_camera = &truth[start.truth_idx].target_from_camera;
    let map_from_camera = &own[start.estimate_idx].target_from_camera;
    let aligned = trajectory_error(truth, own, Alignment::Similarity).ok()?;
    let scale = aligned.truth_from_estimate.scale();
    let rotation = enu_from_camera.rotation() * map_from_camera.rotation().inverse();

    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let mut rmses_m = Vec::with_capacity(settings.draw_count);
    for _ in 0..settings.draw_count {
        let direction = Vector3::from(UnitSphere.sample(&mut rng));
        let axis = Unit::new_normalize(Vector3::from(UnitSphere.sample(&mut rng)));
        let factor = if rng.random::<bool>() {
            settings.scale_factor
        } else {
            1.0 / settings.scale_factor
        };
        let turned = UnitQuaternion::from_axis_angle(&axis, settings.turn_rad) * rotation;
        let enu_from_map = about(
            scale * factor,
            turned,
            map_from_camera.translation(),
            &(enu_from_camera.translation() + direction * settings.offset_m),
        );
        rmses_m.push(placed_rmse_m(truth, own, causal, &enu_from_map)?);
    }
    (!rmses_m.is_empty()).then(|| median(&mut rmses_m))
}

/// The error of the own trajectory when the truth of its beginning places it: drift alone.
///
/// The beginning is `ideal_duration_s` from the first own frame on, extended until the truth has
/// travelled `ideal_distance_m`. Its orientations give the rotation and its positions the scale,
/// so that a straight beginning places as well as a curved one.
pub fn drift_rmse_m(
    truth: &[StampedPose<Enu>],
    own: &[StampedPose<Map>],
    causal: &[StampedPose<Enu>],
    settings: &BaselineSettings,
) -> Option<f64> {
    let beginning = beginning(truth, &associate(truth, own), settings);
    let enu_from_map = place_by_truth(truth, own, &beginning)?;
    placed_rmse_m(truth, own, causal, &enu_from_map)
}

fn beginning(truth: &[StampedPose<Enu>], pairs: &[Pair], settings: &BaselineSettings) -> Vec<Pair> {
    let mut beginning: Vec<Pair> = Vec::new();
    let mut travelled_m = 0.0;
    for pair in pairs {
        let pose = &truth[pair.truth_idx];
        if let (Some(first), Some(last)) = (beginning.first(), beginning.last()) {
            let elapsed_s = pose.captured_at - truth[first.truth_idx].captured_at;
            if elapsed_s > settings.ideal_duration_s && travelled_m >= settings.ideal_distance_m {
                break;
            }
            let step = pose.target_from_camera.translation()
                - truth[last.truth_idx].target_from_camera.translation();
            travelled_m += step.norm();
        }
        beginning.push(*pair);
    }
    beginning
}

/// The least-squares placement, its rotation fixed to the mean of the orientations.
fn place_by_truth(
    truth: &[StampedPose<Enu>],
    own: &[StampedPose<Map>],
    pairs: &[Pair],
) -> Option<Similarity<Enu, Map>> {
    let poses: Vec<_> = pairs
        .iter()
        .map(|pair| {
            (
                &truth[pair.truth_idx].target_from_camera,
                &own[pair.estimate_idx].target_from_camera,
            )
        })
        .collect();
    let rotation = mean_rotation(
        poses
            .iter()
            .map(|(truth, own)| truth.rotation() * own.rotation().inverse()),
    )?;
    let count = poses.len() as f64;
    let truth_mean = poses
        .iter()
        .map(|(t, _)| *t.translation())
        .sum::<Vector3<f64>>()
        / count;
    let own_mean = poses
        .iter()
        .map(|(_, o)| *o.translation())
        .sum::<Vector3<f64>>()
        / count;
    let (mut product, mut variance) = (0.0, 0.0);
    for (truth, own) in &poses {
        let centred_own = rotation * (own.translation() - own_mean);
        product += centred_own.dot(&(truth.translation() - truth_mean));
        variance += centred_own.norm_squared();
    }
    let scale = product / variance;
    (scale > 0.0 && scale.is_finite()).then(|| about(scale, rotation, &own_mean, &truth_mean))
}

/// The rotation with the least squared chordal distance to all (Markley et al. 2007).
fn mean_rotation(
    rotations: impl Iterator<Item = UnitQuaternion<f64>>,
) -> Option<UnitQuaternion<f64>> {
    let mut moment = nalgebra::Matrix4::zeros();
    for rotation in rotations {
        moment += rotation.coords * rotation.coords.transpose();
    }
    let eigen = SymmetricEigen::try_new(moment, 1e-15, 100)?;
    let (largest, value) = eigen.eigenvalues.argmax();
    (value > 0.0).then(|| {
        let coordinates = eigen.eigenvectors.column(largest).into_owned();
        UnitQuaternion::from_quaternion(Quaternion::from_vector(coordinates))
    })
}

/// The similarity that turns and scales about a point of the map, which it puts at `point_in_enu`.
fn about(
    scale: f64,
    rotation: UnitQuaternion<f64>,
    point_in_map: &Vector3<f64>,
    point_in_enu: &Vector3<f64>,
) -> Similarity<Enu, Map> {
    let translation = point_in_enu - rotation * point_in_map * scale;
    Similarity::new(scale, rotation, translation)
}

/// The error of the placed own trajectory over the frames of the causal one.
fn placed_rmse_m(
    truth: &[StampedPose<Enu>],
    own: &[StampedPose<Map>],
    causal: &[StampedPose<Enu>],
    enu_from_map: &Similarity<Enu, Map>,
) -> Option<f64> {
    let errors_m: Vec<f64> = associate(truth, causal)
        .into_iter()
        .filter_map(|pair| {
            let captured_at = causal[pair.estimate_idx].captured_at;
            let known = own.partition_point(|pose| pose.captured_at <= captured_at);
            // Before its first own pose the vehicle stands at its start.
            let last = own.get(known.saturating_sub(1))?;
            let placed = *enu_from_map * *last.target_from_camera.translation();
            Some((placed - truth[pair.truth_idx].target_from_camera.translation()).norm())
        })
        .collect();
    (!errors_m.is_empty()).then(|| root_mean_square(&errors_m))
}
