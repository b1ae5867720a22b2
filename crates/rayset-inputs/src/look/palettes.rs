//! Colours of classes.

/// The classes of the LAS specification (ASPRS, LAS 1.4 R15, table 17) in colours that such maps customarily have.
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

/// The stops of a palette without anything between two classes, and the values at its ends. `customary` is whether the
/// classes are those of LAS files.
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
