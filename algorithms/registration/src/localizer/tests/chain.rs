//! Vehicles that are registered to the maps of others, and share theirs in turn.

use geometry::Enu;

use super::*;

/// The place of a flyer's own map, as it would tell others, moved to where the synthetic anchor
/// with its chunks has it.
fn told_by(provider: &Scene, told: Similarity<Enu, Map>) -> Matrix7 {
    let estimate = provider.estimate().unwrap();
    let told_from_own = told.inverse() * estimate.enu_from_map;
    let adjoint = told_from_own.adjoint();
    let covariance = adjoint * estimate.covariance * adjoint.transpose();
    (covariance + covariance.transpose()) * 0.5
}

fn sigma_where(scene: &Scene, camera: &Transform<Enu, Camera>) -> f64 {
    let estimate = scene.estimate().unwrap();
    let map_from_camera = estimate.enu_from_map.inverse().transform_pose(camera);
    let covariance = estimate.position_covariance(&map_from_camera, None);
    covariance.trace().sqrt()
}

/// Goal: what is told from one to the next grows less certain, and telling it again and again makes
/// it no more certain. Method: a chain of three behind an anchor; each tells the next where its map
/// stands, in three rounds while all fly on.
#[test]
fn a_chain_of_registered_maps_grows_less_certain_link_by_link() {
    let mut scenes: Vec<Scene> = (0..3).map(|link| scene(60 + link, 1.0)).collect();
    scenes[0].publish(&AnchorSettings::default());
    let mut told = Vec::new();
    for scene in &mut scenes[1..] {
        scene.publish(&AnchorSettings::default());
        let registered = Reference::Registered;
        scene
            .localizer
            .set_reference(AnchorIdx(0), OwnerIdx(0), registered);
        let anchor = &scene.localizer.anchors[&AnchorIdx(0)];
        told.push(
            anchor
                .landmarks
                .placement()
                .unwrap()
                .enu_from_map
                .relabel::<Enu, Map>(),
        );
    }
    let mut of_last = Vec::new();
    for round in 0..3_u64 {
        for link in 0..3 {
            if link > 0 {
                let covariance = told_by(&scenes[link - 1], told[link - 1]);
                let place = told[link - 1];
                scenes[link]
                    .localizer
                    .place_anchor(AnchorIdx(0), place, covariance, 2 + round);
            }
            for step in 0..12 {
                scenes[link].step(12 * round as usize + step);
            }
        }
        let camera = scenes[2].flyer.enu_from_camera;
        let sigmas: Vec<f64> = scenes
            .iter()
            .map(|scene| sigma_where(scene, &camera))
            .collect();
        println!("round {round}: {sigmas:.4?}");
        assert!(sigmas[0] < sigmas[1] && sigmas[1] < sigmas[2], "{sigmas:?}");
        of_last.push(sigmas[2]);
    }
    assert!(of_last[2] > 0.9 * of_last[0], "{of_last:?}");
}
