//! How many messages a page may send.

use std::time::Instant;

/// Messages a second. A page sends one for each frame of a screen, of which fast ones have 360, and
/// one for each frame that it gets.
const A_SECOND: f64 = 600.0;
/// Messages at once.
const AT_ONCE: f64 = 1000.0;

/// Counts messages: a bucket that fills with time and that every message empties a little.
pub(crate) struct Rate {
    left: f64,
    last: Instant,
}

impl Rate {
    pub(crate) fn new() -> Self {
        Self { left: AT_ONCE, last: Instant::now() }
    }

    /// Takes note of a message that has come now; returns whether it is not one too many.
    pub(crate) fn allows(&mut self) -> bool {
        self.allows_at(Instant::now())
    }

    fn allows_at(&mut self, now: Instant) -> bool {
        let passed = now.saturating_duration_since(self.last).as_secs_f64();
        self.last = now;
        self.left = (self.left + passed * A_SECOND).min(AT_ONCE) - 1.0;
        self.left >= 0.0
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_flood_is_too_much_and_a_busy_page_is_not() {
        let (mut busy, mut flood) = (Rate::new(), Rate::new());
        let start = busy.last;
        let at = |number: u32, a_second: f64| start + Duration::from_secs_f64(f64::from(number) / a_second);
        assert!((0..10_000).all(|number| busy.allows_at(at(number, 400.0))));
        let fine = (0..10_000).take_while(|&number| flood.allows_at(at(number, 10_000.0))).count();
        assert!((1000..1100).contains(&fine), "{fine}");
    }
}
