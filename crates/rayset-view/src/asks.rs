//! What a page asks for besides pictures to look at, answered by a thread of its own: such an
//! answer does not wait for a picture.

use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, PoisonError};

use rayset::scene_file::SceneFile;
use rayset::{PreparedScene, Session};

use crate::compose::Opened;
use crate::engine::{self, Map};
use crate::frames::{Outgoing, Send};
use crate::picking::{self, Picked};
use crate::protocol::{Show, ToPage};

/// A question of a page.
pub(crate) enum Ask {
    Pick { question: u32, at: [f64; 2], show: Box<Show> },
    Engine { with_map: bool },
    Save(Box<Show>),
    Command { question: u32, show: Box<Show> },
}

/// The scene that a page sees, for those who ask about it.
#[derive(Clone, Default)]
pub(crate) struct Current(Arc<Mutex<Option<VisibleScene>>>);

/// A scene that is seen.
#[derive(Clone)]
pub(crate) struct VisibleScene {
    pub(crate) file: Arc<SceneFile>,
    pub(crate) scene: PreparedScene,
}

impl Current {
    pub(crate) fn set(&self, seen: Option<VisibleScene>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = seen;
    }

    fn get(&self) -> Option<VisibleScene> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Answers questions until nobody asks any more.
pub(crate) fn answer(
    asks: &Receiver<Ask>,
    session: &Session,
    opened: &Opened,
    current: &Current,
    send: &Send,
) {
    let mut map: Option<Option<Map>> = None;
    while let Ok(ask) = asks.recv() {
        let answer = match ask {
            Ask::Pick { question, at, show } => {
                ToPage::Picked(Box::new(picked(question, at, &show, current)))
            }
            Ask::Save(show) => saved(&show, opened),
            Ask::Command { question, show } => ToPage::Command { question, command: opened.command(&show) },
            Ask::Engine { with_map } => {
                // A cloud that cannot be read has no map; what is wrong with it is said where it is
                // rendered.
                let map = map.get_or_insert_with(|| Map::new(opened).unwrap_or_default());
                ToPage::Engine(Box::new(engine::report(session, map.as_ref(), with_map)))
            }
        };
        if !send(Outgoing::Text(answer)) {
            return;
        }
    }
}

/// The scene file of what is seen.
fn saved(show: &Show, opened: &Opened) -> ToPage {
    let text =
        opened.saved(show).and_then(|scene| serde_json::to_string_pretty(&scene).map_err(|e| e.to_string()));
    let problem = |what| ToPage::Problem { generation: show.generation, what };
    text.map_or_else(problem, |scene| ToPage::Saved { scene })
}

fn picked(question: u32, at: [f64; 2], show: &Show, current: &Current) -> Picked {
    let nothing = Picked { question, ..Picked::default() };
    let is_within = at.iter().all(|part| (0.0..=1.0).contains(part));
    let Some(seen) = current.get().filter(|_| is_within) else { return nothing };
    // What is wrong with the camera, or the file, is said where the picture is made.
    picking::pick(question, at, show, &seen.scene, &seen.file.scene.root).unwrap_or(nothing)
}
