//! A scene compiled for tracing, and what lives as long as it does: its programs, and the tables of its shadows.

use std::sync::Arc;

use super::engine::{Engine, Reservation};
use super::world::World;
use crate::scene::RenderSettings;

/// A scene that is ready to be looked at, any number of times and from several threads. Cheap to clone.
///
/// Cached shadows are made as views need them and kept, inside the session's budget, as long as this lives.
#[derive(Clone, Debug)]
pub struct PreparedScene(pub(super) Arc<Prepared>);

/// What views share.
pub(super) struct Prepared {
    pub(super) world: World,
    pub(super) settings: RenderSettings,
    // Given back before the session goes.
    _reservation: Option<Reservation>,
    pub(super) engine: Arc<Engine>,
}

impl std::fmt::Debug for Prepared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} instructions", self.world.program.instructions.len())
    }
}

impl PreparedScene {
    pub(super) fn new(
        world: World,
        settings: RenderSettings,
        engine: Arc<Engine>,
        reservation: Option<Reservation>,
    ) -> Self {
        Self(Arc::new(Prepared { world, settings, _reservation: reservation, engine }))
    }
}
