//! Who hears how a build gets on, and who may stop it.

use crate::cancel::CancelToken;

/// The parts of a build, for progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Stage {
    /// Reading and checking the input.
    Read,
    /// Measuring the spacing of points.
    Spacing,
    /// Ordering points and writing pages.
    Write,
}

/// Hears how a build gets on. Called from one thread at a time, a few times a second.
pub trait Progress: Sync {
    /// `done` of `total` points (0 where unknown) have passed a stage.
    fn update(&self, stage: Stage, done: u64, total: u64);
}

/// Hears nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn update(&self, _: Stage, _: u64, _: u64) {}
}

/// Who hears how a build gets on, and who may stop it.
#[derive(Clone)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct BuildControl<'a> {
    /// Hears how it gets on.
    pub progress: &'a dyn Progress,
    /// Stops it: the build then returns [`BuildError::Cancelled`](super::BuildError::Cancelled) and leaves no file behind.
    pub cancel: CancelToken,
}

impl Default for BuildControl<'_> {
    /// Nobody.
    fn default() -> Self {
        Self { progress: &NoProgress, cancel: CancelToken::new() }
    }
}

impl<'a> From<&'a dyn Progress> for BuildControl<'a> {
    fn from(progress: &'a dyn Progress) -> Self {
        Self { progress, ..Self::default() }
    }
}

impl BuildControl<'_> {
    /// Sets the token that stops the build.
    #[must_use]
    pub fn with_cancel(self, cancel: &CancelToken) -> Self {
        Self { cancel: cancel.clone(), ..self }
    }
}
