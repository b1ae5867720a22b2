//! The server: the page and its socket, for those who may look.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

use axum::Router;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{DefaultBodyLimit, Query, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use rayset::Session;
use tokio::net::TcpListener;
use tokio::sync::watch;

use crate::access::{Access, LEAST_PASSWORD, Refusal, SECRET_BYTES};
use crate::compose::{Opened, Subject};
use crate::connections::Limited;
use crate::page;
use crate::protocol::{MOST_MESSAGE_BYTES, PictureMemory, ToPage};
use crate::refusals::{LogDecision, Refusals};
use crate::visit::{self, Places};

/// Most pages that are connected at a time.
pub(crate) const MOST_PAGES: usize = 4;
/// Bytes that a page's picture takes for each of its pixels: as it is shown, its distances, on its
/// way, and the rows that are shaded at the end with those around them.
const PIXEL_BYTES: u64 = 20;
/// What the page may do: run its own scripts, show its own pictures, speak to this server, and
/// nothing else.
const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; \
    connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

/// How to serve.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Options {
    /// Where to listen; beyond this machine only with a password.
    pub address: IpAddr,
    /// The port; 0 for any that is free.
    pub port: u16,
    /// Lets in whoever knows it.
    pub password: Option<String>,
    /// Names besides those of this machine, with or without a port, under which a proxy may be
    /// reached.
    pub allowed_hosts: Vec<String>,
    /// Bytes for the pictures of all pages together.
    pub picture_bytes: u64,
    /// The most that they get of any memory, and the part of the process's memory that they get of
    /// less, as one by this number: pages are told which memory would give them more pixels.
    pub most_picture_bytes: u64,
    /// See `most_picture_bytes`.
    pub picture_share: u64,
    /// What cookies are signed with. Kept from one run to the next, it lets pages connect again.
    pub key: [u8; SECRET_BYTES],
}

impl Options {
    /// Options with a key, on a port of 127.0.0.1, with 64 MiB for pictures.
    #[must_use]
    pub fn new(key: [u8; SECRET_BYTES], port: u16) -> Self {
        let address = IpAddr::V4(Ipv4Addr::LOCALHOST);
        Self {
            address,
            port,
            password: None,
            allowed_hosts: Vec::new(),
            picture_bytes: 64 << 20,
            most_picture_bytes: 64 << 20,
            picture_share: 1,
            key,
        }
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
    /// The password is too short.
    #[error("the password is too short; at least {LEAST_PASSWORD} characters are needed")]
    ShortPassword,
    /// It would be open to everybody.
    #[error(
        "{0} is beyond this machine: whoever can reach it could look, so a password of at least {LEAST_PASSWORD} characters is needed"
    )]
    Password(IpAddr),
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
pub(crate) struct Shared {
    pub(crate) access: Access,
    pub(crate) stage: watch::Sender<Stage>,
    /// The most pixels of a page's picture.
    pub(crate) most_pixels: u64,
    /// Memory for the pictures of a page.
    pub(crate) page_bytes: u64,
    /// What would give them more pixels.
    memory: PictureMemory,
    /// Places for pages that are taken.
    pub(crate) pages: AtomicUsize,
    pub(crate) log: Box<dyn Fn(&str) + Send + Sync>,
    refusals: Refusals,
}

/// How far opening what is to be seen has come.
#[derive(Clone)]
pub(crate) enum Stage {
    /// What is being done, and which part of it is done.
    Opening {
        what: String,
        part: f64,
    },
    Ready(Arc<Ready>),
}

/// What there is to see.
pub(crate) struct Ready {
    pub(crate) session: Session,
    pub(crate) opened: Arc<Opened>,
    pub(crate) hello: ToPage,
}

/// Tells a server what there is to see.
#[derive(Clone)]
pub struct Opener(Arc<Shared>);

impl Opener {
    /// Pages that wait are told how far it is: what is being done, and which part of it, 0 to 1, is
    /// done.
    pub fn progress(&self, what: &str, part: f64) {
        self.0.stage.send_replace(Stage::Opening { what: what.to_owned(), part });
    }

    /// Opens a scene to all pages.
    ///
    /// # Errors
    /// [`ServeError`] if the scene cannot be read.
    pub fn open(&self, subject: Subject, session: Session) -> Result<(), ServeError> {
        let opened = Arc::new(Opened::new(subject).map_err(ServeError::Scene)?);
        let hello = ToPage::Hello {
            title: opened.subject.title.clone(),
            camera: Box::new(opened.camera),
            bounds: [opened.bounds.min.to_array(), opened.bounds.max.to_array()],
            stance: opened.subject.stance.clone().map(Box::new),
            unit: opened.subject.unit,
            remarks: opened.subject.remarks.clone(),
            scene: Box::new(opened.subject.scene.clone()),
            most_pixels: self.0.most_pixels,
            memory: self.0.memory,
            choices: opened.subject.looks.as_ref().map(|looks| Box::new(looks.choices())),
        };
        self.0.stage.send_replace(Stage::Ready(Arc::new(Ready { session, opened, hello })));
        Ok(())
    }
}

impl Server {
    /// Listens. What there is to see follows by [`opener`](Self::opener). `log` is given a line for
    /// every visitor who is refused.
    ///
    /// # Errors
    /// [`ServeError`] if the port cannot be had, or if it would be open to everybody.
    pub fn start(options: Options, log: impl Fn(&str) + Send + Sync + 'static) -> Result<Self, ServeError> {
        match &options.password {
            Some(password) if password.chars().count() < LEAST_PASSWORD => {
                return Err(ServeError::ShortPassword);
            }
            None if !options.address.is_loopback() => return Err(ServeError::Password(options.address)),
            _ => {}
        }
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let address = SocketAddr::new(options.address, options.port);
        let listener = runtime
            .block_on(TcpListener::bind(address))
            .map_err(|source| ServeError::Listen { address, source })?;
        let address = listener.local_addr()?;
        let page_bytes = options.picture_bytes / MOST_PAGES as u64;
        let password = options.password.as_deref();
        let shared = Shared {
            access: Access::new(options.key, address.port(), options.allowed_hosts, password),
            stage: watch::Sender::new(Stage::Opening { what: "opening".into(), part: 0.0 }),
            most_pixels: page_bytes / PIXEL_BYTES,
            page_bytes,
            memory: PictureMemory {
                bytes_per_pixel: PIXEL_BYTES * MOST_PAGES as u64 * options.picture_share,
                most_pixels: options.most_picture_bytes / MOST_PAGES as u64 / PIXEL_BYTES,
            },
            pages: AtomicUsize::new(0),
            log: Box::new(log),
            refusals: Refusals::default(),
        };
        Ok(Self { runtime, listener, shared: Arc::new(shared), address })
    }

    /// What tells this server what there is to see, from any thread.
    #[must_use]
    pub fn opener(&self) -> Opener {
        Opener(self.shared.clone())
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
        (self.inviter())()
    }

    /// What issues further invitations, from any thread.
    pub fn inviter(&self) -> impl Fn() -> io::Result<String> + Send + Sync + 'static + use<> {
        let (shared, mut address) = (self.shared.clone(), self.address);
        if address.ip().is_unspecified() {
            // It listens everywhere, but nobody is there.
            address.set_ip(IpAddr::V4(Ipv4Addr::LOCALHOST));
        }
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
            .route("/enter", post(enter).layer(DefaultBodyLimit::max(MOST_FORM_BYTES)))
            .route("/{file}", get(asset))
            .fallback(async || StatusCode::NOT_FOUND)
            .layer(middleware::from_fn_with_state(self.shared.clone(), guard))
            .with_state(self.shared);
        self.runtime.block_on(axum::serve(Limited::new(self.listener), router).into_future())
    }
}

impl Shared {
    /// Logs that somebody was refused. Whoever is refused again and again does not fill the log.
    fn log_refusal(&self, line: &str) {
        match self.refusals.count() {
            LogDecision::Line => (self.log)(line),
            LogDecision::LineAfter(unsaid) => {
                (self.log)(&format!("{line} ({unsaid} more were refused before)"));
            }
            LogDecision::Nothing => {}
        }
    }

    /// The answer to somebody who may not look.
    fn refuse(&self, refusal: Refusal, path: &str) -> Response {
        // A path may hold anything; a line holds what a terminal shows.
        let path: String = path.chars().take(60).map(|c| if c.is_control() { '?' } else { c }).collect();
        self.log_refusal(&format!("refused a request for {path}: {refusal}"));
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
        // Without any, browsers would say nothing of where the password's form comes from.
        (header::REFERRER_POLICY, "same-origin"),
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

/// Longest form.
const MOST_FORM_BYTES: usize = 4 << 10;

/// Asks for the password.
const DOOR: &str = "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width\">\
    <title>rayset</title><link rel=icon href=icon.svg><link rel=stylesheet href=style.css>\
    <body class=door><main><form method=post action=enter><h1>rayset</h1><label for=password>Password</label>\
    <input id=password name=password type=password autocomplete=current-password required autofocus>\
    <button>Enter</button>REFUSAL</form></main>";
/// What is said to who was not let in.
const NOT_LET_IN: &str = "<p role=alert>That was not it, or too soon after another attempt.";

/// Lets in who knows the password.
async fn enter(State(shared): State<Arc<Shared>>, headers: HeaderMap, body: String) -> Response {
    let password = body.strip_prefix("password=").and_then(unescaped).unwrap_or_default();
    match shared.access.check_origin(&headers).and_then(|()| shared.access.enter(&password)) {
        Ok(cookie) => ([(header::SET_COOKIE, cookie)], Html(WELCOME)).into_response(),
        Err(refusal) => {
            let mut response = shared.refuse(refusal, "/enter");
            if !shared.access.has_password() {
                return response;
            }
            *response.body_mut() = DOOR.replace("REFUSAL", NOT_LET_IN).into();
            let kind = HeaderValue::from_static("text/html; charset=utf-8");
            response.headers_mut().insert(header::CONTENT_TYPE, kind);
            response
        }
    }
}

/// The text of a form's field; `None` if it is none.
fn unescaped(field: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(field.len());
    let mut rest = field.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'+' => b' ',
            b'%' => {
                let digits = [rest.next()?, rest.next()?];
                u8::from_str_radix(std::str::from_utf8(&digits).ok()?, 16).ok()?
            }
            other => other,
        });
    }
    String::from_utf8(bytes).ok()
}

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
            // A page that goes on by itself, and no redirection: that would count as coming from
            // wherever the link was, and the cookie would not come along.
            Ok(cookie) => ([(header::SET_COOKIE, cookie)], Html(WELCOME)).into_response(),
            // A link that is opened again by the same browser still leads to the page.
            Err(_) if shared.access.check_cookie(&headers).is_ok() => {
                (StatusCode::SEE_OTHER, [(header::LOCATION, "./")]).into_response()
            }
            Err(_) if shared.access.has_password() => Html(DOOR.replace("REFUSAL", "")).into_response(),
            Err(refusal) => shared.refuse(refusal, "/"),
        };
    }
    match shared.access.check_cookie(&headers) {
        Ok(()) => page::file("index.html").map_or(StatusCode::NOT_FOUND.into_response(), page::response),
        Err(_) if shared.access.has_password() => Html(DOOR.replace("REFUSAL", "")).into_response(),
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
    let upgrade = upgrade.max_message_size(MOST_MESSAGE_BYTES).max_frame_size(MOST_MESSAGE_BYTES);
    match Places::one(&shared) {
        Some(place) => upgrade.on_upgrade(move |socket| visit::serve(place, socket)),
        None => {
            let what = format!(
                "{MOST_PAGES} pages are open already, or a picture is being saved with the memory of those that are not"
            );
            shared.log_refusal(&format!("refused a page: {what}"));
            // Scripts cannot read why a socket was not opened: it is opened to say so.
            upgrade.on_upgrade(move |socket| visit::refuse(what, socket))
        }
    }
}
