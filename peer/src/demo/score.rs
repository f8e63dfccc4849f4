//! What the flight was worth: read from the files after everybody has ended.

use std::path::Path;

use geometry::Enu;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use sim::ScenarioName;

use crate::config::KeepingConfig;
use crate::evaluate::{BaselineSettings, SwarmScore, VehicleRecord, VehicleScore, judge};
use crate::files::{StampedPose, read_cloud, read_covariances, read_tum};
use crate::plot::Realignment;
use crate::process::VehicleSummary;

/// Judges a vehicle by the files in `folder`, the truth among them.
pub fn score(folder: &Path, summary: &VehicleSummary, seed: u64) -> anyhow::Result<VehicleScore> {
    let path = |suffix: &str| folder.join(format!("{}.{suffix}", summary.id));
    let truth = read_tum(&path("truth.tum"))?;
    let causal = read_tum(&path("tum"))?;
    let covariances = read_covariances(&path("cov.csv"))?;
    let covariances: Vec<Matrix3<f64>> = covariances.into_iter().map(|(_, one)| one).collect();
    let corrected = read_tum(&path("final.tum"))?;
    let own = read_tum(&path("own.tum"))?;
    let record = VehicleRecord {
        truth: &truth,
        causal: &causal,
        covariances: &covariances,
        corrected: &corrected,
        own: &own,
        frame_count: usize::try_from(summary.frame_count).unwrap_or(usize::MAX),
    };
    let settings = BaselineSettings {
        seed,
        ..BaselineSettings::default()
    };
    Ok(judge(&record, &settings))
}

/// How the vehicles that carry lights held together.
pub fn swarm(
    scenario: ScenarioName,
    folder: &Path,
    summaries: &[VehicleSummary],
) -> anyhow::Result<SwarmScore> {
    let mut truths = Vec::new();
    let mut place_m = None;
    for vehicle in scenario.vehicles() {
        let Some(lights) = vehicle.lights else {
            continue;
        };
        truths.push(read_tum(&folder.join(format!("{}.truth.tum", vehicle.id)))?);
        if vehicle.keeps_place {
            let separation_px = KeepingConfig::default().separation_px;
            place_m = Some(vehicle.camera.intrinsics().fy * lights.length_m / separation_px);
        }
    }
    let followers = || {
        summaries
            .iter()
            .filter_map(|summary| summary.keeping.as_ref())
    };
    let frame_count: u64 = followers().map(|keeping| keeping.frame_count).sum();
    let seen_count: u64 = followers().map(|keeping| keeping.seen_count).sum();
    let seen_share = (frame_count > 0).then(|| seen_count as f64 / frame_count as f64);
    Ok(SwarmScore {
        place_m,
        ..SwarmScore::of(&truths, seen_share)
    })
}

/// Before and after registration, in the manner of the paper's Fig. 10. Before is the rough start
/// that the ratio is measured against: half a metre, 15° and a scale of 1.1 off.
pub fn realignment(folder: &Path, anchor: &str, peer: &str) -> anyhow::Result<Realignment> {
    let path = |id: &str, suffix: &str| folder.join(format!("{id}.{suffix}"));
    let cloud = |path: &Path| -> anyhow::Result<Vec<Vector3<f64>>> {
        // A vehicle that never found itself has an empty map, which the reader refuses.
        Ok(read_cloud(path)
            .map(|cloud| cloud.points)
            .unwrap_or_default())
    };
    let corrected: Vec<StampedPose<Enu>> = read_tum(&path(peer, "final.tum"))?;
    let truth: Vec<StampedPose<Enu>> = read_tum(&path(peer, "truth.tum"))?;
    let path_after = positions(&corrected);
    let cloud_after = cloud(&path(peer, "map.ply"))?;
    let start = path_after.first().copied().unwrap_or_default();
    let rough =
        |points: &[Vector3<f64>]| points.iter().map(|point| roughly(point, &start)).collect();
    Ok(Realignment {
        vehicle: peer.to_owned(),
        anchor_cloud: cloud(&path(anchor, "map.ply"))?,
        cloud_before: rough(&cloud_after),
        path_before: rough(&path_after),
        cloud_after,
        path_after,
        truth: positions(&truth),
    })
}

fn roughly(point: &Vector3<f64>, start: &Vector3<f64>) -> Vector3<f64> {
    let settings = BaselineSettings::default();
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), settings.turn_rad);
    let offset = Vector3::new(0.6, 0.8, 0.0) * settings.offset_m;
    start + turn * (point - start) * settings.scale_factor + offset
}

fn positions(poses: &[StampedPose<Enu>]) -> Vec<Vector3<f64>> {
    let positions = poses.iter();
    positions
        .map(|pose| *pose.target_from_camera.translation())
        .collect()
}
