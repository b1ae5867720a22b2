//! Round numbers within a range, and how they are written.

/// The values 1, 2 and 5 times a power of ten are round.
const ROUND: [f64; 3] = [1.0, 2.0, 5.0];

/// The largest round number that is not above a positive number.
pub(super) fn round_below(value: f64) -> f64 {
    let power = 10_f64.powf(value.log10().floor());
    // A number just below a power of ten may have been taken for it.
    let factor = value / power * (1.0 + 1e-9);
    ROUND.iter().rev().find(|round| **round <= factor).map_or(0.5 * power, |round| round * power)
}

/// A marked place of a scale.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tick {
    pub(super) value: f64,
    pub(super) label: String,
}

/// Marks of a scale, and the power of ten that its labels are to be multiplied by, 0 if none.
#[derive(Debug)]
pub(super) struct Ticks {
    pub(super) ticks: Vec<Tick>,
    pub(super) power: i32,
}

/// Round numbers from `low` to `high`, about `wanted` of them, evenly spaced.
pub(super) fn linear(low: f64, high: f64, wanted: f64) -> Ticks {
    let step = match round_below((high - low) / wanted.max(1.0)) {
        // The next round number: as many as wanted, at most.
        step if step * 2.1 * wanted < high - low => step * 5.0,
        step if (high - low) / step > wanted * 1.3 => step * 2.0,
        step => step,
    };
    let largest = low.abs().max(high.abs());
    let power = if (1e-3..1e8).contains(&largest) { 0 } else { largest.log10().floor() as i32 };
    let unit = 10_f64.powi(power);
    let decimals = (-((step / unit).log10() + 1e-9).floor()).clamp(0.0, 12.0) as usize;
    let first = (low / step - 1e-9).ceil();
    let ticks = (0..)
        .map(|i| (first + f64::from(i)) * step)
        .take_while(|value| *value <= high + 1e-9 * step)
        .take(64)
        .map(|value| Tick { value, label: plain(value / unit, decimals) })
        .collect();
    Ticks { ticks, power }
}

/// Round numbers from `low` to `high`, both positive, about `wanted` of them, evenly spaced in the
/// logarithm.
pub(super) fn logarithmic(low: f64, high: f64, wanted: f64) -> Ticks {
    let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
    let decades = (high / low).log10();
    let factors: &[f64] = match wanted / decades.max(1e-9) {
        room if room >= 3.0 => &ROUND,
        room if room >= 2.0 => &[1.0, 3.0],
        _ => &[1.0],
    };
    let every = (decades / wanted.max(1.0)).ceil().max(1.0) as i32;
    let values: Vec<f64> = (first..=last)
        .filter(|power| factors.len() > 1 || power.rem_euclid(every) == 0)
        .flat_map(|power| factors.iter().map(move |factor| factor * 10_f64.powi(power)))
        .filter(|v| (low * (1.0 - 1e-9)..=high * (1.0 + 1e-9)).contains(v))
        .collect();
    if values.len() < 4 && decades < 1.5 {
        // About a decade: ordinary round numbers are closer.
        return linear(low, high, wanted);
    }
    let simple = (1e-3..1e5).contains(&low) && high < 1e5;
    let label = |value: f64| if simple { plain(value, decimals_of(value)) } else { scientific(value) };
    let ticks = values.into_iter().map(|value| Tick { value, label: label(value) }).collect();
    Ticks { ticks, power: 0 }
}

/// Digits behind the point of a round number.
fn decimals_of(value: f64) -> usize {
    (-(value.abs().log10() + 1e-9).floor()).clamp(0.0, 12.0) as usize
}

/// A number with a true minus sign, and thousands parted if there are ten of them.
pub(super) fn plain(value: f64, decimals: usize) -> String {
    let digits = format!("{:.decimals$}", value.abs());
    let (whole, fraction) = digits.split_once('.').map_or((digits.as_str(), None), |(w, f)| (w, Some(f)));
    let mut text = String::new();
    // Nothing is less than zero by rounding.
    if value < 0.0 && digits.contains(|c| ('1'..='9').contains(&c)) {
        text.push('−');
    }
    for (i, digit) in whole.chars().enumerate() {
        if i > 0 && whole.len() > 4 && (whole.len() - i).is_multiple_of(3) {
            text.push('\u{2009}');
        }
        text.push(digit);
    }
    if let Some(fraction) = fraction {
        text.push('.');
        text.push_str(fraction);
    }
    text
}

/// `2×10⁻⁷`
fn scientific(value: f64) -> String {
    let power = (value.log10() + 1e-9).floor() as i32;
    let factor = (value / 10_f64.powi(power)).round();
    let power = power_of_ten(power);
    if factor == 1.0 { power } else { format!("{factor}×{power}") }
}

/// `10⁻⁷`
pub(super) fn power_of_ten(power: i32) -> String {
    let raised = |c: char| match c.to_digit(10) {
        Some(digit) => ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'][digit as usize],
        None => '⁻',
    };
    format!("10{}", power.to_string().chars().map(raised).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(ticks: &Ticks) -> Vec<&str> {
        ticks.ticks.iter().map(|tick| tick.label.as_str()).collect()
    }

    #[test]
    fn ticks_are_round_numbers_within_the_range_and_about_as_many_as_wanted() {
        assert_eq!(labels(&linear(0.0, 10.0, 5.0)), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels(&linear(-0.13, 0.42, 5.0)), ["−0.1", "0.0", "0.1", "0.2", "0.3", "0.4"]);
        assert_eq!(labels(&linear(2_345_611.0, 2_345_689.0, 4.0))[0], "2\u{2009}345\u{2009}620");
        let tiny = linear(0.0, 6e-7, 3.0);
        assert_eq!((labels(&tiny), tiny.power), (vec!["0", "2", "4", "6"], -7));
        for (low, high) in [(0.0, 1.0), (-7.3, 911.0), (1e-9, 1.1e-9), (5.0, 5.001), (-3e12, 4e12)] {
            for wanted in [2.0, 4.0, 6.0, 9.0] {
                let ticks = linear(low, high, wanted).ticks;
                assert!((1..=18).contains(&ticks.len()), "{low} {high} {wanted}: {}", ticks.len());
                let slack = 1e-6 * (high - low);
                assert!(ticks.iter().all(|t| t.value >= low - slack && t.value <= high + slack));
                let mut labels: Vec<&str> = ticks.iter().map(|t| t.label.as_str()).collect();
                labels.dedup();
                assert_eq!(labels.len(), ticks.len(), "{low} {high} {wanted}: {ticks:?}");
            }
        }
    }

    #[test]
    fn ticks_of_logarithms_are_powers_of_ten_or_fill_decades() {
        assert_eq!(labels(&logarithmic(1e-3, 1e4, 7.0)).len(), 8);
        assert_eq!(labels(&logarithmic(2e-9, 3e-5, 5.0)), ["10⁻⁸", "10⁻⁷", "10⁻⁶", "10⁻⁵"]);
        assert_eq!(labels(&logarithmic(1.0, 100.0, 7.0)), ["1", "2", "5", "10", "20", "50", "100"]);
        assert_eq!(labels(&logarithmic(1e-12, 1e12, 5.0)), ["10⁻¹⁰", "10⁻⁵", "10⁰", "10⁵", "10¹⁰"]);
        assert_eq!(labels(&logarithmic(3.0, 4.0, 4.0))[0], "3.0");
        assert_eq!(labels(&logarithmic(0.1057, 0.93, 7.0)).len(), 8);
    }

    #[test]
    fn round_numbers_are_not_above_what_they_stand_for() {
        for (value, round) in
            [(1.0, 1.0), (1.99, 1.0), (4.9, 2.0), (5.0, 5.0), (9.99, 5.0), (0.05, 0.05), (2e7, 2e7)]
        {
            assert!((round_below(value) / round - 1.0).abs() < 1e-12, "{value}: {}", round_below(value));
        }
    }
}
