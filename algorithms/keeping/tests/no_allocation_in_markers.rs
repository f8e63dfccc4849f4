//! Goal: no image costs marker vision an allocation, whatever it shows.
//! Method: a counting allocator, alone in this process.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use camera::Image;
use geometry::Timestamp;
use keeping::markers::{
    CameraMarkers, FinderSettings, PaperPipeline, PaperPipelineSettings, TrackerSettings,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::marker_light::MarkerScene;

struct Counting;

static ALLOCATION_COUNT: AtomicUsize = AtomicUsize::new(0);

// SAFETY: everything is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATION_COUNT.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn no_image_costs_an_allocation() {
    let mut images: Vec<Image> = MarkerScene::matrix()
        .iter()
        .map(|(_, scene)| scene.draw(1).image)
        .collect();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    // From faint noise over salt of all densities to frames of nothing but noise.
    for bright_share in [0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 0.6] {
        let mut image = Image::filled(324, 244, 0);
        for pixel in image.pixels_mut() {
            let noise: u8 = rng.random_range(0..20);
            let is_bright = rng.random::<f64>() < bright_share;
            *pixel = if is_bright { 255 - noise } else { noise };
        }
        images.push(image);
    }
    let finder = FinderSettings::default();
    let mut camera = CameraMarkers::new(finder, TrackerSettings::default(), 324);
    let mut paper = PaperPipeline::new(PaperPipelineSettings::default());
    let before = ALLOCATION_COUNT.load(Ordering::Relaxed);
    let mut pair_count = 0;
    for (idx, image) in images.iter().cycle().take(3 * images.len()).enumerate() {
        let captured_at = Timestamp::from_nanoseconds(50_000_000 * idx as i64);
        pair_count += camera.see(image, captured_at, None).0.pairs.len();
        pair_count += usize::from(paper.find(image, captured_at).is_some());
    }
    let after = ALLOCATION_COUNT.load(Ordering::Relaxed);
    assert!(pair_count > 100, "{pair_count}");
    assert_eq!(after, before);
}
