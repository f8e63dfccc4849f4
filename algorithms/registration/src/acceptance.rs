//! Whether an alignment is supported by the clouds, and in which directions it is not.

use geometry::{Matrix7, Similarity, Tangent7};
use nalgebra::{SMatrix, SymmetricEigen, Vector3};

use crate::alignment::{Metric, Quality, Refusal, Source, Target};
use crate::cloud::{ShapedCloud, to_single};
use crate::icp::{Icp, Pair, cost, overlap_of_target};
use crate::median::median;

/// Of the larger and of the smaller of the two overlaps.
const OVERLAP_MIN: (f64, f64) = (0.45, 0.25);
/// Partners are sought within this many spacings of the coarser cloud.
const PARTNER_SPACINGS: f64 = 2.5;
/// Root mean square distance from the surface, relative to how far partners are sought: a wrong
/// alignment of dense clouds pairs points at random and comes near 0.6.
const RESIDUAL_MAX: f64 = 0.35;
/// Fewer pairs with two normals say nothing of how normals agree.
const NORMAL_PAIR_COUNT_MIN: f64 = 20.0;
/// Mean cosine between the normals of pairs. Chance gives 0.5, and up to 0.71 after the iteration
/// has made the best of it, a box in a cloud of noise; surfaces whose noise equals the spacing of
/// their points still have 0.73.
const NORMAL_AGREEMENT_MIN: f64 = 0.72;
/// How far a shifted source is moved for comparison, in widths; partners are sought within one.
const SHIFT_WIDTHS: f64 = 2.0;
/// Below this contrast single points coincide, whatever their normals: noise against other noise
/// comes to 0.3 and more.
const CONTRAST_MAX_WITHOUT_NORMALS: f64 = 0.25;
/// Points that fall anywhere between others are about half of their spacing from the nearest.
const COINCIDENCE_SPACINGS_MAX: f64 = 0.4;
/// So many pairs tell how well the clouds agree.
const PAIR_COUNT_MAX: usize = 1500;
/// So many points tell the contrast.
const CONTRAST_POINT_COUNT: usize = 200;
/// A direction with less information per pair than this, relative to a pair that fixes it fully,
/// is not fixed. What normals of both clouds have in common, such as the rounding of an edge,
/// pretends 0.003.
const INFORMATION_MIN: f64 = 0.004;

/// Within this distance a pair is explained by how sparse the clouds are.
pub(crate) fn partner_distance(source: &ShapedCloud, target: &ShapedCloud, scale: f64) -> f64 {
    PARTNER_SPACINGS * (source.spacing * scale).max(target.spacing).max(1e-9)
}

/// Measures how well the clouds agree after the iteration.
pub(crate) fn measure(
    source: &ShapedCloud,
    target: &ShapedCloud,
    icp: &Icp,
    metric: Metric,
    with_scale: bool,
) -> Quality {
    let alignment = &icp.target_from_source;
    let width = partner_distance(source, target, alignment.scale());
    let mut pairing = icp.pairing.clone();
    pairing.keep_source_alone();
    pairing.renew(source, target, alignment, width);
    let pairs = &pairing.pairs;
    let mut distances: Vec<f32> = pairs.iter().map(|pair| pair.distance_squared).collect();
    let overlap_source = pairs.len() as f64 / source.points.len().max(1) as f64;
    let overlap_target = overlap_of_target(source, target, alignment, width);
    let stride = pairs.len().div_ceil(PAIR_COUNT_MAX).max(1);
    let pairs: Vec<Pair> = pairs.iter().copied().step_by(stride).collect();
    let squares = cost(source, target, alignment, &pairs, metric);
    let rotation = alignment.rotation().inverse();
    let mut surface_squares = 0.0;
    let mut surfaces = SurfaceInformation::default();
    let mut normals = NormalAgreement::default();
    for pair in &pairs {
        let point = source.points[pair.source_idx as usize];
        let residual = target.points[pair.target_idx as usize] - *alignment * point;
        let normal = target.shapes[pair.target_idx as usize].normal;
        let own_normal = source.shapes[pair.source_idx as usize].normal;
        surface_squares += match normal {
            Some(normal) => residual.dot(&normal).powi(2),
            None => residual.norm_squared(),
        };
        let normal = normal.map(|normal| rotation * normal);
        let lever = point / source.radius;
        surfaces.add([normal, own_normal], &lever);
        if let (Some(normal), Some(own_normal)) = (normal, own_normal) {
            normals.add(normal.dot(&own_normal));
        }
    }
    let pair_count = pairs.len().max(1) as f64;
    Quality {
        rmse_m: (squares / pair_count).sqrt(),
        distance_m_p50: median(&mut distances, f32::total_cmp)
            .map_or(0.0, f64::from)
            .sqrt(),
        surface_rmse_m: (surface_squares / pair_count).sqrt(),
        overlap_source,
        overlap_target,
        iteration_count: icp.iteration_count,
        normal_agreement: normals.mean(),
        residual_contrast: contrast(source, target, alignment, width),
        weak_directions: weak_directions(&surfaces.mean(), with_scale),
        evidence: None,
        likeness: None,
    }
}

/// The verdict over what was measured.
pub(crate) fn judge(
    source: &ShapedCloud,
    target: &ShapedCloud,
    icp: &Icp,
    quality: &Quality,
) -> Result<(), Refusal> {
    if icp.scale_bounded {
        return Err(Refusal::ScaleOutOfBounds {
            scale: icp.target_from_source.scale(),
        });
    }
    if !icp.converged {
        // What slides along a free direction does not come to rest.
        return Err(match quality.weak_directions.is_empty() {
            true => Refusal::NotConverged,
            false => Refusal::WeakGeometry {
                directions: quality.weak_directions.clone(),
            },
        });
    }
    // Which points are the same is known then, and how near the others come says little of maps
    // that hold other points of the same things.
    let is_told = quality.likeness.is_some_and(|it| it.tells_the_place());
    if !is_told {
        judge_surfaces(source, target, icp, quality)?;
    }
    if !quality.weak_directions.is_empty() {
        return Err(Refusal::WeakGeometry {
            directions: quality.weak_directions.clone(),
        });
    }
    Ok(())
}

/// Whether most of one cloud is near the other, on the same surfaces.
fn judge_surfaces(
    source: &ShapedCloud,
    target: &ShapedCloud,
    icp: &Icp,
    quality: &Quality,
) -> Result<(), Refusal> {
    let (more, less) = (
        quality.overlap_source.max(quality.overlap_target),
        quality.overlap_source.min(quality.overlap_target),
    );
    if more < OVERLAP_MIN.0 || less < OVERLAP_MIN.1 {
        return Err(Refusal::LittleOverlap {
            source: quality.overlap_source,
            target: quality.overlap_target,
        });
    }
    let distance = partner_distance(source, target, icp.target_from_source.scale());
    if quality.surface_rmse_m > RESIDUAL_MAX * distance {
        return Err(Refusal::LargeResidual {
            rmse_m: quality.surface_rmse_m,
        });
    }
    let normals_agree = quality
        .normal_agreement
        .is_some_and(|agreement| agreement > NORMAL_AGREEMENT_MIN);
    let coincide = quality.residual_contrast < CONTRAST_MAX_WITHOUT_NORMALS
        && quality.distance_m_p50 < COINCIDENCE_SPACINGS_MAX * target.spacing;
    if !normals_agree && !coincide {
        return Err(Refusal::SurfacesDisagree {
            normal_agreement: quality.normal_agreement,
        });
    }
    Ok(())
}

/// The information of pairs when only the distance to the surface counts, with the rotation and
/// the scale acting on the cloud's radius.
#[derive(Clone, Debug, Default)]
struct SurfaceInformation {
    of_surfaces: Matrix7,
    of_others: Matrix7,
    surface_count: f64,
    other_count: f64,
}

impl SurfaceInformation {
    /// The product of what the two normals say: errors that they do not share cancel out, where
    /// the square of one would take its error for information.
    ///
    /// - `normals`: of both points, in the source's axes.
    fn add(&mut self, normals: [Option<Vector3<f64>>; 2], lever: &Vector3<f64>) {
        match normals {
            [Some(first), Some(second)] => {
                let [first, second] = [first, second * first.dot(&second).signum()]
                    .map(|normal| along(&normal, lever));
                let product = first * second.transpose();
                self.of_surfaces += (product + product.transpose()) * 0.5;
                self.surface_count += 1.0;
            }
            [None, None] => {
                let axes = (0..3).map(|axis| along(&Vector3::ith(axis, 1.0), lever));
                self.of_others += axes.map(|axis| axis * axis.transpose()).sum::<Matrix7>();
                self.other_count += 1.0;
            }
            // The edge of a surface, which one cloud shows and the other does not.
            _ => {}
        }
    }

    /// Per pair. Points without a surface are mostly those at edges, which slide along them; only
    /// where much of the cloud is such do they tell what its surfaces leave free.
    fn mean(&self) -> Matrix7 {
        let count = (self.surface_count + self.other_count).max(1.0);
        (self.of_surfaces + self.of_others * (self.other_count / count)) / count
    }
}

fn along(direction: &Vector3<f64>, lever: &Vector3<f64>) -> Tangent7 {
    let mut column = Tangent7::zeros();
    column
        .fixed_rows_mut::<3>(0)
        .copy_from(&lever.cross(direction));
    column.fixed_rows_mut::<3>(3).copy_from(direction);
    column[6] = lever.dot(direction);
    column
}

/// How well the normals of pairs agree, where both have one.
#[derive(Clone, Copy, Debug, Default)]
struct NormalAgreement {
    sum: f64,
    count: f64,
}

impl NormalAgreement {
    fn add(&mut self, cosine: f64) {
        self.sum += cosine.abs();
        self.count += 1.0;
    }

    /// `None` where hardly any pair has two normals.
    fn mean(&self) -> Option<f64> {
        (self.count >= NORMAL_PAIR_COUNT_MIN).then(|| self.sum / self.count)
    }
}

/// How far the source is from the target, relative to how far it is when shifted by
/// `SHIFT_WIDTHS` widths: near zero where the clouds fit, near one where any other place would do
/// as well.
fn contrast(
    source: &ShapedCloud,
    target: &ShapedCloud,
    target_from_source: &Similarity<Target, Source>,
    width: f64,
) -> f64 {
    let distance = SHIFT_WIDTHS * width;
    let shifted = (0..6).map(|idx| {
        let shift = Vector3::ith(idx / 2, if idx % 2 == 0 { distance } else { -distance });
        capped_squares(source, target, target_from_source, &shift, width)
    });
    let elsewhere = shifted.sum::<f64>() / 6.0;
    if elsewhere <= 0.0 {
        // A cloud that fills space fits wherever it is moved.
        return 1.0;
    }
    capped_squares(source, target, target_from_source, &Vector3::zeros(), width) / elsewhere
}

/// Squared distances of the shifted source points from the target, added up; a point without a
/// partner counts with the square of the width.
fn capped_squares(
    source: &ShapedCloud,
    target: &ShapedCloud,
    target_from_source: &Similarity<Target, Source>,
    shift: &Vector3<f64>,
    width: f64,
) -> f64 {
    let limit = (width * width) as f32;
    let stride = source.points.len().div_ceil(CONTRAST_POINT_COUNT).max(1);
    let squares = source.points.iter().step_by(stride).map(|point| {
        let moved = *target_from_source * *point + shift;
        let found = target.tree.nearest(to_single(&moved), limit);
        f64::from(found.map_or(limit, |found| found.distance_squared))
    });
    squares.sum()
}

/// The directions that the surfaces of one cloud leave free, in words.
fn weak_directions(information: &Matrix7, with_scale: bool) -> Vec<String> {
    let mut information = *information;
    if !with_scale {
        // A scale that is fixed is known.
        information.fixed_view_mut::<1, 6>(6, 0).fill(0.0);
        information.fixed_view_mut::<6, 1>(0, 6).fill(0.0);
        information[(6, 6)] = 1.0;
    }
    let eigen = SymmetricEigen::new(information);
    let weak = (0..7).filter(|idx| eigen.eigenvalues[*idx] < INFORMATION_MIN);
    let mut named: Vec<String> = weak
        .map(|idx| name_direction(&eigen.eigenvectors.column(idx).into_owned()))
        .collect();
    named.sort();
    named
}

fn name_direction(direction: &SMatrix<f64, 7, 1>) -> String {
    let rotation = direction.fixed_rows::<3>(0).into_owned();
    let translation = direction.fixed_rows::<3>(3).into_owned();
    let scale = direction[6].abs();
    let (kind, axis) = if scale > rotation.norm() && scale > translation.norm() {
        return "scale".to_owned();
    } else if rotation.norm() > translation.norm() {
        ("rotation about", rotation)
    } else {
        ("translation along", translation)
    };
    let largest = axis.iamax();
    let axis = axis.normalize() * axis[largest].signum();
    // Adding zero turns −0 into 0.
    let [x, y, z] = std::array::from_fn(|idx| (axis[idx] * 100.0).round() / 100.0 + 0.0);
    format!("{kind} ({x:.2}, {y:.2}, {z:.2})")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Cloud;

    /// A lattice that is as wide as a shift is the same after it.
    #[test]
    fn what_fits_wherever_it_is_moved_has_no_contrast() {
        let width = 1.0;
        let lattice =
            (0..27).map(|idx| Vector3::from([idx % 3, idx / 3 % 3, idx / 9].map(f64::from)));
        let target: Vec<_> = lattice.map(|point| point * SHIFT_WIDTHS * width).collect();
        let target = ShapedCloud::new(&Cloud::from_points(target), None);
        let source = ShapedCloud::new(&Cloud::from_points(vec![Vector3::zeros()]), None);
        assert_eq!(
            contrast(&source, &target, &Similarity::identity(), width),
            1.0
        );
    }
}
