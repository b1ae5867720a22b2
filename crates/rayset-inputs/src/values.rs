//! Parsers for values as people write them on a command line.

use std::str::FromStr;

use anyhow::{Context, bail, ensure};
use rayset::scene::{FARTHEST, SHORTEST};

/// A number of bytes: `64MiB`, `20MB`, `1048576`.
pub fn size(text: &str) -> Result<u64, String> {
    bytesize::ByteSize::from_str(text)
        .map(|b| b.as_u64())
        .map_err(|_| format!("`{text}` is not a size; write it as 64MiB, 20MB or 1048576"))
}

/// A picture size: `512x512`.
pub fn dimensions(text: &str) -> Result<(u32, u32), String> {
    let parsed = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    let (width, height) =
        parsed.ok_or_else(|| format!("`{text}` is not a picture size; write it as 512x512"))?;
    let fits = |side: u32| (1..=1 << 20).contains(&side);
    if fits(width) && fits(height) {
        Ok((width, height))
    } else {
        Err(format!("`{text}` is not between 1x1 and 1048576x1048576"))
    }
}

/// A number within bounds, both included.
pub fn number_within(text: &str, least: f64, most: f64) -> Result<f64, String> {
    let number = text.trim().parse().ok().filter(|v: &f64| (least..=most).contains(v));
    let plain =
        |v: f64| if v == 0.0 || (1e-4..1e6).contains(&v.abs()) { v.to_string() } else { format!("{v:e}") };
    number.ok_or_else(|| format!("`{text}` is not a number from {} to {}", plain(least), plain(most)))
}

/// A length.
pub fn length(text: &str) -> Result<f64, String> {
    number_within(text, SHORTEST, FARTHEST)
}

/// Three numbers: `1,0,-2.5`.
pub fn vector(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) if [x, y, z].iter().all(|v| v.abs() <= FARTHEST) => Ok([x, y, z]),
        Some(&[_, _, _]) => Err(format!("`{text}`: expected numbers from -1e18 to 1e18")),
        _ => Err(format!("`{text}` is not three numbers; write it as 1,0,-2.5")),
    }
}

/// A vector that is not too short to have a direction.
pub fn direction(text: &str) -> Result<[f64; 3], String> {
    let vector = vector(text)?;
    if vector.iter().any(|v| v.abs() >= SHORTEST) {
        Ok(vector)
    } else {
        Err(format!("`{text}` has no direction; at least one of its numbers must not be 0"))
    }
}

/// An axis with its sign, as `-z`, or any direction.
pub fn axis(text: &str) -> Result<[f64; 3], String> {
    let (sign, name) =
        text.strip_prefix('-').map_or((1.0, text.trim_start_matches('+')), |name| (-1.0, name));
    match name {
        "x" => Ok([sign, 0.0, 0.0]),
        "y" => Ok([0.0, sign, 0.0]),
        "z" => Ok([0.0, 0.0, sign]),
        _ => direction(text),
    }
}

/// Two numbers: `0:10`.
pub fn range(text: &str) -> Result<(f64, f64), String> {
    let parsed =
        text.split_once(':').and_then(|(a, b)| Some((a.trim().parse().ok()?, b.trim().parse().ok()?)));
    let in_range = |v: f64| v.abs() <= FARTHEST;
    match parsed {
        Some((low, high)) if in_range(low) && in_range(high) => Ok((low, high)),
        Some(_) => Err(format!("`{text}`: expected numbers from -1e18 to 1e18")),
        None => Err(format!("`{text}` is not a range; write it as 0:10")),
    }
}

/// A colour, `#rrggbb` or a name, as display-encoded values of 0 to 1.
pub fn color(text: &str) -> Result<[f64; 3], String> {
    let hex = match text {
        "white" => "ffffff",
        "black" => "000000",
        "grey" | "gray" => "808080",
        other => other.trim_start_matches('#'),
    };
    let wrong = || format!("`{text}` is not a colour; write it as #c8b090, white, black or grey");
    let value = u32::from_str_radix(hex, 16).map_err(|_| wrong())?;
    if hex.len() != 6 {
        return Err(wrong());
    }
    Ok([16, 8, 0].map(|shift| f64::from(value >> shift & 255) / 255.0))
}

/// Opacity from density: `clamp`, `extinction:K`, or a curve `0:0,1:0.5,4:1`.
pub fn opacity(text: &str) -> anyhow::Result<rayset::scene::OpacityRule> {
    use rayset::scene::OpacityRule;
    if text == "clamp" {
        return Ok(OpacityRule::Clamp);
    }
    if let Some(kappa) = text.strip_prefix("extinction:") {
        let kappa = kappa.parse().with_context(|| format!("`{kappa}` is not an extinction coefficient"))?;
        return Ok(OpacityRule::Extinction(kappa));
    }
    let points: Result<Vec<(f64, f64)>, String> = text.split(',').map(range).collect();
    match points {
        Ok(points) => Ok(OpacityRule::Curve(points)),
        Err(_) => bail!("`{text}` is no opacity; write clamp, extinction:2.5 or a curve like 0:0,1:0.5,4:1"),
    }
}

/// Where a value of each point comes from: a number, the name of a column, or `auto`.
pub fn rule(text: &str) -> anyhow::Result<rayset::build::Rule> {
    use rayset::build::Rule;
    ensure!(!text.is_empty(), "expected a number, a column name or `auto`");
    if let Ok(number) = text.parse::<f64>() {
        return Ok(Rule::Number(number));
    }
    Ok(if text == "auto" { Rule::Auto } else { Rule::Attribute(text.to_owned()) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_as_people_write_them() {
        assert_eq!(size("64MiB"), Ok(64 << 20));
        assert_eq!(size("20MB"), Ok(20_000_000));
        assert_eq!(size("4096"), Ok(4096));
        assert_eq!(dimensions("640x480"), Ok((640, 480)));
        assert_eq!(vector("1, -2,3e1"), Ok([1.0, -2.0, 30.0]));
        assert_eq!(color("#ff0000"), Ok([1.0, 0.0, 0.0]));
        for wrong in ["", "64 apples", "-1"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
        assert!(dimensions("640").is_err() && vector("1,2").is_err() && color("#12345").is_err());
        assert!(dimensions("0x1").is_err() && vector("1,nan,2").is_err() && range("0:inf").is_err());
        assert!(direction("0,0,0").is_err() && length("0").is_err() && length("nan").is_err());
    }
}

/// Frames of a sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frames {
    /// All frames of the scene.
    All,
    /// From the first to the last, both included.
    Part(u32, u32),
}

impl Frames {
    /// The frames of an animation that are meant.
    ///
    /// # Errors
    /// If it has no such frames.
    pub fn of(self, path: &rayset::scene::CameraPath) -> anyhow::Result<std::ops::RangeInclusive<u32>> {
        self.among(path.ends(), "animation")
    }

    /// Those that are meant of the frames from the first to the last of `what`.
    ///
    /// # Errors
    /// If it has no such frames.
    pub fn among(self, (from, to): (u32, u32), what: &str) -> anyhow::Result<std::ops::RangeInclusive<u32>> {
        match self {
            Self::All => Ok(from..=to),
            Self::Part(first, last) => {
                ensure!(
                    from <= first && last <= to,
                    "--frames {first}..{last}: the {what} runs from frame {from} to frame {to}"
                );
                Ok(first..=last)
            }
        }
    }
}

/// `all`, `7` or `0..23`.
pub fn frames(text: &str) -> Result<Frames, String> {
    let wrong = || format!("{text}: expected all, a frame like 7, or FIRST..LAST like 0..23");
    if text == "all" {
        return Ok(Frames::All);
    }
    let (first, last) = text.split_once("..").unwrap_or((text, text));
    match (first.parse(), last.parse()) {
        (Ok(first), Ok(last)) if first <= last => Ok(Frames::Part(first, last)),
        _ => Err(wrong()),
    }
}
