//! A link that can be cut: a proxy between a client and a TCP server, in user space.

mod pipe;

use std::io;
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use pipe::{Direction, Gate, Pipe};

/// How a link fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    /// Connections are closed, and new ones are closed as soon as they are made.
    Reset,
    /// Nothing arrives in either direction and nobody is told, as when a radio fades. Bytes on
    /// their way stay in the sockets' buffers and arrive after healing, as with retransmission.
    Blackhole,
    /// The same, but only what the client sends is held back.
    BlackholeToServer,
    /// The same, but only what the server sends is held back.
    BlackholeToClient,
}

/// Bytes that passed since the start, and connections that were made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    pub to_server_bytes: u64,
    pub to_client_bytes: u64,
    pub connection_count: u64,
}

/// A running proxy. It stops when it is dropped.
///
/// Every connection has two threads per direction, all of which sleep in the kernel or on a
/// condition variable; at most 256 KiB a direction are on their way.
pub struct Conditioner {
    address: SocketAddr,
    shared: Arc<Shared>,
    acceptor: Option<JoinHandle<()>>,
}

/// Dead connections are forgotten beyond this number, oldest first.
const CONNECTIONS_KEPT: usize = 64;
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);

struct Shared {
    server: SocketAddr,
    gate: Arc<Gate>,
    connections: Mutex<Vec<Connection>>,
}

struct Connection {
    sockets: [TcpStream; 2],
    pipes: Vec<Pipe>,
}

impl Conditioner {
    /// Listens on `listen` (port 0 finds a free one) and passes connections on to `server`.
    pub fn start(listen: SocketAddr, server: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(listen)?;
        let address = listener.local_addr()?;
        let shared = Arc::new(Shared {
            server,
            gate: Arc::new(Gate::new()),
            connections: Mutex::new(Vec::new()),
        });
        let acceptor = {
            let shared = Arc::clone(&shared);
            thread::Builder::new()
                .name("link-acceptor".into())
                .spawn(move || accept(&listener, &shared))?
        };
        Ok(Self {
            address,
            shared,
            acceptor: Some(acceptor),
        })
    }

    /// Where clients connect.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Breaks the link until [`Conditioner::heal`]. A later cut replaces an earlier one.
    pub fn cut(&self, cut: Cut) {
        self.shared.gate.set_cut(Some(cut));
        if cut == Cut::Reset {
            self.shared.close_connections();
        }
    }

    pub fn heal(&self) {
        self.shared.gate.set_cut(None);
    }

    /// The cut that is in force.
    pub fn cut_in_force(&self) -> Option<Cut> {
        self.shared.gate.cut()
    }

    /// Delays every byte from now on by `delay` in each direction.
    pub fn set_delay(&self, delay: Duration) {
        self.shared.gate.set_delay(delay);
    }

    /// Limits each direction of each connection from now on.
    pub fn set_rate_limit(&self, bandwidth_bytes_per_s: Option<u64>) {
        self.shared.gate.set_rate_limit(bandwidth_bytes_per_s);
    }

    pub fn traffic(&self) -> Traffic {
        self.shared.gate.traffic()
    }
}

impl Drop for Conditioner {
    fn drop(&mut self) {
        self.shared.gate.close();
        // The acceptor sleeps in accept: a connection of our own wakes it.
        let _ = TcpStream::connect_timeout(&self.address, CONNECT_TIMEOUT);
        if let Some(acceptor) = self.acceptor.take() {
            let _ = acceptor.join();
        }
        self.shared.close_connections();
    }
}

impl Shared {
    fn close_connections(&self) {
        let connections = std::mem::take(
            &mut *self
                .connections
                .lock()
                .expect("no holder of this lock panics"),
        );
        for connection in connections {
            connection.close();
        }
    }

    fn connect(self: &Arc<Self>, client: TcpStream) -> io::Result<()> {
        let server = TcpStream::connect_timeout(&self.server, CONNECT_TIMEOUT)?;
        client.set_nodelay(true)?;
        server.set_nodelay(true)?;
        let gate = &self.gate;
        let pipes = vec![
            Pipe::start(&client, &server, Direction::ToServer, gate)?,
            Pipe::start(&server, &client, Direction::ToClient, gate)?,
        ];
        gate.count_connection();
        let mut connections = self
            .connections
            .lock()
            .expect("no holder of this lock panics");
        connections.retain(|connection| !connection.is_finished());
        if connections.len() >= CONNECTIONS_KEPT {
            connections.remove(0).close();
        }
        connections.push(Connection {
            sockets: [client, server],
            pipes,
        });
        Ok(())
    }
}

impl Connection {
    fn is_finished(&self) -> bool {
        self.pipes.iter().all(Pipe::is_finished)
    }

    fn close(self) {
        for socket in &self.sockets {
            // An error means that the other side closed first.
            let _ = socket.shutdown(Shutdown::Both);
        }
        for pipe in self.pipes {
            pipe.stop();
        }
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    for client in listener.incoming() {
        if shared.gate.is_closed() {
            return;
        }
        let Ok(client) = client else { continue };
        if shared.gate.cut() != Some(Cut::Reset) {
            // A server that is not there closes the client, as a refusal would.
            let _ = shared.connect(client);
            // A reset may have come while the connection was being made.
            if shared.gate.cut() == Some(Cut::Reset) {
                shared.close_connections();
            }
        }
    }
}

#[cfg(test)]
mod tests;
