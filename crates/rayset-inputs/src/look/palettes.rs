//! Colours of classes.

/// The classes of the LAS specification (ASPRS, LAS 1.4 R15, table 17) in colours that such maps
/// customarily have.
const LAS: [&str; 23] = [
    "#9a9a9a", // never classified
    "#b4b4b4", // unclassified
    "#a9805a", // ground
    "#9bd26b", // low vegetation
    "#55ad45", // medium vegetation
    "#237a33", // high vegetation
    "#df5a43", // building
    "#c94fc0", // low point (noise)
    "#c9a57f", // model key point
    "#3f7fd6", // water
    "#7d6fb0", // rail
    "#6d7680", // road surface
    "#bcbcd4", // overlap
    "#f2d649", // wire, guard
    "#f0b81c", // wire, conductor
    "#e39a2b", // transmission tower
    "#c98816", // wire connector
    "#8c5d49", // bridge deck
    "#e048e0", // high noise
    "#86b3b0", // overhead structure
    "#d8c7a0", // ignored ground
    "#e8f0f8", // snow
    "#6a4a3a", // temporal exclusion
];

/// Colours that are told apart well, for other classes.
const OTHERS: [&str; 10] = [
    "#4c78a8", "#f58518", "#54a24b", "#e45756", "#72b7b2", "#eeca3b", "#b279a2", "#ff9da6", "#9d755d",
    "#bab0ac",
];

/// The stops of a palette without anything between two classes, and the values at its ends.
/// `customary` is whether the classes are those of LAS files.
pub(super) fn of_classes(least: f64, largest: f64, customary: bool) -> (serde_json::Value, (f64, f64)) {
    /// Of more classes, several share a colour.
    const MOST: f64 = 256.0;
    let (first, count) = (least.floor(), (largest.floor() - least.floor() + 1.0).clamp(1.0, MOST));
    let color = |class: f64| {
        let index = class.rem_euclid(4096.0) as usize;
        match LAS.get(index) {
            Some(color) if customary => *color,
            _ => OTHERS[index % OTHERS.len()],
        }
    };
    let stops: Vec<serde_json::Value> = (0..count as usize)
        .flat_map(|i| {
            let color = color(first + i as f64);
            [(i as f64 / count, color), ((i + 1) as f64 / count, color)]
        })
        .map(|(at, color)| serde_json::json!([at, color]))
        .collect();
    (stops.into(), (first - 0.5, first + count - 0.5))
}

/// The colour of the label of a number, from 0: those of `OTHERS` first, then hues that turn by the
/// golden angle, which are never near those of the latest ones, in three degrees of lightness.
pub(super) fn of_label(number: usize) -> String {
    let Some(turns) = number.checked_sub(OTHERS.len()) else { return OTHERS[number].to_owned() };
    let hue = (turns as f64 * 137.507_764).to_radians();
    let lightness = [0.72, 0.58, 0.84][turns % 3];
    let [red, green, blue] = of_oklch(lightness, 0.12, hue);
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// The bytes of sRGB of a colour in Oklab (Ottosson 2020), in cylindrical coordinates; what
/// displays cannot show is cut.
fn of_oklch(lightness: f64, chroma: f64, hue: f64) -> [u8; 3] {
    let (a, b) = (chroma * hue.cos(), chroma * hue.sin());
    let long = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let medium = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let short = (lightness - 0.089_484_177_5 * a - 1.291_485_548 * b).powi(3);
    let linear = [
        4.076_741_662_1 * long - 3.307_711_591_3 * medium + 0.230_969_929_2 * short,
        -1.268_438_004_6 * long + 2.609_757_401_1 * medium - 0.341_319_396_5 * short,
        -0.004_196_086_3 * long - 0.703_418_614_7 * medium + 1.707_614_701 * short,
    ];
    linear.map(|v| {
        let v = v.clamp(0.0, 1.0);
        let display = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
        (display * 255.0).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_that_follow_each_other_are_told_apart() {
        let channels = |color: &str| -> Vec<i32> {
            (1..7)
                .step_by(2)
                .map(|at| i32::from_str_radix(&color[at..at + 2], 16).expect("two digits"))
                .collect()
        };
        let colors: Vec<Vec<i32>> = (0..256).map(|number| channels(&of_label(number))).collect();
        for (number, color) in colors.iter().enumerate() {
            for other in &colors[number + 1..(number + 5).min(256)] {
                let apart: i32 = color.iter().zip(other).map(|(a, b)| (a - b).abs()).sum();
                assert!(apart >= 40, "{number}: {color:?} and {other:?}");
            }
            assert_eq!(colors.iter().filter(|other| *other == color).count(), 1, "{number}");
        }
    }
}
