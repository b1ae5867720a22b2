//! A page's connection, from its first message to its last.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::extract::ws::{Message, WebSocket};
use rayset::CancelToken;
use tokio::sync::mpsc;

use crate::asks::{self, Ask, Current};
use crate::frames::{Frames, Outgoing, Send};
use crate::protocol::{FromPage, Show, ToPage};
use crate::rate::Rate;
use crate::saving;
use crate::server::{MOST_PAGES, Ready, Shared, Stage};
use crate::wanted::PageWish;

/// Messages that wait for a page, besides frames, of which at most two are under way.
const MESSAGES_WAITING: usize = 4;
/// Questions of a page that wait for an answer; further ones are not heard.
const QUESTIONS_WAITING: usize = 4;
/// Between pings, which keep a page that rests from being taken for one that has gone.
const BETWEEN_PINGS: Duration = Duration::from_secs(10);
/// A page that takes longer than this for a message has gone.
const PATIENCE: Duration = Duration::from_secs(20);

/// Places for pages, each with its share of the memory for pictures; free again when dropped.
pub(crate) struct Places {
    shared: Arc<Shared>,
    count: usize,
}

impl Places {
    /// One place; `None` if all are taken.
    pub(crate) fn one(shared: &Arc<Shared>) -> Option<Self> {
        Self::take(shared, |free| free.min(1))
    }

    /// All that are free; `None` if none is.
    fn rest(shared: &Arc<Shared>) -> Option<Self> {
        Self::take(shared, |free| free)
    }

    fn take(shared: &Arc<Shared>, wanted: impl Fn(usize) -> usize) -> Option<Self> {
        let mut count = 0;
        let take = |taken| {
            count = wanted(MOST_PAGES - taken);
            (count > 0).then_some(taken + count)
        };
        let taken = shared.pages.fetch_update(Ordering::Relaxed, Ordering::Relaxed, take);
        taken.ok().map(|_| Self { shared: shared.clone(), count })
    }
}

impl Drop for Places {
    fn drop(&mut self) {
        self.shared.pages.fetch_sub(self.count, Ordering::Relaxed);
    }
}

/// Speaks with a page until either side has enough.
pub(crate) async fn serve(place: Places, mut socket: WebSocket) {
    // The place is free again when the page's threads, too, have ended: one may be preparing a
    // scene.
    let place = Arc::new(place);
    let shared = place.shared.clone();
    let Some(ready) = opened(&shared, &mut socket).await else { return };
    let (send, mut outgoing) = mpsc::channel(MESSAGES_WAITING);
    let Some(page) = Page::start(&place, ready, send) else { return };
    if give(&mut socket, Outgoing::Text(page.ready.hello.clone())).await.is_err() {
        return;
    }
    let mut rate = Rate::new();
    let mut pings = tokio::time::interval(BETWEEN_PINGS);
    loop {
        let ended = tokio::select! {
            message = socket.recv() => match message.map(|message| message.map(|m| page.hear(&mut rate, m))) {
                Some(Ok(Ok(None))) => Ok(()),
                Some(Ok(Ok(Some(answer)))) => give(&mut socket, Outgoing::Text(answer)).await,
                Some(Ok(Err(()))) | Some(Err(_)) | None => Err(()),
            },
            _ = pings.tick() => deliver(&mut socket, Message::Ping(Vec::new().into())).await,
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

/// Tells a page why it is not served, and ends the connection.
pub(crate) async fn refuse(what: String, mut socket: WebSocket) {
    // A page that does not listen is not told.
    let _ = give(&mut socket, Outgoing::Text(ToPage::Refused { what })).await;
    let _ = deliver(&mut socket, Message::Close(None)).await;
}

/// Waits until there is something to see, and tells the page meanwhile how far it is; `None` if the
/// page does not wait.
async fn opened(shared: &Shared, socket: &mut WebSocket) -> Option<Arc<Ready>> {
    let mut stage = shared.stage.subscribe();
    let (mut rate, mut pings) = (Rate::new(), tokio::time::interval(BETWEEN_PINGS));
    loop {
        let now = stage.borrow_and_update().clone();
        match now {
            Stage::Ready(ready) => return Some(ready),
            Stage::Opening { what, part } => {
                give(socket, Outgoing::Text(ToPage::Opening { what, part })).await.ok()?;
            }
        }
        tokio::select! {
            changed = stage.changed() => changed.ok()?,
            _ = pings.tick() => deliver(socket, Message::Ping(Vec::new().into())).await.ok()?,
            // What it says means nothing yet; that it has gone does.
            message = socket.recv() => {
                message?.ok()?;
                if !rate.allows() {
                    return None;
                }
            }
        }
    }
}

/// A page that is served.
struct Page {
    shared: Arc<Shared>,
    ready: Arc<Ready>,
    place: Arc<Places>,
    wanted: Arc<PageWish>,
    asks: SyncSender<Ask>,
    /// Sends to the page, from a thread.
    send: mpsc::Sender<Outgoing>,
    /// The picture that is being saved, or was saved last.
    saving: Mutex<Option<Saving>>,
}

struct Saving {
    cancel: CancelToken,
    is_done: Arc<AtomicBool>,
}

impl Page {
    /// Starts the threads of a page: one makes its pictures, one answers its questions. `None` if
    /// the system starts none.
    fn start(place: &Arc<Places>, ready: Arc<Ready>, send: mpsc::Sender<Outgoing>) -> Option<Self> {
        let (wanted, current) = (Arc::new(PageWish::default()), Current::default());
        let (asks, questions) = std::sync::mpsc::sync_channel(QUESTIONS_WAITING);
        let shared = place.shared.clone();
        // Made first: dropped, it ends the threads that have been started.
        let page = Self {
            shared: shared.clone(),
            ready: ready.clone(),
            place: place.clone(),
            wanted: wanted.clone(),
            asks,
            send,
            saving: Mutex::default(),
        };
        let (session, opened) = (ready.session.clone(), ready.opened.clone());
        let frames = Frames::new(session, opened, shared.most_pixels, wanted, current.clone(), page.sender());
        page.thread(move || frames.run())?;
        let send = page.sender();
        page.thread(move || asks::answer(&questions, &ready.session, &ready.opened, &current, &send))?;
        Some(page)
    }

    /// Runs something on a thread of its own. `None`, and a line in the log, if the system starts
    /// none.
    fn thread(&self, run: impl FnOnce() + std::marker::Send + 'static) -> Option<()> {
        let place = self.place.clone();
        let started = std::thread::Builder::new().name("rayset-view".into()).spawn(move || {
            run();
            drop(place);
        });
        let said =
            |error: std::io::Error| (self.shared.log)(&format!("the system starts no thread: {error}"));
        started.map_err(said).ok().map(drop)
    }

    fn sender(&self) -> Send {
        let send = self.send.clone();
        Box::new(move |message| send.blocking_send(message).is_ok())
    }

    /// Takes note of what a page says; returns the answer, if there is one at once. An error ends
    /// the connection.
    fn hear(&self, rate: &mut Rate, message: Message) -> Result<Option<ToPage>, ()> {
        let log = &self.shared.log;
        if !rate.allows() {
            log("closed a page: it sent too many messages");
            return Err(());
        }
        let text = match message {
            Message::Text(text) => text,
            Message::Ping(_) | Message::Pong(_) => return Ok(None),
            Message::Binary(_) | Message::Close(_) => return Err(()),
        };
        match serde_json::from_str(&text) {
            Ok(message) => self.follow(message),
            Err(error) => {
                log(&format!("closed a page: it sent what is no message: {error}"));
                Err(())
            }
        }
    }

    fn follow(&self, message: FromPage) -> Result<Option<ToPage>, ()> {
        match message {
            FromPage::Show(show) => self.wanted.show(*show),
            FromPage::Ack { frame } => self.wanted.acknowledge(frame),
            FromPage::Invite {} => {
                let token = self.shared.access.issue().map_err(|_| ())?;
                return Ok(Some(ToPage::Invited { token }));
            }
            FromPage::Save(show) => self.ask(Ask::Save(show)),
            FromPage::Command { question, show } => self.ask(Ask::Command { question, show }),
            FromPage::Pick { question, at, show } => self.ask(Ask::Pick { question, at, show }),
            FromPage::Engine { with_map } => self.ask(Ask::Engine { with_map }),
            FromPage::Picture(show) => {
                return Ok(self.save(show).err().map(|what| ToPage::Pictured { what: Some(what) }));
            }
            FromPage::Cancel {} => {
                self.cancel_saving();
            }
        }
        Ok(None)
    }

    fn cancel_saving(&self) {
        if let Some(saving) = &*self.saving.lock().unwrap_or_else(PoisonError::into_inner) {
            saving.cancel.cancel();
        }
    }

    /// Passes a question on. Of a page that asks faster than it is answered, some are not.
    fn ask(&self, ask: Ask) {
        let _ = self.asks.try_send(ask);
    }

    /// Saves a picture, with the memory of the pages that are not open.
    fn save(&self, show: Box<Show>) -> Result<(), String> {
        let mut saving = self.saving.lock().unwrap_or_else(PoisonError::into_inner);
        if saving.as_ref().is_some_and(|saving| !saving.is_done.load(Ordering::Acquire)) {
            return Err("a picture is being saved already".into());
        }
        let Some(places) = Places::rest(&self.shared) else {
            return Err("there is no memory to save a picture while as many pages are open, or another is being saved".into());
        };
        let (cancel, is_done) = (CancelToken::new(), Arc::new(AtomicBool::new(false)));
        *saving = Some(Saving { cancel: cancel.clone(), is_done: is_done.clone() });
        let (ready, send) = (self.ready.clone(), self.sender());
        let bytes = self.shared.page_bytes * places.count as u64;
        let started = self.thread(move || {
            let saved = saving::save(&ready.session, &ready.opened, &show, bytes, &cancel, &send);
            // Before the page is told, so that it can ask for the next.
            is_done.store(true, Ordering::Release);
            drop(places);
            send(Outgoing::Text(ToPage::Pictured { what: saved.err() }));
        });
        started.ok_or_else(|| "the system starts no thread".into())
    }
}

impl Drop for Page {
    /// Ends the threads whichever way the connection ended.
    fn drop(&mut self) {
        self.wanted.close();
        self.cancel_saving();
    }
}

/// Sends a message; an error if the page does not take it.
async fn give(socket: &mut WebSocket, message: Outgoing) -> Result<(), ()> {
    let message = match message {
        Outgoing::Text(text) => Message::Text(serde_json::to_string(&text).map_err(|_| ())?.into()),
        Outgoing::Frame(bytes) => Message::Binary(bytes.into()),
    };
    deliver(socket, message).await
}

async fn deliver(socket: &mut WebSocket, message: Message) -> Result<(), ()> {
    match tokio::time::timeout(PATIENCE, socket.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) | Err(_) => Err(()),
    }
}
