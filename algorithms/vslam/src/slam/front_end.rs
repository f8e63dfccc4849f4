//! From an image to what can be tracked; needs no map.

use camera::{CameraModel, Image};
use features::{Extractor, ExtractorSettings, Features};
use geometry::Timestamp;

use crate::frame::Frame;
use crate::look::Look;
use crate::optics::{LEVEL_FACTOR, Optics};
use crate::{FrameRefusal, Observation, VslamSettings};

/// Finds the keypoints of images.
///
/// It knows nothing of the images before and of no map: a thread of its own may extract the next
/// frame while [`crate::Vslam`] still works on the last one.
#[derive(Clone, Debug)]
pub struct FrontEnd {
    optics: Optics,
    extractor: Extractor,
    features: Features,
}

/// An image's keypoints, to be given to [`crate::Vslam::track`] of the same camera.
#[derive(Clone, Debug)]
pub struct ExtractedFrame {
    pub(crate) captured_at: Timestamp,
    pub(crate) look: Look,
    pub(crate) content: Result<Frame, FrameRefusal>,
}

impl FrontEnd {
    pub fn new(camera: CameraModel, settings: &VslamSettings) -> Self {
        let feature_count = settings.feature_count_for(&camera);
        let optics = Optics::new(camera, settings.keypoint_sigma_px);
        let extractor = Extractor::new(ExtractorSettings {
            feature_count,
            level_count: optics.level_count,
            scale_factor: LEVEL_FACTOR,
            finest_scale: optics.finest_scale,
            ..ExtractorSettings::default()
        });
        Self {
            optics,
            extractor,
            features: Features::default(),
        }
    }

    /// Looks at an image. One of another size than the camera's is refused when it is tracked.
    pub fn extract(&mut self, image: &Image, captured_at: Timestamp) -> ExtractedFrame {
        let content = match self.refusal(image) {
            Some(refusal) => Err(refusal),
            None => {
                self.extractor.extract(image, &mut self.features);
                Ok(Frame::new(&self.optics, &self.features, captured_at))
            }
        };
        ExtractedFrame {
            captured_at,
            look: Look::of(image),
            content,
        }
    }

    fn refusal(&self, image: &Image) -> Option<FrameRefusal> {
        let got = (image.width(), image.height());
        let expected = (self.optics.camera.width(), self.optics.camera.height());
        (got != expected).then_some(FrameRefusal::ImageSize { got, expected })
    }
}

impl ExtractedFrame {
    pub fn captured_at(&self) -> Timestamp {
        self.captured_at
    }

    /// The keypoints; none of a frame that will be refused.
    pub fn observations(&self) -> &[Observation] {
        let content = self.content.as_ref();
        content.map_or(&[], |frame| &frame.observations)
    }

    pub fn keypoint_count(&self) -> usize {
        self.observations().len()
    }
}
