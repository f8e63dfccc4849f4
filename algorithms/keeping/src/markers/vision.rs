//! Marker vision of a vehicle: each of its cameras finds and follows pairs for itself.

use camera::Image;
use geometry::Timestamp;

use super::finder::{FinderSettings, FramePairs, PairFinder};
use super::tracker::{EgoMotion, MarkerTrack, MarkerTracker, TrackerSettings};

/// One camera's finder and tracker.
#[derive(Clone, Debug)]
pub struct CameraMarkers {
    finder: PairFinder,
    tracker: MarkerTracker,
}

/// All cameras of a vehicle, by number. Tracks are named by camera and [`super::TrackId`]; the same
/// neighbour in two cameras is two tracks, which the rule joins by their bearings.
#[derive(Clone, Debug)]
pub struct MarkerVision {
    cameras: Vec<CameraMarkers>,
}

impl CameraMarkers {
    pub fn new(finder: FinderSettings, tracker: TrackerSettings, width_max_px: usize) -> Self {
        Self {
            finder: PairFinder::new(finder, width_max_px),
            tracker: MarkerTracker::new(tracker),
        }
    }

    /// Turns the expected baseline, as the camera rolls.
    pub fn expect_baseline(&mut self, baseline_rad: f64) {
        self.finder.expect_baseline(baseline_rad);
    }

    /// What the next image shows, and what is known after it.
    pub fn see(
        &mut self,
        image: &Image,
        captured_at: Timestamp,
        ego: Option<&EgoMotion>,
    ) -> (FramePairs<'_>, &[MarkerTrack]) {
        let frame = self.finder.find(image);
        let tracks = self.tracker.update(&frame, captured_at, ego);
        (frame, tracks)
    }

    /// All tracks as of the last image.
    pub fn tracks(&self) -> &[MarkerTrack] {
        self.tracker.tracks()
    }
}

impl MarkerVision {
    pub fn new(cameras: Vec<CameraMarkers>) -> Self {
        Self { cameras }
    }

    /// The camera with this number, or `None` if there are fewer.
    pub fn camera(&mut self, camera_idx: usize) -> Option<&mut CameraMarkers> {
        self.cameras.get_mut(camera_idx)
    }

    /// Every track of every camera, with the camera's number.
    pub fn tracks(&self) -> impl Iterator<Item = (usize, &MarkerTrack)> {
        let cameras = self.cameras.iter().enumerate();
        cameras.flat_map(|(idx, camera)| camera.tracks().iter().map(move |track| (idx, track)))
    }
}

#[cfg(test)]
mod tests {
    use sim::marker_light::MarkerScene;

    use super::*;

    /// Goal: each camera follows its own pairs. Method: only the second of two sees any.
    #[test]
    fn tracks_carry_the_number_of_their_camera() {
        let settings = (FinderSettings::default(), TrackerSettings::default());
        let camera = CameraMarkers::new(settings.0, settings.1, 324);
        let mut vision = MarkerVision::new(vec![camera.clone(), camera]);
        let lab = MarkerScene::lab();
        for idx in 0..3 {
            let captured_at = Timestamp::from_nanoseconds(50_000_000 * idx);
            for (camera_idx, scene) in [lab.without_pairs(), lab.clone()].iter().enumerate() {
                let camera = vision.camera(camera_idx).unwrap();
                camera.see(&scene.draw(3).image, captured_at, None);
            }
        }
        let cameras: Vec<usize> = vision.tracks().map(|(camera_idx, _)| camera_idx).collect();
        assert_eq!(cameras, [1]);
        assert!(vision.tracks().all(|(_, track)| track.is_confirmed()));
        assert!(vision.camera(2).is_none());
    }
}
