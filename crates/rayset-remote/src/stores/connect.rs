//! Clients of buckets and hosts, with the credentials that the user's other tools would use.

use std::collections::HashMap;
use std::env;
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use object_store::aws::{AmazonS3Builder, resolve_bucket_region};
use object_store::gcp::{GcpCredential, GoogleCloudStorageBuilder};
use object_store::http::HttpBuilder;
use object_store::multipart::MultipartStore;
use object_store::{ClientOptions, ObjectStore, RetryConfig, StaticCredentialProvider};
use rayset::storage::shown;

use super::aws_profile::{self, Credentials};
use super::pending::Pending;
use super::place::{Keeper, ObjectAddress};
use super::redirect::Connector;
use super::renewal::Renewal;
use super::{azure, failure, tries};
use crate::times::Times;

/// What speaks with a bucket or a host.
#[derive(Clone)]
pub(super) struct Client {
    pub(super) store: Arc<dyn ObjectStore>,
    pub(super) renewal: Renewal,
    /// `None` for web servers, which are only read.
    parts: Option<Arc<dyn MultipartStore>>,
    /// Of S3 alone.
    pending: Option<Pending>,
}

/// What writes to a bucket.
#[derive(Clone)]
pub(super) struct Writer {
    pub(super) store: Arc<dyn ObjectStore>,
    pub(super) parts: Arc<dyn MultipartStore>,
    /// What finds uploads whose identities are lost, where there is a way.
    pub(super) pending: Option<Pending>,
    pub(super) renewal: Renewal,
    pub(super) times: Times,
}

impl Client {
    fn new<S: ObjectStore + MultipartStore>(store: S) -> Self {
        let store = Arc::new(store);
        Self { store: store.clone(), renewal: Renewal::default(), parts: Some(store), pending: None }
    }

    pub(super) fn writable(&self, place: &ObjectAddress, times: Times) -> io::Result<Writer> {
        let parts = self.parts.clone().ok_or_else(|| {
            let name = shown(Path::new(&place.name));
            let what = format!("{name}: web servers are only read; write to a disk or a bucket");
            io::Error::new(io::ErrorKind::Unsupported, what)
        })?;
        let (store, renewal, pending) = (self.store.clone(), self.renewal.clone(), self.pending.clone());
        Ok(Writer { store, parts, pending, renewal, times })
    }
}

/// The clients of this process. Copies are the same clients.
#[derive(Clone, Default)]
pub(super) struct Clients(Arc<Mutex<HashMap<Keeper, Client>>>);

impl Clients {
    /// The client of an object's keeper.
    pub(super) async fn client(&self, place: &ObjectAddress, times: Times) -> io::Result<Client> {
        if let Some(known) = self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&place.keeper) {
            return Ok(known.clone());
        }
        let made = connect(&place.keeper, times).await;
        let made = made.map_err(|error| failure::in_words(&error, &place.name))?;
        // If another thread was faster, its client does as well.
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(place.keeper.clone(), made.clone());
        Ok(made)
    }
}

async fn connect(keeper: &Keeper, times: Times) -> object_store::Result<Client> {
    match keeper {
        Keeper::S3(bucket) => s3(bucket, times).await,
        Keeper::Google(bucket) => google(bucket),
        Keeper::Azure(container) => Ok(Client::new(azure::client(container, options)?)),
        Keeper::Web(host) => {
            let insecure = host.starts_with("http:");
            let builder = HttpBuilder::new().with_url(host).with_client_options(options(insecure));
            let builder = builder.with_http_connector(Connector);
            let store = Arc::new(builder.with_retry(once()).build()?);
            Ok(Client { store, renewal: Renewal::default(), parts: None, pending: None })
        }
    }
}

fn google(bucket: &str) -> object_store::Result<Client> {
    let mut builder = GoogleCloudStorageBuilder::from_env().with_bucket_name(bucket).with_retry(once());
    let mut endpoint = set("GOOGLE_BASE_URL");
    // Google's own tools, too, send no credentials to an emulator.
    if let Some(host) = set("STORAGE_EMULATOR_HOST") {
        let host = if host.contains("://") { host } else { format!("http://{host}") };
        let host = host.trim_end_matches('/').to_owned();
        let nobody = StaticCredentialProvider::new(GcpCredential { bearer: String::new() });
        builder = builder.with_base_url(&host).with_credentials(Arc::new(nobody));
        endpoint = Some(host);
    }
    let insecure = endpoint.is_some_and(|endpoint| endpoint.starts_with("http:"));
    Ok(Client::new(builder.with_client_options(options(insecure)).with_http_connector(Connector).build()?))
}

async fn s3(bucket: &str, times: Times) -> object_store::Result<Client> {
    let mut builder = AmazonS3Builder::from_env().with_bucket_name(bucket).with_retry(once());
    let profile = aws_profile::find()
        .map_err(|source| object_store::Error::Generic { store: "S3", source: source.into() })?;
    let mut endpoint =
        set("AWS_ENDPOINT_URL_S3").or_else(|| set("AWS_ENDPOINT_URL")).or_else(|| set("AWS_ENDPOINT"));
    let mut region = set("AWS_REGION").or_else(|| set("AWS_DEFAULT_REGION"));
    let mut renewal = Renewal::default();
    if let Some(profile) = profile {
        endpoint = endpoint.or(profile.endpoint);
        region = region.or(profile.region);
        builder = match profile.credentials {
            Some(Credentials::Fixed(fixed)) => {
                let builder =
                    builder.with_access_key_id(&fixed.key_id).with_secret_access_key(&fixed.secret_key);
                match &fixed.token {
                    Some(token) => builder.with_token(token),
                    None => builder,
                }
            }
            Some(Credentials::Process(process)) => {
                let process = Arc::new(process);
                renewal = Renewal::by(process.clone());
                builder.with_credentials(process)
            }
            None => builder,
        };
    }
    let options = options(endpoint.as_deref().is_some_and(|endpoint| endpoint.starts_with("http:")));
    if region.is_none() && endpoint.is_none() {
        let asked = tries::attempts(times, &renewal, || resolve_bucket_region(bucket, &options)).await;
        region = Some(asked.map_err(|failed| failed.error)?);
    }
    if let Some(endpoint) = endpoint {
        builder = builder.with_endpoint(endpoint);
    }
    builder = builder.with_region(region.unwrap_or_else(|| "us-east-1".to_owned()));
    let store =
        Arc::new(builder.with_client_options(options.clone()).with_http_connector(Connector).build()?);
    let pending = Some(Pending::new(store.clone(), &options)?);
    Ok(Client { renewal, pending, store: store.clone(), parts: Some(store) })
}

/// The value of a variable of the environment, if it has one.
pub(super) fn set(name: &str) -> Option<String> {
    env::var(name).ok().filter(|value| !value.is_empty())
}

/// What is tried again is decided by `RemoteStorage` and `tries`, and so is how long an answer is
/// waited for.
pub(super) fn once() -> RetryConfig {
    RetryConfig { max_retries: 0, ..RetryConfig::default() }
}

fn options(insecure: bool) -> ClientOptions {
    let insecure = insecure || set("AWS_ALLOW_HTTP").is_some_and(|value| value == "true");
    ClientOptions::new()
        .with_allow_http(insecure)
        .with_connect_timeout(Duration::from_secs(10))
        .with_timeout_disabled()
        .with_pool_max_idle_per_host(128)
}
