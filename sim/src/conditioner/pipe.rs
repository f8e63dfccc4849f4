//! One direction of one connection: a reader and a writer thread with a bounded queue between.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use super::{Cut, Traffic};

const PIECE_BYTES: usize = 16 * 1024;
const PIECES_MAX: usize = 15;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    ToServer,
    ToClient,
}

impl Cut {
    fn blocks(self, direction: Direction) -> bool {
        match self {
            Self::Reset | Self::Blackhole => true,
            Self::BlackholeToServer => direction == Direction::ToServer,
            Self::BlackholeToClient => direction == Direction::ToClient,
        }
    }
}

/// What all pipes of a link obey.
pub struct Gate {
    state: Mutex<GateState>,
    changed: Condvar,
}

#[derive(Default)]
struct GateState {
    cut: Option<Cut>,
    closed: bool,
    delay: Duration,
    bandwidth_bytes_per_s: Option<u64>,
    traffic: Traffic,
}

impl Gate {
    pub fn new() -> Self {
        Self {
            state: Mutex::new(GateState::default()),
            changed: Condvar::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, GateState> {
        self.state.lock().expect("no holder of this lock panics")
    }

    fn change(&self, change: impl FnOnce(&mut GateState)) {
        change(&mut self.lock());
        self.changed.notify_all();
    }

    pub fn set_cut(&self, cut: Option<Cut>) {
        self.change(|state| state.cut = cut);
    }

    pub fn set_delay(&self, delay: Duration) {
        self.change(|state| state.delay = delay);
    }

    pub fn set_rate_limit(&self, bandwidth_bytes_per_s: Option<u64>) {
        self.change(|state| state.bandwidth_bytes_per_s = bandwidth_bytes_per_s);
    }

    pub fn close(&self) {
        self.change(|state| state.closed = true);
    }

    pub fn count_connection(&self) {
        self.lock().traffic.connection_count += 1;
    }

    pub fn cut(&self) -> Option<Cut> {
        self.lock().cut
    }

    pub fn is_closed(&self) -> bool {
        self.lock().closed
    }

    pub fn traffic(&self) -> Traffic {
        self.lock().traffic
    }

    fn delay(&self) -> Duration {
        self.lock().delay
    }

    /// Sleeps until a piece may pass, and counts it; false if the pipe ended meanwhile.
    fn pass(&self, direction: Direction, size_bytes: usize, ended: &AtomicBool) -> bool {
        let mut state = self
            .changed
            .wait_while(self.lock(), |state| {
                let blocked = state.cut.is_some_and(|cut| cut.blocks(direction));
                blocked && !state.closed && !ended.load(Ordering::Acquire)
            })
            .expect("no holder of this lock panics");
        if state.closed || ended.load(Ordering::Acquire) {
            return false;
        }
        match direction {
            Direction::ToServer => state.traffic.to_server_bytes += size_bytes as u64,
            Direction::ToClient => state.traffic.to_client_bytes += size_bytes as u64,
        }
        true
    }

    /// How long the link is busy with a piece.
    fn occupation(&self, size_bytes: usize) -> Duration {
        match self.lock().bandwidth_bytes_per_s {
            Some(bandwidth) => Duration::from_secs_f64(size_bytes as f64 / bandwidth.max(1) as f64),
            None => Duration::ZERO,
        }
    }

    /// Sleeps, but wakes when the pipe ends.
    fn sleep_until(&self, moment: Instant, ended: &AtomicBool) {
        let mut state = self.lock();
        loop {
            let left = moment.saturating_duration_since(Instant::now());
            if left.is_zero() || state.closed || ended.load(Ordering::Acquire) {
                return;
            }
            state = self
                .changed
                .wait_timeout(state, left)
                .expect("no holder of this lock panics")
                .0;
        }
    }
}

struct Piece {
    due_at: Instant,
    bytes: Vec<u8>,
}

pub struct Pipe {
    gate: Arc<Gate>,
    ended: Arc<AtomicBool>,
    threads: [JoinHandle<()>; 2],
}

impl Pipe {
    pub fn start(
        source: &TcpStream,
        target: &TcpStream,
        direction: Direction,
        gate: &Arc<Gate>,
    ) -> std::io::Result<Self> {
        let ended = Arc::new(AtomicBool::new(false));
        let (sender, receiver) = sync_channel(PIECES_MAX);
        let reader = {
            let (source, gate) = (source.try_clone()?, Arc::clone(gate));
            thread::Builder::new()
                .name("link-reader".into())
                .spawn(move || read(source, &gate, &sender))?
        };
        let writer = {
            let (target, gate) = (target.try_clone()?, Arc::clone(gate));
            let ended = Arc::clone(&ended);
            thread::Builder::new()
                .name("link-writer".into())
                .spawn(move || write(target, &gate, direction, &receiver, &ended))?
        };
        Ok(Self {
            gate: Arc::clone(gate),
            ended,
            threads: [reader, writer],
        })
    }

    pub fn is_finished(&self) -> bool {
        self.threads.iter().all(JoinHandle::is_finished)
    }

    /// Waits for the threads. The sockets must have been shut down.
    pub fn stop(self) {
        self.gate
            .change(|_| self.ended.store(true, Ordering::Release));
        for thread in self.threads {
            let _ = thread.join();
        }
    }
}

fn read(mut source: TcpStream, gate: &Gate, pieces: &SyncSender<Piece>) {
    let mut buffer = vec![0; PIECE_BYTES];
    loop {
        let size_bytes = match source.read(&mut buffer) {
            Ok(0) | Err(_) => return,
            Ok(size_bytes) => size_bytes,
        };
        let piece = Piece {
            due_at: Instant::now() + gate.delay(),
            bytes: buffer[..size_bytes].to_vec(),
        };
        if pieces.send(piece).is_err() {
            // Nobody can be written to, so nobody may go on sending.
            let _ = source.shutdown(Shutdown::Both);
            return;
        }
    }
}

fn write(
    mut target: TcpStream,
    gate: &Gate,
    direction: Direction,
    pieces: &Receiver<Piece>,
    ended: &AtomicBool,
) {
    for piece in pieces {
        gate.sleep_until(piece.due_at, ended);
        if !gate.pass(direction, piece.bytes.len(), ended) {
            break;
        }
        let free_at = Instant::now() + gate.occupation(piece.bytes.len());
        if target.write_all(&piece.bytes).is_err() {
            break;
        }
        gate.sleep_until(free_at, ended);
    }
    // The end of one direction is passed on; the other may still have something to say.
    let _ = target.shutdown(Shutdown::Write);
}
