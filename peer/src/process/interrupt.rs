//! Signals as a wish to end, so that what is only known at the end is still written.

use std::sync::atomic::{AtomicBool, Ordering};

static WISHED: AtomicBool = AtomicBool::new(false);

/// Somebody wished for the end before the work was done.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

/// From now on the first interrupt, termination or hang-up is a wish; a second one of the same
/// kind ends the process.
pub fn listen() {
    signals::wish_on(signals::INTERRUPT);
    signals::wish_on(signals::TERMINATE);
    // Whoever started this with `nohup` wants it to stay.
    if !signals::is_ignored(signals::HANG_UP) {
        signals::wish_on(signals::HANG_UP);
    }
}

/// For a child: Ctrl-C and the end of the terminal reach its parent too, which ends it in order.
/// A termination is meant for this process alone.
pub fn leave_to_parent() {
    signals::ignore(signals::INTERRUPT);
    signals::ignore(signals::HANG_UP);
    signals::wish_on(signals::TERMINATE);
}

/// Wishes for the end.
pub fn wish() {
    WISHED.store(true, Ordering::Relaxed);
}

/// Whether somebody wished for the end.
pub fn wished() -> bool {
    WISHED.load(Ordering::Relaxed)
}

/// What [`wished`] reads.
pub fn flag() -> &'static AtomicBool {
    &WISHED
}

#[cfg(unix)]
mod signals {
    pub const HANG_UP: i32 = 1;
    pub const INTERRUPT: i32 = 2;
    pub const TERMINATE: i32 = 15;

    const DEFAULT_ACTION: usize = 0;
    const IGNORE: usize = 1;

    unsafe extern "C" {
        fn signal(number: i32, action: usize) -> usize;
    }

    extern "C" fn wish(number: i32) {
        super::wish();
        // SAFETY: POSIX allows `signal` in a handler.
        unsafe { signal(number, DEFAULT_ACTION) };
    }

    pub fn wish_on(number: i32) {
        let handler: extern "C" fn(i32) = wish;
        // SAFETY: the handler has C's signature for one, and does only what POSIX allows in it:
        // it stores to a lock-free atomic and calls `signal`.
        unsafe { signal(number, handler as usize) };
    }

    pub fn ignore(number: i32) {
        // SAFETY: to ignore a signal runs no code of ours.
        unsafe { signal(number, IGNORE) };
    }

    /// Asked by ignoring it for a moment, in which nothing has been started yet.
    pub fn is_ignored(number: i32) -> bool {
        // SAFETY: as above; what `signal` returned is what it takes.
        unsafe {
            let before = signal(number, IGNORE);
            signal(number, before);
            before == IGNORE
        }
    }
}

#[cfg(not(unix))]
mod signals {
    pub const HANG_UP: i32 = 1;
    pub const INTERRUPT: i32 = 2;
    pub const TERMINATE: i32 = 15;

    pub fn wish_on(_number: i32) {}

    pub fn ignore(_number: i32) {}

    pub fn is_ignored(_number: i32) -> bool {
        false
    }
}
