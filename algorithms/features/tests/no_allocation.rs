//! Goal: the extractor allocates nothing once it has seen an image of the size.
//! Method: a counting allocator.

#[path = "../../test_support/counting_allocator.rs"]
mod counting_allocator;

use camera::Image;
use features::{Extractor, ExtractorSettings, Features};

use counting_allocator::allocation_count;

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
    let before = allocation_count();
    extractor.extract(&image, &mut features);
    assert_eq!(allocation_count(), before);
}
