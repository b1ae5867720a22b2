//! How values are spread, in a line of a terminal.

use std::env;

/// Columns of a histogram.
const BINS: usize = 40;
/// The part of the values at either end that is left out: a few strays would make all others one column.
const LEFT_OUT: f64 = 0.002;

const BLOCKS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
const PLAIN: [char; 8] = ['.', ':', '-', '=', '+', '*', '%', '#'];

/// How many values of a sample lie in each of some ranges of equal width.
#[derive(Debug, PartialEq, serde::Serialize)]
pub(crate) struct Histogram {
    /// Lower end of the first range.
    pub(crate) low: f64,
    /// Upper end of the last range.
    pub(crate) high: f64,
    pub(crate) counts: Vec<u64>,
}

impl Histogram {
    /// The histogram of the finite values; `None` if there are none, or only one and the same.
    pub(crate) fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = values.filter(|value| value.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let (first, last) = (*sorted.first()?, *sorted.last()?);
        let left_out = (LEFT_OUT * sorted.len() as f64) as usize;
        let (mut low, mut high) = (sorted[left_out], sorted[sorted.len() - 1 - left_out]);
        if !(high > low) {
            (low, high) = (first, last);
        }
        if !((high - low).is_finite() && high > low) {
            return None;
        }
        let mut counts = vec![0; BINS];
        for value in sorted.into_iter().filter(|value| (low..=high).contains(value)) {
            let bin = ((value - low) / (high - low) * BINS as f64) as usize;
            counts[bin.min(BINS - 1)] += 1;
        }
        Some(Self { low, high, counts })
    }

    /// A character for each range, as high as there are values in it; a space where there are none.
    pub(crate) fn line(&self, unicode: bool) -> String {
        let most = self.counts.iter().max().copied().unwrap_or(0).max(1);
        let signs = if unicode { BLOCKS } else { PLAIN };
        let sign = |count: u64| match count {
            0 => ' ',
            count => signs[((count * 8).div_ceil(most) as usize - 1).min(7)],
        };
        self.counts.iter().map(|&count| sign(count)).collect()
    }
}

/// Whether the terminal shows Unicode, as the environment has it.
pub(crate) fn terminal_is_unicode() -> bool {
    // The first that is not empty holds, as setlocale(3) has it.
    let locale =
        ["LC_ALL", "LC_CTYPE", "LANG"].iter().find_map(|name| env::var(name).ok().filter(|v| !v.is_empty()));
    locale.map_or(cfg!(any(windows, target_os = "macos")), |locale| {
        let locale = locale.to_ascii_lowercase();
        locale.contains("utf-8") || locale.contains("utf8")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_high_as_there_are_values_and_strays_are_left_out() {
        // A ramp: as many of each number as it says, and a stray far away.
        let values = (0..BINS).flat_map(|i| std::iter::repeat_n(i as f64, i + 1)).chain([1e9, f64::NAN]);
        let histogram = Histogram::of(values).expect("a histogram");
        assert_eq!((histogram.low, histogram.high), (1.0, 39.0));
        let line = histogram.line(true);
        assert_eq!(line.chars().count(), BINS);
        assert!(line.starts_with('▁') && line.ends_with('█'), "{line}");
        let plain = histogram.line(false);
        assert!(plain.is_ascii() && plain.starts_with('.') && plain.ends_with('#'), "{plain}");
        let two = Histogram::of([0.0, 0.0, 0.0, 1.0].into_iter()).expect("a histogram");
        assert_eq!(two.counts.iter().sum::<u64>(), 4);
        assert_eq!(two.line(true).trim_start_matches('█').chars().filter(|c| *c != ' ').count(), 1);
        assert_eq!(Histogram::of([5.0; 9].into_iter()), None);
        assert_eq!(Histogram::of([f64::NAN].into_iter()), None);
        assert_eq!(Histogram::of([-f64::MAX, f64::MAX].into_iter()), None);
    }
}
