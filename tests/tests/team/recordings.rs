//! Short recordings of two vehicles, in the layout of the TUM RGB-D benchmark.

use std::fmt::Write;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};

use sim::{Renderer, Scenario, Scene};
use tempfile::TempDir;

/// 20 s at 10 Hz: long enough to be placed, to lose the link, and to find it again.
const FRAME_COUNT: usize = 200;
pub const SEED: u64 = 1;

/// The recordings of all tests.
pub static RECORDINGS: LazyLock<Recordings> = LazyLock::new(Recordings::render);

pub struct Recordings {
    _folder: TempDir,
    /// A ground vehicle and a drone in one room; neither folder holds a truth.
    pub ground: PathBuf,
    pub drone: PathBuf,
    /// Fixes of the ground vehicle, far beyond its recording too.
    pub fixes: PathBuf,
}

impl Recordings {
    fn render() -> Self {
        let folder = TempDir::new().unwrap();
        let scenario = Scenario::lab(SEED);
        let scene = Arc::new(Scene::paint(&scenario.world));
        let ground = folder.path().join("ground");
        let drone = folder.path().join("drone");
        render(&scenario, &scene, 0, &ground);
        render(&scenario, &scene, 1, &drone);
        let mut fixes = String::from("# timestamp tx ty tz qx qy qz qw\n");
        for fix in scenario.fixes(0) {
            let p = fix.position_in_site;
            let stamp = fix.captured_at;
            writeln!(fixes, "{stamp} {} {} {} 0 0 0 1", p.x, p.y, p.z).unwrap();
        }
        let path = folder.path().join("fixes.tum");
        fs::write(&path, fixes).unwrap();
        Self {
            _folder: folder,
            ground,
            drone,
            fixes: path,
        }
    }
}

fn render(scenario: &Scenario, scene: &Arc<Scene>, vehicle_idx: usize, folder: &Path) {
    render_frames(scenario, scene, vehicle_idx, folder, 0..FRAME_COUNT);
}

/// - `frames`: of the vehicle's route, in the order in which they are recorded at 10 Hz.
fn render_frames(
    scenario: &Scenario,
    scene: &Arc<Scene>,
    vehicle_idx: usize,
    folder: &Path,
    frames: impl IntoIterator<Item = usize>,
) {
    fs::create_dir_all(folder.join("rgb")).unwrap();
    let vehicle = &scenario.vehicles[vehicle_idx];
    let description = &vehicle.description;
    let yaml = peer::demo::sensor_yaml(&description.camera, &description.body_from_camera);
    fs::write(folder.join("camera.yaml"), yaml).unwrap();
    let mut renderer = Renderer::new(Arc::clone(scene), &description.camera, vehicle.sensor);
    let mut list = String::from("# timestamp filename\n");
    for (step, frame_idx) in frames.into_iter().enumerate() {
        let image = renderer.render(&scenario.shot(vehicle_idx, frame_idx));
        let stamp = scenario.timestamp(scenario.frame_time_s(step));
        let name = format!("rgb/{step:04}.png");
        let size = (image.width() as u32, image.height() as u32);
        write_png(&folder.join(&name), size, image.pixels());
        writeln!(list, "{stamp} {name}").unwrap();
    }
    fs::write(folder.join("rgb.txt"), list).unwrap();
}

/// The ground vehicle's way around the lab, which can be driven in any order.
pub struct Tour {
    scenario: Scenario,
    scene: Arc<Scene>,
}

impl Tour {
    pub fn lab() -> Self {
        let scenario = Scenario::lab(SEED);
        let scene = Arc::new(Scene::paint(&scenario.world));
        Self { scenario, scene }
    }

    /// A recording of these frames of the way.
    pub fn render(&self, folder: &Path, frames: Vec<usize>) -> PathBuf {
        render_frames(&self.scenario, &self.scene, 0, folder, frames);
        folder.to_owned()
    }

    /// Where the vehicle is at each step of a drive.
    pub fn fixes(&self, path: &Path, count: usize, frame_of: impl Fn(usize) -> usize) -> PathBuf {
        let mut text = String::new();
        for step in 0..count {
            let time_s = self.scenario.frame_time_s(frame_of(step));
            let pose = self.scenario.vehicles[0].route.pose(time_s);
            let p = pose.translation();
            let stamp = self.scenario.timestamp(self.scenario.frame_time_s(step));
            writeln!(text, "{stamp} {} {} {} 0 0 0 1", p.x, p.y, p.z).unwrap();
        }
        fs::write(path, text).unwrap();
        path.to_owned()
    }
}

fn write_png(path: &Path, (width, height): (u32, u32), pixels: &[u8]) {
    let file = BufWriter::new(File::create(path).unwrap());
    let mut encoder = png::Encoder::new(file, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fastest);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(pixels).unwrap();
}
