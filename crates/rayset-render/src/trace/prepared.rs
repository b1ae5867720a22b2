//! A scene compiled for tracing, with everything that lives as long as it does: its programs and
//! its shadow tables.

use std::sync::Arc;

use super::engine::{Engine, Reservation};
use super::world::World;
use crate::scene::{RenderSettings, Scene};

/// A scene that is ready to be rendered, any number of times and from several threads. Cheap to
/// clone.
///
/// Cached shadows are computed as views need them and kept, within the session's budget, as long as
/// this value lives.
#[derive(Clone, Debug)]
pub struct PreparedScene(pub(super) Arc<Prepared>);

/// The state that all views of a scene share.
pub(super) struct Prepared {
    /// The scene as it was given.
    #[cfg_attr(not(feature = "parts"), allow(dead_code, reason = "parts say which scene they are of"))]
    pub(super) scene: Scene,
    pub(super) world: World,
    pub(super) settings: RenderSettings,
    remarks: Vec<String>,
    // Declared before `engine`, and so released before it.
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
        scene: Scene,
        world: World,
        settings: RenderSettings,
        engine: Arc<Engine>,
        reservation: Option<Reservation>,
        remarks: Vec<String>,
    ) -> Self {
        Self(Arc::new(Prepared { scene, world, settings, remarks, _reservation: reservation, engine }))
    }

    /// What a person should know of the scene, a sentence each: caps that were left out, and why.
    #[must_use]
    pub fn remarks(&self) -> &[String] {
        &self.0.remarks
    }

    /// The longest distance between two samples of a ray, in world space: a surface is seen at most
    /// so far behind where it begins.
    #[doc(hidden)]
    #[must_use]
    pub fn longest_step(&self) -> f64 {
        self.0.world.steps.coarsest_world()
    }
}
