//! What a page wants to see, shared by its connection, which hears of it, and its pictures' thread,
//! which makes it.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rayset::CancelToken;

use crate::protocol::Show;

/// Most frames on their way to a page: one that it draws, and one behind it.
const MOST_IN_FLIGHT: u32 = 2;
/// A quick frame that has taken longer than this is given up for a newer one. Sooner, and a scene
/// that is slow to trace would show nothing while it moves.
const PATIENCE: Duration = Duration::from_secs(1);

/// The latest wish of a page, and how far it has been fulfilled.
#[derive(Default)]
pub(crate) struct PageWish {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    show: Option<Arc<Show>>,
    /// What has been shown last.
    done: Option<Done>,
    /// What is being made.
    working: Option<Working>,
    sent: u32,
    acknowledged: u32,
    closed: bool,
}

struct Done {
    show: Arc<Show>,
    grade: Grade,
    /// Whether it has been shown; otherwise it cannot be.
    is_shown: bool,
}

/// How good a picture is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Grade {
    /// Fewer rays than pixels, in a frame's time.
    Quick,
    /// The picture that `rayset render` makes.
    Fine,
}

struct Working {
    grade: Grade,
    since: Instant,
    cancel: CancelToken,
}

/// A picture to make.
pub(crate) struct Order {
    pub(crate) show: Arc<Show>,
    pub(crate) grade: Grade,
    /// Cancelled when something else is wanted.
    pub(crate) cancel: CancelToken,
}

impl PageWish {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Wants something else from now on. What is being made is given up, unless it is nearly done.
    pub(crate) fn show(&self, show: Show) {
        let mut state = self.lock();
        state.show = Some(Arc::new(show));
        let is_over = |working: &&Working| working.grade == Grade::Fine || working.since.elapsed() > PATIENCE;
        let over = state.working.as_ref().filter(is_over).map(|working| working.cancel.clone());
        drop(state);
        // Cancelling wakes threads: not under the lock.
        if let Some(cancel) = over {
            cancel.cancel();
        }
        self.notify();
    }

    /// Wakes whoever waits. Under the lock, so that none that has just looked, and found nothing,
    /// misses it.
    fn notify(&self) {
        let _state = self.lock();
        self.changed.notify_all();
    }

    /// A frame has been drawn, and those before it.
    pub(crate) fn acknowledge(&self, frame: u32) {
        let mut state = self.lock();
        state.acknowledged = state.acknowledged.max(frame.min(state.sent));
        drop(state);
        self.changed.notify_all();
    }

    /// Nobody looks any more.
    pub(crate) fn close(&self) {
        let mut state = self.lock();
        state.closed = true;
        let working = state.working.as_ref().map(|working| working.cancel.clone());
        drop(state);
        if let Some(cancel) = working {
            cancel.cancel();
        }
        self.notify();
    }

    /// Waits for a picture to make: first a quick one of what is wanted, then, if nothing moves, a
    /// fine one. `None` once nobody looks any more.
    pub(crate) fn next(&self) -> Option<Order> {
        let mut state = self.lock();
        loop {
            if state.closed {
                return None;
            }
            if let Some((show, grade)) = state.to_do() {
                let cancel = CancelToken::new();
                state.working = Some(Working { grade, since: Instant::now(), cancel: cancel.clone() });
                return Some(Order { show, grade, cancel });
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Takes note that an order has been fulfilled.
    pub(crate) fn done(&self, order: &Order) {
        let mut state = self.lock();
        state.working = None;
        state.done = Some(Done { show: order.show.clone(), grade: order.grade, is_shown: true });
    }

    /// Takes note that an order cannot be fulfilled. What cannot be shown quickly cannot be shown
    /// finely either.
    pub(crate) fn failed(&self, order: &Order) {
        let mut state = self.lock();
        state.working = None;
        state.done = Some(Done { show: order.show.clone(), grade: Grade::Fine, is_shown: false });
    }

    /// Takes note that an order was given up.
    pub(crate) fn given_up(&self) {
        self.lock().working = None;
    }

    /// The number of the next frame, if it may be sent now.
    pub(crate) fn try_send(&self) -> Option<u32> {
        let mut state = self.lock();
        state.has_room().then(|| state.send())
    }

    /// Waits until a frame may be sent; `None` if `cancel` is cancelled first, or nobody looks any
    /// more.
    pub(crate) fn wait_to_send(&self, cancel: &CancelToken) -> Option<u32> {
        let mut state = self.lock();
        loop {
            if state.closed || cancel.is_cancelled() {
                return None;
            }
            if state.has_room() {
                return Some(state.send());
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// Whether two wishes are for the same picture.
fn is_same_picture(a: &Show, b: &Show) -> bool {
    (a.camera, a.size) == (b.camera, b.size) && a.changes == b.changes
}

impl State {
    fn to_do(&self) -> Option<(Arc<Show>, Grade)> {
        let show = self.show.as_ref()?;
        let reached = self.done.as_ref().filter(|done| done.show.generation == show.generation);
        // A picture that has come to rest has been shown quickly while it moved: again would be no
        // better.
        let before = self.done.as_ref().filter(|done| done.is_shown && is_same_picture(&done.show, show));
        match reached.map(|done| done.grade).or(before.map(|_| Grade::Quick)) {
            None => Some((show.clone(), Grade::Quick)),
            Some(Grade::Quick) if !show.moving => Some((show.clone(), Grade::Fine)),
            Some(_) => None,
        }
    }

    fn has_room(&self) -> bool {
        self.sent - self.acknowledged < MOST_IN_FLIGHT
    }

    fn send(&mut self) -> u32 {
        self.sent += 1;
        self.sent
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::{Changes, Pose};

    fn show(generation: u32, moving: bool) -> Show {
        let camera = Pose {
            position: [f64::from(generation), 0.0, 0.0],
            direction: [0.0, 0.0, -1.0],
            up: [0.0, 1.0, 0.0],
            fovy: 40.0,
            height: None,
        };
        Show { generation, camera, size: [64, 48], moving, changes: Changes::default() }
    }

    #[test]
    fn a_moving_picture_is_quick_and_one_at_rest_is_quick_first_and_then_fine() {
        let wanted = PageWish::default();
        wanted.show(show(1, true));
        let order = wanted.next().expect("an order");
        assert_eq!((order.show.generation, order.grade), (1, Grade::Quick));
        wanted.done(&order);
        wanted.show(show(2, false));
        for grade in [Grade::Quick, Grade::Fine] {
            let order = wanted.next().expect("an order");
            assert_eq!((order.show.generation, order.grade), (2, grade));
            wanted.done(&order);
        }
        wanted.close();
        assert!(wanted.next().is_none());
    }

    #[test]
    fn a_picture_that_comes_to_rest_is_not_made_quickly_twice() {
        let wanted = PageWish::default();
        wanted.show(show(1, true));
        let order = wanted.next().expect("an order");
        wanted.done(&order);
        wanted.show(Show { generation: 2, moving: false, ..show(1, false) });
        let order = wanted.next().expect("an order");
        assert_eq!((order.show.generation, order.grade), (2, Grade::Fine));
        wanted.done(&order);
        // One that cannot be made is tried, and said, again.
        wanted.show(show(3, true));
        wanted.failed(&wanted.next().expect("an order"));
        wanted.show(Show { generation: 4, moving: false, ..show(3, false) });
        let order = wanted.next().expect("an order");
        assert_eq!((order.show.generation, order.grade), (4, Grade::Quick));
    }

    #[test]
    fn a_new_wish_ends_fine_pictures_at_once_and_lets_quick_ones_finish() {
        let wanted = PageWish::default();
        wanted.show(show(1, false));
        let quick = wanted.next().expect("an order");
        wanted.show(show(2, false));
        assert!(!quick.cancel.is_cancelled());
        wanted.done(&quick);
        let newer = wanted.next().expect("an order");
        assert_eq!((newer.show.generation, newer.grade), (2, Grade::Quick));
        wanted.done(&newer);
        let fine = wanted.next().expect("an order");
        wanted.show(show(3, true));
        assert!(fine.cancel.is_cancelled());
    }

    #[test]
    fn no_more_frames_are_under_way_than_the_page_can_take_whatever_it_acknowledges() {
        let wanted = PageWish::default();
        assert_eq!([wanted.try_send(), wanted.try_send(), wanted.try_send()], [Some(1), Some(2), None]);
        wanted.acknowledge(u32::MAX);
        assert_eq!([wanted.try_send(), wanted.try_send(), wanted.try_send()], [Some(3), Some(4), None]);
        wanted.acknowledge(1);
        assert_eq!(wanted.try_send(), None);
        wanted.close();
        assert_eq!(wanted.wait_to_send(&CancelToken::new()), None);
    }
}
