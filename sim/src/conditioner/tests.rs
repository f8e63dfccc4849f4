use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use super::*;

/// Long against scheduling on a busy machine, short against a test suite.
const QUIET: Duration = Duration::from_millis(200);

fn loopback() -> SocketAddr {
    (Ipv4Addr::LOCALHOST, 0).into()
}

/// A server that returns every byte, for as many connections as come.
fn echo_server() -> SocketAddr {
    let listener = TcpListener::bind(loopback()).unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            thread::spawn(move || {
                let mut buffer = [0; 4096];
                while let Ok(size_bytes @ 1..) = stream.read(&mut buffer) {
                    if stream.write_all(&buffer[..size_bytes]).is_err() {
                        return;
                    }
                }
            });
        }
    });
    address
}

fn link() -> Conditioner {
    Conditioner::start(loopback(), echo_server()).unwrap()
}

fn client(link: &Conditioner) -> TcpStream {
    let stream = TcpStream::connect(link.address()).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(10)))
        .unwrap();
    stream
}

fn echo(stream: &mut TcpStream, bytes: &[u8]) -> io::Result<Vec<u8>> {
    stream.write_all(bytes)?;
    let mut answer = vec![0; bytes.len()];
    stream.read_exact(&mut answer)?;
    Ok(answer)
}

fn assert_silent(stream: &mut TcpStream) {
    stream.set_read_timeout(Some(QUIET)).unwrap();
    let error = stream.read(&mut [0; 16]).unwrap_err();
    assert!(matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut
    ));
    stream
        .set_read_timeout(Some(Duration::from_secs(10)))
        .unwrap();
}

#[test]
fn passes_and_counts_bytes() {
    let link = link();
    let mut stream = client(&link);
    let bytes: Vec<u8> = (0..100_000_u32).map(|value| value as u8).collect();
    let mut writer = stream.try_clone().unwrap();
    let sent = bytes.clone();
    let sender = thread::spawn(move || writer.write_all(&sent).unwrap());
    let mut answer = vec![0; bytes.len()];
    stream.read_exact(&mut answer).unwrap();
    sender.join().unwrap();
    assert!(answer == bytes);
    let expected = Traffic {
        to_server_bytes: 100_000,
        to_client_bytes: 100_000,
        connection_count: 1,
    };
    assert_eq!(link.traffic(), expected);
}

#[test]
fn a_blackhole_keeps_the_connection_and_its_bytes() {
    let link = link();
    let mut stream = client(&link);
    assert_eq!(echo(&mut stream, b"before").unwrap(), b"before");
    link.cut(Cut::Blackhole);
    assert_eq!(link.cut_in_force(), Some(Cut::Blackhole));
    stream.write_all(b"during").unwrap();
    assert_silent(&mut stream);
    link.heal();
    let mut answer = [0; 6];
    stream.read_exact(&mut answer).unwrap();
    assert_eq!(&answer, b"during");
    assert_eq!(link.traffic().connection_count, 1);
}

#[test]
fn a_blackhole_can_be_one_way() {
    let link = link();
    let mut stream = client(&link);
    assert_eq!(echo(&mut stream, b"hello").unwrap(), b"hello");
    link.cut(Cut::BlackholeToClient);
    stream.write_all(b"there").unwrap();
    assert_silent(&mut stream);
    let traffic = link.traffic();
    assert_eq!((traffic.to_server_bytes, traffic.to_client_bytes), (10, 5));
    link.heal();
    let mut answer = [0; 5];
    stream.read_exact(&mut answer).unwrap();
    assert_eq!(&answer, b"there");
}

#[test]
fn a_reset_ends_connections_and_refuses_new_ones_until_healed() {
    let link = link();
    let mut stream = client(&link);
    assert_eq!(echo(&mut stream, b"before").unwrap(), b"before");
    link.cut(Cut::Reset);
    assert!(echo(&mut stream, b"after").is_err());
    assert!(echo(&mut client(&link), b"again").is_err());
    link.heal();
    assert_eq!(echo(&mut client(&link), b"healed").unwrap(), b"healed");
}

#[test]
fn a_reset_ends_what_a_blackhole_held() {
    let link = link();
    let mut stream = client(&link);
    assert_eq!(echo(&mut stream, b"before").unwrap(), b"before");
    link.cut(Cut::Blackhole);
    stream.write_all(b"held").unwrap();
    assert_silent(&mut stream);
    link.cut(Cut::Reset);
    assert!(matches!(stream.read(&mut [0; 16]), Ok(0) | Err(_)));
}

#[test]
fn delay_and_rate_limit_take_their_time() {
    let link = link();
    let mut stream = client(&link);
    link.set_delay(Duration::from_millis(60));
    let start = Instant::now();
    assert_eq!(echo(&mut stream, b"slow").unwrap(), b"slow");
    assert!(start.elapsed() >= Duration::from_millis(120));
    link.set_delay(Duration::ZERO);
    link.set_rate_limit(Some(20_000));
    let start = Instant::now();
    for _ in 0..3 {
        echo(&mut stream, &[7; 1000]).unwrap();
    }
    // The link is busy for 50 ms after each of the first two thousand bytes that come back.
    assert!(start.elapsed() >= Duration::from_millis(100));
}

#[test]
fn the_end_of_a_stream_is_passed_on() {
    let link = link();
    let mut stream = client(&link);
    stream.write_all(b"last words").unwrap();
    stream.shutdown(Shutdown::Write).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    assert_eq!(answer, b"last words");
}

#[test]
fn stops_while_everything_is_stuck() {
    let link = link();
    let mut stream = client(&link);
    assert_eq!(echo(&mut stream, b"before").unwrap(), b"before");
    link.cut(Cut::Blackhole);
    stream.write_all(b"held").unwrap();
    let start = Instant::now();
    drop(link);
    assert!(start.elapsed() < Duration::from_secs(5));
    assert!(matches!(stream.read(&mut [0; 16]), Ok(0) | Err(_)));
}

#[test]
fn a_server_that_is_not_there_ends_the_client() {
    let gone = TcpListener::bind(loopback()).unwrap().local_addr().unwrap();
    let link = Conditioner::start(loopback(), gone).unwrap();
    let mut stream = client(&link);
    assert!(matches!(stream.read(&mut [0; 16]), Ok(0) | Err(_)));
    assert_eq!(link.traffic().connection_count, 0);
}
