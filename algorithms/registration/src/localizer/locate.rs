//! One image among the landmarks of one anchor.

use geometry::absolute_pose::{
    PointObservation, RansacSettings, RefineSettings, RefinedPose, ransac_absolute_pose,
    refine_absolute_pose,
};
use geometry::{Camera, Chunk, Map, Matrix7, Similarity, Tangent7, Transform};
use nalgebra::{Matrix2, Vector2, Vector6};
use rand_chacha::ChaCha8Rng;

use super::image_grid::ImageGrid;
use super::landmarks::{AnchorLandmarks, AnchorMap};
use super::matching::{FeatureIndex, LandmarkMatch, match_predicted, search};
use super::types::{ChunkIdx, LocalizerSettings, ObservedFeature, Refusal};

/// A camera in a chunk of an anchor, with the scale between the maps.
#[derive(Clone, Debug)]
pub(super) struct Located {
    /// The chunk that most of the landmarks belong to.
    pub chunk: ChunkIdx,
    /// From the camera's axes, in the own map's unit, to the chunk.
    pub chunk_from_camera: Similarity<Chunk, Camera>,
    /// Over `[ω; ν; ln s]`, right perturbation, but ν in the chunk's unit.
    pub covariance: Matrix7,
    /// Whether the scale was measured; otherwise it is one and means nothing.
    pub scale_known: bool,
    /// Median depth of the landmarks, in the chunk's unit.
    pub depth: f64,
    pub inlier_count: usize,
}

/// Where to look.
pub(super) enum Hint {
    /// Everywhere; begins with this chunk.
    Nowhere { cursor: ChunkIdx },
    /// Near a predicted pose.
    Predicted {
        camera_from_anchor: Transform<Camera, AnchorMap>,
        /// How far a landmark may be from where it is expected, on the ideal plane.
        radius: f64,
    },
}

/// Counts on the way, whatever the end.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Effort {
    pub chunk_count: usize,
    pub candidate_count: usize,
    pub match_count: usize,
    pub inlier_count: usize,
}

/// Everything about an image and an anchor that locating needs.
pub(super) struct Attempt<'a> {
    pub observed: &'a [ObservedFeature],
    pub features: &'a FeatureIndex,
    /// In the own map, if there is one: then the scale between the maps can be measured.
    pub map_from_camera: Option<Transform<Map, Camera>>,
    pub anchor: &'a AnchorLandmarks,
    pub settings: &'a LocalizerSettings,
}

impl Attempt<'_> {
    /// Finds the camera; `hint` is moved on where it is a cursor.
    pub fn locate(
        &self,
        hint: &mut Hint,
        effort: &mut Effort,
        rng: &mut ChaCha8Rng,
    ) -> Result<Located, Refusal> {
        let start = match hint {
            Hint::Nowhere { cursor } => self.find(cursor, effort, rng)?,
            Hint::Predicted {
                camera_from_anchor,
                radius,
            } => self.find_near(camera_from_anchor, *radius, effort, rng)?,
        };
        self.refine(&start, effort)
    }

    fn find(
        &self,
        cursor: &mut ChunkIdx,
        effort: &mut Effort,
        rng: &mut ChaCha8Rng,
    ) -> Result<Transform<Camera, AnchorMap>, Refusal> {
        let matches = search(self.features, self.anchor, self.settings, cursor);
        effort.chunk_count += matches.chunk_count;
        effort.candidate_count += matches.candidate_count;
        effort.match_count = matches.list.len();
        let observations = self.loose_observations(&matches.list);
        let settings = RansacSettings {
            iteration_count_max: self.settings.search_iteration_count_max,
            inlier_count_min: self.settings.search_inlier_count_min,
            ..RansacSettings::default()
        };
        if observations.len() < settings.inlier_count_min {
            return Err(Refusal::TooFewMatches);
        }
        let best = ransac_absolute_pose::<AnchorMap>(&observations, &settings, rng)
            .map_err(|_| Refusal::NoConsensus)?;
        effort.inlier_count = best.inlier_count;
        let rest: Vec<PointObservation> = observations
            .iter()
            .zip(&best.inliers)
            .filter_map(|(observation, inlier)| (!inlier).then_some(*observation))
            .collect();
        let rival_count_min =
            (best.inlier_count as f64 * self.settings.rival_share_max).ceil() as usize;
        let rival_settings = RansacSettings {
            inlier_count_min: rival_count_min.max(8),
            iteration_count_max: settings.iteration_count_max / 2,
            ..settings
        };
        let rival = ransac_absolute_pose::<AnchorMap>(&rest, &rival_settings, rng);
        if let Ok(rival) = rival
            && !is_same_place(
                &best.camera_from_world,
                &rival.camera_from_world,
                &matches.list,
            )
        {
            return Err(Refusal::Ambiguous);
        }
        Ok(best.camera_from_world)
    }

    fn find_near(
        &self,
        predicted: &Transform<Camera, AnchorMap>,
        radius: f64,
        effort: &mut Effort,
        rng: &mut ChaCha8Rng,
    ) -> Result<Transform<Camera, AnchorMap>, Refusal> {
        let matches = match_predicted(self.features, self.anchor, predicted, radius, self.settings);
        effort.chunk_count += matches.chunk_count;
        effort.candidate_count += matches.candidate_count;
        effort.match_count = matches.list.len();
        let required = self.settings.inlier_count_min;
        if matches.candidate_count < required {
            return Err(Refusal::NothingInView);
        }
        if matches.list.len() < required {
            return Err(Refusal::TooFewMatches);
        }
        let observations = self.loose_observations(&matches.list);
        let settings = RansacSettings {
            iteration_count_max: self.settings.predicted_iteration_count_max,
            inlier_count_min: required,
            ..RansacSettings::default()
        };
        let best = ransac_absolute_pose::<AnchorMap>(&observations, &settings, rng)
            .map_err(|_| Refusal::NoConsensus)?;
        effort.inlier_count = best.inlier_count;
        Ok(best.camera_from_world)
    }

    /// Observations before a pose is known: landmark errors count as a constant share.
    fn loose_observations(&self, matches: &[LandmarkMatch]) -> Vec<PointObservation> {
        let slack_squared = self.settings.search_slack.powi(2);
        let observe = |one: &LandmarkMatch| {
            let feature = &self.observed[one.feature_idx];
            PointObservation {
                point_in_world: one.landmark.point,
                position: feature.position,
                sigma: (feature.sigma * feature.sigma + slack_squared).sqrt(),
                blur: Vector2::zeros(),
            }
        };
        matches.iter().map(observe).collect()
    }

    /// Matches anew around the pose, refines it on all that fits, and adds the scale.
    fn refine(
        &self,
        start: &Transform<Camera, AnchorMap>,
        effort: &mut Effort,
    ) -> Result<Located, Refusal> {
        let settings = self.settings;
        let mut pose = *start;
        let mut result = None;
        for radius in [2.0 * settings.refine_radius, settings.refine_radius] {
            let matches = match_predicted(self.features, self.anchor, &pose, radius, settings);
            effort.chunk_count += matches.chunk_count;
            effort.candidate_count += matches.candidate_count;
            let matches = matches.list;
            let observations = self.exact_observations(&matches, &pose);
            let refined = refine_absolute_pose(&pose, &observations, &RefineSettings::default())
                .map_err(|_| Refusal::NoConsensus)?;
            pose = refined.camera_from_world;
            result = Some((matches, refined));
        }
        let (mut matches, refined) = result.ok_or(Refusal::NoConsensus)?;
        let mut inliers = refined.inliers.iter();
        matches.retain(|_| *inliers.next().expect("one flag for each observation"));
        effort.match_count = effort.match_count.max(refined.inliers.len());
        effort.inlier_count = matches.len();
        if matches.len() < settings.inlier_count_min {
            return Err(Refusal::TooFewInliers);
        }
        let inlier_share = matches.len() as f64 / refined.inliers.len() as f64;
        if inlier_share < settings.inlier_share_min {
            return Err(Refusal::NoConsensus);
        }
        // Single frames are believed only when several agree and show what should be in view.
        let is_keyframe = self.map_from_camera.is_some();
        if self.occupied_cell_count(&matches) < settings.occupied_cell_count_min
            || (is_keyframe && self.breadth(&matches) < settings.inlier_breadth_min)
        {
            return Err(Refusal::InliersClustered);
        }
        self.conclude(&matches, &refined)
    }

    /// Observations around a known pose: each landmark's covariance as the camera sees it.
    fn exact_observations(
        &self,
        matches: &[LandmarkMatch],
        camera_from_anchor: &Transform<Camera, AnchorMap>,
    ) -> Vec<PointObservation> {
        let rotation = camera_from_anchor.rotation_matrix();
        let observe = |one: &LandmarkMatch| {
            let feature = &self.observed[one.feature_idx];
            let point = *camera_from_anchor * one.landmark.point;
            let position = point.xy() / point.z;
            let in_camera = rotation * one.landmark.covariance * rotation.transpose();
            let across = |axis: usize| {
                // d(x/z) = (dx − (x/z) dz) / z.
                let mixed = in_camera[(axis, axis)] - 2.0 * position[axis] * in_camera[(axis, 2)]
                    + position[axis] * position[axis] * in_camera[(2, 2)];
                mixed.max(0.0) / (point.z * point.z)
            };
            let variance = feature.sigma * feature.sigma + 0.5 * (across(0) + across(1));
            PointObservation {
                point_in_world: one.landmark.point,
                position: feature.position,
                sigma: variance.sqrt(),
                blur: Vector2::zeros(),
            }
        };
        matches.iter().map(observe).collect()
    }

    /// In how many cells of a 4×4 grid over the image there are inliers.
    fn occupied_cell_count(&self, inliers: &[LandmarkMatch]) -> usize {
        let grid = ImageGrid::new(self.features.bounds(), [4, 4]);
        let mut occupied = vec![false; grid.cell_count()];
        for one in inliers {
            occupied[grid.cell(&self.observed[one.feature_idx].position)] = true;
        }
        occupied.iter().filter(|one| **one).count()
    }

    /// How broad the inliers lie in the image in the direction in which they lie narrowest: the
    /// standard deviation, in widths and heights of the image.
    fn breadth(&self, inliers: &[LandmarkMatch]) -> f64 {
        let (lowest, highest) = self.features.bounds();
        let extent = (highest - lowest).map(|length| length.max(1e-9));
        let places = inliers.iter().map(|one| {
            let position = self.observed[one.feature_idx].position;
            (position - lowest).component_div(&extent)
        });
        let count = inliers.len().max(1) as f64;
        let mean = places.clone().sum::<Vector2<f64>>() / count;
        let spread: Matrix2<f64> = places
            .map(|place| (place - mean) * (place - mean).transpose())
            .sum();
        (spread / count)
            .symmetric_eigenvalues()
            .min()
            .max(0.0)
            .sqrt()
    }

    fn conclude(
        &self,
        inliers: &[LandmarkMatch],
        refined: &RefinedPose<AnchorMap>,
    ) -> Result<Located, Refusal> {
        let camera_from_anchor = &refined.camera_from_world;
        let mut depths: Vec<f64> = inliers
            .iter()
            .map(|one| (*camera_from_anchor * one.landmark.point).z)
            .collect();
        depths.sort_by(f64::total_cmp);
        let depth = depths[depths.len() / 2];
        let scale = self.measure_scale(inliers, camera_from_anchor);

        let pose_covariance = refined.world_from_camera_covariance;
        let mut covariance = Matrix7::zeros();
        covariance
            .fixed_view_mut::<6, 6>(0, 0)
            .copy_from(&pose_covariance);
        if let Some(scale) = &scale {
            let cross = pose_covariance * scale.d_log_scale_d_pose;
            covariance.fixed_view_mut::<6, 1>(0, 6).copy_from(&cross);
            covariance
                .fixed_view_mut::<1, 6>(6, 0)
                .copy_from(&cross.transpose());
            covariance[(6, 6)] = scale.variance + cross.dot(&scale.d_log_scale_d_pose);
        }
        let chunk = most_frequent_chunk(inliers);
        let map_from_chunk = self
            .anchor
            .map_from_chunk(chunk)
            .expect("inliers come from placed chunks");
        let scale_value = scale.as_ref().map_or(1.0, |scale| scale.log_scale.exp());
        let anchor_from_camera = camera_from_anchor.inverse();
        let scaled = Similarity::<AnchorMap, Camera>::new(
            scale_value,
            *anchor_from_camera.rotation(),
            *anchor_from_camera.translation(),
        );
        // From the anchor map's unit to the chunk's, which differ only after loop closures.
        let mut to_chunk_unit = Tangent7::repeat(1.0);
        to_chunk_unit
            .fixed_rows_mut::<3>(3)
            .fill(1.0 / map_from_chunk.scale());
        Ok(Located {
            chunk,
            chunk_from_camera: map_from_chunk.inverse() * scaled,
            covariance: covariance.component_mul(&(to_chunk_unit * to_chunk_unit.transpose())),
            scale_known: scale.is_some(),
            depth: depth / map_from_chunk.scale(),
            inlier_count: inliers.len(),
        })
    }

    /// The anchor map's unit in the own map's, from points whose depth both know.
    fn measure_scale(
        &self,
        inliers: &[LandmarkMatch],
        camera_from_anchor: &Transform<Camera, AnchorMap>,
    ) -> Option<MeasuredScale> {
        let camera_from_map = self.map_from_camera?.inverse();
        let rotation_from_map = camera_from_map.rotation_matrix();
        let rotation_from_anchor = camera_from_anchor.rotation_matrix();
        let mut pairs: Vec<DepthPair> = Vec::new();
        for one in inliers {
            let Some(own) = &self.observed[one.feature_idx].point else {
                continue;
            };
            let landmark = *camera_from_anchor * one.landmark.point;
            let own_depth = (camera_from_map * own.point_in_map).z;
            let axis = rotation_from_map.row(2);
            let own_variance = (axis * own.covariance_in_map * axis.transpose())[(0, 0)];
            let axis = rotation_from_anchor.row(2);
            let variance = (axis * one.landmark.covariance * axis.transpose())[(0, 0)];
            let log_ratio = (landmark.z / own_depth).ln();
            let variance = own_variance / (own_depth * own_depth)
                + variance / (landmark.z * landmark.z)
                + self.settings.depth_ratio_sigma_min.powi(2);
            if own_depth > 0.0 && log_ratio.is_finite() && variance.is_finite() && variance > 0.0 {
                let (x, y, z) = (landmark.x, landmark.y, landmark.z);
                pairs.push(DepthPair {
                    log_ratio,
                    variance,
                    // World_from_camera * exp([ω; ν]) moves the point by −ω × X − ν.
                    d_log_ratio_d_pose: Vector6::new(-y, x, 0.0, 0.0, 0.0, -1.0) / z,
                });
            }
        }
        (pairs.len() >= self.settings.depth_pair_count_min).then(|| average_scale(&mut pairs))
    }
}

struct DepthPair {
    log_ratio: f64,
    variance: f64,
    d_log_ratio_d_pose: Vector6<f64>,
}

struct MeasuredScale {
    log_scale: f64,
    /// Without the part that comes from the pose.
    variance: f64,
    d_log_scale_d_pose: Vector6<f64>,
}

/// The robust mean of the logarithms of the depth ratios, from the median on.
fn average_scale(pairs: &mut [DepthPair]) -> MeasuredScale {
    pairs.sort_by(|a, b| a.log_ratio.total_cmp(&b.log_ratio));
    let mut log_scale = pairs[pairs.len() / 2].log_ratio;
    let mut result = MeasuredScale {
        log_scale,
        variance: 1.0,
        d_log_scale_d_pose: Vector6::zeros(),
    };
    let kernel = geometry::RobustKernel::GemanMcClure { threshold: 3.0 };
    for _ in 0..6 {
        let mut weight_sum = 0.0;
        let mut weighted = 0.0;
        let mut derivative = Vector6::zeros();
        let mut cost = 0.0;
        for pair in pairs.iter() {
            let squared = (pair.log_ratio - log_scale).powi(2) / pair.variance;
            let weight = kernel.weight(squared) / pair.variance;
            weight_sum += weight;
            weighted += weight * pair.log_ratio;
            derivative += pair.d_log_ratio_d_pose * weight;
            cost += kernel.weight(squared) * squared;
        }
        log_scale = weighted / weight_sum;
        // The scatter says whether the variances are too small.
        let excess = (cost / pairs.len() as f64).max(1.0);
        result = MeasuredScale {
            log_scale,
            variance: excess / weight_sum,
            d_log_scale_d_pose: derivative / weight_sum,
        };
    }
    result
}

fn most_frequent_chunk(inliers: &[LandmarkMatch]) -> ChunkIdx {
    let mut chunks: Vec<ChunkIdx> = inliers.iter().map(|one| one.chunk).collect();
    chunks.sort_unstable();
    let longest = chunks.chunk_by(|a, b| a == b).max_by_key(|run| run.len());
    longest.expect("there are inliers")[0]
}

/// Whether two poses differ by less than a few degrees and a share of the depth.
fn is_same_place(
    first: &Transform<Camera, AnchorMap>,
    second: &Transform<Camera, AnchorMap>,
    matches: &[LandmarkMatch],
) -> bool {
    let mut depths: Vec<f64> = matches
        .iter()
        .map(|one| (*first * one.landmark.point).z)
        .filter(|depth| *depth > 0.0)
        .collect();
    depths.sort_by(f64::total_cmp);
    let depth = depths.get(depths.len() / 2).copied().unwrap_or(0.0);
    let between = first.inverse().translation() - second.inverse().translation();
    first.rotation().angle_to(second.rotation()) < 0.15 && between.norm() < 0.15 * depth
}
