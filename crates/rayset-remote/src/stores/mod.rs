//! Addresses by `object_store`: who is asked for what.
//!
//! `place` reads an address, `connect` makes the client of a bucket or a host with the user's
//! credentials (`aws_profile`, `azure`, `credential_process`; `renewal`, when they have expired),
//! `object` reads ranges of a pinned object, `upload` writes one (`pending` finds uploads that were
//! left), `tries` makes requests in bounded time, over connections of `redirect`, `failure` says
//! what went wrong.

mod aws_profile;
mod azure;
mod connect;
mod credential_process;
mod failure;
mod object;
mod pending;
mod place;
mod redirect;
mod renewal;
mod tries;
mod upload;

use std::collections::{HashMap, VecDeque};
use std::future::Future;
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError, Weak, mpsc};
use std::time::{Duration, Instant};

use rayset::storage::{self, Addresses, RequestLimit, Storage};
use tokio::runtime::{Builder, Runtime};

use self::connect::{Client, Clients};
use self::object::{PinnedObject, Version};
use self::place::ObjectAddress;
use crate::times::Times;
use crate::{Cache, CacheError, Settings};
use crate::{IN_FLIGHT, REQUESTS_BYTES};

/// An object that was looked at less long ago than this is taken to be what it was.
const TRUSTED: Duration = Duration::from_secs(2);
/// Bytes that are read when an object is looked at: scenes are read whole, and other files say
/// there where the rest is.
const FIRST_BYTES: u64 = 64 << 10;
/// Objects that are kept open, with their first bytes, for whoever opens them next.
const RECENT: usize = 4;
/// How long an upload that is given up may take to be cleared away.
const ABANDON_WITHIN: Duration = Duration::from_secs(5);

/// Opens addresses in this process from now on.
pub(crate) fn open_addresses(settings: &Settings, times: Times) -> Result<(), CacheError> {
    let cache = settings.cache.as_ref().map(|(folder, bytes)| Cache::open(folder, *bytes)).transpose()?;
    storage::open_addresses_with(Arc::new(Stores {
        runtime: Mutex::default(),
        times,
        cache: cache.map(Arc::new),
        clients: Clients::default(),
        opened: Mutex::default(),
        recent: Mutex::default(),
        uploads: upload::Uploads::default(),
        sending_bytes: settings.sending_bytes.unwrap_or(upload::USUAL_SENDING_BYTES),
        limit: limit(settings.cache.is_some()),
    }));
    Ok(())
}

struct Stores {
    /// Made when it is needed first.
    runtime: Mutex<Option<Arc<Runtime>>>,
    times: Times,
    cache: Option<Arc<Cache>>,
    clients: Clients,
    opened: Mutex<HashMap<String, Opened>>,
    /// The last ones that were looked at.
    recent: Mutex<VecDeque<Arc<PinnedObject>>>,
    uploads: upload::Uploads,
    /// Of parts of outputs that are sent at a time.
    sending_bytes: u64,
    /// What all objects may have in flight together.
    limit: Arc<RequestLimit>,
}

/// Of one object or of many: the memory of requests is that of their connections.
fn limit(keeps: bool) -> Arc<RequestLimit> {
    let (requests, bytes) = IN_FLIGHT;
    // What is kept on a disk is copied: as it comes, and as it is written or read there.
    let copies = if keeps { 2 * bytes } else { 0 };
    RequestLimit::new(requests, bytes, REQUESTS_BYTES + copies)
}

/// An object that somebody still reads.
struct Opened {
    object: Weak<PinnedObject>,
    version: Version,
    /// When it was looked at last, if that is to be trusted.
    looked: Option<Instant>,
}

impl Stores {
    fn runtime(&self) -> io::Result<Arc<Runtime>> {
        let mut runtime = self.runtime.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(runtime) = &*runtime {
            return Ok(runtime.clone());
        }
        let made = Builder::new_multi_thread()
            .worker_threads(2)
            .thread_name("rayset-remote")
            .enable_all()
            .build()?;
        Ok(runtime.insert(Arc::new(made)).clone())
    }

    /// Waits for something that is done elsewhere; may be called wherever waiting is allowed, also
    /// by tasks of another runtime.
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

    fn place(&self, address: &str) -> io::Result<(ObjectAddress, Client)> {
        let place = ObjectAddress::new(address)?;
        let (clients, wanted, times) = (self.clients.clone(), place.clone(), self.times);
        let client = self.wait(async move { clients.client(&wanted, times).await })?;
        Ok((place, client))
    }

    /// The object that was opened here, if it has been looked at a moment ago.
    fn lately(&self, address: &str) -> Option<Arc<PinnedObject>> {
        let opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        let known =
            opened.get(address).filter(|known| known.looked.is_some_and(|at| at.elapsed() < TRUSTED))?;
        known.object.upgrade()
    }

    fn is_known(&self, address: &str) -> bool {
        let opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        opened.get(address).is_some_and(|known| known.object.strong_count() > 0)
    }

    /// Looks at an object again when it is opened next.
    fn forget_look(&self, address: &str) {
        let mut opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = opened.get_mut(address) {
            known.looked = None;
        }
    }

    /// Keeps an object for whoever opens it next: a scene is looked at by one reader after the
    /// other.
    fn keep(&self, object: Arc<PinnedObject>) {
        let mut recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        recent.push_back(object);
        if recent.len() > RECENT
            && let Some(oldest) = recent.pop_front()
        {
            oldest.forget_first();
        }
    }
}

impl Addresses for Stores {
    fn open(&self, address: &str) -> io::Result<Arc<dyn Storage>> {
        if let Some(object) = self.lately(address) {
            return Ok(object);
        }
        let (place, client) = self.place(address)?;
        let (asked, wanted, times) = (client.clone(), place.clone(), self.times);
        // What the cache has costs nothing, and an object that is known is probably the same.
        let bytes = if self.cache.is_some() || self.is_known(address) { 0 } else { FIRST_BYTES };
        let look = self.wait(async move { object::look(&asked, &wanted, bytes, times).await })?;
        let version = look.version.clone();
        let mut opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        opened.retain(|_, known| known.object.strong_count() > 0);
        if let Some(known) = opened.get_mut(address)
            && known.version == version
            && let Some(object) = known.object.upgrade()
        {
            known.looked = Some(Instant::now());
            return Ok(object);
        }
        let object = PinnedObject::new(
            self.runtime()?,
            client,
            place,
            look,
            self.cache.clone(),
            self.times,
            &self.limit,
        )?;
        let object = Arc::new(object);
        self.keep(object.clone());
        let known = Opened { object: Arc::downgrade(&object), version, looked: Some(Instant::now()) };
        opened.insert(address.to_owned(), known);
        Ok(object)
    }

    fn prepare(&self, address: &str) -> io::Result<()> {
        let (place, client) = self.place(address)?;
        self.wait(upload::prepare(client.writable(&place, self.times)?, place))
    }

    fn put(&self, file: &Path, address: &str) -> io::Result<()> {
        let (place, client) = self.place(address)?;
        let file = std::fs::File::open(file)?;
        let (writer, uploads) = (client.writable(&place, self.times)?, self.uploads.clone());
        let put = self.wait(upload::put(writer, place, file, uploads, self.sending_bytes));
        self.forget_look(address);
        put
    }

    fn look_again(&self) {
        let mut opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        opened.values_mut().for_each(|known| known.looked = None);
    }

    fn abandon(&self, address: &str) {
        let Ok(place) = ObjectAddress::new(address) else { return };
        let (uploads, clients, times) = (self.uploads.clone(), self.clients.clone(), self.times);
        let _ = self.wait(async move {
            let work = async {
                let client = clients.client(&place, times).await?.writable(&place, times)?;
                upload::abandon(client, place, uploads).await;
                Ok(())
            };
            tokio::time::timeout(ABANDON_WITHIN, work).await.unwrap_or(Ok(()))
        });
    }
}
