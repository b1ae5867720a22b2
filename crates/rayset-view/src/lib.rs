//! A viewer in the browser: a server on the user's own machine, whose page looks around in a scene
//! that the session traces within its memory.
//!
//! One visit, followed through the files (ARCHITECTURE.md has it as a table): [`Server::start`]
//! (`server`) listens; a visitor with a token (`access`) gets the page (`page`), which opens a
//! socket and says what it wants to see (`protocol`); its wishes (`wanted`) are fulfilled by a
//! thread (`frames`) that makes a scene of them (`compose`), has the session trace it, at a
//! resolution that keeps up with motion (`pacing`), and sends the pictures (`payload`). A page's
//! connection is `visit`; looks that it can choose `looks`, cuts `cuts`; questions besides are
//! answered in `asks`, `picking` and `engine`; `saving` renders pictures for files.
//!
//! Nothing of the engine is reached around: pictures come from [`rayset::View::render`], and the
//! last of them is that of `rayset render`, bit for bit.

mod access;
mod asks;
mod compose;
mod connections;
mod cuts;
mod engine;
mod frames;
mod looks;
mod pacing;
mod page;
mod payload;
mod picking;
mod protocol;
mod rate;
mod refusals;
mod saving;
mod server;
mod visit;
mod wanted;

/// Takes a message as a page would send it, for tests: reads it, and makes of a wish the scene that
/// would be traced.
///
/// # Errors
/// What is wrong with it.
#[doc(hidden)]
pub fn hear_message(bytes: &[u8]) -> Result<(), String> {
    use self::protocol::{FromPage, MOST_EDGE, Show};
    let scene = serde_json::json!({"rayset": 1, "root": {"type": "sphere", "radius": 1}});
    let opened = compose::Opened::new(Subject::scene(String::new(), "ball.json".into(), scene))?;
    let seen = |show: &Show| {
        show.check(MOST_EDGE, u64::MAX)?;
        opened.saved(show)?;
        opened.legend(&show.changes, &[])?;
        opened.parse(&opened.composed(show, true)?).map(drop)
    };
    match serde_json::from_slice::<FromPage>(bytes).map_err(|error| error.to_string())? {
        FromPage::Show(show) | FromPage::Save(show) | FromPage::Picture(show) => seen(&show),
        FromPage::Pick { show, .. } | FromPage::Command { show, .. } => seen(&show),
        FromPage::Ack { .. } | FromPage::Invite {} | FromPage::Engine { .. } | FromPage::Cancel {} => Ok(()),
    }
}

pub use self::access::{SECRET_BYTES, secret};
pub use self::compose::Subject;
pub use self::looks::{Attribute, Choices, Command, Histogram, Looks, Stance, Styled};
pub use self::server::{Opener, Options, ServeError, Server};
