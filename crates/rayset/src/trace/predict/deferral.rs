//! How many tiles may wait for their pages, and how.

/// Number of attempts at a tile without waiting. The next attempt waits for every page, so that even with a budget that
/// keeps none of them between attempts the tile is finished.
const IMPATIENT_ATTEMPTS: u32 = 6;
/// The same where pages come from far away: hundreds of tiles are traced in the time that one page takes, and an attempt that
/// waits for page after page takes many times that.
const IMPATIENT_ATTEMPTS_FAR: u32 = 48;

/// How many tiles a thread may defer, and how it waits for them.
#[derive(Clone, Copy, Debug)]
pub(in crate::trace) struct Deferral {
    /// Most tiles that are deferred at a time.
    pub(in crate::trace) most: usize,
    /// Whether pages come from far away.
    pub(in crate::trace) far: bool,
}

impl Deferral {
    /// Number of attempts at a tile without waiting.
    pub(in crate::trace) fn impatient_attempts(self) -> u32 {
        if self.far { IMPATIENT_ATTEMPTS_FAR } else { IMPATIENT_ATTEMPTS }
    }
}
