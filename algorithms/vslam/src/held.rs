//! How much of an image the map holds.

use crate::optics::Optics;
use crate::{Keyframe, MapPoint, Observation, VslamMap};

/// Cells along either side of the image.
const CELLS_ALONG: usize = 8;
/// Where points of known range hold so many of the keypoints, and so much of the image, no others
/// are needed.
const HELD_KEYPOINTS_MIN: f64 = 0.2;
const HELD_CELLS_MIN: f64 = 0.7;

/// So many points of known range tell where a camera is.
pub(crate) const PLACED_MIN: usize = 20;

/// Whether points of known range tell where a keyframe is. If not, nothing that it sees has a
/// known range because of it.
pub(crate) fn is_placed(map: &VslamMap, keyframe: &Keyframe) -> bool {
    let points = keyframe.points().filter_map(|point| map.point(point));
    points
        .filter(|point| point.has_range())
        .take(PLACED_MIN)
        .count()
        == PLACED_MIN
}

type Cells = [bool; CELLS_ALONG * CELLS_ALONG];

/// Which parts of an image show points of known range.
#[derive(Clone, Debug)]
pub(crate) struct Held {
    cells: Cells,
    /// Cells with any keypoint.
    textured: Cells,
    keypoint_count: usize,
    point_count: usize,
}

impl Held {
    pub(crate) fn by(optics: &Optics, map: &VslamMap, observations: &[Observation]) -> Self {
        let mut held = Self {
            cells: [false; CELLS_ALONG * CELLS_ALONG],
            textured: [false; CELLS_ALONG * CELLS_ALONG],
            keypoint_count: observations.len(),
            point_count: 0,
        };
        for observation in observations {
            let cell = cell(optics, observation);
            held.textured[cell] = true;
            let point = observation.point.and_then(|point| map.point(point));
            if point.is_some_and(MapPoint::has_range) {
                held.cells[cell] = true;
                held.point_count += 1;
            }
        }
        held
    }

    pub(crate) fn holds(&self, optics: &Optics, observation: &Observation) -> bool {
        self.cells[cell(optics, observation)]
    }

    /// Whether enough of the keypoints and of the image is held.
    pub(crate) fn suffices(&self) -> bool {
        self.point_count as f64 >= HELD_KEYPOINTS_MIN * self.keypoint_count as f64
            && self.share() >= HELD_CELLS_MIN
    }

    /// Cells held, of those with any keypoint.
    pub(crate) fn share(&self) -> f64 {
        let count = |cells: &Cells| cells.iter().filter(|cell| **cell).count() as f64;
        count(&self.cells) / count(&self.textured).max(1.0)
    }
}

fn cell(optics: &Optics, observation: &Observation) -> usize {
    let size = [optics.camera.width(), optics.camera.height()];
    let along = [0, 1].map(|axis| {
        let share = observation.position_px[axis] / size[axis] as f64;
        // A cast from float saturates: negative becomes 0.
        ((share * CELLS_ALONG as f64) as usize).min(CELLS_ALONG - 1)
    });
    along[1] * CELLS_ALONG + along[0]
}
