//! Whether the fixes determine where the map stands, and how well.

use std::collections::BTreeMap;
use std::fmt;

use geometry::{Enu, Map, Matrix7, Similarity, so3, umeyama};
use nalgebra::{Matrix3, SMatrix, SymmetricEigen, Vector3};
use vslam::KeyframeId;

use super::association::Tie;
use super::chain::{Node, Solution, median};
use super::{DEPTH_UNTOLD_M, Depths, Georeference, PlacedKeyframe};
use crate::{GeoreferenceSettings, KeyframePose};

/// A fix beyond this, squared and whitened, is an outlier: 99.9 % of χ² with three degrees.
const CHI2_OUTLIER: f64 = 16.27;

/// Why the fixes do not tell where the map stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotObservable {
    TooFewFixes {
        count: usize,
    },
    /// The path is short against the noise of the fixes.
    Hovering,
    /// Nothing tells how the map is turned about the path.
    StraightPath,
    /// Most fixes contradict each other or the map.
    Inconsistent,
    /// The estimate does not settle.
    Unstable,
}

impl fmt::Display for NotObservable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::TooFewFixes { count: 0 } => "no position fixes",
            Self::TooFewFixes { .. } => "too few fixes",
            Self::Hovering => "hovering",
            Self::StraightPath => "straight path",
            Self::Inconsistent => "fixes contradict the map",
            Self::Unstable => "georeference does not settle",
        })
    }
}

/// The georeference that a solution amounts to, if it is observable.
pub(super) fn judge(
    ties: &[&Tie],
    keyframes: &BTreeMap<KeyframeId, KeyframePose>,
    solution: Solution,
    depths: &Depths,
    settings: &GeoreferenceSettings,
) -> Result<Georeference, NotObservable> {
    let rotation_sigma_rad = typical(&solution.nodes, |node| weakest_turn(&node.covariance).0);
    let scale_sigma = typical(&solution.nodes, |node| node.covariance[(6, 6)].sqrt());
    if scale_sigma > settings.scale_sigma_max {
        return Err(NotObservable::Hovering);
    }
    if rotation_sigma_rad > settings.rotation_sigma_max_rad {
        return Err(name_of_weakness(&solution.nodes));
    }
    let accepted: Vec<&&Tie> = ties
        .iter()
        .zip(&solution.residuals_squared)
        .filter(|(_, residual_squared)| **residual_squared < CHI2_OUTLIER)
        .map(|(tie, _)| tie)
        .collect();
    if accepted.len() * 2 < ties.len() || accepted.len() < settings.fix_count_min {
        return Err(NotObservable::Inconsistent);
    }
    let enu_from_map = fit(&solution.nodes, keyframes).ok_or(NotObservable::Unstable)?;
    let sigmas: Vec<f64> = accepted
        .iter()
        .map(|tie| ((tie.fix.covariance.m11 + tie.fix.covariance.m22) * 0.5).sqrt())
        .collect();
    Ok(Georeference {
        covariance: common_covariance(&solution.nodes, keyframes, depths)
            .ok_or(NotObservable::Unstable)?,
        enu_from_map,
        fix_sigma_m: median(&sigmas),
        outlier_count: ties.len() - accepted.len(),
        fix_count: ties.len(),
        drift_factor: solution.drift_factor,
        newest_fix_at: accepted
            .iter()
            .map(|tie| tie.fix.captured_at)
            .max()
            .ok_or(NotObservable::Inconsistent)?,
        keyframes: solution
            .nodes
            .into_iter()
            .map(|node| {
                let placed = PlacedKeyframe {
                    enu_from_camera: node.enu_from_camera,
                    covariance: node.covariance,
                };
                (node.keyframe, placed)
            })
            .collect(),
    })
}

fn typical(nodes: &[Node], value: impl Fn(&Node) -> f64) -> f64 {
    median(&nodes.iter().map(value).collect::<Vec<_>>())
}

/// The largest standard deviation of the rotation, and its axis in the camera.
fn weakest_turn(covariance: &Matrix7) -> (f64, Vector3<f64>) {
    let block: Matrix3<f64> = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let eigen = SymmetricEigen::new(block);
    let idx = eigen.eigenvalues.imax();
    (
        eigen.eigenvalues[idx].max(0.0).sqrt(),
        eigen.eigenvectors.column(idx).into_owned(),
    )
}

/// A rotation that is free about the path is that of a straight path; any other of a short one.
fn name_of_weakness(nodes: &[Node]) -> NotObservable {
    let centre = nodes
        .iter()
        .map(|node| *node.enu_from_camera.translation())
        .sum::<Vector3<f64>>()
        / nodes.len().max(1) as f64;
    let mut spread = Matrix3::zeros();
    for node in nodes {
        let offset = node.enu_from_camera.translation() - centre;
        spread += offset * offset.transpose();
    }
    let eigen = SymmetricEigen::new(spread);
    let along_path = eigen
        .eigenvectors
        .column(eigen.eigenvalues.imax())
        .into_owned();
    let Some(middle) = nodes.get(nodes.len() / 2) else {
        return NotObservable::Hovering;
    };
    let axis = middle.enu_from_camera.rotation() * weakest_turn(&middle.covariance).1;
    if axis.dot(&along_path).abs() > 0.8 {
        NotObservable::StraightPath
    } else {
        NotObservable::Hovering
    }
}

/// Points by which places are compared: the camera and two points ahead of it, `reach` away,
/// where what it sees may be.
pub(crate) fn probes(reach: f64) -> [Vector3<f64>; 3] {
    [
        Vector3::zeros(),
        Vector3::new(0.5 * reach, 0.0, reach),
        Vector3::new(0.0, 0.5 * reach, reach),
    ]
}

fn fit(
    nodes: &[Node],
    keyframes: &BTreeMap<KeyframeId, KeyframePose>,
) -> Option<Similarity<Enu, Map>> {
    let reach = reach(nodes);
    let pairs: Vec<_> = nodes
        .iter()
        .filter_map(|node| Some((node, keyframes.get(&node.keyframe)?)))
        .flat_map(|(node, pose)| {
            probes(reach).map(|probe| {
                (
                    node.enu_from_camera * probe,
                    pose.map_from_camera * probe,
                    1.0,
                )
            })
        })
        .collect();
    umeyama(pairs.iter().copied(), true).ok()
}

/// How far from the camera the map's content is taken to be, in the unit of the map.
fn reach(nodes: &[Node]) -> f64 {
    DEPTH_UNTOLD_M / typical(nodes, |node| node.enu_from_camera.scale())
}

/// How far towards what the anchor sees, as shares of its depth, others stand who see it too: not
/// at the anchor's camera, which the fixes hold best, but where an error of scale or turn shifts
/// them along with the scene.
const USE_SHARES: [f64; 2] = [0.5, 0.75];

/// The covariance of one similarity under which the places of use are, on average over the
/// keyframes, as uncertain as under the keyframes' own covariances.
///
/// The sum of their information, `Λ = Σ Jᵀ P⁻¹ J`, would treat them as independent and give
/// an average normalised variance of 7/n; scaling it by 7/(3 n) makes that 3, as it should be.
fn common_covariance(
    nodes: &[Node],
    keyframes: &BTreeMap<KeyframeId, KeyframePose>,
    depths: &Depths,
) -> Option<Matrix7> {
    let mut information = Matrix7::zeros();
    let mut probe_count = 0;
    for node in nodes {
        let Some(pose) = keyframes.get(&node.keyframe) else {
            continue;
        };
        let depth = depths.near(node.keyframe, node.enu_from_camera.scale());
        let ahead = USE_SHARES.iter().flat_map(|share| {
            let [_, first, second] = probes(share * depth);
            [first, second]
        });
        for probe in ahead {
            let in_camera = d_point_d_tangent(&node.enu_from_camera.linear_matrix(), &probe);
            let spread = in_camera * node.covariance * in_camera.transpose();
            let Some(inverse) = spread.try_inverse() else {
                continue;
            };
            let enu_from_map =
                node.enu_from_camera * Similarity::from(pose.map_from_camera.inverse());
            let in_map = d_point_d_tangent(
                &enu_from_map.linear_matrix(),
                &(pose.map_from_camera * probe),
            );
            information += in_map.transpose() * inverse * in_map;
            probe_count += 1;
        }
    }
    let share = 7.0 / (3.0 * f64::from(probe_count));
    let covariance = (information * share).cholesky()?.inverse();
    Some((covariance + covariance.transpose()) * 0.5)
}

/// `∂(S exp(δ) p)/∂δ = sR [−[p]×, I, p]`.
pub(crate) fn d_point_d_tangent(linear: &Matrix3<f64>, point: &Vector3<f64>) -> SMatrix<f64, 3, 7> {
    let mut jacobian = SMatrix::<f64, 3, 7>::zeros();
    jacobian
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&(linear * -so3::hat(point)));
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(linear);
    jacobian
        .fixed_view_mut::<3, 1>(0, 6)
        .copy_from(&(linear * point));
    jacobian
}
