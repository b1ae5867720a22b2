//! The values at the ends of a colour map: numbers, or percentiles of a sample; and maps over the
//! logarithm.

use anyhow::{Result, bail, ensure};
use rayset::scene::{NamedPalette, Palette};
use serde_json::{Value, json};

use super::statistics::percentile;
use crate::style::{End, ValueRange};

/// Colours of a map over the logarithm, evenly spaced: straight lines between them differ from the
/// curve by less than what shows.
const KNOTS: usize = 256;

impl ValueRange {
    /// What a map over the logarithm has if nothing is said, of positive values in ascending order.
    pub(super) fn customary(sorted: &[f64]) -> Result<(f64, f64)> {
        let range = Self(End::Percent(1.0), End::Percent(99.0)).ends(sorted)?;
        // Of values that are all the same, the middle of the map.
        Ok(if range.0 < range.1 { range } else { (0.3 * range.0, 3.0 * range.0) })
    }

    /// Whether the values of the input must be known.
    pub(super) fn is_relative(&self) -> bool {
        [self.0, self.1].iter().any(|end| matches!(end, End::Percent(_)))
    }

    /// The numbers, of values in ascending order.
    pub(super) fn of(&self, sorted: &[f64]) -> Result<(f64, f64)> {
        let (low, high) = self.ends(sorted)?;
        ensure!(low != high, "--value-range: the values at both of its ends are {low}; write a wider one");
        Ok((low, high))
    }

    fn ends(&self, sorted: &[f64]) -> Result<(f64, f64)> {
        let known = !self.is_relative() || !sorted.is_empty();
        ensure!(known, "there are no values to take percent of; say --value-range LOW:HIGH");
        let value = |end| match end {
            End::Value(v) => v,
            End::Percent(share) => percentile(sorted, share / 100.0),
        };
        Ok((value(self.0), value(self.1)))
    }
}

/// A map over the logarithm of values from `low` to `high`, as a scene file has it: its stops stand
/// closer where values are small. `color` is what the scene has.
pub(super) fn over_logarithm(color: &Value, (low, high): (f64, f64)) -> Result<Value> {
    if !(low > 0.0 && high > 0.0) {
        bail!("--log: the value range {low}:{high} must be above 0; say --value-range LOW:HIGH or 5%:99%");
    }
    let palette = palette(color)?;
    let stops = (0..=KNOTS).map(|i| i as f64 / KNOTS as f64).map(|t| {
        let place = (low * (high / low).powf(t) - low) / (high - low);
        let [red, green, blue] = palette.display_color(t).map(|v| (v * 255.0).round() as u8);
        json!([place.clamp(0.0, 1.0), format!("#{red:02x}{green:02x}{blue:02x}")])
    });
    Ok(stops.collect::<Vec<_>>().into())
}

/// The colours of a map as a scene file writes it.
fn palette(color: &Value) -> Result<Palette> {
    let none = "--log: there is no colour map; add --colormap, and --color-by";
    if let Some(name) = color.as_str() {
        return name.parse::<NamedPalette>().map(Palette::Named).map_err(|_| anyhow::anyhow!(none));
    }
    let stop = |stop: &Value| {
        let at = stop[0].as_f64()?;
        Some((at, crate::values::color(stop[1].as_str()?).ok()?))
    };
    match color.as_array().map(|stops| stops.iter().map(stop).collect::<Option<Vec<_>>>()) {
        Some(Some(stops)) if !stops.is_empty() => Ok(Palette::Stops(stops.into())),
        _ => bail!(none),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_numbers_or_percentiles_of_the_values() {
        let sorted: Vec<f64> = (0..=1000).map(f64::from).collect();
        let of = |text: &str| ValueRange::parse(text).expect("a range").of(&sorted).expect("two values");
        assert_eq!(of("0:10"), (0.0, 10.0));
        assert_eq!(of("1%:99%"), (10.0, 990.0));
        assert_eq!(of(" -5 : 50 %"), (-5.0, 500.0));
        assert_eq!(of("99%:1%"), (990.0, 10.0));
        for wrong in ["5", "1%", "a:b", "-1%:9%", "0:101%", "nan:1", "0:inf", "1e19:0", "nan%:5%"] {
            assert!(ValueRange::parse(wrong).is_err(), "{wrong}");
        }
        let same = ValueRange::parse("0%:50%").expect("a range").of(&[2.0, 2.0, 3.0]);
        assert!(same.expect_err("one value").to_string().contains("are 2"));
        assert!(ValueRange::customary(&[]).is_err());
        assert_eq!(ValueRange::customary(&[10.0; 5]).expect("a range"), (3.0, 30.0));
    }

    #[test]
    fn a_map_over_the_logarithm_has_the_maps_colours_at_equal_factors() {
        let (low, high) = (1e-5, 1e3);
        let stops = over_logarithm(&json!("viridis"), (low, high)).expect("a map");
        let palette = palette(&stops).expect("stops");
        let map: NamedPalette = "viridis".parse().expect("a map");
        for i in 0..=1000 {
            let t = f64::from(i) / 1000.0;
            let value = low * (high / low).powf(t);
            let (found, exact) = (palette.display_color((value - low) / (high - low)), map.display_color(t));
            let error = (0..3).map(|c| (found[c] - exact[c]).abs()).fold(0.0, f64::max);
            assert!(error < 1.5 / 255.0, "at {value}: {error}");
        }
        assert!(over_logarithm(&json!("viridis"), (0.0, 1.0)).is_err());
        assert!(over_logarithm(&json!("points"), (1.0, 2.0)).is_err());
        assert!(over_logarithm(&json!("#102030"), (1.0, 2.0)).is_err());
    }
}
