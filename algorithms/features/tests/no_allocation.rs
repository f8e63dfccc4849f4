//! Goal: the extractor allocates nothing once it has seen an image of the size.
//! Method: a counting allocator, alone in this process.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use camera::Image;
use features::{Extractor, ExtractorSettings, Features};

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
fn the_second_image_costs_no_allocation() {
    let mut image = Image::filled(324, 244, 0);
    for (idx, pixel) in image.pixels_mut().iter_mut().enumerate() {
        let tile = (idx % 324 / 13) * 7919 + (idx / 324 / 11) * 104_729;
        *pixel = (tile % 251) as u8;
    }
    let mut extractor = Extractor::new(ExtractorSettings::default());
    let mut features = Features::default();
    extractor.extract(&image, &mut features);
    assert!(features.len() > 300, "{}", features.len());
    let before = ALLOCATION_COUNT.load(Ordering::Relaxed);
    extractor.extract(&image, &mut features);
    assert_eq!(ALLOCATION_COUNT.load(Ordering::Relaxed), before);
}
