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
    unit: &'static str,
    terminal: bool,
    hidden: bool,
    told: ProgressCallback<'a>,
}

struct State {
    title: &'static str,
    bar: ProgressBar,
    started: Instant,
    last_line: Instant,
}

impl<'a> Meter<'a> {
    /// For work that is counted in a unit; `hidden` shows nothing.
    #[must_use]
    pub fn new(unit: &'static str, hidden: bool) -> Self {
        let state = State {
            title: "",
            bar: ProgressBar::hidden(),
            started: Instant::now(),
            last_line: Instant::now(),
        };
        Self { state: Mutex::new(state), unit, terminal: std::io::stderr().is_terminal(), hidden, told: None }
    }

    /// The same, with somebody else who is told.
    #[must_use]
    pub fn telling(self, told: ProgressCallback<'a>) -> Self {
        Self { told, ..self }
    }

    /// Shows how much of `total` is done of a stage.
    pub fn show(&self, title: &'static str, done: u64, total: u64) {
        self.show_in(self.unit, title, done, total);
    }

    /// Shows progress that is counted in another unit.
    pub fn show_in(&self, unit: &str, title: &'static str, done: u64, total: u64) {
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
            state.started = Instant::now();
            state.last_line = Instant::now();
            if self.terminal {
                state.bar = bar(unit, title, total);
            }
        }
        if self.terminal {
            state.bar.set_length(total.max(done));
            state.bar.set_position(done);
        } else if state.last_line.elapsed() > QUIET {
            state.last_line = Instant::now();
            let rate = done as f64 / state.started.elapsed().as_secs_f64();
            let left = total.saturating_sub(done) as f64 / rate;
            report::remark(format_args!(
                "{title}: {} of {} {}, {} a second, {left:.0} s left",
                report::count(done),
                report::count(total.max(done)),
                unit,
                report::count(rate as u64)
            ));
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

fn bar(unit: &str, title: &'static str, total: u64) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(total.max(1)), ProgressDrawTarget::stderr_with_hz(4));
    let template = format!("{{msg:8}} {{bar:30}} {{human_pos}}/{{human_len}} {unit} {{per_sec}} {{eta}}");
    if let Ok(style) = ProgressStyle::with_template(&template) {
        bar.set_style(style);
    }
    bar.set_message(title);
    bar
}
