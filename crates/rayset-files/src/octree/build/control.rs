//! Progress reports and cancellation of a build.

use crate::points::ReadError;
use rayset_base::cancel::CancelToken;

/// The stages of a build, for progress reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Stage {
    /// Reading and checking the input.
    Read,
    /// Measuring the spacing of points, or looking for copies among them.
    Spacing,
    /// Ordering points and writing pages.
    Write,
    /// Making what stands for points from afar.
    Aggregate,
}

/// Receives progress reports of a build. Called from one thread at a time.
pub trait Progress: Sync {
    /// `done` of `total` points (slices of voxels for a grid) have passed a stage; `total` is 0 if
    /// unknown.
    fn update(&self, stage: Stage, done: u64, total: u64);
}

/// Ignores progress reports.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn update(&self, _: Stage, _: u64, _: u64) {}
}

/// Progress reports and cancellation of a build.
#[derive(Clone)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct BuildControl<'a> {
    /// Receives the progress reports.
    pub progress: &'a dyn Progress,
    /// Cancels the build, which then returns
    /// [`BuildError::Cancelled`](super::BuildError::Cancelled) and leaves no file behind.
    pub cancel: CancelToken,
    /// Is asked, of an input that turns out to be damaged, whether the build goes on without any of
    /// its points. It is given the index of the source and its error. If `None`, and in builds in
    /// parts, the first damaged input ends the build.
    #[expect(clippy::type_complexity, reason = "a name of its own would be one more in the public surface")]
    pub leaves_out: Option<&'a (dyn Fn(usize, &ReadError) -> bool + Sync)>,
}

impl Default for BuildControl<'_> {
    /// No progress reports, and a new token.
    fn default() -> Self {
        Self { progress: &NoProgress, cancel: CancelToken::new(), leaves_out: None }
    }
}

impl<'a> From<&'a dyn Progress> for BuildControl<'a> {
    fn from(progress: &'a dyn Progress) -> Self {
        Self { progress, ..Self::default() }
    }
}

impl<'a> BuildControl<'a> {
    /// Sets who is asked whether a build goes on without a damaged input.
    #[must_use]
    pub fn with_leaving_out(self, leaves_out: &'a (dyn Fn(usize, &ReadError) -> bool + Sync)) -> Self {
        Self { leaves_out: Some(leaves_out), ..self }
    }

    /// Sets the token that stops the build.
    #[must_use]
    pub fn with_cancel(self, cancel: &CancelToken) -> Self {
        Self { cancel: cancel.clone(), ..self }
    }
}
