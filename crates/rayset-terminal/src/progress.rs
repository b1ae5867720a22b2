//! Progress: a bar on a terminal, otherwise a line now and then.

use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rayset::build::{Progress, Stage};

use crate::report;

/// Time between two lines if there is no terminal.
const QUIET: Duration = Duration::from_secs(10);

/// Is told of progress besides: what is being done, how much of it is done, and how much there is.
pub type ProgressCallback<'a> = Option<&'a (dyn Fn(&str, u64, u64) + Sync)>;

/// Shows the progress of a sequence of stages.
pub struct Meter<'a> {
    state: Mutex<State>,
    /// `None`: work is counted in time, and shown as a share of all of it.
    unit: Option<&'static str>,
    terminal: bool,
    hidden: bool,
    told: ProgressCallback<'a>,
}

struct State {
    title: &'static str,
    bar: ProgressBar,
    begun: Begun,
    last_line: Instant,
}

impl<'a> Meter<'a> {
    /// For work that is counted in a unit; `hidden` shows nothing.
    #[must_use]
    pub fn new(unit: &'static str, hidden: bool) -> Self {
        Self::of(Some(unit), hidden)
    }

    /// For work of which what is done is said by the time that it takes.
    #[must_use]
    pub fn of_time() -> Self {
        Self::of(None, false)
    }

    fn of(unit: Option<&'static str>, hidden: bool) -> Self {
        let state =
            State { title: "", bar: ProgressBar::hidden(), begun: Begun::now(0), last_line: Instant::now() };
        Self { state: Mutex::new(state), unit, terminal: std::io::stderr().is_terminal(), hidden, told: None }
    }

    /// The same, with somebody else who is told.
    #[must_use]
    pub fn telling(self, told: ProgressCallback<'a>) -> Self {
        Self { told, ..self }
    }

    /// Shows how much of `total` is done of a stage.
    pub fn show(&self, title: &'static str, done: u64, total: u64) {
        self.show_stage(self.unit, title, done, total);
    }

    /// Shows progress that is counted in another unit.
    pub fn show_in(&self, unit: &str, title: &'static str, done: u64, total: u64) {
        self.show_stage(Some(unit), title, done, total);
    }

    fn show_stage(&self, unit: Option<&str>, title: &'static str, done: u64, total: u64) {
        if let Some(told) = self.told {
            told(title, done, total);
        }
        if self.hidden {
            return;
        }
        let mut state = self.state.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if state.title != title {
            state.bar.finish_and_clear();
            state.title = title;
            state.begun = Begun::now(done);
            state.last_line = Instant::now();
            if self.terminal {
                state.bar = bar(unit, title, total);
            }
        }
        let left = state.begun.seconds_left(done, total);
        if self.terminal {
            state.bar.set_length(total.max(done));
            state.bar.set_position(done);
            state.bar.set_prefix(format!("{} left", in_words(left)));
        } else if state.last_line.elapsed() > QUIET {
            state.last_line = Instant::now();
            let rate = done as f64 / state.begun.elapsed().as_secs_f64();
            let so_far = match unit {
                None => format!("{:.1} %", done as f64 / total.max(done).max(1) as f64 * 100.0),
                Some(unit) => format!(
                    "{} of {} {unit}, {} a second",
                    report::count(done),
                    report::count(total.max(done)),
                    report::count(rate as u64)
                ),
            };
            report::remark(format_args!("{title}: {so_far}, {} left", in_words(left)));
        }
    }

    /// Clears what is shown.
    pub fn finish(&self) {
        let state = self.state.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        state.bar.finish_and_clear();
    }
}

impl Progress for Meter<'_> {
    fn update(&self, stage: Stage, done: u64, total: u64) {
        self.show(rayset_inputs::stage_name(stage), done, total);
    }
}

/// Where work began, and when.
pub struct Begun {
    at: Instant,
    done: u64,
}

impl Begun {
    /// Now, with so much of it done before.
    #[must_use]
    pub fn now(done: u64) -> Self {
        Self { at: Instant::now(), done }
    }

    /// How long ago that is.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.at.elapsed()
    }

    /// Seconds that the rest of the work takes, when so much of it is done, as what was done since
    /// did.
    #[must_use]
    pub fn seconds_left(&self, done: u64, total: u64) -> f64 {
        seconds_left(self.elapsed(), done.saturating_sub(self.done), total.saturating_sub(done))
    }
}

/// Seconds that work takes of which so much is left, where so much took a time.
fn seconds_left(elapsed: Duration, done: u64, left: u64) -> f64 {
    elapsed.as_secs_f64() * left as f64 / done.max(1) as f64
}

/// `45 s`, `3 min 20 s`, `2 h 5 min`.
#[must_use]
pub fn in_words(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match whole {
        0..60 => format!("{whole} s"),
        60..3600 => format!("{} min {} s", whole / 60, whole % 60),
        _ => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
    }
}

fn bar(unit: Option<&str>, title: &'static str, total: u64) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(total.max(1)), ProgressDrawTarget::stderr_with_hz(4));
    let so_far = match unit {
        None => "{percent} %".into(),
        Some(unit) => format!("{{human_pos}}/{{human_len}} {unit} {{per_sec}}"),
    };
    if let Ok(style) = ProgressStyle::with_template(&format!("{{msg:8}} {{bar:30}} {so_far} {{prefix}}")) {
        bar.set_style(style);
    }
    bar.set_message(title);
    bar
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_said_in_two_units_at_most() {
        for (seconds, said) in
            [(0.4, "0 s"), (59.4, "59 s"), (59.6, "1 min 0 s"), (200.0, "3 min 20 s"), (7500.0, "2 h 5 min")]
        {
            assert_eq!(in_words(seconds), said);
        }
        assert_eq!(seconds_left(Duration::from_secs(10), 25, 75), 30.0);
    }
}
