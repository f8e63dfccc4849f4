//! Signals as a wish to end, so that what is only known at the end is still written.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

static WISHED: AtomicBool = AtomicBool::new(false);

/// Somebody wished for the end before the work was done.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

/// How often a wait looks whether somebody wishes for the end.
pub const GLANCE: Duration = Duration::from_millis(100);

/// Signals so soon after the first are the same wish: `timeout` sends two at once.
const SAME_WISH: Duration = Duration::from_secs(1);

/// From now on an interrupt, a termination or a hang-up is a wish; one more, a second later or
/// after that, ends the process.
pub fn listen() {
    let mut numbers = vec![signals::INTERRUPT, signals::TERMINATE];
    // Whoever started this with `nohup` wants it to stay.
    if !signals::is_ignored(signals::HANG_UP) {
        numbers.push(signals::HANG_UP);
    }
    wish_on(numbers);
}

/// For a child: Ctrl-C and the end of the terminal reach its parent too, which ends it in order.
/// A termination is meant for this process alone.
pub fn leave_to_parent() {
    signals::ignore(signals::INTERRUPT);
    signals::ignore(signals::HANG_UP);
    wish_on(vec![signals::TERMINATE]);
}

fn wish_on(numbers: Vec<i32>) {
    for number in &numbers {
        signals::wish_on(*number);
    }
    std::thread::spawn(move || {
        while !wished() {
            std::thread::sleep(GLANCE);
        }
        std::thread::sleep(SAME_WISH);
        for number in numbers {
            signals::restore(number);
        }
    });
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

    extern "C" fn wish(_number: i32) {
        super::wish();
    }

    pub fn wish_on(number: i32) {
        let handler: extern "C" fn(i32) = wish;
        // SAFETY: the handler has C's signature for one, and does only what POSIX allows in it:
        // it stores to a lock-free atomic.
        unsafe { signal(number, handler as usize) };
    }

    pub fn ignore(number: i32) {
        // SAFETY: to ignore a signal runs no code of ours.
        unsafe { signal(number, IGNORE) };
    }

    pub fn restore(number: i32) {
        // SAFETY: the default action runs no code of ours.
        unsafe { signal(number, DEFAULT_ACTION) };
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

    pub fn restore(_number: i32) {}

    pub fn is_ignored(_number: i32) -> bool {
        false
    }
}
