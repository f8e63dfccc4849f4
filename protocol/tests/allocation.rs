//! Decoding allocates in proportion to the bytes that came, whatever lengths they claim.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

struct Counting;

static LARGEST_BYTES: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call is handed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST_BYTES.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Each case claims a length of 2³² or more right where a list, a text or an array is expected.
#[test]
fn claimed_lengths_allocate_nothing() {
    let version = b"gversion\x82\x01\x00";
    let heads: [&[u8]; 4] = [
        b"\x9b\x00\x00\x00\x01\x00\x00\x00\x00",
        b"\x7b\x00\x00\x00\x01\x00\x00\x00\x00",
        b"\x5b\x00\x00\x00\x01\x00\x00\x00\x00",
        b"\xd8\x45\x5b\x00\x00\x00\x01\x00\x00\x00\x00",
    ];
    let fields: [&[u8]; 9] = [
        b"hreplaces",
        b"jprovenance",
        b"gentries",
        b"fchunks",
        b"dheld",
        b"fpoints",
        b"fanchor",
        b"isignature",
        b"gunknown",
    ];
    for field in fields {
        for head in heads {
            let bytes = [b"\xa2", &version[..], field, head, b"\x00\x00"].concat();
            LARGEST_BYTES.store(0, Ordering::Relaxed);
            assert!(protocol::decode::<protocol::Chunk>(&bytes).is_err());
            assert!(protocol::decode::<protocol::Manifest>(&bytes).is_err());
            assert!(protocol::decode::<protocol::Have>(&bytes).is_err());
            assert!(protocol::decode::<protocol::Placement>(&bytes).is_err());
            let largest_bytes = LARGEST_BYTES.load(Ordering::Relaxed);
            // The decoder's own buffer has 4 KiB.
            assert!(
                largest_bytes <= 8192,
                "{largest_bytes} for {:?}",
                str::from_utf8(field)
            );
        }
    }
}
