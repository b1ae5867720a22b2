//! Connections whose redirects carry no secret to another server.
//!
//! A redirect is followed here, and not by the client of HTTP, which hands on the address that it
//! comes from with its query (`Referer`), and every header that it does not know to be secret, such
//! as `x-amz-security-token`. To another server go the headers of [`HANDED_ON`] alone, and no body.

use std::collections::hash_map::RandomState;
use std::fmt;
use std::hash::BuildHasher;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use object_store::client::{
    ClientConfigKey, ClientOptions, HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest,
    HttpRequestBody, HttpResponse, HttpService,
};
use rayset::storage::redacted;
use reqwest::dns::{Addrs, Name, Resolve, Resolving};
use reqwest::header::{ACCEPT, AUTHORIZATION, HOST, HeaderName, IF_MATCH, LOCATION, RANGE, USER_AGENT};
use reqwest::{Method, StatusCode, redirect};
use url::Url;

/// The headers of a request that another server sees: which bytes are wanted, and of which object.
const HANDED_ON: [HeaderName; 4] = [ACCEPT, IF_MATCH, RANGE, USER_AGENT];
/// Most redirects that are followed, one after another.
const MOST: usize = 10;

/// Makes connections.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Connector;

impl HttpConnector for Connector {
    fn connect(&self, options: &ClientOptions) -> object_store::Result<HttpClient> {
        let said = |key| options.get_config_value(&key);
        let may_be_insecure = said(ClientConfigKey::AllowHttp).is_some_and(|value| value == "true");
        let mut builder = reqwest::Client::builder()
            .redirect(redirect::Policy::none())
            .referer(false)
            .https_only(!may_be_insecure)
            .http1_only()
            .user_agent(concat!("rayset/", env!("CARGO_PKG_VERSION")))
            .dns_resolver(Arc::new(AnyOrder));
        let seconds = said(ClientConfigKey::ConnectTimeout);
        if let Some(seconds) = seconds.and_then(|text| text.strip_suffix('s')?.parse().ok()) {
            builder = builder.connect_timeout(Duration::from_secs(seconds));
        }
        if let Some(most) = said(ClientConfigKey::PoolMaxIdlePerHost).and_then(|text| text.parse().ok()) {
            builder = builder.pool_max_idle_per_host(most);
        }
        let client = builder.build().map_err(|source| object_store::Error::Generic {
            store: "HTTP",
            source: source.without_url().into(),
        })?;
        Ok(HttpClient::new(Connection(client)))
    }
}

#[derive(Debug)]
struct Connection(reqwest::Client);

#[async_trait]
impl HttpService for Connection {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let mut request = self.with_user_as_header(request)?;
        for _ in 0..=MOST {
            let again = request.clone();
            let answer = HttpService::call(&self.0, request).await?;
            match next(again, &answer)? {
                Some(next) => request = self.with_user_as_header(next)?,
                None => return Ok(answer),
            }
        }
        Err(failed(format!("more than {MOST} redirects, one after another")))
    }
}

impl Connection {
    /// User and password of an address as the header that servers expect them in.
    fn with_user_as_header(&self, mut request: HttpRequest) -> Result<HttpRequest, HttpError> {
        let text = request.uri().to_string();
        if !text.contains('@') {
            return Ok(request);
        }
        let made = self.0.get(&text).build().map_err(|error| failed(error.without_url().to_string()))?;
        if let Some(user) = made.headers().get(AUTHORIZATION) {
            request.headers_mut().insert(AUTHORIZATION, user.clone());
        }
        *request.uri_mut() = made.url().as_str().parse().map_err(|_| failed("no address"))?;
        Ok(request)
    }
}

/// The request that an answer asks for; `None` if it asks for none.
fn next(request: HttpRequest, answer: &HttpResponse) -> Result<Option<HttpRequest>, HttpError> {
    let Some(to) = answer.headers().get(LOCATION) else { return Ok(None) };
    let mut method = request.method().clone();
    match answer.status() {
        StatusCode::MOVED_PERMANENTLY | StatusCode::FOUND if method == Method::POST => method = Method::GET,
        StatusCode::SEE_OTHER if method != Method::HEAD => method = Method::GET,
        StatusCode::MOVED_PERMANENTLY
        | StatusCode::FOUND
        | StatusCode::SEE_OTHER
        | StatusCode::TEMPORARY_REDIRECT
        | StatusCode::PERMANENT_REDIRECT => {}
        _ => return Ok(None),
    }
    let wrong = |what: &str| failed(format!("a redirect to {what}"));
    let from = Url::parse(&request.uri().to_string()).map_err(|_| wrong("nowhere"))?;
    let to = to.to_str().ok().and_then(|to| from.join(to).ok()).ok_or_else(|| wrong("nowhere"))?;
    let (mut parts, mut body) = request.into_parts();
    if method != parts.method {
        body = HttpRequestBody::empty();
    }
    if from.origin() != to.origin() {
        if !matches!(method, Method::GET | Method::HEAD) || !body.is_empty() {
            let to = redacted(to.as_str()).into_owned();
            return Err(wrong(&format!("another server, {to}, which is sent nothing; name that one")));
        }
        let kept = HANDED_ON.into_iter().filter_map(|name| Some((name.clone(), parts.headers.remove(name)?)));
        parts.headers = kept.collect();
    }
    parts.headers.remove(HOST);
    parts.method = method;
    parts.uri = to.as_str().parse().map_err(|_| wrong("no address"))?;
    Ok(Some(HttpRequest::from_parts(parts, body)))
}

/// Why a redirect was not followed, which another attempt does not change.
#[derive(Debug)]
pub(super) struct NotFollowed(String);

impl fmt::Display for NotFollowed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for NotFollowed {}

fn failed(what: impl Into<String>) -> HttpError {
    HttpError::new(HttpErrorKind::Unknown, NotFollowed(what.into()))
}

/// The addresses of a host in any order, so that many connections are to many of its machines.
struct AnyOrder;

impl Resolve for AnyOrder {
    fn resolve(&self, name: Name) -> Resolving {
        Box::pin(async move {
            let found = tokio::net::lookup_host((name.as_str(), 0)).await?;
            let mut found: Vec<SocketAddr> = found.collect();
            let random = RandomState::new();
            found.sort_by_cached_key(|address| random.hash_one(address));
            Ok(Box::new(found.into_iter()) as Addrs)
        })
    }
}
