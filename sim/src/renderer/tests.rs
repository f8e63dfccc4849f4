use camera::{Distortion, Intrinsics};
use nalgebra::{Matrix2, Matrix3, Rotation3, UnitQuaternion, Vector2};

use super::*;
use crate::paint::Canvas;
use crate::scenario::{Scenario, ScenarioName};
use crate::world::Finish;

const CLEAN: SensorSettings = SensorSettings {
    exposure_s: 0.0,
    read_noise: 0.0,
    shot_noise: 0.0,
    vignette: 0.0,
};
const CELL_M: f64 = 0.25;

/// A board of 4 × 3 m that hangs 1.5 m before the origin of the site, across its x axis.
fn board() -> Panel {
    Panel {
        corner: Vector3::new(1.5, 2.0, 1.5),
        right: -Vector3::y(),
        down: -Vector3::z(),
        width_m: 4.0,
        height_m: 3.0,
        finish: Finish::PaintedWall,
        seed: 0,
    }
}

/// The board with a shade for every texel of 5 mm.
fn scene(shade: impl Fn(f64, f64) -> f32) -> Arc<Scene> {
    let panel = board();
    let mut canvas = Canvas::new(panel.width_m, panel.height_m, 0.005);
    canvas.paint_each(&shade);
    Arc::new(Scene {
        panels: vec![panel],
        hulls: Vec::new(),
        pictures: vec![lazy(move || Picture::new(&canvas))],
    })
}

fn checkerboard() -> Arc<Scene> {
    scene(|u_m, v_m| {
        let cells = (u_m / CELL_M).floor() as i64 + (v_m / CELL_M).floor() as i64;
        if cells % 2 == 0 { 40.0 } else { 210.0 }
    })
}

/// Looks along x from near the origin, turned by a rotation vector.
fn shot(turn_rad: Vector3<f64>) -> Shot {
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let optical = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let rotation = optical * UnitQuaternion::from_scaled_axis(turn_rad);
    Shot {
        site_from_camera: Transform::new(rotation, Vector3::new(0.1, 0.05, -0.1)),
        velocity_in_camera: Vector3::zeros(),
        rotation_rate_in_camera: Vector3::zeros(),
        gain: 1.0,
        noise_seed: 1,
    }
}

/// The corner of a checkerboard near a pixel: where every gradient in the window is at a right
/// angle to the line from it (Förstner and Gülch 1987).
fn refined_corner(image: &Image, guess: Vector2<f64>) -> Vector2<f64> {
    let grey = |x: i64, y: i64| f64::from(image.get(x as usize, y as usize));
    let mut corner = guess;
    for _ in 0..5 {
        let (cx, cy) = (corner.x.round() as i64, corner.y.round() as i64);
        let mut normal = Matrix2::zeros();
        let mut right_side = Vector2::zeros();
        for y in cy - 5..=cy + 5 {
            for x in cx - 5..=cx + 5 {
                let gradient = Vector2::new(
                    grey(x + 1, y) - grey(x - 1, y),
                    grey(x, y + 1) - grey(x, y - 1),
                );
                let outer = gradient * gradient.transpose();
                normal += outer;
                right_side += outer * Vector2::new(x as f64, y as f64);
            }
        }
        corner = normal.try_inverse().expect("corners have two directions") * right_side;
    }
    corner
}

#[test]
fn points_appear_where_the_camera_model_projects_them() {
    let scene = checkerboard();
    for vehicle in ScenarioName::Lab.vehicles() {
        let camera = vehicle.camera;
        let mut renderer = Renderer::new(Arc::clone(&scene), &camera, CLEAN);
        for turn_rad in [
            Vector3::zeros(),
            Vector3::new(0.15, -0.3, 0.2),
            Vector3::new(-0.1, 0.5, -0.1),
        ] {
            let shot = shot(turn_rad);
            let image = renderer.render(&shot);
            let mut errors_px = Vec::new();
            for idx in 0..15 * 11 {
                let (column, row) = (f64::from(idx % 15 + 1), f64::from(idx / 15 + 1));
                let point = board().point(CELL_M * column, CELL_M * row);
                let in_camera = shot.site_from_camera.inverse() * point;
                // Cells that look small do not fill the window.
                let cell_px = camera.focal_length_px() * CELL_M / in_camera.z;
                let Some(pixel) = camera.project(&in_camera) else {
                    continue;
                };
                if !camera.contains(&pixel, 8.0) || cell_px < 18.0 {
                    continue;
                }
                errors_px.push(refined_corner(&image, pixel) - pixel);
            }
            // Corners are found to a tenth of a pixel, and none may be off systematically.
            let worst_px = errors_px.iter().map(Vector2::norm).fold(0.0, f64::max);
            let bias_px = errors_px.iter().sum::<Vector2<f64>>() / errors_px.len() as f64;
            assert!(errors_px.len() >= 12, "{} corners", errors_px.len());
            assert!(worst_px < 0.25, "{worst_px} px");
            assert!(bias_px.norm() < 0.05, "{bias_px:?} px");
        }
    }
}

#[test]
fn edges_cover_pixels_by_their_area() {
    let camera = ScenarioName::Lab.vehicles()[0].camera.clone();
    let mut scene_of_card = Arc::into_inner(scene(|_, _| 200.0)).unwrap();
    let mut card = board();
    card.corner = Vector3::new(1.5, 0.31, 0.27);
    (card.width_m, card.height_m) = (0.637, 0.411);
    // A black wall behind it.
    scene_of_card.panels = vec![card.clone(), board()];
    scene_of_card.panels[1].corner.x = 1.6;
    let mut black = Canvas::new(4.0, 3.0, 1.0);
    black.paint_each(&|_, _| 0.0);
    scene_of_card
        .pictures
        .push(lazy(move || Picture::new(&black)));
    let mut renderer = Renderer::new(Arc::new(scene_of_card), &camera, CLEAN);
    let shot = shot(Vector3::new(0.05, 0.1, 0.3));
    let image = renderer.render(&shot);
    let light: f64 = image.pixels().iter().map(|pixel| f64::from(*pixel)).sum();
    // The area of the outline on the image, by Gauss's formula over points along its edges.
    let corners = card.corners();
    let outline: Vec<Vector2<f64>> = (0..400)
        .map(|idx| {
            let (side, along) = (idx / 100, f64::from(idx as i32 % 100) / 100.0);
            let point = corners[side].lerp(&corners[(side + 1) % 4], along);
            let in_camera = shot.site_from_camera.inverse() * point;
            camera.project(&in_camera).unwrap()
        })
        .collect();
    let pairs = outline.iter().zip(outline.iter().cycle().skip(1));
    let area_px: f64 = 0.5 * pairs.map(|(a, b)| a.x * b.y - a.y * b.x).sum::<f64>().abs();
    let ratio = light / 200.0 / area_px;
    assert!((ratio - 1.0).abs() < 2e-3, "{ratio} of {area_px} px²");
}

#[test]
fn a_shot_gives_the_same_bytes_and_another_seed_other_noise() {
    let camera = ScenarioName::Lab.vehicles()[1].camera.clone();
    let mut renderer = Renderer::new(scene(|_, _| 128.0), &camera, SensorSettings::default());
    let first_shot = shot(Vector3::zeros());
    let other_shot = Shot {
        noise_seed: 2,
        ..first_shot
    };
    let first = renderer.render(&first_shot);
    let other = renderer.render(&other_shot);
    assert_eq!(first, renderer.render(&first_shot));
    // Away from the board there is nothing but black; the centre is mid-grey, σ = 2.
    let differences = (0..10_000).map(|idx| {
        let (x, y) = (110 + idx % 100, 100 + idx / 100);
        f64::from(first.get(x, y)) - f64::from(other.get(x, y))
    });
    let variance = differences
        .map(|difference| difference * difference)
        .sum::<f64>()
        / 1e4;
    assert!((variance / 8.0 - 1.0).abs() < 0.15, "{variance}");
}

/// Compares a blurred frame with the mean of sharp ones along the way.
#[test]
fn motion_blur_is_the_mean_over_the_exposure() {
    let intrinsics = Intrinsics {
        fx: 480.0,
        fy: 480.0,
        cx: 320.0,
        cy: 180.0,
    };
    let camera = CameraModel::new(640, 360, intrinsics, Distortion::None).unwrap();
    let exposure_s = 0.01;
    let sensor = SensorSettings {
        exposure_s,
        ..CLEAN
    };
    let moving = Shot {
        velocity_in_camera: Vector3::new(-0.6, 0.3, 0.2),
        rotation_rate_in_camera: Vector3::new(0.1, -0.5, 0.3),
        ..shot(Vector3::new(0.0, 0.2, 0.1))
    };
    let scene = checkerboard();
    let blurred = Renderer::new(Arc::clone(&scene), &camera, sensor).render(&moving);
    let mut sharp = Renderer::new(scene, &camera, CLEAN);
    let mut mean = vec![0.0; 640 * 360];
    let part_count = 8;
    for part in 0..part_count {
        let time_s = exposure_s * ((f64::from(part) + 0.5) / f64::from(part_count) - 0.5);
        let mut delta = nalgebra::Vector6::zeros();
        delta
            .fixed_rows_mut::<3>(0)
            .copy_from(&(moving.rotation_rate_in_camera * time_s));
        delta
            .fixed_rows_mut::<3>(3)
            .copy_from(&(moving.velocity_in_camera * time_s));
        let part_shot = Shot {
            site_from_camera: moving.site_from_camera.perturbed(&delta),
            ..moving
        };
        let image = sharp.render(&part_shot);
        for (sum, pixel) in mean.iter_mut().zip(image.pixels()) {
            *sum += f64::from(*pixel) / f64::from(part_count);
        }
    }
    let still = sharp.render(&moving);
    let difference = |image: &Image| {
        let pairs = mean.iter().zip(image.pixels());
        pairs
            .map(|(mean, pixel)| (mean - f64::from(*pixel)).powi(2))
            .sum::<f64>()
    };
    let (blurred, still) = (difference(&blurred), difference(&still));
    assert!(blurred < 0.1 * still, "{blurred} against {still}");
}

#[test]
fn the_lab_has_structure_everywhere() {
    let scenario = Scenario::lab(4);
    let scene = Arc::new(Scene::paint(&scenario.world));
    for vehicle in 0..2 {
        let Scenario { vehicles, .. } = &scenario;
        let camera = &vehicles[vehicle].description.camera;
        let sensor = SensorSettings::default();
        let mut renderer = Renderer::new(Arc::clone(&scene), camera, sensor);
        for frame_idx in [0, 150, 300, 450] {
            let image = renderer.render(&scenario.shot(vehicle, frame_idx));
            let count = image.pixels().len();
            let dark = image.pixels().iter().filter(|pixel| **pixel < 8).count();
            let bright = image.pixels().iter().filter(|pixel| **pixel > 250).count();
            assert!(
                dark * 50 < count && bright * 20 < count,
                "{dark}, {bright} of {count}"
            );
            let blocks = (0..12).map(|idx| {
                let (width, height) = (image.width() / 4, image.height() / 3);
                contrast(&image, idx % 4 * width, idx / 4 * height, width, height)
            });
            let flat = blocks.filter(|deviation| *deviation < 8.0).count();
            assert!(
                flat <= 1,
                "{flat} of 12 blocks of frame {frame_idx} are flat"
            );
        }
    }
}

/// The standard deviation of the shades in a part of an image.
fn contrast(image: &Image, left: usize, top: usize, width: usize, height: usize) -> f64 {
    let rows = top..top + height;
    let shades: Vec<f64> = rows
        .flat_map(|y| {
            image.row(y)[left..left + width]
                .iter()
                .map(|s| f64::from(*s))
        })
        .collect();
    let mean = shades.iter().sum::<f64>() / shades.len() as f64;
    let squares = shades.iter().map(|shade| (shade - mean).powi(2));
    (squares.sum::<f64>() / shades.len() as f64).sqrt()
}

/// A vehicle upright at this place, with lights well above and below its hull.
fn neighbour(place: Vector3<f64>) -> Neighbour {
    Neighbour {
        hull_idx: 0,
        site_from_body: Transform::new(UnitQuaternion::identity(), place),
        lights: Some(MarkerLights { length_m: 0.3 }),
    }
}

/// The board in grey, with a cube of 0.1 m as the only hull.
fn scene_with_cube() -> Arc<Scene> {
    let grey = Arc::into_inner(scene(|_, _| 120.0)).unwrap();
    let cube = Cuboid {
        centre: Vector3::zeros(),
        half: Vector3::repeat(0.05),
        yaw_rad: 0.0,
    };
    Arc::new(grey.with_hulls([[cube].as_slice()]))
}

/// Column and row of the centre of light in a part of an image, and its sum above 140.
fn bright_centre(image: &Image, around: &Vector2<f64>) -> (Vector2<f64>, f64) {
    let (mut sum, mut moment) = (0.0, Vector2::zeros());
    let (cx, cy) = (around.x.round() as usize, around.y.round() as usize);
    for y in cy - 4..=cy + 4 {
        for x in cx - 4..=cx + 4 {
            let level = (f64::from(image.get(x, y)) - 140.0).max(0.0);
            sum += level;
            moment += Vector2::new(x as f64, y as f64) * level;
        }
    }
    (moment / sum.max(1e-9), sum)
}

#[test]
fn lights_appear_where_the_camera_model_projects_them() {
    let place = Vector3::new(1.2, -0.3, 0.1);
    let seen = neighbour(place);
    for vehicle in ScenarioName::Lab.vehicles() {
        let camera = vehicle.camera;
        let mut renderer = Renderer::new(scene_with_cube(), &camera, CLEAN);
        let shot = shot(Vector3::new(0.05, 0.1, 0.0));
        let image = renderer.render_among(&shot, &[seen]);
        for side in [0.15, -0.15] {
            let light = place + Vector3::z() * side;
            let in_camera = shot.site_from_camera.inverse() * light;
            let expected = camera.project(&in_camera).unwrap();
            let (centre, _) = bright_centre(&image, &expected);
            let [x, y] = [expected.x, expected.y].map(|axis| axis.round() as usize);
            assert_eq!(image.get(x, y), 255);
            // The clipped middle of a spot is only as symmetric as its pixels.
            assert!((centre - expected).norm() < 0.2, "{centre} {expected}");
        }
    }
}

#[test]
fn lights_are_hidden_by_what_stands_before_them() {
    let camera = ScenarioName::Lab.vehicles()[1].camera.clone();
    let mut renderer = Renderer::new(scene_with_cube(), &camera, CLEAN);
    let shot = shot(Vector3::zeros());
    let dark = |place: Vector3<f64>| Neighbour {
        lights: None,
        ..neighbour(place)
    };
    let upper = Vector3::new(1.2, 0.0, 0.0);
    let light = upper + Vector3::z() * 0.15;
    let pixel = camera.project(&(shot.site_from_camera.inverse() * light));
    let mut light_of = |neighbours: &[Neighbour]| {
        bright_centre(&renderer.render_among(&shot, neighbours), &pixel.unwrap()).1
    };
    let alone = light_of(&[neighbour(upper)]);
    assert!(alone > 1000.0, "{alone}");
    let eye = *shot.site_from_camera.translation();
    let before = eye + (light - eye) * 0.5;
    assert_eq!(light_of(&[neighbour(upper), dark(before)]), 0.0);
    let beside = before + Vector3::y() * 0.1;
    assert_eq!(light_of(&[neighbour(upper), dark(beside)]), alone);
    let behind = upper + Vector3::new(0.2, 0.0, 0.0);
    assert_eq!(light_of(&[neighbour(upper), dark(behind)]), alone);
    // The wall of the room hides what is behind it, and nobody sees backwards.
    let beyond = Vector3::new(1.7, 0.0, 0.0);
    let backwards = Vector3::new(-1.2, 0.0, 0.0);
    for unseen in [beyond, backwards] {
        let image = renderer.render_among(&shot, &[neighbour(unseen)]);
        assert_eq!(image, renderer.render(&shot));
    }
}

#[test]
fn a_light_half_as_far_is_four_times_as_bright() {
    let camera = ScenarioName::Lab.vehicles()[1].camera.clone();
    let mut renderer = Renderer::new(scene_with_cube(), &camera, CLEAN);
    let mut brightest = |depth_m: f64| {
        // Dark enough that the sensor does not clip it.
        let dimmed = Shot {
            gain: 0.01,
            ..shot(Vector3::zeros())
        };
        let eye = *dimmed.site_from_camera.translation();
        let place = eye + Vector3::new(depth_m, 0.0, 0.0);
        let lit = renderer.render_among(&dimmed, &[neighbour(place)]);
        let light = place + Vector3::z() * 0.15;
        let pixel = camera.project(&(dimmed.site_from_camera.inverse() * light));
        let [x, y] = [pixel.unwrap().x, pixel.unwrap().y].map(|axis| axis.round() as usize);
        f64::from(lit.get(x, y))
    };
    let ratio = brightest(0.5) / brightest(1.0);
    // A centre between pixels loses up to a quarter.
    assert!((2.7..5.5).contains(&ratio), "{ratio}");
}

#[test]
fn hulls_cover_what_is_behind_them() {
    let camera = ScenarioName::Lab.vehicles()[1].camera.clone();
    let mut renderer = Renderer::new(scene_with_cube(), &camera, CLEAN);
    let shot = shot(Vector3::zeros());
    let place = Vector3::new(1.1, -0.2, 0.1);
    let unlit = Neighbour {
        lights: None,
        ..neighbour(place)
    };
    let image = renderer.render_among(&shot, &[unlit]);
    let dark = image.pixels().iter().filter(|pixel| **pixel < 90).count() as f64;
    // The nearest face is 0.95 m from the camera.
    let side_px = camera.focal_length_px() * 0.1 / 0.95;
    assert!((0.95..1.6).contains(&(dark / side_px / side_px)), "{dark}");
    let pixel = camera
        .project(&(shot.site_from_camera.inverse() * place))
        .unwrap();
    assert!(image.get(pixel.x as usize, pixel.y as usize) < 90);
}
