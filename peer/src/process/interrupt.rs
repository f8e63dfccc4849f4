//! Ctrl-C as a wish to end, so that what is only known at the end is still written.

use std::sync::atomic::{AtomicBool, Ordering};

static WISHED: AtomicBool = AtomicBool::new(false);

/// From now on the first interrupt or termination is a wish; a second one ends the process.
#[cfg(unix)]
pub fn listen() {
    const INTERRUPT: i32 = 2;
    const TERMINATE: i32 = 15;
    const DEFAULT_ACTION: usize = 0;

    unsafe extern "C" {
        fn signal(number: i32, action: usize) -> usize;
    }

    extern "C" fn wish(number: i32) {
        WISHED.store(true, Ordering::Relaxed);
        // SAFETY: POSIX allows `signal` in a handler.
        unsafe { signal(number, DEFAULT_ACTION) };
    }

    let handler: extern "C" fn(i32) = wish;
    for number in [INTERRUPT, TERMINATE] {
        // SAFETY: the handler has C's signature for one, and does only what POSIX allows in it:
        // it stores to a lock-free atomic and calls `signal`.
        unsafe { signal(number, handler as usize) };
    }
}

#[cfg(not(unix))]
pub fn listen() {}

/// Whether somebody wished for the end.
pub fn wished() -> bool {
    WISHED.load(Ordering::Relaxed)
}
