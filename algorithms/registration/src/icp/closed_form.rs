//! Point-to-point in closed form (eq. 6), weighted.

use geometry::{RobustKernel, Similarity, umeyama};
use nalgebra::Vector3;

use super::pairs::Pair;
use crate::alignment::{Source, Target};
use crate::cloud::ShapedCloud;

/// The similarity that brings the pairs together best; `None` if they lie on a line.
///
/// A free scale is the ratio of the spreads (Horn 1987), which does not change when the clouds
/// are swapped; the least squares of one side would draw the noisy cloud smaller.
///
/// - `scale`: the fixed scale, or `None` where it is free.
pub(crate) fn solve(
    source: &ShapedCloud,
    target: &ShapedCloud,
    pairs: &[Pair],
    kernel: RobustKernel,
    scale: Option<f64>,
) -> Option<Similarity<Target, Source>> {
    let weighted = pairs.iter().map(|pair| {
        (
            target.points[pair.target_idx as usize],
            source.points[pair.source_idx as usize],
            kernel.weight(f64::from(pair.distance_squared)),
        )
    });
    let (mut target_mean, mut source_mean, mut weight_sum) =
        (Vector3::zeros(), Vector3::zeros(), 0.0);
    for (in_target, in_source, weight) in weighted.clone() {
        target_mean += in_target * weight;
        source_mean += in_source * weight;
        weight_sum += weight;
    }
    target_mean /= weight_sum;
    source_mean /= weight_sum;
    let rigid = umeyama::<Target, Source>(weighted.clone(), false).ok()?;
    let scale = scale.unwrap_or_else(|| {
        let (mut of_target, mut of_source) = (0.0, 0.0);
        for (in_target, in_source, weight) in weighted {
            of_target += (in_target - target_mean).norm_squared() * weight;
            of_source += (in_source - source_mean).norm_squared() * weight;
        }
        (of_target / of_source).sqrt()
    });
    let rotation = *rigid.rotation();
    let translation = target_mean - rotation * source_mean * scale;
    (scale.is_finite() && scale > 0.0).then(|| Similarity::new(scale, rotation, translation))
}
