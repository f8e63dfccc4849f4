//! The loop's thread: it wakes for every image, and at a fixed rate without one.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use camera::Image;
use geometry::Timestamp;
use keeping::Obstacle;
use nalgebra::Vector3;

use super::keeper::{StationKeeper, StationMoment};

/// Where velocities go: to the autopilot, and beside an image what they come from.
pub trait Outlet: Send {
    /// - `velocity_in_heading`: forward, left, up.
    fn fly(&mut self, now: Timestamp, velocity_in_heading: &Vector3<f64>);

    fn note(&mut self, moment: &StationMoment);

    /// An image made the loop fail; it goes on without what it knew.
    fn fault(&mut self, captured_at: Timestamp);
}

/// The running loop.
pub struct StationLoop<O> {
    window: StationWindow,
    thread: JoinHandle<O>,
}

/// Through it the loop sees. Only the newest image waits; one that was not looked at in time is
/// replaced.
#[derive(Clone)]
pub struct StationWindow {
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    waiting: Option<Waiting>,
    /// Images so far, and how many of them are answered or were replaced.
    shown_count: u64,
    answered_count: u64,
    obstacles: Arc<[Obstacle]>,
    obstacles_at: Timestamp,
    is_closed: bool,
}

/// Where obstacles were so long ago says nothing about where they are from the vehicle.
const OBSTACLES_S: f64 = 1.0;

/// An image, and what was known when it came.
struct Waiting {
    captured_at: Timestamp,
    image: Image,
    obstacles: Arc<[Obstacle]>,
}

/// What the loop wakes up for.
enum Waking {
    /// The image with this number.
    Image(u64, Waiting),
    Beat,
    End,
}

impl<O: Outlet + 'static> StationLoop<O> {
    /// - `period`: a velocity goes out at least so often, from the first image on.
    pub fn start(keeper: StationKeeper, period: Duration, outlet: O) -> Self {
        let window = StationWindow {
            shared: Arc::default(),
        };
        let seen_through = window.clone();
        let thread = std::thread::spawn(move || keep(keeper, period, outlet, &seen_through));
        Self { window, thread }
    }

    pub fn window(&self) -> StationWindow {
        self.window.clone()
    }

    /// Ends the loop; `None` if it has ended before by a fault of its own.
    pub fn finish(self) -> Option<O> {
        self.window.close();
        self.thread.join().ok()
    }
}

fn keep<O: Outlet>(
    mut keeper: StationKeeper,
    period: Duration,
    mut outlet: O,
    window: &StationWindow,
) -> O {
    // Nobody may wait for a loop that has ended, however it did.
    let _closing = Closing(window);
    let fresh = keeper.clone();
    let mut newest: Option<(Timestamp, Instant)> = None;
    let mut next_beat = Instant::now() + period;
    loop {
        match window.wake(next_beat) {
            Waking::End => {
                if let Some((captured_at, at)) = newest {
                    outlet.fly(captured_at.after(at.elapsed()), &Vector3::zeros());
                }
                return outlet;
            }
            Waking::Image(number, waiting) => {
                let captured_at = waiting.captured_at;
                let seen = look(&mut keeper, &fresh, |keeper| {
                    keeper.see(captured_at, &waiting.image, &waiting.obstacles)
                });
                match &seen {
                    Ok(None) => {}
                    Ok(Some(moment)) => {
                        newest = Some((captured_at, Instant::now()));
                        outlet.fly(captured_at, &moment.velocity);
                    }
                    Err(Fault) => {
                        outlet.fly(captured_at, &Vector3::zeros());
                        outlet.fault(captured_at);
                    }
                }
                window.answer(number);
                if let Ok(Some(moment)) = &seen {
                    outlet.note(moment);
                }
            }
            Waking::Beat => {
                next_beat = Instant::now().max(next_beat + period);
                if let Some((captured_at, at)) = newest {
                    let now = captured_at.after(at.elapsed());
                    outlet.fly(now, &keeper.velocity_at(now));
                }
            }
        }
    }
}

/// An image made the keeper panic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Fault;

/// Looks at an image. A keeper that it breaks is thrown away whole, and a fresh one goes on.
pub(super) fn look(
    keeper: &mut StationKeeper,
    fresh: &StationKeeper,
    see: impl FnOnce(&mut StationKeeper) -> Option<StationMoment>,
) -> Result<Option<StationMoment>, Fault> {
    catch_unwind(AssertUnwindSafe(|| see(keeper))).map_err(|_| {
        *keeper = fresh.clone();
        Fault
    })
}

impl StationWindow {
    pub fn show(&self, captured_at: Timestamp, image: Image) {
        let mut state = self.lock();
        let is_known = captured_at - state.obstacles_at <= OBSTACLES_S;
        let obstacles = if is_known {
            Arc::clone(&state.obstacles)
        } else {
            Arc::default()
        };
        state.waiting = Some(Waiting {
            captured_at,
            image,
            obstacles,
        });
        state.shown_count += 1;
        self.shared.changed.notify_all();
    }

    /// Says what is around the vehicle, in its heading frame, the nearest first. Whoever knows may
    /// tell; the loop asks nobody, and forgets what has not been said for a second.
    pub fn tell(&self, now: Timestamp, obstacles: Vec<Obstacle>) {
        let mut state = self.lock();
        state.obstacles = obstacles.into();
        state.obstacles_at = now;
    }

    /// Waits until all that was shown is answered, so that a velocity goes out before the
    /// acknowledgement of its image. The loop waits for no other thread, so this takes as long as
    /// the outlet does.
    pub fn wait_until_answered(&self) {
        let mut state = self.lock();
        while state.answered_count < state.shown_count && !state.is_closed {
            let woken = self.shared.changed.wait(state);
            state = woken.unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn wake(&self, next_beat: Instant) -> Waking {
        let mut state = self.lock();
        loop {
            if state.is_closed {
                return Waking::End;
            }
            if let Some(waiting) = state.waiting.take() {
                return Waking::Image(state.shown_count, waiting);
            }
            let left = next_beat.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Waking::Beat;
            }
            let woken = self.shared.changed.wait_timeout(state, left);
            state = woken.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn answer(&self, number: u64) {
        self.lock().answered_count = number;
        self.shared.changed.notify_all();
    }

    fn close(&self) {
        self.lock().is_closed = true;
        self.shared.changed.notify_all();
    }

    /// A thread that died while it held the lock left nothing half done.
    fn lock(&self) -> MutexGuard<'_, State> {
        let state = self.shared.state.lock();
        state.unwrap_or_else(PoisonError::into_inner)
    }
}

struct Closing<'a>(&'a StationWindow);

impl Drop for Closing<'_> {
    fn drop(&mut self) {
        self.0.close();
    }
}
