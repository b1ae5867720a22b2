//! Addresses by `object_store`: who is asked for what.
//!
//! `place` reads an address, `connect` makes the client of a bucket or a host with the user's credentials (`aws_profile`),
//! `object` reads ranges of a pinned object, `upload` writes one, `failure` says what went wrong.

mod aws_profile;
mod connect;
mod failure;
mod object;
mod place;
mod upload;

use std::collections::HashMap;
use std::future::Future;
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError, Weak, mpsc};
use std::time::{Duration, Instant};

use rayset::storage::{self, Addresses, Storage};
use tokio::runtime::{Builder, Runtime};

use self::connect::{Client, Clients};
use self::object::{PinnedObject, Version};
use self::place::Place;
use crate::{Cache, CacheError, Settings};

/// An object that was looked at less long ago than this is taken to be what it was.
const TRUSTED: Duration = Duration::from_secs(2);
/// How long an upload that is given up may take to be cleared away.
const ABANDON_WITHIN: Duration = Duration::from_secs(5);

/// Opens addresses in this process from now on.
pub(crate) fn open_addresses(settings: &Settings) -> Result<(), CacheError> {
    let cache = settings.cache.as_ref().map(|(folder, bytes)| Cache::open(folder, *bytes)).transpose()?;
    storage::open_addresses_with(Arc::new(Stores {
        runtime: Mutex::default(),
        cache: cache.map(Arc::new),
        clients: Clients::default(),
        opened: Mutex::default(),
        uploads: upload::Uploads::default(),
    }));
    Ok(())
}

struct Stores {
    /// Made when it is needed first.
    runtime: Mutex<Option<Arc<Runtime>>>,
    cache: Option<Arc<Cache>>,
    clients: Clients,
    opened: Mutex<HashMap<String, Opened>>,
    uploads: upload::Uploads,
}

/// An object that somebody still reads.
struct Opened {
    object: Weak<PinnedObject>,
    version: Version,
    looked: Instant,
}

impl Stores {
    fn runtime(&self) -> io::Result<Arc<Runtime>> {
        let mut runtime = self.runtime.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(runtime) = &*runtime {
            return Ok(runtime.clone());
        }
        let made =
            Builder::new_multi_thread().worker_threads(2).thread_name("rayset-far").enable_all().build()?;
        Ok(runtime.insert(Arc::new(made)).clone())
    }

    /// Waits for something that is done elsewhere; may be called wherever waiting is allowed, also by tasks of another runtime.
    fn wait<T: Send + 'static>(
        &self,
        work: impl Future<Output = io::Result<T>> + Send + 'static,
    ) -> io::Result<T> {
        let (send, receive) = mpsc::channel();
        self.runtime()?.spawn(async move {
            // Whoever waits has not gone.
            let _ = send.send(work.await);
        });
        receive.recv().unwrap_or_else(|_| Err(io::Error::other("a task of the connection panicked")))
    }

    fn place(&self, address: &str) -> io::Result<(Place, Client)> {
        let place = Place::new(address)?;
        let (clients, wanted) = (self.clients.clone(), place.clone());
        let client = self.wait(async move { clients.client(&wanted).await })?;
        Ok((place, client))
    }

    /// The object that was opened here, if it has been looked at a moment ago.
    fn lately(&self, address: &str) -> Option<Arc<PinnedObject>> {
        let opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        let known = opened.get(address).filter(|known| known.looked.elapsed() < TRUSTED)?;
        known.object.upgrade()
    }
}

impl Addresses for Stores {
    fn open(&self, address: &str) -> io::Result<Arc<dyn Storage>> {
        if let Some(object) = self.lately(address) {
            return Ok(object);
        }
        let (place, client) = self.place(address)?;
        let (store, path, name) = (client.store.clone(), place.path.clone(), place.name.clone());
        let version = self.wait(async move { object::look(&*store, &path, &name).await })?;
        let mut opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        opened.retain(|_, known| known.object.strong_count() > 0);
        if let Some(known) = opened.get_mut(address)
            && known.version == version
            && let Some(object) = known.object.upgrade()
        {
            known.looked = Instant::now();
            return Ok(object);
        }
        let object =
            PinnedObject::new(self.runtime()?, client.store, place, version.clone(), self.cache.clone())?;
        let object = Arc::new(object);
        let known = Opened { object: Arc::downgrade(&object), version, looked: Instant::now() };
        opened.insert(address.to_owned(), known);
        Ok(object)
    }

    fn prepare(&self, address: &str) -> io::Result<()> {
        let (place, client) = self.place(address)?;
        self.wait(upload::prepare(client.writable(&place)?, place))
    }

    fn put(&self, file: &Path, address: &str) -> io::Result<()> {
        let (place, client) = self.place(address)?;
        let file = std::fs::File::open(file)?;
        self.wait(upload::put(client.writable(&place)?, place, file, self.uploads.clone()))
    }

    fn abandon(&self, address: &str) {
        let Ok(place) = Place::new(address) else { return };
        let (uploads, clients) = (self.uploads.clone(), self.clients.clone());
        let _ = self.wait(async move {
            let work = async {
                let client = clients.client(&place).await?.writable(&place)?;
                upload::abandon(client, place, uploads).await;
                Ok(())
            };
            tokio::time::timeout(ABANDON_WITHIN, work).await.unwrap_or(Ok(()))
        });
    }
}
