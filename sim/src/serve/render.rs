//! The thread that renders what is flown.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender};

use camera::Image;

use crate::renderer::Renderer;
use crate::route::Motion;
use crate::scenario::Scenario;

/// One frame of every vehicle.
pub struct Request {
    pub frame_idx: usize,
    /// How each vehicle moves at that frame.
    pub motions: Vec<Motion>,
    /// Whose frames somebody wants.
    pub wanted: Vec<bool>,
}

/// Paints the scene, then renders what is requested until nobody can request any more. At most
/// one request waits, because the next frame is asked for when the last one is sent.
pub fn render_all(
    scenario: &Scenario,
    requests: Receiver<Request>,
    frames: SyncSender<Vec<Option<Image>>>,
) {
    let scene = Arc::new(scenario.paint());
    let mut renderers: Vec<Renderer> = scenario
        .vehicles
        .iter()
        .map(|vehicle| {
            let camera = &vehicle.description.camera;
            Renderer::new(Arc::clone(&scene), camera, vehicle.sensor)
        })
        .collect();
    for request in requests {
        let Request {
            frame_idx,
            motions,
            wanted,
        } = request;
        let render = |(vehicle_idx, renderer): (usize, &mut Renderer)| {
            let shot = scenario.shot_in_motion(vehicle_idx, frame_idx, &motions[vehicle_idx]);
            let neighbours = scenario.neighbours(vehicle_idx, &motions);
            wanted[vehicle_idx].then(|| renderer.render_among(&shot, &neighbours))
        };
        let images = renderers.iter_mut().enumerate().map(render).collect();
        if frames.send(images).is_err() {
            return;
        }
    }
}
