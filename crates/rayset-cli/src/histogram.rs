//! How values are spread, in a line of a terminal.

use std::env;

/// Columns of a histogram.
const BINS: usize = 40;
/// The part of the values at either end that is left out: a few strays would make all others one
/// column.
const LEFT_OUT: f64 = 0.002;

const BLOCKS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
const PLAIN: [char; 8] = ['.', ':', '-', '=', '+', '*', '%', '#'];

/// Positive values whose largest is so many times the smallest are counted by their logarithms.
const WIDE: f64 = 1e3;
/// A column this many times as high as the next is cut off, so that the others show.
const SPIKE: u64 = 4;

/// How many values of a sample lie in each of some ranges of equal width.
#[derive(Debug, PartialEq, serde::Serialize)]
pub(crate) struct Histogram {
    /// Lower end of the first range.
    pub(crate) low: f64,
    /// Upper end of the last range.
    pub(crate) high: f64,
    /// Whether the ranges have equal widths in the logarithm.
    pub(crate) logarithmic: bool,
    pub(crate) counts: Vec<u64>,
}

impl Histogram {
    /// The histogram of the finite values; `None` if there are none, or only one and the same. Few
    /// whole numbers have a range each, and are its middles.
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
        sorted.retain(|value| (low..=high).contains(value));
        let whole = sorted.iter().all(|value| value.fract() == 0.0) && high - low < BINS as f64;
        let logarithmic = !whole && low > 0.0 && high / low > WIDE;
        let bins = if whole { (high - low) as usize + 1 } else { BINS };
        let place = |value: f64| match (whole, logarithmic) {
            (true, _) => value - low,
            (_, true) => (value / low).ln() / (high / low).ln() * bins as f64,
            _ => (value - low) / (high - low) * bins as f64,
        };
        let mut counts = vec![0; bins];
        for value in sorted {
            counts[(place(value) as usize).min(bins - 1)] += 1;
        }
        Some(Self { low, high, logarithmic, counts })
    }

    /// A character for each range, as high as there are values in it; a space where there are none.
    pub(crate) fn line(&self, unicode: bool) -> String {
        let mut heights = self.counts.clone();
        heights.sort_unstable_by(|a, b| b.cmp(a));
        let (most, next) = (heights[0].max(1), heights.get(1).copied().unwrap_or(0));
        let most = if next > 0 && most > SPIKE * next { next + next.div_ceil(3) } else { most };
        let signs = if unicode { BLOCKS } else { PLAIN };
        let sign = |count: u64| match count {
            0 => ' ',
            count => signs[((count * 8).div_ceil(most) as usize - 1).min(7)],
        };
        self.counts.iter().map(|&count| sign(count)).collect()
    }

    /// The line between its ends: `0.5 |▁▂▇█▂▁| 20`.
    pub(crate) fn with_ends(&self, unicode: bool) -> String {
        let scale = if self.logarithmic { " (logarithmic)" } else { "" };
        format!("{} |{}| {}{scale}", short(self.low), self.line(unicode), short(self.high))
    }
}

/// A number in at most five digits, or as many as it has before the point.
fn short(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 || (1e-3..1e9).contains(&size) {
        let decimals = (4.0 - size.max(1e-3).log10().floor()).clamp(0.0, 7.0) as usize;
        let text = format!("{value:.decimals$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    } else {
        format!("{value:.3e}")
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
        let values =
            (0..BINS).flat_map(|i| std::iter::repeat_n(0.5 * i as f64, i + 1)).chain([1e9, f64::NAN]);
        let histogram = Histogram::of(values).expect("a histogram");
        assert_eq!((histogram.low, histogram.high, histogram.logarithmic), (0.5, 19.5, false));
        let line = histogram.line(true);
        assert_eq!(line.chars().count(), BINS);
        assert!(line.starts_with('▁') && line.ends_with('█'), "{line}");
        let plain = histogram.with_ends(false);
        assert!(plain.is_ascii() && plain.starts_with("0.5 |.") && plain.ends_with("#| 19.5"), "{plain}");
    }

    #[test]
    fn whole_numbers_have_a_column_each_and_a_spike_leaves_the_others_visible() {
        let of = |values: &[f64]| Histogram::of(values.iter().copied());
        let two = of(&[0.0, 0.0, 0.0, 1.0]).expect("a histogram");
        assert_eq!((two.counts.as_slice(), two.line(true).as_str()), (&[3, 1][..], "█▃"));
        let spike = [vec![-3.0; 5000], vec![-1.0; 20], vec![0.0; 40]].concat();
        assert_eq!(of(&spike).expect("a histogram").line(true), "█ ▃▆");
        assert_eq!(of(&[5.0; 9]), None);
        assert_eq!(of(&[f64::NAN]), None);
        assert_eq!(of(&[-f64::MAX, f64::MAX]), None);
        let wide = of(&(0..900).map(|i| 10_f64.powf(f64::from(i) / 100.0 - 7.0)).collect::<Vec<_>>());
        let wide = wide.expect("a histogram");
        let flat = wide.counts.iter().all(|count| (20..=25).contains(count));
        assert!(wide.logarithmic && flat, "{wide:?}");
        assert!(wide.with_ends(true).starts_with("1.023e-7 |"), "{}", wide.with_ends(true));
    }
}
