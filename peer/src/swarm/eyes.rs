//! Rendered cameras in place of ideal ones: pictures in, sightings out.

use std::f64::consts::FRAC_PI_2;

use camera::{CameraModel, Distortion, Intrinsics};
use geometry::Timestamp;
use keeping::markers::{CameraMarkers, EgoMotion, FinderSettings, MarkerVision, TrackerSettings};
use keeping::mount::{self, CameraMount, Sightings};
use keeping::{Baseline, FieldOfView, MarkerModel, Sighting};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use sim::swarm::{Glimpse, PictureSettings, Studio, Swarm, SwarmCamera};

/// The cameras of all drones, and what each makes of its own.
pub struct Eyes {
    studio: Studio,
    mounts: Vec<CameraMount>,
    view: FieldOfView,
    drones: Vec<DroneEyes>,
    sightings: Sightings,
}

struct DroneEyes {
    vision: MarkerVision,
    /// When its last pictures were taken.
    heading_rad: f64,
}

/// The paper's sensor.
const SIZE_PX: [usize; 2] = [324, 244];
/// Around stand cameras on their side: 98° high and 86° wide, one every 60°, so that they see 45°
/// up and down in every direction.
const AROUND_FOCAL_PX: f64 = 130.0;
const AROUND_AZIMUTHS_DEG: [f64; 5] = [0.0, 60.0, -60.0, 120.0, -120.0];
const AROUND_HALF_WIDTH_DEG: f64 = 43.0;
/// One camera looks up and one down, to 45° from the vertical and beyond.
const POLAR_FOCAL_PX: f64 = 115.0;
const POLAR_HALF_WIDTH_DEG: f64 = 45.0;
/// The paper's tracks are of 20 frames a second; at ten everything moves twice as far.
const GATE_PX: f64 = 20.0;

/// Which lights a camera looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outlook {
    Around,
    Up,
    Down,
}

impl Eyes {
    /// - `view`: what is outside of it is not looked at, and cameras that see nothing else are not
    ///   carried.
    /// - `markers`: the lights of the team; their baseline is that of the lights which a camera
    ///   sees.
    pub fn new(
        settings: &PictureSettings,
        view: FieldOfView,
        markers: &MarkerModel,
        drone_count: usize,
        seed: u64,
    ) -> Self {
        let mounts = mounts(&view, markers);
        let cameras = mounts.iter().map(|mount| SwarmCamera {
            model: mount.camera.clone(),
            heading_from_camera: mount.heading_from_camera,
        });
        let markers_of = |mount: &CameraMount| {
            let finder = FinderSettings {
                baseline_rad: mount.baseline_rad,
                ..FinderSettings::default()
            };
            let tracker = TrackerSettings {
                gate_px: GATE_PX,
                ..TrackerSettings::default()
            };
            CameraMarkers::new(finder, tracker, SIZE_PX[0])
        };
        let drones = (0..drone_count).map(|_| DroneEyes {
            vision: MarkerVision::new(mounts.iter().map(markers_of).collect()),
            heading_rad: 0.0,
        });
        Self {
            studio: Studio::new(cameras.collect(), settings, seed),
            view,
            drones: drones.collect(),
            mounts,
            sightings: Sightings::default(),
        }
    }

    /// Looks once with all cameras of a drone.
    ///
    /// - `glimpses`: what was seen, with whose it is, for those who check.
    pub fn look(
        &mut self,
        swarm: &mut Swarm,
        drone: usize,
        glimpses: &mut Vec<Glimpse>,
    ) -> &[Sighting] {
        self.sightings.clear();
        glimpses.clear();
        if swarm.is_blinded(drone) {
            return &self.sightings;
        }
        let captured_at = Timestamp::from_seconds(swarm.time_s())
            .expect("flights last hours at most, which time stamps can hold");
        let heading_rad = swarm.pictured_heading_rad(drone);
        let eyes = &mut self.drones[drone];
        let turn_rad = heading_rad - std::mem::replace(&mut eyes.heading_rad, heading_rad);
        for (camera_idx, mount) in self.mounts.iter().enumerate() {
            let image = swarm.picture(drone, &self.studio, camera_idx);
            let Some(camera) = eyes.vision.camera(camera_idx) else {
                continue;
            };
            let (frame, tracks) = camera.see(&image, captured_at, Some(&turned(mount, turn_rad)));
            for sighting in mount.sightings(&frame, tracks) {
                if self.view.contains(&sighting.direction) {
                    mount::join(&mut self.sightings, sighting);
                }
            }
        }
        glimpses.extend(self.sightings.iter().map(|sighting| Glimpse {
            target: swarm.target_towards(drone, &sighting.direction),
            direction: sighting.direction,
            separation_px: None,
        }));
        &self.sightings
    }
}

/// How a camera turned with its drone since its last picture.
fn turned(mount: &CameraMount, turn_rad: f64) -> EgoMotion {
    let now_from_before = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -turn_rad);
    let heading_from_camera = mount.heading_from_camera;
    EgoMotion {
        now_from_before: heading_from_camera.inverse() * now_from_before * heading_from_camera,
        intrinsics: *mount.camera.intrinsics(),
    }
}

fn mounts(view: &FieldOfView, markers: &MarkerModel) -> Vec<CameraMount> {
    let reach_deg = view.half_width_rad.to_degrees() + AROUND_HALF_WIDTH_DEG;
    let around = AROUND_AZIMUTHS_DEG
        .into_iter()
        .filter(|azimuth_deg| azimuth_deg.abs() < reach_deg);
    let mut mounts: Vec<CameraMount> = around
        .map(|azimuth_deg| {
            let (sin, cos) = azimuth_deg.to_radians().sin_cos();
            let (ahead, left) = (Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0));
            mount(Outlook::Around, [-Vector3::z(), left, ahead], markers)
        })
        .collect();
    if view.elevation_rad_max.to_degrees() > POLAR_HALF_WIDTH_DEG {
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        mounts.push(mount(Outlook::Up, [x, y, z], markers));
        mounts.push(mount(Outlook::Down, [x, -y, -z], markers));
    }
    mounts
}

/// - `axes`: of the image across, of the image down, and along the view, in the heading frame.
fn mount(outlook: Outlook, axes: [Vector3<f64>; 3], markers: &MarkerModel) -> CameraMount {
    let (focal_px, baseline, baseline_rad) = match outlook {
        // Lights one above the other are side by side in a camera on its side.
        Outlook::Around => (AROUND_FOCAL_PX, Baseline::Vertical, 0.0),
        Outlook::Up | Outlook::Down => (POLAR_FOCAL_PX, Baseline::Horizontal, FRAC_PI_2),
    };
    let [cx, cy] = SIZE_PX.map(|side| 0.5 * (side as f64 - 1.0));
    let intrinsics = Intrinsics {
        fx: focal_px,
        fy: focal_px,
        cx,
        cy,
    };
    CameraMount {
        camera: CameraModel::new(SIZE_PX[0], SIZE_PX[1], intrinsics, Distortion::None)
            .expect("the constants are a camera"),
        heading_from_camera: UnitQuaternion::from_matrix(&Matrix3::from_columns(&axes)),
        baseline_rad,
        markers: MarkerModel {
            baseline,
            ..*markers
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: cameras together see all that the view promises, with room for the lights' own size.
    #[test]
    fn cameras_leave_no_gap_in_the_view() {
        let view = FieldOfView::all_but_rear();
        let mounts = mounts(&view, &MarkerModel::default());
        let is_seen = |direction: &Vector3<f64>| {
            mounts.iter().any(|mount| {
                let in_camera = mount.heading_from_camera.inverse() * direction;
                let half = [0, 1].map(|axis| 0.5 * SIZE_PX[axis] as f64 - 4.0);
                let focal_px = mount.camera.intrinsics().fx;
                // Each kind of lights shines 45° to either side.
                let is_around = direction.z.abs() <= direction.x.hypot(direction.y);
                let is_for_around = mount.markers.baseline == Baseline::Vertical;
                is_around == is_for_around
                    && in_camera.z > 0.0
                    && (focal_px * in_camera.x / in_camera.z).abs() <= half[0]
                    && (focal_px * in_camera.y / in_camera.z).abs() <= half[1]
            })
        };
        for azimuth_deg in -150..=150 {
            for elevation_deg in -90..=90 {
                let azimuth_rad = f64::from(azimuth_deg).to_radians();
                let elevation_rad = f64::from(elevation_deg).to_radians();
                let direction = Vector3::new(
                    elevation_rad.cos() * azimuth_rad.cos(),
                    elevation_rad.cos() * azimuth_rad.sin(),
                    elevation_rad.sin(),
                );
                assert!(
                    is_seen(&direction),
                    "{azimuth_deg}° left, {elevation_deg}° up"
                );
            }
        }
    }

    #[test]
    fn one_camera_ahead_needs_no_others_behind() {
        let front = FieldOfView {
            azimuth_rad: 0.0,
            half_width_rad: 40_f64.to_radians(),
            elevation_rad_max: 34_f64.to_radians(),
        };
        assert_eq!(mounts(&front, &MarkerModel::default()).len(), 3);
    }
}
