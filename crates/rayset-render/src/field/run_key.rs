//! By what decoded runs are found again.

/// Which run it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RunKey {
    /// A number of the cloud and of how its runs are decoded.
    pub cloud: usize,
    /// Its page.
    pub page: u32,
    /// Its number in the page.
    pub number: u16,
    /// What is decoded of it.
    pub what: RunPart,
    /// Of what is seen from afar, the number of the sight: a batch sets it.
    pub sight: u16,
}

/// What is decoded of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum RunPart {
    /// All.
    #[default]
    Whole,
    /// What is a density of points that are small in a picture.
    Density,
    /// What of these is seen as Gaussians; of aggregates, so many of them.
    Spread(u16),
}
