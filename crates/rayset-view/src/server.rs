//! The server: the page and its socket, for those who may look.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use axum::Router;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Query, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::get;
use rayset::Session;
use tokio::net::TcpListener;
use tokio::sync::mpsc;

use crate::access::{Access, Refusal, SECRET_BYTES};
use crate::compose::{Opened, Subject};
use crate::connections::Limited;
use crate::frames::{Frames, Outgoing};
use crate::page;
use crate::protocol::{FromPage, MOST_MESSAGE_BYTES, ToPage};
use crate::rate::Rate;
use crate::wanted::Wanted;

/// Most pages that are connected at a time.
const MOST_PAGES: usize = 4;
/// Bytes that a page's picture takes for each of its pixels: as it is shown, its distances, on its way.
const PIXEL_BYTES: u64 = 14;
/// Messages that wait for a page, besides frames, of which at most two are under way.
const MESSAGES_WAITING: usize = 4;
/// Between pings, which keep a page that rests from being taken for one that has gone.
const BETWEEN_PINGS: Duration = Duration::from_secs(10);
/// A page that takes longer than this for a message has gone.
const PATIENCE: Duration = Duration::from_secs(20);
/// What the page may do: run its own scripts, show its own pictures, speak to this server, and nothing else.
const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; \
    connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// How to serve.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Options {
    /// The port on 127.0.0.1; 0 for any that is free.
    pub port: u16,
    /// Names besides those of this machine, with or without a port, under which a proxy may be reached.
    pub allowed_hosts: Vec<String>,
    /// Bytes for the pictures of all pages together.
    pub picture_bytes: u64,
    /// What cookies are signed with. Kept from one run to the next, it lets pages connect again.
    pub key: [u8; SECRET_BYTES],
}

impl Options {
    /// Options with a key, on a port, with 64 MiB for pictures.
    #[must_use]
    pub fn new(key: [u8; SECRET_BYTES], port: u16) -> Self {
        Self { port, allowed_hosts: Vec::new(), picture_bytes: 64 << 20, key }
    }
}

/// Why there is no server.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// The port cannot be had.
    #[error("cannot listen on {address}: {source}; --port says another one")]
    Listen {
        /// Where.
        address: SocketAddr,
        /// The system's reason.
        source: io::Error,
    },
    /// The scene cannot be shown.
    #[error("{0}")]
    Scene(String),
    /// The system refused something else.
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// A server that listens, and serves once it is [`run`](Self::run).
pub struct Server {
    runtime: tokio::runtime::Runtime,
    listener: TcpListener,
    shared: Arc<Shared>,
    address: SocketAddr,
}

/// What all connections share.
struct Shared {
    access: Access,
    session: Session,
    opened: Arc<Opened>,
    /// The most pixels of a page's picture.
    most_pixels: u64,
    hello: ToPage,
    pages: AtomicUsize,
    log: Box<dyn Fn(&str) + Send + Sync>,
}

impl Server {
    /// Listens on 127.0.0.1, and opens the scene once, so that mistakes in it are known before a page is opened. `log` is
    /// given a line for every visitor who is refused.
    ///
    /// # Errors
    /// [`ServeError`] if the port cannot be had or the scene cannot be read.
    pub fn start(
        subject: Subject,
        session: Session,
        options: Options,
        log: impl Fn(&str) + Send + Sync + 'static,
    ) -> Result<Self, ServeError> {
        let most_pixels = options.picture_bytes / MOST_PAGES as u64 / PIXEL_BYTES;
        let opened = Arc::new(Opened::new(subject).map_err(ServeError::Scene)?);
        let hello = ToPage::Hello {
            title: opened.subject.title.clone(),
            camera: opened.camera,
            bounds: [opened.bounds.min.to_array(), opened.bounds.max.to_array()],
            scene: Box::new(opened.subject.scene.clone()),
            most_pixels,
        };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let address = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), options.port);
        let listener = runtime
            .block_on(TcpListener::bind(address))
            .map_err(|source| ServeError::Listen { address, source })?;
        let address = listener.local_addr()?;
        let access = Access::new(options.key, address.port(), options.allowed_hosts);
        let pages = AtomicUsize::new(0);
        let shared = Shared { access, session, opened, most_pixels, hello, pages, log: Box::new(log) };
        Ok(Self { runtime, listener, shared: Arc::new(shared), address })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// An address that opens a page, once.
    ///
    /// # Errors
    /// The system's error, if it has no random numbers.
    pub fn invitation(&self) -> io::Result<String> {
        Ok(format!("http://{}/?token={}", self.address, self.shared.access.issue()?))
    }

    /// What issues further invitations, from any thread.
    pub fn inviter(&self) -> impl Fn() -> io::Result<String> + Send + Sync + 'static + use<> {
        let (shared, address) = (self.shared.clone(), self.address);
        move || Ok(format!("http://{address}/?token={}", shared.access.issue()?))
    }

    /// Serves until the process ends.
    ///
    /// # Errors
    /// The system's error.
    pub fn run(self) -> io::Result<()> {
        let router = Router::new()
            .route("/", get(index))
            .route("/socket", get(socket))
            .route("/{file}", get(asset))
            .fallback(async || StatusCode::NOT_FOUND)
            .layer(middleware::from_fn_with_state(self.shared.clone(), guard))
            .with_state(self.shared);
        self.runtime.block_on(axum::serve(Limited::new(self.listener), router).into_future())
    }
}

impl Shared {
    /// The answer to somebody who may not look.
    fn refuse(&self, refusal: Refusal, path: &str) -> Response {
        // A path may hold anything; a line holds what a terminal shows.
        let path: String = path.chars().take(60).map(|c| if c.is_control() { '?' } else { c }).collect();
        (self.log)(&format!("refused a request for {path}: {refusal}"));
        let what =
            "Not for you, or no longer: open an address that `rayset view` has printed, each works once.\n";
        (StatusCode::FORBIDDEN, what).into_response()
    }
}

/// Checks every request, and says in every answer what its page may do.
async fn guard(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let path = request.uri().path().to_owned();
    let mut response = match shared.access.check_host(request.headers()) {
        Ok(()) => next.run(request).await,
        Err(refusal) => shared.refuse(refusal, &path),
    };
    let said = [
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ];
    for (name, value) in said {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

const WELCOME: &str = "<!doctype html><html lang=en><meta charset=utf-8><title>rayset</title><link rel=icon href=icon.svg>\
    <meta http-equiv=refresh content=\"0; url=./\"><p><a href=\"./\">Go on</a>";

#[derive(serde::Deserialize)]
struct Visit {
    token: Option<String>,
}

/// The page. Whoever brings a token gets a cookie, and comes again without it.
async fn index(
    State(shared): State<Arc<Shared>>,
    Query(visit): Query<Visit>,
    headers: HeaderMap,
) -> Response {
    if let Some(token) = visit.token {
        return match shared.access.redeem(&token) {
            // A page that goes on by itself, and no redirection: that would count as coming from wherever the link was, and the cookie
            // would not come along.
            Ok(cookie) => ([(header::SET_COOKIE, cookie)], Html(WELCOME)).into_response(),
            // A link that is opened again by the same browser still leads to the page.
            Err(_) if shared.access.check_cookie(&headers).is_ok() => {
                (StatusCode::SEE_OTHER, [(header::LOCATION, "./")]).into_response()
            }
            Err(refusal) => shared.refuse(refusal, "/"),
        };
    }
    match shared.access.check_cookie(&headers) {
        Ok(()) => page::file("index.html").map_or(StatusCode::NOT_FOUND.into_response(), page::response),
        Err(refusal) => shared.refuse(refusal, "/"),
    }
}

/// Scripts and styles of the page. They are the same for everybody.
async fn asset(axum::extract::Path(name): axum::extract::Path<String>) -> Response {
    // The page itself is at `/`, for those who may see it.
    // Browsers ask for an icon by its old name where a page has not yet said another.
    let name = if name == "favicon.ico" { "icon.svg" } else { &name };
    let file = page::file(name).filter(|_| name != "index.html");
    file.map_or(StatusCode::NOT_FOUND.into_response(), page::response)
}

/// The socket of a page. Who may not look learns nothing else, not even whether this is a socket.
async fn socket(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    let allowed = shared.access.check_origin(&headers).and_then(|()| shared.access.check_cookie(&headers));
    if let Err(refusal) = allowed {
        return shared.refuse(refusal, "/socket");
    }
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(rejection) => return rejection.into_response(),
    };
    let Some(place) = Place::take(&shared) else {
        (shared.log)(&format!("refused a page: {MOST_PAGES} are open already"));
        return (StatusCode::SERVICE_UNAVAILABLE, "too many pages are open\n").into_response();
    };
    let upgrade = upgrade.max_message_size(MOST_MESSAGE_BYTES).max_frame_size(MOST_MESSAGE_BYTES);
    upgrade.on_upgrade(move |socket| serve_page(place, socket))
}

/// One of the places for pages; free again when dropped.
struct Place(Arc<Shared>);

impl Place {
    fn take(shared: &Arc<Shared>) -> Option<Self> {
        let free = |pages| (pages < MOST_PAGES).then_some(pages + 1);
        let taken = shared.pages.fetch_update(Ordering::Relaxed, Ordering::Relaxed, free);
        taken.ok().map(|_| Self(shared.clone()))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.0.pages.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Speaks with a page until either side has enough.
async fn serve_page(place: Place, mut socket: WebSocket) {
    // The place is free again when the page's thread, too, has ended: it may be preparing a scene.
    let place = Arc::new(place);
    let of_thread = place.clone();
    let shared = &place.0;
    let wanted = Arc::new(Wanted::default());
    let (send, mut outgoing) = mpsc::channel(MESSAGES_WAITING);
    let to_page = Box::new(move |message| send.blocking_send(message).is_ok());
    let frames = Frames::new(
        shared.session.clone(),
        shared.opened.clone(),
        shared.most_pixels,
        wanted.clone(),
        to_page,
    );
    let started = std::thread::Builder::new().name("rayset-view".into()).spawn(move || {
        frames.run();
        drop(of_thread);
    });
    if let Err(error) = started {
        (shared.log)(&format!("a page was turned away: the system starts no thread: {error}"));
        return;
    }
    // Ends the thread whichever way this function is left.
    let _closed = CloseWhenDropped(&wanted);
    if give(&mut socket, Outgoing::Text(shared.hello.clone())).await.is_err() {
        return;
    }
    let mut rate = Rate::new();
    let mut pings = tokio::time::interval(BETWEEN_PINGS);
    loop {
        let ended = tokio::select! {
            message = socket.recv() => match message.map(|message| message.map(|m| hear(shared, &wanted, &mut rate, m))) {
                Some(Ok(Ok(None))) => Ok(()),
                Some(Ok(Ok(Some(answer)))) => give(&mut socket, Outgoing::Text(answer)).await,
                Some(Ok(Err(()))) | Some(Err(_)) | None => Err(()),
            },
            _ = pings.tick() => ping(&mut socket).await,
            message = outgoing.recv() => match message {
                Some(message) => give(&mut socket, message).await,
                None => Err(()),
            },
        };
        if ended.is_err() {
            return;
        }
    }
}

struct CloseWhenDropped<'a>(&'a Wanted);

impl Drop for CloseWhenDropped<'_> {
    fn drop(&mut self) {
        self.0.close();
    }
}

/// Takes note of what a page says; returns the answer, if there is one at once. An error ends the connection.
fn hear(shared: &Shared, wanted: &Wanted, rate: &mut Rate, message: Message) -> Result<Option<ToPage>, ()> {
    if !rate.allows() {
        (shared.log)("closed a page: it sent too many messages");
        return Err(());
    }
    let text = match message {
        Message::Text(text) => text,
        Message::Ping(_) | Message::Pong(_) => return Ok(None),
        Message::Binary(_) | Message::Close(_) => return Err(()),
    };
    match serde_json::from_str(&text) {
        Ok(FromPage::Show(show)) => wanted.show(*show),
        Ok(FromPage::Ack { frame }) => wanted.acknowledge(frame),
        Ok(FromPage::Invite) => {
            let token = shared.access.issue().map_err(|_| ())?;
            return Ok(Some(ToPage::Invited { token }));
        }
        Ok(FromPage::Save(show)) => {
            let scene = serde_json::to_string_pretty(&shared.opened.saved(&show)).map_err(|_| ())?;
            return Ok(Some(ToPage::Saved { scene }));
        }
        Err(error) => {
            (shared.log)(&format!("closed a page: it sent what is no message: {error}"));
            return Err(());
        }
    }
    Ok(None)
}

/// Sends a message; an error if the page does not take it.
async fn give(socket: &mut WebSocket, message: Outgoing) -> Result<(), ()> {
    let message = match message {
        Outgoing::Text(text) => Message::Text(serde_json::to_string(&text).map_err(|_| ())?.into()),
        Outgoing::Frame(bytes) => Message::Binary(bytes.into()),
    };
    deliver(socket, message).await
}

async fn ping(socket: &mut WebSocket) -> Result<(), ()> {
    deliver(socket, Message::Ping(Vec::new().into())).await
}

async fn deliver(socket: &mut WebSocket, message: Message) -> Result<(), ()> {
    match tokio::time::timeout(PATIENCE, socket.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) | Err(_) => Err(()),
    }
}
