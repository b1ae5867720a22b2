//! Clients of buckets and hosts, with the credentials that the user's other tools would use.

use std::collections::HashMap;
use std::env;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use object_store::aws::{AmazonS3Builder, resolve_bucket_region};
use object_store::azure::MicrosoftAzureBuilder;
use object_store::gcp::GoogleCloudStorageBuilder;
use object_store::http::HttpBuilder;
use object_store::multipart::MultipartStore;
use object_store::{ClientOptions, ObjectStore, RetryConfig};

use super::aws_profile::{self, Credentials};
use super::failure;
use super::place::{Keeper, Place};

/// What speaks with a bucket or a host.
#[derive(Clone)]
pub(super) struct Client {
    pub(super) store: Arc<dyn ObjectStore>,
    /// `None` for web servers, which are only read.
    parts: Option<Arc<dyn MultipartStore>>,
}

/// What writes to a bucket.
#[derive(Clone)]
pub(super) struct Writer {
    pub(super) store: Arc<dyn ObjectStore>,
    pub(super) parts: Arc<dyn MultipartStore>,
}

impl Client {
    fn new<S: ObjectStore + MultipartStore>(store: S) -> Self {
        let store = Arc::new(store);
        Self { store: store.clone(), parts: Some(store) }
    }

    pub(super) fn writable(&self, place: &Place) -> io::Result<Writer> {
        let parts = self.parts.clone().ok_or_else(|| {
            let what = format!("{}: web servers are only read; write to a disk or a bucket", place.name);
            io::Error::new(io::ErrorKind::Unsupported, what)
        })?;
        Ok(Writer { store: self.store.clone(), parts })
    }
}

/// The clients of this process. Copies are the same clients.
#[derive(Clone, Default)]
pub(super) struct Clients(Arc<Mutex<HashMap<Keeper, Client>>>);

impl Clients {
    /// The client of an object's keeper.
    pub(super) async fn client(&self, place: &Place) -> io::Result<Client> {
        if let Some(known) = self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&place.keeper) {
            return Ok(known.clone());
        }
        let made = connect(&place.keeper).await.map_err(|error| failure::in_words(&error, &place.name))?;
        // If another thread was faster, its client does as well.
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(place.keeper.clone(), made.clone());
        Ok(made)
    }
}

async fn connect(keeper: &Keeper) -> object_store::Result<Client> {
    match keeper {
        Keeper::S3(bucket) => s3(bucket).await,
        Keeper::Google(bucket) => {
            let builder = GoogleCloudStorageBuilder::from_env().with_bucket_name(bucket);
            Ok(Client::new(builder.with_client_options(options(false)).with_retry(once()).build()?))
        }
        Keeper::Azure(container) => azure(container),
        Keeper::Web(host) => {
            let insecure = host.starts_with("http:");
            let builder = HttpBuilder::new().with_url(host).with_client_options(options(insecure));
            Ok(Client { store: Arc::new(builder.with_retry(once()).build()?), parts: None })
        }
    }
}

async fn s3(bucket: &str) -> object_store::Result<Client> {
    let mut builder = AmazonS3Builder::from_env().with_bucket_name(bucket).with_retry(once());
    let profile = aws_profile::find()
        .map_err(|source| object_store::Error::Generic { store: "S3", source: source.into() })?;
    let mut endpoint =
        set("AWS_ENDPOINT_URL_S3").or_else(|| set("AWS_ENDPOINT_URL")).or_else(|| set("AWS_ENDPOINT"));
    let mut region = set("AWS_REGION").or_else(|| set("AWS_DEFAULT_REGION"));
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
            Some(Credentials::Process(process)) => builder.with_credentials(Arc::new(process)),
            None => builder,
        };
    }
    let options = options(endpoint.as_deref().is_some_and(|endpoint| endpoint.starts_with("http:")));
    if region.is_none() && endpoint.is_none() {
        region = Some(resolve_bucket_region(bucket, &options).await?);
    }
    if let Some(endpoint) = endpoint {
        builder = builder.with_endpoint(endpoint);
    }
    builder = builder.with_region(region.unwrap_or_else(|| "us-east-1".to_owned()));
    Ok(Client::new(builder.with_client_options(options).build()?))
}

fn azure(container: &str) -> object_store::Result<Client> {
    let mut builder = MicrosoftAzureBuilder::from_env().with_container_name(container).with_retry(once());
    let mut insecure = false;
    let mut has_key =
        ["AZURE_STORAGE_ACCOUNT_KEY", "AZURE_STORAGE_SAS_TOKEN", "AZURE_STORAGE_SAS_KEY", "AZURE_CLIENT_ID"]
            .iter()
            .any(|name| set(name).is_some());
    if let Some(account) = set("AZURE_STORAGE_ACCOUNT") {
        builder = builder.with_account(account);
    }
    if let Some(key) = set("AZURE_STORAGE_KEY") {
        (builder, has_key) = (builder.with_access_key(key), true);
    }
    for field in set("AZURE_STORAGE_CONNECTION_STRING").unwrap_or_default().split(';') {
        match field.split_once('=') {
            Some(("AccountName", name)) => builder = builder.with_account(name),
            Some(("AccountKey", key)) => (builder, has_key) = (builder.with_access_key(key), true),
            Some(("BlobEndpoint", endpoint)) => {
                insecure = endpoint.starts_with("http:");
                builder = builder.with_endpoint(endpoint.to_owned());
            }
            _ => {}
        }
    }
    // As whoever has said `az login`.
    if !has_key && set("AZURE_SKIP_SIGNATURE").is_none() {
        builder = builder.with_use_azure_cli(true);
    }
    Ok(Client::new(builder.with_client_options(options(insecure)).build()?))
}

/// The value of a variable of the environment, if it has one.
pub(super) fn set(name: &str) -> Option<String> {
    env::var(name).ok().filter(|value| !value.is_empty())
}

/// Time-outs and retries of reads are those of `FarStorage`, so there are none here.
fn once() -> RetryConfig {
    RetryConfig { max_retries: 0, ..RetryConfig::default() }
}

fn options(insecure: bool) -> ClientOptions {
    let insecure = insecure || set("AWS_ALLOW_HTTP").is_some_and(|value| value == "true");
    ClientOptions::new()
        .with_allow_http(insecure)
        .with_connect_timeout(Duration::from_secs(10))
        .with_timeout(Duration::from_secs(120))
        .with_pool_max_idle_per_host(128)
}
