//! Maps of a single vehicle, kept to be continued.
//!
//! ```text
//! offset  little endian
//!  0      "STARLMAP"
//!  8      u32 version, u32 CRC-32 (IEEE) and u64 byte count of what follows
//! 24      u16 byte count, UTF-8          the camera
//!         u32 u32                        counts of keyframes and points
//!         per keyframe
//!           i64                          captured_at, ns
//!           7 × f64                      camera_from_map: quaternion w x y z, translation
//!           u32                          the number of its parent, of none 2³² − 1
//!           u32                          count of keypoints
//!           per keypoint
//!             f64 f64 u8 f32 32 × u8     position in px, level, angle in rad, descriptor
//!         per point
//!           3 × f64, 9 × f64, f64        position, covariance, parallax in rad
//!           u32                          count of views
//!           per view
//!             u32 u32                    numbers of the keyframe and of its keypoint
//! ```

mod bytes;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use camera::CameraModel;
use features::Descriptor;
use geometry::{Timestamp, Transform};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector2, Vector3};
use vslam::{
    KeyframeParts, KeypointParts, MapParts, PointParts, ViewParts, VslamMap, VslamSettings,
};

use super::error::{FileError, Refused};
use bytes::Reader;

const MAGIC: &[u8; 8] = b"STARLMAP";
/// Grows with every change of the layout, of the image pyramid, or of what descriptors mean.
const VERSION: u32 = 2;
const HEADER_BYTES: usize = 24;
/// A map of an hour at thirty keyframes a minute is a tenth of this.
const FILE_BYTES_MAX: u64 = 1 << 30;
const NO_PARENT: u32 = u32::MAX;
const KEYFRAME_BYTES: usize = 8 + 7 * 8 + 4 + 4;
const KEYPOINT_BYTES: usize = 2 * 8 + 1 + 4 + 32;
const POINT_BYTES: usize = 13 * 8 + 4;
const VIEW_BYTES: usize = 8;

/// Writes a map that `camera` made: all of it, or nothing of it.
pub fn write_slam_map(path: &Path, map: &VslamMap, camera: &CameraModel) -> Result<(), FileError> {
    let written = encode(&map.to_parts(), camera);
    replace(path, &written).map_err(|error| FileError::Write {
        error,
        path: path.to_owned(),
    })
}

/// Reads a map to be continued with the same camera.
pub fn read_slam_map(
    path: &Path,
    camera: &CameraModel,
    settings: &VslamSettings,
) -> Result<VslamMap, FileError> {
    let in_read = |error| FileError::Read {
        error,
        path: path.to_owned(),
    };
    let refused = |refused: Refused| refused.into_error(path);
    let metadata = fs::metadata(path).map_err(in_read)?;
    // A pipe would be waited for, and a device read without end.
    if !metadata.is_file() {
        return Err(refused(Refused::whole("this is no file")));
    }
    if metadata.len() > FILE_BYTES_MAX {
        let reason = format!("{} bytes are too many for a map", metadata.len());
        return Err(refused(Refused::whole(reason)));
    }
    let read = fs::read(path).map_err(in_read)?;
    let parts = decode(&read, camera).map_err(refused)?;
    VslamMap::from_parts(&parts, camera, settings)
        .map_err(|error| refused(Refused::whole(format!("the map is damaged: {error}"))))
}

/// Puts a whole file in the place of another, which stays if that fails.
fn replace(path: &Path, content: &[u8]) -> std::io::Result<()> {
    if path.exists() && !path.is_file() {
        // A device or a pipe has no successor.
        return fs::write(path, content);
    }
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let partial: PathBuf = path.with_file_name(name);
    let write = || {
        let mut file = fs::File::create(&partial)?;
        file.write_all(content)?;
        file.sync_all()?;
        fs::rename(&partial, path)
    };
    write().inspect_err(|_| {
        // What is left of it is no map; if it cannot be removed either, its name says so.
        let _ = fs::remove_file(&partial);
    })
}

fn encode(parts: &MapParts, camera: &CameraModel) -> Vec<u8> {
    let mut body = Vec::new();
    let camera = describe(camera);
    body.extend((camera.len() as u16).to_le_bytes());
    body.extend(camera.as_bytes());
    put_count(&mut body, parts.keyframes.len());
    put_count(&mut body, parts.points.len());
    for keyframe in &parts.keyframes {
        put_keyframe(&mut body, keyframe);
    }
    for point in &parts.points {
        put_point(&mut body, point);
    }
    let mut file = Vec::with_capacity(HEADER_BYTES + body.len());
    file.extend(MAGIC);
    file.extend(VERSION.to_le_bytes());
    file.extend(crc32fast::hash(&body).to_le_bytes());
    file.extend((body.len() as u64).to_le_bytes());
    file.extend(body);
    file
}

fn put_count(body: &mut Vec<u8>, count: usize) {
    let count = u32::try_from(count).expect("a map counts by 32 bits");
    body.extend(count.to_le_bytes());
}

fn put_numbers<'a>(body: &mut Vec<u8>, numbers: impl IntoIterator<Item = &'a f64>) {
    body.extend(numbers.into_iter().flat_map(|number| number.to_le_bytes()));
}

fn put_keyframe(body: &mut Vec<u8>, keyframe: &KeyframeParts) {
    body.extend(keyframe.captured_at.nanoseconds().to_le_bytes());
    let pose = &keyframe.camera_from_map;
    let rotation = pose.rotation();
    put_numbers(body, [&rotation.w, &rotation.i, &rotation.j, &rotation.k]);
    put_numbers(body, pose.translation());
    body.extend(keyframe.parent.unwrap_or(NO_PARENT).to_le_bytes());
    put_count(body, keyframe.keypoints.len());
    for keypoint in &keyframe.keypoints {
        put_numbers(body, &keypoint.position_px);
        body.push(keypoint.level);
        body.extend(keypoint.angle_rad.to_le_bytes());
        body.extend(keypoint.descriptor.to_bytes());
    }
}

fn put_point(body: &mut Vec<u8>, point: &PointParts) {
    put_numbers(body, &point.position_in_map);
    put_numbers(body, &point.covariance_in_map);
    put_numbers(body, [&point.parallax_rad]);
    put_count(body, point.views.len());
    for view in &point.views {
        body.extend(view.keyframe_idx.to_le_bytes());
        body.extend(view.keypoint_idx.to_le_bytes());
    }
}

/// What two cameras must agree in: the numbers as they are, not rounded.
fn describe(camera: &CameraModel) -> String {
    let intrinsics = camera.intrinsics();
    format!(
        "{}×{} px, fx {}, fy {}, cx {}, cy {}, distortion {:?}",
        camera.width(),
        camera.height(),
        intrinsics.fx,
        intrinsics.fy,
        intrinsics.cx,
        intrinsics.cy,
        camera.distortion()
    )
}

fn decode(file: &[u8], camera: &CameraModel) -> Result<MapParts, Refused> {
    let mut body = Reader::new(check_header(file)?);
    let camera_bytes = usize::from(u16::from_le_bytes(body.array()?));
    let made_by = String::from_utf8_lossy(body.take(camera_bytes)?);
    let ours = describe(camera);
    if made_by != ours {
        return Err(Refused::whole(format!(
            "the map was made with another camera ({made_by}) than this one ({ours})"
        )));
    }
    let keyframe_count = body.count(KEYFRAME_BYTES)?;
    let point_count = body.count(POINT_BYTES)?;
    let keyframes = (0..keyframe_count).map(|_| take_keyframe(&mut body));
    let keyframes = keyframes.collect::<Result<_, _>>()?;
    let points = (0..point_count).map(|_| take_point(&mut body));
    let points = points.collect::<Result<_, _>>()?;
    body.end()?;
    Ok(MapParts { keyframes, points })
}

/// What follows the header, if it is whole and of this version.
fn check_header(file: &[u8]) -> Result<&[u8], Refused> {
    let mut header = Reader::new(file);
    if header.take(MAGIC.len()).ok() != Some(MAGIC) {
        return Err(Refused::whole("this is no map of starling slam"));
    }
    let version = header.u32()?;
    if version != VERSION {
        return Err(Refused::whole(format!(
            "the map is of version {version}, expected {VERSION}; make it again from its recording"
        )));
    }
    let (crc, body_bytes) = (header.u32()?, u64::from_le_bytes(header.array()?));
    let body = header.rest();
    if body.len() as u64 != body_bytes {
        return Err(Refused::whole(format!(
            "the map has {} bytes, expected {body_bytes}: it was cut or added to",
            body.len()
        )));
    }
    let got = crc32fast::hash(body);
    if got != crc {
        return Err(Refused::whole(format!(
            "the map is damaged: checksum {got:08x}, expected {crc:08x}"
        )));
    }
    Ok(body)
}

fn take_keyframe(body: &mut Reader<'_>) -> Result<KeyframeParts, Refused> {
    let captured_at = Timestamp::from_nanoseconds(i64::from_le_bytes(body.array()?));
    let [w, i, j, k] = body.numbers()?;
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
    let translation = Vector3::from(body.numbers()?);
    let parent = body.u32()?;
    let keypoint_count = body.count(KEYPOINT_BYTES)?;
    let keypoints = (0..keypoint_count).map(|_| take_keypoint(body));
    Ok(KeyframeParts {
        captured_at,
        camera_from_map: Transform::new(rotation, translation),
        parent: (parent != NO_PARENT).then_some(parent),
        keypoints: keypoints.collect::<Result<_, _>>()?,
    })
}

fn take_keypoint(body: &mut Reader<'_>) -> Result<KeypointParts, Refused> {
    Ok(KeypointParts {
        position_px: Vector2::from(body.numbers()?),
        level: u8::from_le_bytes(body.array()?),
        angle_rad: f32::from_le_bytes(body.array()?),
        descriptor: Descriptor::from_bytes(body.array()?),
    })
}

fn take_point(body: &mut Reader<'_>) -> Result<PointParts, Refused> {
    let position_in_map = Vector3::from(body.numbers()?);
    let covariance: [f64; 9] = body.numbers()?;
    let [parallax_rad] = body.numbers()?;
    let view_count = body.count(VIEW_BYTES)?;
    let views = (0..view_count).map(|_| {
        Ok(ViewParts {
            keyframe_idx: body.u32()?,
            keypoint_idx: body.u32()?,
        })
    });
    Ok(PointParts {
        position_in_map,
        covariance_in_map: Matrix3::from_column_slice(&covariance),
        parallax_rad,
        views: views.collect::<Result<_, Refused>>()?,
    })
}

#[cfg(test)]
mod tests;
