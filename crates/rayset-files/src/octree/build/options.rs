//! The options of a build.

use std::path::PathBuf;

use super::error::BuildError;
use crate::octree::format::{MAX_ATTRIBUTES, NAME_BYTES};
use crate::points::PointSource;
use rayset_base::setters;
use rayset_store::container::MAX_PAGE_BYTES;

/// Where the radius or weight of each point comes from.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Rule {
    /// The same number for every point.
    Number(f64),
    /// A column of the input, by name.
    Attribute(String),
    /// For the radius only: measured from the local spacing of the points.
    Auto,
    /// For the radius only: the longest semi-axis of each point, of inputs that all have
    /// [columns of these](crate::points::SHAPE_COLUMNS).
    SemiAxis,
}

/// The shapes of points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum ShapeRule {
    /// Those of inputs that have columns of [semi-axes and
    /// rotations](crate::points::SHAPE_COLUMNS). Else, where radii are measured, shapes are, too:
    /// discs across the normals of inputs that have any (columns `nx`, `ny`, `nz`, and other usual
    /// names); otherwise discs on surfaces, rods along wires, small balls where points are
    /// scattered. Clouds without surfaces have balls, and so have those whose radii are given.
    #[default]
    Auto,
    /// Balls, whatever the inputs say.
    Round,
    /// Those of particles of a fluid, whose radii are measured: flat along its surface, balls
    /// inside, after Yu & Turk (2013). Radii must be measured: any other rule for them is an error,
    /// and a column `radius` is passed over.
    Fluid,
}

/// What to do with records whose position, radius or weight cannot be used.
///
/// A record is invalid if a coordinate is not finite, its radius is not a positive number, or its
/// weight is not finite. Coordinates, radii and weights whose absolute value exceeds 1e18, and
/// radii below 1e-18, are out of range: they cannot be stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum InvalidPolicy {
    /// Count and skip invalid records. If any record is out of range, fail with an error that
    /// states a scale factor that brings it into range.
    #[default]
    Skip,
    /// Count and skip invalid records and those out of range.
    SkipAll,
    /// Fail with an error that names the first such record.
    Reject,
}

/// How exactly positions are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Precision {
    /// With an error of at most this fraction of the smallest radius in a run of up to 128 points.
    Relative(f64),
    /// Unchanged, bit for bit.
    Exact,
}

impl Default for Precision {
    /// 1/4096 of the radius: the error of the density is about 1e-5 of its maximum where supports
    /// overlap.
    fn default() -> Self {
        Self::Relative(1.0 / 4096.0)
    }
}

/// How to build a cloud.
#[derive(Clone, Debug)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct BuildOptions {
    /// Radius of influence. `None`: the column `radius` if every input has one, otherwise
    /// [`Rule::SemiAxis`] if every input has semi-axes, otherwise [`Rule::Auto`]; of a
    /// [fluid](ShapeRule::Fluid) always this.
    pub radius: Option<Rule>,
    /// Scale factor for every radius, whatever `radius` is.
    pub radius_scale: f64,
    /// Scale factor for every coordinate, and for radii that come from a column.
    pub length_scale: f64,
    /// Weight. `None`: the column `weight` if every input has one, otherwise 1.
    pub weight: Option<Rule>,
    /// Scale factor for every weight, whatever `weight` is.
    pub weight_scale: f64,
    /// Shapes.
    pub shape: ShapeRule,
    /// Names of further columns to store.
    pub attributes: Vec<String>,
    /// Whether to store colours if an input has them. Points without a colour are then grey by
    /// their intensity, or grey.
    pub keep_color: bool,
    /// What to do with invalid records.
    pub invalid: InvalidPolicy,
    /// How exactly to store positions.
    pub precision: Precision,
    /// Size of a page in bytes, a multiple of 4096 from 16384 to 262144. `None`: 32768, or 16384
    /// for fewer than 500 000 points, or more if a run with all columns needs it.
    pub page_bytes: Option<u32>,
    /// Memory budget for rendering in bytes, stored in the file as a default.
    pub render_memory: Option<u64>,
    /// Memory budget of the build in bytes. Does not affect the file.
    pub memory_bytes: u64,
    /// Number of threads. Does not affect the file.
    pub threads: usize,
    /// Folder of temporary files; by default that of the output. Does not affect the file.
    pub temp_dir: Option<PathBuf>,
}

setters!(BuildOptions {
    with_radius => radius: Option<Rule>,
    with_radius_scale => radius_scale: f64,
    with_length_scale => length_scale: f64,
    with_weight => weight: Option<Rule>,
    with_weight_scale => weight_scale: f64,
    with_shape => shape: ShapeRule,
    with_attributes => attributes: Vec<String>,
    with_keep_color => keep_color: bool,
    with_invalid => invalid: InvalidPolicy,
    with_precision => precision: Precision,
    with_page_bytes => page_bytes: Option<u32>,
    with_render_memory => render_memory: Option<u64>,
    with_memory_bytes => memory_bytes: u64,
    with_threads => threads: usize,
    with_temp_dir => temp_dir: Option<PathBuf>,
});

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            radius: None,
            radius_scale: 1.0,
            length_scale: 1.0,
            weight: None,
            weight_scale: 1.0,
            shape: ShapeRule::Auto,
            attributes: Vec::new(),
            keep_color: true,
            invalid: InvalidPolicy::Skip,
            precision: Precision::default(),
            page_bytes: None,
            render_memory: None,
            memory_bytes: 256 << 20,
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            temp_dir: None,
        }
    }
}

/// Memory in bytes that the first pass needs besides its sources: a batch of points and a buffer of
/// records.
const READING_BYTES: u64 = 6 << 20;

/// Largest number of threads, more than any machine has processors.
const MOST_THREADS: usize = 4096;

/// Smallest `memory_bytes` with which a build with `threads` threads can run.
#[must_use]
pub fn minimum_memory(threads: usize) -> u64 {
    (4 << 20) + (threads as u64) * (2 << 20)
}

/// Checks threads and memory, of which at least `least_bytes` are needed.
///
/// # Errors
/// [`BuildError::Option`], [`BuildError::Memory`].
pub(super) fn check_resources(options: &BuildOptions, least_bytes: u64) -> Result<(), BuildError> {
    if options.threads > MOST_THREADS {
        let what = format!("{} are more than {MOST_THREADS}", options.threads);
        return Err(BuildError::Option { option: "threads", what });
    }
    let needed = minimum_memory(options.threads.max(1)).max(least_bytes);
    if options.memory_bytes < needed {
        return Err(BuildError::Memory { given: options.memory_bytes, needed });
    }
    Ok(())
}

/// Memory in bytes that the sources need. One is read after another, before anything else needs
/// much memory; the others are idle.
fn reading_bytes(sources: &[Box<dyn PointSource + '_>]) -> u64 {
    let idle: u64 = sources.iter().map(|source| source.memory_idle()).sum();
    let more = sources.iter().map(|source| source.memory_needed().saturating_sub(source.memory_idle()));
    idle + more.max().unwrap_or(0)
}

/// Checks that the options are in range.
///
/// # Errors
/// [`BuildError::NoInput`], [`BuildError::Option`], [`BuildError::Memory`].
pub(super) fn check_options(
    options: &BuildOptions,
    sources: &[Box<dyn PointSource + '_>],
) -> Result<(), BuildError> {
    let wrong = |option, what: String| Err(BuildError::Option { option, what });
    if sources.is_empty() {
        return Err(BuildError::NoInput);
    }
    check_resources(options, READING_BYTES + reading_bytes(sources))?;
    if let Some(page) = options.page_bytes
        && (page == 0 || page % 4096 != 0 || page as usize > MAX_PAGE_BYTES || page < 16384)
    {
        return wrong(
            "page size",
            format!("{page} is no multiple of 4096 between 16384 and {MAX_PAGE_BYTES}"),
        );
    }
    if options.attributes.len() > MAX_ATTRIBUTES {
        return wrong("attributes", format!("at most {MAX_ATTRIBUTES} can be kept"));
    }
    if let Some(name) = options.attributes.iter().find(|a| a.is_empty() || a.len() > NAME_BYTES) {
        return wrong("attributes", format!("`{name}` has not 1 to {NAME_BYTES} bytes"));
    }
    let mut names: Vec<&String> = options.attributes.iter().collect();
    names.sort();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        return wrong("attributes", format!("`{}` is named twice", pair[0]));
    }
    if let Precision::Relative(p) = options.precision
        && !(p > 0.0 && p <= 0.5)
    {
        return wrong("precision", format!("{p} is not in (0, 0.5] of a radius"));
    }
    for (option, scale) in [
        ("radius scale", options.radius_scale),
        ("length scale", options.length_scale),
        ("weight scale", options.weight_scale),
    ] {
        if !(scale > 0.0 && scale.is_finite()) {
            return wrong(option, format!("{scale} is not a positive number"));
        }
    }
    if options.shape == ShapeRule::Fluid && !matches!(options.radius, None | Some(Rule::Auto)) {
        let what =
            "shapes of a fluid are measured with the radii: give no radius, and a radius scale if need be";
        return wrong("shape", what.into());
    }
    let has_axes = |source: &dyn PointSource| source.schema().axes_of_shapes().is_some();
    let have_axes = options.shape == ShapeRule::Auto && sources.iter().all(|source| has_axes(&**source));
    if options.radius == Some(Rule::SemiAxis) && !have_axes {
        return wrong("radius", "not all inputs have semi-axes and rotations that are kept".into());
    }
    match options.radius {
        Some(Rule::Number(r)) if !(1e-18..=1e18).contains(&(r * options.radius_scale)) => {
            return wrong("radius", format!("{} is not between 1e-18 and 1e18", r * options.radius_scale));
        }
        _ => {}
    }
    match options.weight {
        Some(Rule::Number(w)) if !((w * options.weight_scale).abs() <= 1e18) => {
            return wrong("weight", format!("{} is not a number of at most 1e18", w * options.weight_scale));
        }
        Some(Rule::Auto) => return wrong("weight", "only a radius can be `auto`".into()),
        Some(Rule::SemiAxis) => return wrong("weight", "only a radius can be a semi-axis".into()),
        _ => {}
    }
    Ok(())
}
