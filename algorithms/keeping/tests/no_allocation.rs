//! Goal: a step of either rule allocates nothing, not even the first.
//! Method: a counting allocator, alone in this process.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use keeping::{
    FieldOfView, Keeper, KeeperSettings, Obstacle, PaperRule, PaperRuleSettings, Perception,
    Placed, Range, Sighting,
};
use nalgebra::Vector3;

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

/// More neighbours than are followed, so that the full lists are exercised too.
const NEIGHBOUR_COUNT: usize = 200;

#[test]
fn no_step_costs_an_allocation() {
    let sightings: Vec<Sighting> = (0..NEIGHBOUR_COUNT)
        .map(|idx| {
            let (angle_rad, height) = (2.4 * idx as f64, idx as f64 / 100.0 - 1.0);
            let across = (1.0 - height * height).max(0.0).sqrt();
            let range_m = 1.5 + 0.03 * idx as f64;
            Sighting {
                direction: Vector3::new(across * angle_rad.cos(), across * angle_rad.sin(), height),
                range: Range {
                    expected_m: Some(range_m),
                    low_m: 0.9 * range_m,
                    high_m: 1.1 * range_m,
                },
            }
        })
        .collect();
    let obstacles = [Obstacle {
        direction: Vector3::x(),
        clearance_m: 1.0,
    }];
    let views = [FieldOfView::all_but_rear()];
    let rule = PaperRule::new(PaperRuleSettings::default());
    let mut keeper = Keeper::new(KeeperSettings::default());
    let before = ALLOCATION_COUNT.load(Ordering::Relaxed);
    for step in 0..10 {
        keeper.step(
            &Perception {
                sightings: &sightings,
                obstacles: &obstacles,
                views: &views,
                heading_rad: 0.1 * f64::from(step),
                velocity: Vector3::x(),
                nominal_mps: 1.0,
            },
            0.1,
        );
        rule.correction(sightings.iter().map(|sighting| Placed {
            direction: sighting.direction,
            range_m: sighting.range.low_m,
        }));
    }
    assert_eq!(ALLOCATION_COUNT.load(Ordering::Relaxed), before);
}
