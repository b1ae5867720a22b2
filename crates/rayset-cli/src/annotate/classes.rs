//! Classes of points, by name.

use rayset::Cloud;

/// Points of a sample: enough to meet every class of a few thousandths.
const SAMPLE_POINTS: usize = 1 << 14;

/// The classes of the LAS specification (ASPRS, LAS 1.4 R15, table 17).
const LAS: [&str; 23] = [
    "never classified",
    "unclassified",
    "ground",
    "low vegetation",
    "medium vegetation",
    "high vegetation",
    "building",
    "low noise",
    "key point",
    "water",
    "rail",
    "road",
    "overlap",
    "wire, guard",
    "wire, conductor",
    "transmission tower",
    "wire connector",
    "bridge deck",
    "high noise",
    "overhead structure",
    "ignored ground",
    "snow",
    "temporal exclusion",
];

/// The classes of a column that a sample of the points has, ascending, with their names; none if the sample cannot be read.
pub(super) fn in_use(cloud: &Cloud, column: &str) -> Vec<(f64, String)> {
    let schema = cloud.sample_schema();
    let index = schema.columns.iter().position(|known| known.name == column);
    let (Some(index), Ok(sample)) = (index, cloud.sample(SAMPLE_POINTS)) else { return Vec::new() };
    let mut values: Vec<f64> = (0..sample.len()).map(|i| sample.columns[index].get(i)).collect();
    values.retain(|value| value.is_finite());
    values.sort_by(f64::total_cmp);
    values.dedup();
    let customary = column.eq_ignore_ascii_case("classification");
    let name = |class: f64| match LAS.get(class as usize) {
        Some(name) if customary && class >= 0.0 => (*name).to_owned(),
        _ => format!("{class}"),
    };
    values.into_iter().map(|class| (class, name(class))).collect()
}
