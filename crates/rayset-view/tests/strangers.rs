//! Visitors without a browser: those who hold places, fill logs, or come too late.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rayset_view::{Options, SECRET_BYTES, Server};

/// A server that has nothing to show yet, its first invitation, and its log.
fn served() -> (SocketAddr, impl Fn() -> String, Arc<Mutex<Vec<String>>>) {
    let log = Arc::new(Mutex::new(Vec::new()));
    let lines = log.clone();
    let options = Options::new([7; SECRET_BYTES], 0);
    let server = Server::start(options, move |line| lines.lock().expect("no panic").push(line.to_owned()))
        .expect("a port");
    let (address, invite) = (server.address(), server.inviter());
    std::thread::spawn(move || server.run());
    (address, move || invite().expect("a token"), log)
}

/// What is answered to a request, as far as the server says anything.
fn answer(address: SocketAddr, request: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("a connection");
    stream.write_all(request.as_bytes()).expect("it listens");
    let mut text = String::new();
    let _ = stream.set_read_timeout(Some(Duration::from_secs(60)));
    let _ = stream.read_to_string(&mut text);
    text
}

fn get(address: SocketAddr, path: &str, headers: &str) -> String {
    answer(address, &format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n{headers}\r\n"))
}

/// A byte each tenth of a second, until the server has closed the connection, or for a minute.
fn is_closed_while_it_trickles(address: SocketAddr, begin: &str, byte: &[u8]) -> bool {
    let mut stream = TcpStream::connect(address).expect("a connection");
    stream.write_all(begin.as_bytes()).expect("it listens");
    let until = Instant::now() + Duration::from_secs(60);
    let _ = stream.set_read_timeout(Some(Duration::from_millis(100)));
    while Instant::now() < until {
        let written = stream.write_all(byte);
        let mut buffer = [0; 4096];
        match stream.read(&mut buffer) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(error)
                if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) => {}
            Err(_) => return true,
        }
        if written.is_err() {
            return true;
        }
    }
    false
}

#[test]
fn a_request_that_trickles_in_does_not_hold_its_place() {
    let (address, ..) = served();
    let head = format!("GET / HTTP/1.1\r\nHost: {address}\r\nX-Slow: ");
    let body = format!("POST /enter HTTP/1.1\r\nHost: {address}\r\nContent-Length: 4000\r\n\r\npassword=");
    let second = format!("GET /style.css HTTP/1.1\r\nHost: {address}\r\n\r\nGET / HTTP/1.1\r\nX-Slow: ");
    std::thread::scope(|scope| {
        let slow = [("a head", head), ("a body", body), ("a second head", second)];
        let tries = slow.map(|(what, begin)| {
            (what, scope.spawn(move || is_closed_while_it_trickles(address, &begin, b"a")))
        });
        for (what, closed) in tries {
            assert!(closed.join().expect("no panic"), "{what} that trickles in held its place for a minute");
        }
    });
}

#[test]
fn as_many_slow_visitors_as_there_are_places_do_not_keep_others_out_for_long() {
    let (address, ..) = served();
    let crowd: Vec<TcpStream> = (0..128)
        .map(|_| {
            let mut stream = TcpStream::connect(address).expect("a connection");
            stream.write_all(b"GET / HTTP/1.1\r\n").expect("it listens");
            stream
        })
        .collect();
    // They say a byte more often than a silent one would be closed.
    let until = Instant::now() + Duration::from_secs(60);
    let is_served = || get(address, "/style.css", "").starts_with("HTTP/1.1 200");
    while !is_served() {
        assert!(Instant::now() < until, "slow visitors hold all places");
        for mut stream in &crowd {
            let _ = stream.write_all(b"a");
        }
        std::thread::sleep(Duration::from_millis(200));
    }
}

#[test]
fn the_log_of_refused_requests_is_bounded() {
    const REFUSED: usize = 1000;
    let (address, _, log) = served();
    let began = Instant::now();
    for _ in 0..REFUSED {
        assert!(get(address, "/", "").starts_with("HTTP/1.1 403"));
    }
    let lines = log.lock().expect("no panic").len();
    let most = 21 + began.elapsed().as_secs() as usize / 10;
    assert!(lines <= most, "{lines} lines of {REFUSED} refused requests");
    assert!(lines >= 20, "{lines} lines");
}

#[test]
fn a_page_too_many_is_told_why_it_is_not_connected() {
    let (address, invite, _) = served();
    let invitation = invite();
    let path = &invitation[invitation.find("/?").expect("a query")..];
    let welcome = get(address, path, "");
    let cookie = welcome.lines().find_map(|line| line.strip_prefix("set-cookie: ")).expect("a cookie");
    let cookie = cookie.split(';').next().expect("a value").to_owned();
    let socket = || {
        let mut stream = TcpStream::connect(address).expect("a connection");
        let request = format!(
            "GET /socket HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\nCookie: {cookie}\r\nConnection: Upgrade\r\n\
             Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).expect("it listens");
        let _ = stream.set_read_timeout(Some(Duration::from_secs(60)));
        stream
    };
    // What a socket hears first: of those that are served, how far opening is.
    let first = |stream: &mut TcpStream, wanted: &str| {
        let mut heard = Vec::new();
        let mut buffer = [0; 1024];
        while !String::from_utf8_lossy(&heard).contains(wanted) {
            match stream.read(&mut buffer) {
                Ok(count) if count > 0 => heard.extend_from_slice(&buffer[..count]),
                _ => panic!("no {wanted} in {}", String::from_utf8_lossy(&heard)),
            }
        }
    };
    let mut served: Vec<TcpStream> = (0..4).map(|_| socket()).collect();
    served.iter_mut().for_each(|stream| first(stream, "\"opening\""));
    let mut fifth = socket();
    first(&mut fifth, "4 pages are open already");
}
