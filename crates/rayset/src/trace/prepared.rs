//! A scene compiled for tracing, and what lives as long as it does: its programs, and the tables of its shadows.

use std::sync::Arc;

use super::RenderError;
use super::session::{ExecSettings, Reservation, Session};
use super::view::View;
use super::world::World;
use crate::scene::{Camera, RenderSettings};

/// A scene that is ready to be looked at, any number of times and from several threads. Cheap to clone.
///
/// Cached shadows are made as views need them and kept, inside the session's budget, as long as this lives.
#[derive(Clone, Debug)]
pub struct PreparedScene(Arc<Prepared>);

/// What views share.
pub(super) struct Prepared {
    pub(super) world: World,
    settings: RenderSettings,
    // Given back before the session goes.
    _reservation: Option<Reservation>,
    session: Session,
}

impl std::fmt::Debug for Prepared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} instructions", self.world.program.instructions.len())
    }
}

impl Prepared {
    pub(super) fn exec(&self) -> &ExecSettings {
        self.session.exec()
    }

    pub(super) fn session(&self) -> &Session {
        &self.session
    }
}

impl PreparedScene {
    pub(super) fn new(
        world: World,
        settings: RenderSettings,
        session: Session,
        reservation: Option<Reservation>,
    ) -> Self {
        Self(Arc::new(Prepared { world, settings, _reservation: reservation, session }))
    }

    /// A look at the scene, in a picture of the settings' size.
    ///
    /// # Errors
    /// [`RenderError::Camera`] where the camera makes no rays.
    pub fn view(&self, camera: &Camera) -> Result<View, RenderError> {
        self.view_of_size(camera, self.0.settings.width, self.0.settings.height)
    }

    /// A look at the scene, in a picture of `width` by `height` pixels, each 1 to 1 048 576.
    ///
    /// # Errors
    /// [`RenderError::Camera`] where the camera makes no rays, [`RenderError::Setting`] where the size is out of range.
    pub fn view_of_size(&self, camera: &Camera, width: u32, height: u32) -> Result<View, RenderError> {
        if width == 0 || height == 0 || width > 1 << 20 || height > 1 << 20 {
            let what = format!("{width}x{height} is not between 1x1 and 1048576x1048576");
            return Err(RenderError::Setting { setting: "size", what });
        }
        let rays = camera.ray_maker(width, height)?;
        let settings = RenderSettings { width, height, ..self.0.settings };
        Ok(View { prepared: self.0.clone(), rays, settings })
    }
}
