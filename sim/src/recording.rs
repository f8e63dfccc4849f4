//! Rendered recordings of one camera: pictures with their stamps, and the truth.
//!
//! A recording is a function of its world's name, a seed and the conditions: the seed chooses the
//! building, its finishes, the route, the speeds and when each condition strikes.

mod conditions;
mod radio;
mod stage;
mod walk;

use std::sync::Arc;

use camera::{CameraModel, Image};
use geometry::{Body, Camera, Enu, Timestamp, Transform};

pub use conditions::Condition;
use conditions::Weather;
use stage::Stage;
pub(crate) use stage::video_camera;

use crate::renderer::{Renderer, Scene, SensorSettings, Shot, gain_at};
use crate::scenario::timestamp_at;

/// Where a camera is carried, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RecordingWorld {
    /// The demo's drone before the wall of its lab: 324×244 at 10 Hz, 52 s.
    Lab,
    /// A drone around the same lab: 324×244 at 15 Hz, 50 s.
    Round,
    /// Pans of up to a full turn in a room, with little motion: 640×480 at 30 Hz, 25 s.
    Handheld,
    /// A walk through rooms and corridors of an office: 640×480 at 5 Hz, 70 s at most.
    Office,
    /// Fast small motions close to a printed board: 640×480 at 30 Hz, 20 s.
    Board,
    /// Once around 300 m of corridors, and 12 m more: 640×480, wide, at 12 Hz, about 210 s.
    Corridor,
    /// Hover, turns in place, a flight, and the same again: 640×480 at 20 Hz, 36 s.
    Hover,
    /// A drone on the spot in the demo's lab, which turns there in the end: 324×244 at 10 Hz, 20 s.
    Still,
}

/// What to record.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordingSettings {
    pub world: RecordingWorld,
    pub seed: u64,
    /// None for a clear view.
    pub conditions: Vec<Condition>,
    /// End early; conditions are spread over what is left.
    pub frame_count_max: Option<usize>,
}

/// A camera on its way through a world.
pub struct Recording {
    settings: RecordingSettings,
    stage: Stage,
    weather: Weather,
    scene: Arc<Scene>,
    frame_count: usize,
}

/// A picture and the truth about it.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedFrame {
    pub captured_at: Timestamp,
    pub site_from_camera: Transform<Enu, Camera>,
    pub image: Image,
}

impl RecordingWorld {
    pub const ALL: [Self; 8] = [
        Self::Lab,
        Self::Round,
        Self::Handheld,
        Self::Office,
        Self::Board,
        Self::Corridor,
        Self::Hover,
        Self::Still,
    ];
    /// Those in which a camera moves enough to make a map of its own.
    pub const MOVING: [Self; 7] = [
        Self::Lab,
        Self::Round,
        Self::Handheld,
        Self::Office,
        Self::Board,
        Self::Corridor,
        Self::Hover,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Lab => "lab",
            Self::Round => "round",
            Self::Handheld => "handheld",
            Self::Office => "office",
            Self::Board => "board",
            Self::Corridor => "corridor",
            Self::Hover => "hover",
            Self::Still => "still",
        }
    }

    pub fn frame_rate_hz(self) -> f64 {
        match self {
            Self::Lab | Self::Still => 10.0,
            Self::Round => 15.0,
            Self::Handheld | Self::Board => 30.0,
            Self::Office => 5.0,
            Self::Corridor => 12.0,
            Self::Hover => 20.0,
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|world| world.name() == name)
    }
}

impl Recording {
    /// Builds the world; pictures are painted when they are first seen.
    pub fn new(settings: RecordingSettings) -> Self {
        let mut stage = Stage::new(settings.world, settings.seed);
        let whole = (stage.duration_s * settings.world.frame_rate_hz()) as usize;
        let frame_count = settings
            .frame_count_max
            .map_or(whole, |most| most.min(whole));
        let duration_s = frame_count as f64 / settings.world.frame_rate_hz();
        let weather = Weather::new(&settings.conditions, settings.seed, duration_s);
        if settings.conditions.contains(&Condition::LowTexture) {
            stage.world.contrast = 0.35;
        }
        let hulls = weather.hulls();
        let scene = Scene::painted_when_seen(&stage.world)
            .with_hulls(hulls.iter().map(|hull| hull.as_slice()));
        Self {
            settings,
            stage,
            weather,
            scene: Arc::new(scene),
            frame_count,
        }
    }

    pub fn camera(&self) -> &CameraModel {
        &self.stage.camera
    }

    pub fn body_from_camera(&self) -> &Transform<Body, Camera> {
        &self.stage.body_from_camera
    }

    pub fn frame_rate_hz(&self) -> f64 {
        self.settings.world.frame_rate_hz()
    }

    /// Frames of the route; with dropped ones, fewer are recorded.
    pub fn frame_count(&self) -> usize {
        self.frame_count
    }

    /// Renders one frame after the other. Every call begins anew and gives the same frames.
    pub fn frames(&self) -> impl Iterator<Item = RecordedFrame> + '_ {
        let mut renderer = Renderer::new(
            Arc::clone(&self.scene),
            &self.stage.camera,
            self.weather.sensor(SensorSettings::default()),
        );
        (0..self.frame_count)
            .filter(|frame_idx| !self.weather.drops(*frame_idx))
            .map(move |frame_idx| self.render(frame_idx, &mut renderer))
    }

    /// Stamps and poses of all frames, without rendering them.
    pub fn truth(&self) -> impl Iterator<Item = (Timestamp, Transform<Enu, Camera>)> + '_ {
        (0..self.frame_count).map(|frame_idx| {
            let time_s = self.time_s(frame_idx);
            let pose = self.stage.route.pose(time_s) * self.stage.body_from_camera;
            (timestamp_at(time_s), pose)
        })
    }

    fn time_s(&self, frame_idx: usize) -> f64 {
        frame_idx as f64 / self.frame_rate_hz()
    }

    fn render(&self, frame_idx: usize, renderer: &mut Renderer) -> RecordedFrame {
        let time_s = self.time_s(frame_idx);
        let motion = self.stage.route.motion(time_s);
        let seed = self.settings.seed;
        let shot = Shot {
            gain: gain_at(time_s, (seed % 64) as f64) * self.weather.gain(time_s),
            noise_seed: seed.rotate_left(40) ^ frame_idx as u64,
            ..motion.shot(&self.stage.body_from_camera)
        };
        let occluders = self.weather.occluders(time_s, &shot.site_from_camera);
        let mut image = renderer.render_among(&shot, &occluders);
        self.weather.disturb(frame_idx, &mut image);
        RecordedFrame {
            captured_at: timestamp_at(time_s),
            site_from_camera: shot.site_from_camera,
            image,
        }
    }
}

#[cfg(test)]
mod tests;
