//! What would make a render faster, said once where it takes long.

use std::time::Duration;

use rayset::Session;
use rayset_terminal::progress::{Begun, in_words};
use rayset_terminal::report::remark;

/// Renders that are finished sooner are let alone.
const LONG_SECONDS: f64 = 60.0;
/// How long a render lasts before it is known how long it will.
const KNOWN_AFTER: Duration = Duration::from_secs(3);

/// Says once what would make a render faster, if it takes long.
pub(super) struct Advice<'a> {
    session: &'a Session,
    /// Whether what is finished is kept anyway.
    keeps: bool,
    /// At the first that was told.
    begun: Option<Begun>,
    is_said: bool,
}

impl<'a> Advice<'a> {
    pub(super) fn new(session: &'a Session, keeps: bool) -> Self {
        Self { session, keeps, begun: None, is_said: false }
    }

    /// Is told how far the render has come.
    pub(super) fn told(&mut self, done: u64, total: u64) {
        let begun = self.begun.get_or_insert_with(|| Begun::now(done));
        if self.is_said || begun.elapsed() < KNOWN_AFTER {
            return;
        }
        let left = begun.seconds_left(done, total);
        if left > LONG_SECONDS {
            self.is_said = true;
            let all = begun.elapsed().as_secs_f64() + left;
            remark(advice((all, left), self.session.share_of_one_ray(), self.keeps));
        }
    }
}

/// The line of a render that takes `all` seconds, of which some are left; one ray a pixel takes a
/// share of them, if that is known.
fn advice((all, left): (f64, f64), share_of_one_ray: Option<f64>, keeps: bool) -> String {
    let mut faster = Vec::new();
    if let Some(share) = share_of_one_ray.filter(|&share| share < 0.9) {
        faster.push(format!("--samples 1 takes {} in all", in_words(share * all)));
    }
    faster.push(format!("half the width and height {}", in_words(all / 4.0)));
    let keep = if keeps { "" } else { "; with --keep-partial, Ctrl-C keeps what is finished" };
    format!("about {} are left; {}{keep}", in_words(left), faster.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_advice_says_what_each_option_takes() {
        assert_eq!(
            advice((400.0, 300.0), Some(0.25), false),
            "about 5 min 0 s are left; --samples 1 takes 1 min 40 s in all, half the width and height 1 min 40 s; \
             with --keep-partial, Ctrl-C keeps what is finished"
        );
        assert!(!advice((400.0, 300.0), Some(1.0), true).contains("samples"));
        assert!(!advice((400.0, 300.0), None, true).contains("samples"));
    }
}
