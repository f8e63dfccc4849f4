//! What may differ between vehicles.

/// Runs a job that takes seconds where it delays no frame, usually on a thread of its own.
pub type Background = fn(Box<dyn FnOnce() + Send>);

/// Settings of [`crate::Vslam`]. The defaults suit all cameras; numbers in pixels scale with it.
#[derive(Clone, Debug)]
pub struct VslamSettings {
    /// Keypoints per frame; `None` chooses by the area of the image. 400 to 3000; more cost time,
    /// fewer lose track in blur and in rooms with little texture.
    pub feature_count: Option<usize>,
    /// One standard deviation of a keypoint on the finest level, in pixels of it, to which small
    /// images are enlarged. 0.5 to 1.5; smaller refuses good matches, larger lets wrong ones in.
    pub keypoint_sigma_px: f64,
    /// Keyframes up to which the whole map is adjusted after a loop was closed, maps were joined,
    /// or in the end; 0 for never, 100 to 2000. Without, a closed loop is bent less exactly.
    pub global_adjustment_keyframes_max: usize,
    /// Where such an adjustment runs. `None` lends it single frames, each of which then takes
    /// 0.1 ms longer per keyframe; the results are the same bit by bit.
    pub background: Option<Background>,
    /// Seed of all random choices.
    pub seed: u64,
}

impl Default for VslamSettings {
    fn default() -> Self {
        Self {
            feature_count: None,
            keypoint_sigma_px: 0.9,
            global_adjustment_keyframes_max: 1000,
            background: None,
            seed: 1,
        }
    }
}

/// Keypoints for an image of 640×480.
const REFERENCE_FEATURE_COUNT: f64 = 1000.0;

impl VslamSettings {
    /// Keypoints per frame for this camera: with the image's width times height, slower than that.
    pub(crate) fn feature_count_for(&self, camera: &camera::CameraModel) -> usize {
        self.feature_count.unwrap_or_else(|| {
            let area_ratio = (camera.width() * camera.height()) as f64 / (640.0 * 480.0);
            let count = REFERENCE_FEATURE_COUNT * area_ratio.sqrt();
            count.clamp(600.0, 2000.0) as usize
        })
    }
}
