//! A map taken apart, to be kept elsewhere, and put together again.

use std::collections::BTreeMap;
use std::fmt;

use camera::CameraModel;
use features::Descriptor;
use geometry::{Camera, Map, Timestamp, Transform};
use nalgebra::{Matrix3, Vector2, Vector3};

use super::VslamMap;
use crate::frame::Frame;
use crate::map::NewPoint;
use crate::mapping::update_neighbours;
use crate::optics::Optics;
use crate::plane_grid::PlaneGrid;
use crate::{KeyframeId, MapId, Observation, PointId, View, VslamSettings};

/// What cannot be computed again of a map: who stands where, and who sees what.
///
/// Keyframes and points are numbered by their place in these lists; what was culled has left no
/// gap.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapParts {
    /// Oldest first.
    pub keyframes: Vec<KeyframeParts>,
    pub points: Vec<PointParts>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct KeyframeParts {
    pub captured_at: Timestamp,
    pub camera_from_map: Transform<Camera, Map>,
    /// An older keyframe near it; only the first has none.
    pub parent: Option<u32>,
    pub keypoints: Vec<KeypointParts>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct KeypointParts {
    pub position_px: Vector2<f64>,
    pub level: u8,
    pub angle_rad: f32,
    pub descriptor: Descriptor,
}

#[derive(Clone, Debug, PartialEq)]
pub struct PointParts {
    pub position_in_map: Vector3<f64>,
    pub covariance_in_map: Matrix3<f64>,
    pub parallax_rad: f64,
    /// By keyframe.
    pub views: Vec<ViewParts>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ViewParts {
    pub keyframe_idx: u32,
    pub keypoint_idx: u32,
}

/// Why parts are no map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapPartsError {
    /// A map has at least two keyframes and a point.
    Empty {
        keyframe_count: usize,
        point_count: usize,
    },
    TooLarge {
        count: usize,
    },
    /// A pose that is no rigid motion, or is not finite.
    KeyframePose {
        keyframe_idx: usize,
    },
    /// The first keyframe has no parent, the others have an older one.
    Parent {
        keyframe_idx: usize,
    },
    /// A keypoint that this camera cannot see, or of a level that there is not.
    Keypoint {
        keyframe_idx: usize,
        keypoint_idx: usize,
    },
    /// A position, covariance or angle that is not finite or out of reach, or a variance below
    /// zero.
    PointNumbers {
        point_idx: usize,
    },
    /// A point is seen by at least two keyframes.
    FewViews {
        point_idx: usize,
    },
    /// A view of a keyframe or keypoint that is not there, or that is taken already.
    View {
        point_idx: usize,
        view: ViewParts,
    },
}

/// Keyframes or points of a map, at most.
const COUNT_MAX: usize = 1 << 24;
/// Lengths and variances of a map, at most; a map is a few to some thousand units large.
const NUMBER_MAX: f64 = 1e12;
/// A unit quaternion may be off by this much: it is stored as it was computed.
const QUATERNION_NORM_ERROR_MAX: f64 = 1e-6;

impl VslamMap {
    /// What it takes to make the map again.
    pub fn to_parts(&self) -> MapParts {
        let keyframe_ids: Vec<KeyframeId> = self.keyframes().map(crate::Keyframe::id).collect();
        let idx_of = |id: KeyframeId| keyframe_ids.binary_search(&id).ok();
        let keyframes = self.keyframes().enumerate().map(|(idx, keyframe)| {
            let holder = keyframe.parent.and_then(|parent| self.holder(parent));
            // The heir of a culled parent may be younger than the child.
            let parent = holder.and_then(idx_of).filter(|parent| *parent < idx);
            KeyframeParts {
                captured_at: keyframe.captured_at,
                camera_from_map: keyframe.camera_from_map,
                parent: (idx > 0).then(|| parent.unwrap_or(idx - 1) as u32),
                keypoints: keyframe.observations.iter().map(keypoint_parts).collect(),
            }
        });
        // Of the others only the direction is known; the next keyframes find them again.
        let ranged = self.points().filter(|point| point.has_range());
        let points = ranged.map(|point| PointParts {
            position_in_map: point.position_in_map,
            covariance_in_map: point.covariance_in_map,
            parallax_rad: point.parallax_rad,
            views: point
                .views
                .iter()
                .filter_map(|view| {
                    Some(ViewParts {
                        keyframe_idx: idx_of(view.keyframe)? as u32,
                        keypoint_idx: view.observation_idx,
                    })
                })
                .collect(),
        });
        MapParts {
            keyframes: keyframes.collect(),
            points: points.collect(),
        }
    }

    /// The map of these parts, as `camera` sees it; ids count from zero.
    ///
    /// Whatever the parts are, there is a consistent map or an error.
    pub fn from_parts(
        parts: &MapParts,
        camera: &CameraModel,
        settings: &VslamSettings,
    ) -> Result<Self, MapPartsError> {
        let (keyframe_count, point_count) = (parts.keyframes.len(), parts.points.len());
        if keyframe_count < 2 || point_count < 1 {
            return Err(MapPartsError::Empty {
                keyframe_count,
                point_count,
            });
        }
        let count = keyframe_count.max(point_count);
        if count > COUNT_MAX {
            return Err(MapPartsError::TooLarge { count });
        }
        let optics = Optics::new(camera.clone(), settings.keypoint_sigma_px);
        let mut map = Self::new(MapId(0), KeyframeId(0), PointId(0));
        for (idx, keyframe) in parts.keyframes.iter().enumerate() {
            map.add_keyframe_parts(&optics, idx, keyframe)?;
        }
        for (idx, point) in parts.points.iter().enumerate() {
            map.add_point_parts(idx, point)?;
        }
        for idx in 0..keyframe_count as u32 {
            update_neighbours(&mut map, KeyframeId(idx));
        }
        Ok(map)
    }

    fn add_keyframe_parts(
        &mut self,
        optics: &Optics,
        keyframe_idx: usize,
        parts: &KeyframeParts,
    ) -> Result<(), MapPartsError> {
        let pose = &parts.camera_from_map;
        let norm_error = (pose.rotation().norm() - 1.0).abs();
        let in_reach = pose.translation().iter().all(is_in_reach);
        if !in_reach || norm_error.is_nan() || norm_error > QUATERNION_NORM_ERROR_MAX {
            return Err(MapPartsError::KeyframePose { keyframe_idx });
        }
        let is_older = |parent: u32| (parent as usize) < keyframe_idx;
        if parts
            .parent
            .map_or(keyframe_idx > 0, |parent| !is_older(parent))
        {
            return Err(MapPartsError::Parent { keyframe_idx });
        }
        let keypoints = parts.keypoints.iter().enumerate();
        let observations = keypoints
            .map(|(keypoint_idx, keypoint)| {
                observation(optics, keypoint).ok_or(MapPartsError::Keypoint {
                    keyframe_idx,
                    keypoint_idx,
                })
            })
            .collect::<Result<Vec<Observation>, MapPartsError>>()?;
        let frame = Frame {
            frame_idx: 0,
            captured_at: parts.captured_at,
            grid: PlaneGrid::new(optics, &observations),
            observations,
        };
        let id = self.add_keyframe(frame, *pose);
        if let Some(keyframe) = self.keyframe_mut(id) {
            keyframe.frame_idx = None;
            keyframe.parent = parts.parent.map(KeyframeId);
        }
        Ok(())
    }

    fn add_point_parts(
        &mut self,
        point_idx: usize,
        parts: &PointParts,
    ) -> Result<(), MapPartsError> {
        let numbers = parts.position_in_map.iter();
        let mut numbers = numbers.chain(parts.covariance_in_map.iter());
        let in_reach = numbers.all(is_in_reach) && is_in_reach(&parts.parallax_rad);
        let variances = parts.covariance_in_map.diagonal();
        if !in_reach || variances.iter().any(|variance| *variance < 0.0) {
            return Err(MapPartsError::PointNumbers { point_idx });
        }
        if parts.views.len() < 2 {
            return Err(MapPartsError::FewViews { point_idx });
        }
        let mut views: BTreeMap<u32, View> = BTreeMap::new();
        for &view in &parts.views {
            let keyframe = KeyframeId(view.keyframe_idx);
            let is_free = self
                .keyframe(keyframe)
                .and_then(|one| one.observations.get(view.keypoint_idx as usize))
                .is_some_and(|keypoint| keypoint.point.is_none());
            let made = View {
                keyframe,
                observation_idx: view.keypoint_idx,
            };
            if !is_free || views.insert(view.keyframe_idx, made).is_some() {
                return Err(MapPartsError::View { point_idx, view });
            }
        }
        let new = NewPoint {
            position_in_map: parts.position_in_map,
            covariance_in_map: parts.covariance_in_map,
            parallax_rad: parts.parallax_rad,
            expected_range: None,
        };
        self.add_point(new, views.into_values().collect());
        Ok(())
    }
}

/// Finite, and so small that its square is.
fn is_in_reach(value: &f64) -> bool {
    value.abs() < NUMBER_MAX
}

fn keypoint_parts(observation: &Observation) -> KeypointParts {
    KeypointParts {
        position_px: observation.position_px,
        level: observation.level,
        angle_rad: observation.angle_rad,
        descriptor: observation.descriptor,
    }
}

fn observation(optics: &Optics, parts: &KeypointParts) -> Option<Observation> {
    let pixel = &parts.position_px;
    let (width, height) = (optics.camera.width() as f64, optics.camera.height() as f64);
    // A comparison with NaN is false.
    let inside = pixel.x > -1.0 && pixel.x < width && pixel.y > -1.0 && pixel.y < height;
    if !inside || usize::from(parts.level) >= optics.level_count || !parts.angle_rad.is_finite() {
        return None;
    }
    let (position, sigma) = optics.undistort(pixel, parts.level)?;
    Some(Observation {
        position,
        position_px: parts.position_px,
        sigma,
        level: parts.level,
        angle_rad: parts.angle_rad,
        descriptor: parts.descriptor,
        point: None,
    })
}

impl fmt::Display for MapPartsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty {
                keyframe_count,
                point_count,
            } => write!(
                f,
                "{keyframe_count} keyframes and {point_count} points are no map"
            ),
            Self::TooLarge { count } => {
                write!(
                    f,
                    "{count} keyframes or points, expected {COUNT_MAX} at most"
                )
            }
            Self::KeyframePose { keyframe_idx } => {
                write!(f, "the pose of keyframe {keyframe_idx} is no rigid motion")
            }
            Self::Parent { keyframe_idx } => {
                write!(f, "keyframe {keyframe_idx} has no older parent")
            }
            Self::Keypoint {
                keyframe_idx,
                keypoint_idx,
            } => write!(
                f,
                "the camera cannot see keypoint {keypoint_idx} of keyframe {keyframe_idx}"
            ),
            Self::PointNumbers { point_idx } => {
                write!(f, "point {point_idx} has numbers that cannot be")
            }
            Self::FewViews { point_idx } => {
                write!(f, "point {point_idx} is not seen by two keyframes")
            }
            Self::View { point_idx, view } => write!(
                f,
                "point {point_idx} is seen as keypoint {} of keyframe {}, which is not there or \
                 shows another",
                view.keypoint_idx, view.keyframe_idx
            ),
        }
    }
}

impl std::error::Error for MapPartsError {}
