//! A build, described step by step.

use std::path::Path;

use super::{BuildControl, BuildError, BuildOptions, BuildReport, run, run_in_memory};
use crate::octree::file::Cloud;
use crate::points::PointSource;

/// Builds a cloud of points: [`Cloud::builder`].
#[must_use = "a builder builds nothing by itself"]
#[derive(Default)]
pub struct CloudBuilder<'a> {
    sources: Vec<Box<dyn PointSource + 'a>>,
    options: BuildOptions,
    control: BuildControl<'a>,
}

impl Cloud {
    /// Begins a build, with [`BuildOptions::default`] and no points yet.
    pub fn builder<'a>() -> CloudBuilder<'a> {
        CloudBuilder::default()
    }
}

impl<'a> CloudBuilder<'a> {
    /// Adds points. A cloud has those of all its sources, in any order.
    pub fn source(self, source: impl PointSource + 'a) -> Self {
        self.sources([Box::new(source) as Box<dyn PointSource + 'a>])
    }

    /// Adds the points of several sources, such as `points::open` returns.
    pub fn sources(mut self, sources: impl IntoIterator<Item = Box<dyn PointSource + 'a>>) -> Self {
        self.sources.extend(sources);
        self
    }

    /// Sets how points become a cloud.
    pub fn options(self, options: BuildOptions) -> Self {
        Self { options, ..self }
    }

    /// Sets who is told of progress, and may end the build.
    pub fn control(self, control: BuildControl<'a>) -> Self {
        Self { control, ..self }
    }

    /// Builds the cloud in memory. No file is created; the cloud is the same, byte for byte, as one
    /// that is built into a file.
    ///
    /// # Errors
    /// [`BuildError`].
    pub fn build(self) -> Result<Cloud, BuildError> {
        self.build_reported().map(|(cloud, _)| cloud)
    }

    /// As [`build`](Self::build), with what there is to say of it.
    ///
    /// # Errors
    /// [`BuildError`].
    pub fn build_reported(self) -> Result<(Cloud, BuildReport), BuildError> {
        run_in_memory(self.sources, &self.options, &self.control)
    }

    /// Builds the cloud into a file.
    ///
    /// # Errors
    /// [`BuildError`]; an existing file at `path` is then unchanged.
    pub fn write(self, path: impl AsRef<Path>) -> Result<BuildReport, BuildError> {
        run(self.sources, path.as_ref(), &self.options, &self.control)
    }
}
