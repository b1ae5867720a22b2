//! How long requests may take.

use std::time::Duration;

/// How long requests may take, and how often they are tried. Only tests choose others than the
/// default.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct Times {
    /// After this time an attempt counts as failed.
    pub attempt: Duration,
    /// All attempts at a request end within this time.
    pub all: Duration,
    /// Most attempts, at least 1.
    pub attempts: u32,
    /// The pause after the first failure, which doubles up to 5 s.
    pub first_pause: Duration,
    /// Bytes a second with which whoever sends much is still waited for.
    pub slowest_sending: u64,
}

impl Default for Times {
    fn default() -> Self {
        Self {
            attempt: Duration::from_secs(30),
            all: Duration::from_secs(180),
            attempts: 6,
            first_pause: Duration::from_millis(100),
            slowest_sending: 64 << 10,
        }
    }
}

#[cfg(feature = "stores")]
impl Times {
    /// The longest pause between attempts.
    pub(crate) const LONGEST_PAUSE: Duration = Duration::from_secs(5);

    /// Those of a request that sends a number of bytes: as much longer as they take on a slow line.
    pub(crate) fn sending(self, bytes: u64) -> Self {
        let longer = Duration::from_secs(bytes / self.slowest_sending.max(1));
        Self { attempt: self.attempt + longer, all: self.all + longer, ..self }
    }

    /// Those of a request whose answer may rightly take as long as all attempts at others.
    pub(crate) fn patient(self) -> Self {
        Self { attempt: self.all, ..self }
    }
}
