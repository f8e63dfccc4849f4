//! The connection to one vehicle.

use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use camera::Image;
use geometry::Timestamp;
use nalgebra::Vector3;

use super::ServeError;
use crate::stream::{self, Fix, Message};

/// How long a client that connected may take to say hello.
const HELLO_TIMEOUT: Duration = Duration::from_secs(5);
/// How long a vehicle that has heard the end may take to leave.
const END_TIMEOUT: Duration = Duration::from_secs(2);

/// A free loopback port for each vehicle.
pub fn listen(vehicle_count: usize) -> Result<Vec<(TcpListener, SocketAddr)>, ServeError> {
    let bind = |_| {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
        let address = listener.local_addr()?;
        Ok((listener, address))
    };
    (0..vehicle_count)
        .map(bind)
        .collect::<io::Result<_>>()
        .map_err(ServeError::Listen)
}

/// The vehicles that connect and say hello in time; the others are `None`.
pub fn await_hellos(
    listeners: Vec<(TcpListener, SocketAddr)>,
    timeout: Duration,
) -> Vec<Option<TcpStream>> {
    let deadline = Instant::now() + timeout;
    let mut streams: Vec<Option<TcpStream>> = listeners.iter().map(|_| None).collect();
    let addresses: Vec<SocketAddr> = listeners.iter().map(|(_, address)| *address).collect();
    thread::scope(|scope| {
        let (sender, arrivals) = channel();
        for (vehicle_idx, (listener, _)) in listeners.into_iter().enumerate() {
            let sender = sender.clone();
            scope.spawn(move || accept_vehicle(&listener, vehicle_idx, deadline, &sender));
        }
        drop(sender);
        while streams.iter().any(Option::is_none) {
            let left = deadline.saturating_duration_since(Instant::now());
            match arrivals.recv_timeout(left) {
                Ok((vehicle_idx, stream)) => streams[vehicle_idx] = Some(stream),
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => break,
            }
        }
        // Whoever still sleeps in accept is woken by a connection that says nothing.
        for (stream, address) in streams.iter().zip(addresses) {
            if stream.is_none() {
                let _ = TcpStream::connect(address);
            }
        }
    });
    streams
}

/// Accepts clients until one says hello; others are closed.
fn accept_vehicle(
    listener: &TcpListener,
    vehicle_idx: usize,
    deadline: Instant,
    arrivals: &Sender<(usize, TcpStream)>,
) {
    while let Ok((stream, _)) = listener.accept() {
        if let Ok(stream) = greet(stream) {
            let _ = arrivals.send((vehicle_idx, stream));
            return;
        }
        if Instant::now() >= deadline {
            return;
        }
    }
}

fn greet(mut stream: TcpStream) -> Result<TcpStream, stream::ReadError> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(HELLO_TIMEOUT))?;
    match stream::read_message(&mut stream)? {
        Message::Hello => {
            stream::write_message(&mut stream, &Message::Hello)?;
            Ok(stream)
        }
        _ => Err(io::Error::from(io::ErrorKind::InvalidData).into()),
    }
}

/// What a socket says after its timeout differs between systems.
fn is_timeout(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut
    )
}

/// A vehicle that said hello. Every error is a reason to give it up.
pub struct Link {
    stream: TcpStream,
    timeout: Duration,
    bytes: Vec<u8>,
}

/// A stream that is read until a deadline, however little comes at a time.
struct Patient<'a> {
    stream: &'a TcpStream,
    deadline: Instant,
}

impl Read for Patient<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = self.deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        self.stream.set_read_timeout(Some(left))?;
        self.stream.read(buffer)
    }
}

impl Link {
    pub fn new(stream: TcpStream, timeout: Duration) -> io::Result<Self> {
        stream.set_write_timeout(Some(timeout))?;
        Ok(Self {
            stream,
            timeout,
            bytes: Vec::new(),
        })
    }

    /// Sends fixes, then a frame.
    pub fn send(
        &mut self,
        fixes: &[Fix],
        captured_at: Timestamp,
        image: &Image,
    ) -> Result<(), String> {
        self.bytes.clear();
        for fix in fixes {
            stream::encode(&Message::Fix(fix.clone()), &mut self.bytes);
        }
        stream::encode_frame(captured_at, image, &mut self.bytes);
        self.stream
            .write_all(&self.bytes)
            .map_err(|error| format!("cannot send: {error}"))
    }

    /// Waits until a frame is acknowledged: the velocity that was commanded because of it, or else
    /// the newest that was commanded since the last one, if any was.
    ///
    /// A vehicle that is slow repeats velocities that decay on its own clock. The simulated clock
    /// stands still meanwhile, so they do not replace what it made of the frame.
    pub fn await_acknowledgement(
        &mut self,
        expected: Timestamp,
    ) -> Result<Option<Vector3<f64>>, String> {
        let mut reader = Patient {
            stream: &self.stream,
            deadline: Instant::now() + self.timeout,
        };
        let (mut because_of_frame, mut newest) = (None, None);
        loop {
            match stream::read_message(&mut reader) {
                Ok(Message::Velocity(command)) => {
                    newest = Some(command.velocity_in_heading);
                    if command.captured_at == expected {
                        because_of_frame = newest;
                    }
                }
                Ok(Message::Acknowledgement { captured_at }) if captured_at == expected => {
                    return Ok(because_of_frame.or(newest));
                }
                Ok(Message::Acknowledgement { captured_at }) => {
                    return Err(format!(
                        "acknowledged the frame of {captured_at}, expected {expected}"
                    ));
                }
                Ok(_) => {
                    return Err("sent something else than a velocity or an acknowledgement".into());
                }
                Err(error) => return Err(self.why_lost(&error, newest.is_some())),
            }
        }
    }

    fn why_lost(&self, error: &stream::ReadError, has_spoken: bool) -> String {
        match error {
            stream::ReadError::Io(error) if is_timeout(error) => {
                let waited_s = self.timeout.as_secs_f64();
                if has_spoken {
                    format!("commanded velocities, but acknowledged nothing for {waited_s:.0} s")
                } else {
                    format!("said nothing for {waited_s:.0} s")
                }
            }
            stream::ReadError::Io(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
                "has left".into()
            }
            error => format!("no acknowledgement: {error}"),
        }
    }

    /// Says that nothing follows. A vehicle that has left already does not need to hear it.
    ///
    /// What it still commands is read away until it leaves: a connection that is closed over
    /// unread bytes may take the last message with it.
    pub fn end(mut self) {
        let _ = stream::write_message(&mut self.stream, &Message::End);
        let _ = self.stream.shutdown(Shutdown::Write);
        let mut reader = Patient {
            stream: &self.stream,
            deadline: Instant::now() + END_TIMEOUT,
        };
        let _ = io::copy(&mut reader, &mut io::sink());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::VelocityCommand;

    /// - `commands`: milliseconds after the frame, and m/s.
    fn check(commands: &[(i64, f64)], expected: Option<f64>) {
        let (listener, address) = listen(1).unwrap().remove(0);
        let mut vehicle = TcpStream::connect(address).unwrap();
        let stream = listener.accept().unwrap().0;
        let mut link = Link::new(stream, Duration::from_secs(20)).unwrap();
        let captured_at = Timestamp::from_nanoseconds(7_000_000_000);
        for (late_ms, speed_mps) in commands {
            let stamp_ns = 7_000_000_000 + late_ms * 1_000_000;
            let command = Message::Velocity(VelocityCommand {
                captured_at: Timestamp::from_nanoseconds(stamp_ns),
                velocity_in_heading: Vector3::x() * *speed_mps,
            });
            stream::write_message(&mut vehicle, &command).unwrap();
        }
        let answer = Message::Acknowledgement { captured_at };
        stream::write_message(&mut vehicle, &answer).unwrap();
        let flown = link.await_acknowledgement(captured_at).unwrap();
        assert_eq!(flown.map(|velocity| velocity.x), expected, "{commands:?}");
    }

    /// Goal: what a vehicle repeats on its wall clock does not count while the simulated clock
    /// stands still. Method: speeds with stamps around that of the frame, in all kinds of order.
    #[test]
    fn the_velocity_because_of_the_frame_flies() {
        check(&[], None);
        check(&[(0, 1.0)], Some(1.0));
        check(&[(0, 1.0), (500, 0.0)], Some(1.0));
        check(&[(-40, 0.3), (0, 1.0), (0, 2.0), (80, 0.5)], Some(2.0));
        check(&[(500, 0.1), (0, 1.0)], Some(1.0));
        check(&[(-40, 0.3), (80, 0.2)], Some(0.2));
    }
}
