//! A web server of ranges of objects that is as slow, and as wrong, as a test or a measurement
//! wants.

use std::collections::{HashMap, HashSet};
use std::convert::Infallible;
use std::net::SocketAddr;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::{DefaultBodyLimit, Path, RawQuery, State};
use axum::http::{HeaderMap, Method, Response, StatusCode};
use bytes::Bytes;
use futures_util::stream;
use rayset::storage::{FileStorage, MemoryStorage, Storage};
use rayset_lab::simulated::Rate;

#[path = "bucket.rs"]
mod bucket;

/// How the server behaves.
#[derive(Clone, Debug, Default)]
pub(crate) struct Behaviour {
    /// Time before every answer.
    pub latency: Duration,
    /// Part of the latency by which it is longer or shorter, at random.
    pub jitter: f64,
    /// Share of the requests that are answered by 500.
    pub failing: f64,
    /// The most requests a second that are answered; those beyond are answered by 503. All are
    /// answered if this is 0.
    pub rate: f64,
    /// Share of the requests that take so much longer.
    pub slow: (f64, Duration),
    /// Share of the answers that are cut off in the middle.
    pub cut: f64,
    /// What every request is answered by, instead of what it asks for.
    pub refuses: Option<u16>,
    /// The session token of credentials that have expired; requests with it are refused as S3
    /// refuses them.
    pub expired: Option<String>,
    /// Where the objects whose names begin so are: what stands before the rest of their names
    /// there.
    pub redirects: Option<(String, String)>,
    /// What every refusal says besides.
    pub says: String,
    /// Names of deviations: `no-tags` (and no dates), `weak-tags`, `no-ranges`, `no-head`, `short`
    /// and `long` (the length that is announced is not that of what is sent), `too-few` (half of
    /// what was asked for, and said to be all), `other-range` (another range than the one asked for
    /// is sent), `silent` (requests are taken and never answered).
    pub odd: HashSet<&'static str>,
}

/// What happens when a number of requests have come.
#[derive(Clone)]
pub(crate) enum Event {
    /// The server behaves otherwise.
    Behave(Behaviour),
    /// Another object takes the place of one.
    Put(String, Vec<u8>),
}

/// An object, and the number of those that were there before it.
type Versioned = (Arc<dyn Storage>, u64);

/// The objects of a server, and how it behaves; both may be changed while it serves.
#[derive(Default)]
pub(crate) struct Objects {
    objects: Mutex<HashMap<String, Versioned>>,
    uploads: Mutex<bucket::Uploads>,
    folder: Option<PathBuf>,
    behaviour: Mutex<Behaviour>,
    /// What is to happen, and after how many more requests.
    next: Mutex<Option<(u64, Event)>>,
    random: AtomicU64,
    rate: Mutex<Rate>,
    /// What came: the method, the name, the query, the headers and the beginning of the body of
    /// each request.
    pub heard: Mutex<Vec<String>>,
    /// Requests that came, of every kind.
    pub requests: AtomicU64,
    /// Requests that were answered, those for the head alone left out.
    pub reads: AtomicU64,
    /// Bytes of the bodies of answers.
    pub bytes: AtomicU64,
    /// Requests that were answered by 500.
    pub failed: AtomicU64,
    /// Requests beyond the rate.
    pub refused: AtomicU64,
    /// Requests that took longer.
    pub slowed: AtomicU64,
    /// Answers that were cut off.
    pub cut: AtomicU64,
}

/// A server that runs until it is dropped.
pub(crate) struct RangeServer {
    /// The objects.
    pub objects: Arc<Objects>,
    /// Where it listens.
    pub address: SocketAddr,
    _runtime: tokio::runtime::Runtime,
}

impl RangeServer {
    /// Serves objects of memory, and the files of a folder, at a port of this machine.
    pub(crate) fn start(folder: Option<PathBuf>, port: u16, behaviour: Behaviour) -> std::io::Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
        let objects = Arc::new(Objects { folder, behaviour: Mutex::new(behaviour), ..Objects::default() });
        let listener = runtime.block_on(tokio::net::TcpListener::bind(("127.0.0.1", port)))?;
        let address = listener.local_addr()?;
        let routes = Router::new().route("/{*name}", axum::routing::any(answer));
        let service = routes.layer(DefaultBodyLimit::disable()).with_state(objects.clone());
        runtime.spawn(async move { axum::serve(listener, service).await });
        Ok(Self { objects, address, _runtime: runtime })
    }

    /// The address of an object.
    pub(crate) fn address_of(&self, name: &str) -> String {
        format!("http://{}/{name}", self.address)
    }

    /// Adds an object, or puts another one in its place.
    pub(crate) fn put(&self, name: &str, content: Vec<u8>) {
        self.objects.put(name, content);
    }

    /// Behaves otherwise from now on.
    pub(crate) fn behave(&self, behaviour: Behaviour) {
        *self.objects.behaviour.lock().expect("no panic") = behaviour;
    }

    /// Lets something happen before a request is answered: the next one, if `requests` is 0.
    pub(crate) fn after(&self, requests: u64, event: Event) {
        *self.objects.next.lock().expect("no panic") = Some((requests, event));
    }

    /// The names of the objects of memory, and the number of uploads that are under way.
    pub(crate) fn held(&self) -> (Vec<String>, usize) {
        let objects = self.objects.objects.lock().expect("no panic");
        let mut names: Vec<String> = objects.keys().cloned().collect();
        names.sort();
        (names, self.objects.uploads.lock().expect("no panic").under_way())
    }
}

impl Objects {
    fn put(&self, name: &str, content: Vec<u8>) {
        let mut objects = self.objects.lock().expect("no panic");
        let version = objects.get(name).map_or(1, |(_, version)| version + 1);
        objects.insert(name.to_owned(), (Arc::new(MemoryStorage::new(Arc::new(content))), version));
    }

    fn find(&self, name: &str) -> Option<Versioned> {
        if let Some(found) = self.objects.lock().expect("no panic").get(name) {
            return Some(found.clone());
        }
        let is_plain = !name.split('/').any(|part| part == "..");
        let path = self.folder.as_ref().filter(|_| is_plain)?.join(name);
        let changed = path.metadata().ok()?.modified().ok()?;
        let version = changed.duration_since(std::time::UNIX_EPOCH).ok()?.as_nanos() as u64;
        Some((Arc::new(FileStorage::open(&path, false).ok()?), version))
    }

    /// A request has come.
    fn count_down(&self) {
        let mut next = self.next.lock().expect("no panic");
        match next.take() {
            Some((0, Event::Behave(behaviour))) => *self.behaviour.lock().expect("no panic") = behaviour,
            Some((0, Event::Put(name, content))) => self.put(&name, content),
            Some((left, event)) => *next = Some((left - 1, event)),
            None => {}
        }
    }

    /// A number from 0 to 1: the same sequence in every run.
    fn random(&self) -> f64 {
        let mut bits = self.random.fetch_add(0x9e37_79b9_7f4a_7c15, Ordering::Relaxed);
        for shift in [30, 27, 31] {
            bits = (bits ^ bits >> shift).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        }
        (bits >> 11) as f64 / (1_u64 << 53) as f64
    }
}

async fn answer(
    State(objects): State<Arc<Objects>>,
    Path(name): Path<String>,
    RawQuery(query): RawQuery,
    method: Method,
    headers: HeaderMap,
    sent: Bytes,
) -> Response<Body> {
    objects.requests.fetch_add(1, Ordering::Relaxed);
    objects.count_down();
    let begins = String::from_utf8_lossy(&sent[..sent.len().min(100)]);
    let heard = format!("{method} {name} {query:?} {headers:?} {begins}");
    objects.heard.lock().expect("no panic").push(heard);
    let behaviour = objects.behaviour.lock().expect("no panic").clone();
    let shaken = 1.0 + behaviour.jitter * (2.0 * objects.random() - 1.0);
    let mut pause = behaviour.latency.mul_f64(shaken);
    if objects.random() < behaviour.slow.0 {
        objects.slowed.fetch_add(1, Ordering::Relaxed);
        pause += behaviour.slow.1;
    }
    let is_admitted = objects.rate.lock().expect("no panic").admits(behaviour.rate);
    tokio::time::sleep(pause).await;
    if !is_admitted {
        objects.refused.fetch_add(1, Ordering::Relaxed);
        return status(503);
    }
    if behaviour.odd.contains("silent") {
        return std::future::pending().await;
    }
    if let Some(code) = behaviour.refuses {
        let body = if method == Method::HEAD { String::new() } else { behaviour.says };
        return Response::builder().status(code).body(Body::from(body)).expect("an answer");
    }
    if let Some((from, to)) = &behaviour.redirects
        && let Some(rest) = name.strip_prefix(from.as_str())
    {
        let to = format!("{to}{rest}");
        return Response::builder()
            .status(307)
            .header("location", to)
            .body(Body::empty())
            .expect("an answer");
    }
    let is_head = method == Method::HEAD;
    if is_head && behaviour.odd.contains("no-head") {
        return status(405);
    }
    let token = headers.get("x-amz-security-token").and_then(|value| value.to_str().ok());
    if behaviour.expired.is_some() && token == behaviour.expired.as_deref() {
        let body = "<?xml version=\"1.0\"?><Error><Code>ExpiredToken</Code><Message>The provided token has expired.\
                    </Message></Error>";
        let body = if is_head { Body::empty() } else { Body::from(body) };
        return Response::builder().status(400).body(body).expect("an answer");
    }
    if objects.random() < behaviour.failing {
        objects.failed.fetch_add(1, Ordering::Relaxed);
        return status(500);
    }
    if !is_head && method != Method::GET {
        return bucket::write(&objects, &name, &query.unwrap_or_default(), &method, sent);
    }
    let Some((object, version)) = objects.find(&name) else { return status(404) };
    let (weak, none) = (behaviour.odd.contains("weak-tags"), behaviour.odd.contains("no-tags"));
    let tag = format!("{}\"{version}\"", if weak { "W/" } else { "" });
    let wanted = headers.get("if-match").and_then(|value| value.to_str().ok());
    if wanted.is_some_and(|wanted| weak || none || wanted != tag) {
        return status(412);
    }
    let length = object.length().expect("a length");
    let range =
        headers.get("range").and_then(|value| value.to_str().ok()).and_then(|text| parse(text, length));
    let range = range.filter(|_| !behaviour.odd.contains("no-ranges"));
    if range.as_ref().is_some_and(|range| range.start >= length) {
        return status(416);
    }
    let mut response = Response::builder().header("accept-ranges", "bytes");
    if !none {
        response = response.header("etag", tag);
    }
    let mut sent = range.clone().unwrap_or(0..length);
    if range.is_some() {
        if behaviour.odd.contains("other-range") {
            sent = sent.start + 1..sent.end.min(length - 1) + 1;
        }
        let said = format!("bytes {}-{}/{length}", sent.start, sent.end - 1);
        response = response.status(StatusCode::PARTIAL_CONTENT).header("content-range", said);
    }
    if is_head {
        return response.header("content-length", length).body(Body::empty()).expect("an answer");
    }
    objects.reads.fetch_add(1, Ordering::Relaxed);
    body(&objects, &behaviour, &*object, sent, response)
}

fn status(code: u16) -> Response<Body> {
    let status = StatusCode::from_u16(code).expect("a status");
    Response::builder().status(status).body(Body::from(format!("{status}"))).expect("an answer")
}

fn body(
    objects: &Objects,
    behaviour: &Behaviour,
    object: &dyn Storage,
    range: Range<u64>,
    response: axum::http::response::Builder,
) -> Response<Body> {
    let mut content = vec![0; (range.end - range.start) as usize];
    object.read_exact_at(&mut content, range.start).expect("its bytes");
    objects.bytes.fetch_add(content.len() as u64, Ordering::Relaxed);
    if behaviour.odd.contains("too-few") {
        content.truncate(content.len() / 2);
    }
    let announced = content.len();
    if behaviour.odd.contains("long") {
        content.extend_from_slice(&[0xab; 100]);
        return response.body(Body::from(content)).expect("an answer");
    }
    if objects.random() < behaviour.cut || behaviour.odd.contains("short") {
        objects.cut.fetch_add(1, Ordering::Relaxed);
        content.truncate(announced / 2);
        // A stream that ends early: the connection is closed.
        let parts =
            [Ok::<_, std::io::Error>(Bytes::from(content)), Err(std::io::ErrorKind::ConnectionReset.into())];
        let body = Body::from_stream(stream::iter(parts));
        return response.header("content-length", announced).body(body).expect("an answer");
    }
    let parts: Vec<Result<Bytes, Infallible>> =
        content.chunks(256 << 10).map(|part| Ok(Bytes::copy_from_slice(part))).collect();
    let body = Body::from_stream(stream::iter(parts));
    response.header("content-length", announced).body(body).expect("an answer")
}

fn parse(text: &str, length: u64) -> Option<Range<u64>> {
    let (start, end) = text.strip_prefix("bytes=")?.split_once('-')?;
    let end = end.parse::<u64>().map_or(length, |last| last.saturating_add(1));
    Some(start.parse().ok()?..end.min(length))
}
