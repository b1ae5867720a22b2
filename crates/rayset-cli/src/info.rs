//! `rayset info`

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use rayset::file::{AttributeInfo, Column};
use rayset::geometry::{Aabb, DVec3};
use rayset::memory::SceneNeeds;
use rayset::scene::{CloudObject, RenderSettings, Scene};
use rayset::{Cloud, Grid};

use crate::annotate::{of_header, of_reference_system};
use crate::histogram::{Histogram, terminal_is_unicode};
use rayset_inputs::{Input, units};

use crate::input::{self, Resources};
use crate::input_args::InputArgs;
use rayset_inputs::look::{self, Chosen};
use rayset_inputs::style::Style;
use rayset_terminal::memory::PROCESS_BYTES;
use rayset_terminal::report;

/// Memory of the whole process for building what has not been built.
const BUILD_MEMORY: u64 = 256 << 20;

/// Say what is in a cloud or grid file, or in points or voxels, and how much memory it wants
#[derive(Args)]
pub(crate) struct InfoArgs {
    /// Cloud or grid file, or files of points or voxels, which are built first, into the cache
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Report as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    input: InputArgs,
}

#[derive(serde::Serialize)]
struct Info {
    points: u64,
    copies: u64,
    skipped: u64,
    bounds_min: [f64; 3],
    bounds_max: [f64; 3],
    radius_min: f32,
    radius_max: f32,
    radius_mean: f64,
    /// The least and the largest detail of points that are ellipsoids: of each its radius, or twice
    /// its shortest semi-axis if that is less.
    details: Option<(f32, f32)>,
    weight_min: f32,
    weight_max: f32,
    position_error: f64,
    position_error_radii: f64,
    /// The step of the coordinates that were read, if the inputs say so.
    step: Option<[f64; 3]>,
    color: bool,
    /// Degree of the harmonics by which colours change with the direction.
    color_degree: u8,
    attributes: Vec<Attribute>,
    crs: String,
    /// The unit of lengths, as the reference system has it.
    length_unit: Option<&'static str>,
    /// Of a sample: of every column whose values vary.
    histograms: BTreeMap<String, Histogram>,
    #[serde(flatten)]
    guess: Option<Guess>,
    sources: Vec<String>,
    identity: String,
    file_bytes: u64,
    page_bytes: u32,
    point_pages: u32,
    node_pages: u32,
    nodes: u64,
    index_fraction: f64,
    render_memory_stored: Option<u64>,
    render_memory_least: u64,
    render_memory_comfortable: u64,
}

/// A stored attribute, as JSON.
#[derive(serde::Serialize)]
struct Attribute {
    name: String,
    #[serde(rename = "type")]
    kind: &'static str,
    unit: String,
    classes: bool,
    min: f64,
    max: f64,
}

impl Attribute {
    fn of(info: &AttributeInfo) -> Self {
        Self {
            name: info.name.clone(),
            kind: info.kind.name(),
            unit: info.unit.clone(),
            classes: info.is_class,
            min: info.min,
            max: info.max,
        }
    }
}

/// What is rendered if nothing is said, and why.
#[derive(serde::Serialize)]
struct Guess {
    look: &'static str,
    look_reason: String,
    up: String,
    up_reason: String,
}

impl Guess {
    fn of(chosen: &Chosen) -> Self {
        // `z up (survey coordinates)`, `look: surface (points with colours), …`
        let within = |text: &str| {
            let (before, rest) = text.split_once(" (").unwrap_or((text, ""));
            (before.to_owned(), rest.split(')').next().unwrap_or_default().to_owned())
        };
        let (up, up_reason) = within(&chosen.up);
        let up = up.trim_end_matches(" up").to_owned();
        Self { look: chosen.look, look_reason: within(&chosen.line).1, up, up_reason }
    }

    /// Whether the values are taken for labels.
    fn shows_labels(&self) -> bool {
        self.look == "labels"
    }

    fn describe(&self) {
        report::say(format_args!("up          {}: {}", self.up, self.up_reason));
        report::say(format_args!("look        {}: {}", self.look, self.look_reason));
    }
}

/// Values of a sample: enough for percentiles to a hundredth, few enough for the smallest machines.
const SAMPLE: usize = 1 << 15;
/// Size of the picture of which the guess is made; it has no influence on what is told of it.
const GUESSED: (u32, u32) = (512, 512);

/// What a sample of the points or voxels says; if they cannot be read, that is remarked, and the
/// header alone is told of.
fn told<T>(found: Result<T>) -> Option<T> {
    found.inspect_err(|error| report::remark(format_args!("left out what needs a sample: {error:#}"))).ok()
}

/// The histograms of a cloud's columns, and of its coordinates.
fn histograms(cloud: &Cloud) -> Result<BTreeMap<String, Histogram>> {
    let (sample, schema) = (cloud.sample(SAMPLE)?, cloud.sample_schema());
    let axes = ["x", "y", "z"].iter().enumerate();
    let coordinates = axes.map(|(axis, name)| {
        let values = sample.position.iter().map(move |p| p[axis]);
        ((*name).to_owned(), Histogram::of(values))
    });
    let columns = schema.columns.iter().zip(&sample.columns).map(|(column, values)| {
        (column.name.clone(), Histogram::of((0..sample.len()).map(|i| values.get(i))))
    });
    // A stored column of the name of a coordinate is the one that is meant by it.
    let found = coordinates.chain(columns);
    Ok(found.filter_map(|(name, histogram)| Some((name, histogram?))).collect())
}

/// Prints a histogram, if there is any, after a label.
fn draw(label: &str, histogram: Option<&Histogram>) {
    if let Some(histogram) = histogram {
        report::say(format_args!("{label:<12}{}", histogram.with_ends(terminal_is_unicode())));
    }
}

pub(crate) fn run(args: &InfoArgs) -> Result<()> {
    let resources = Resources { memory: BUILD_MEMORY, threads: None, told: None };
    let opened = input::open(&args.inputs, &args.input.cache(), resources)?;
    let cloud = match &opened.input {
        Input::Cloud(cloud) => cloud,
        Input::Grid(grid) => return grid_info(grid, args.json),
        Input::Scene(path) => bail!("{} is a scene; `rayset check` says what is in it", path.display()),
    };
    let h = cloud.header();
    let scene = Scene::of_cloud(CloudObject::plain(cloud.clone()));
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let needs = SceneNeeds::of(&scene, &RenderSettings::default().with_size(512, 512));
    let plan = needs.with_threads(threads).with_process(PROCESS_BYTES).plan(u64::MAX / 2);
    let plan = plan.map_err(|least| anyhow::anyhow!("no budget below {least} bytes would do"))?;
    let info = Info {
        points: h.points,
        copies: h.copies,
        skipped: h.skipped,
        bounds_min: h.bounds.min.to_array(),
        bounds_max: h.bounds.max.to_array(),
        radius_min: h.radius.min(),
        radius_max: h.radius.max(),
        radius_mean: h.radius_mean,
        details: h.shape,
        weight_min: h.weight.min(),
        weight_max: h.weight.max(),
        position_error: h.position_error,
        position_error_radii: h.position_error_radii,
        step: h.step,
        color: h.has_color,
        color_degree: h.harmonics,
        attributes: h.attributes.iter().map(Attribute::of).collect(),
        crs: h.crs.clone(),
        length_unit: of_reference_system(&h.crs).map_or_else(|| of_header(h), |space| space.unit),
        histograms: told(histograms(cloud)).unwrap_or_default(),
        guess: told(look::of_cloud(cloud, &Style::default(), GUESSED)).map(|chosen| Guess::of(&chosen)),
        sources: h.sources.clone(),
        identity: h.identity.to_string(),
        file_bytes: h.file_bytes,
        page_bytes: h.page_bytes,
        point_pages: h.point_pages,
        node_pages: h.node_pages,
        nodes: h.nodes,
        index_fraction: 1.0 - h.point_data_bytes as f64 / h.file_bytes as f64,
        render_memory_stored: (h.render_memory > 0).then_some(h.render_memory),
        render_memory_least: plan.least_bytes,
        render_memory_comfortable: plan.comfortable_bytes,
    };
    if args.json { report::json(&info) } else { describe(&info, h.radius, h.weight) }
}

/// The JSON report of `--json` about a grid.
#[derive(serde::Serialize)]
struct GridInfo<'a> {
    size: [u64; 3],
    voxels: &'static str,
    value_min: f64,
    value_max: f64,
    bounds_min: [f64; 3],
    bounds_max: [f64; 3],
    file_bytes: u64,
    bricks: u64,
    pages: u64,
    sources: &'a [String],
    /// The values of all voxels, where they are few and whole.
    labels: Vec<LabelInfo<'a>>,
    /// Of a sample of the values.
    histogram: Option<Histogram>,
    #[serde(flatten)]
    guess: Option<Guess>,
}

/// A value of voxels, in the JSON report.
#[derive(serde::Serialize)]
struct LabelInfo<'a> {
    value: f64,
    name: &'a str,
    voxels: u64,
}

fn grid_info(grid: &Grid, as_json: bool) -> Result<()> {
    let h = grid.header();
    let (value_min, value_max) = h.value_range();
    let bounds = Aabb::new(DVec3::ZERO, h.last_voxel()).transformed(&h.space_from_voxel);
    let sample = told(grid.sample(SAMPLE).map_err(Into::into)).unwrap_or_default();
    let values = sample.columns.first().into_iter();
    let histogram = Histogram::of(values.flat_map(|values| (0..sample.len()).map(|i| values.get(i))));
    let guess = told(look::of_grid(grid, &Style::default(), GUESSED)).map(|chosen| Guess::of(&chosen));
    let labels = h.labels.values.iter();
    let labels =
        labels.map(|label| LabelInfo { value: label.value, name: &label.name, voxels: label.voxels });
    if as_json {
        return report::json(&GridInfo {
            size: h.size,
            voxels: h.kind.name(),
            value_min,
            value_max,
            bounds_min: bounds.min.to_array(),
            bounds_max: bounds.max.to_array(),
            file_bytes: h.file_bytes,
            bricks: h.brick_pages(),
            pages: h.pages(),
            sources: &h.sources,
            labels: labels.collect(),
            histogram,
            guess,
        });
    }
    let [x, y, z] = h.size;
    report::say(format_args!("voxels      {x} x {y} x {z} of {}", h.kind.name()));
    for source in &h.sources {
        report::say(format_args!("source      {source}"));
    }
    let vector = |v: DVec3| v.to_array().map(report::number).join(" ");
    report::say(format_args!("values      {} to {}", report::number(value_min), report::number(value_max)));
    draw("", histogram.as_ref());
    report::say(format_args!("bounds      {}  to  {}", vector(bounds.min), vector(bounds.max)));
    for label in h.labels.values.iter().filter(|_| guess.as_ref().is_some_and(Guess::shows_labels)) {
        let name = if label.name.is_empty() { String::new() } else { format!(" {}", label.name) };
        report::say(format_args!(
            "label       {}{name}: {} voxels",
            label.value,
            report::count(label.voxels)
        ));
    }
    guess.iter().for_each(Guess::describe);
    report::say(format_args!(
        "file        {}, {} bricks, {} pages",
        report::bytes(h.file_bytes),
        h.brick_pages(),
        h.pages()
    ));
    Ok(())
}

fn describe(info: &Info, radius: Column, weight: Column) -> Result<()> {
    let column = |c: Column| match c {
        Column::Constant(v) => format!("{} (all points)", report::number(v)),
        Column::Varying { min, max } => format!("{} to {}", report::number(min), report::number(max)),
    };
    let vector = |v: [f64; 3]| v.map(report::number).join(" ");
    let copies = match info.copies {
        0 => String::new(),
        n => format!("; {} more were equal to one of these, whose weight has theirs", report::count(n)),
    };
    report::say(format_args!(
        "points      {} ({} invalid records skipped{copies})",
        report::count(info.points),
        info.skipped
    ));
    report::say(format_args!("bounds      {}  to  {}", vector(info.bounds_min), vector(info.bounds_max)));
    let histogram = |name: &str| draw("", info.histograms.get(name));
    // A stored column of such a name is told of below.
    let is_column = |axis: &&str| info.attributes.iter().any(|attribute| attribute.name == *axis);
    for axis in ["x", "y", "z"].iter().filter(|axis| !is_column(axis)) {
        draw(axis, info.histograms.get(*axis));
    }
    report::say(format_args!("radius      {}, mean {}", column(radius), report::number(info.radius_mean)));
    histogram("radius");
    if let Some((least, largest)) = info.details {
        let [least, largest] = [least, largest].map(report::number);
        report::say(format_args!(
            "shapes      ellipsoids, whose details (radii, or twice the shortest semi-axes) are {least} to {largest}"
        ));
    }
    report::say(format_args!("weight      {}", column(weight)));
    histogram("weight");
    let steps = info.step.map_or_else(String::new, |step| {
        format!(", which have steps of {}", step.map(report::number).join(", "))
    });
    report::say(format_args!(
        "positions   within {:.3e} of those read{steps}, {:.3e} of a radius",
        info.position_error, info.position_error_radii
    ));
    let of_colors = match (info.color, info.color_degree) {
        (false, _) => "no".to_owned(),
        (true, 0) => "yes".to_owned(),
        (true, degree) => format!("by direction: harmonics of degree {degree}"),
    };
    report::say(format_args!("colours     {of_colors}"));
    for a in &info.attributes {
        let unit = units::readable(&a.name, &a.unit);
        let unit = if unit.is_empty() { unit } else { format!(" {unit}") };
        let classes = if a.classes { ", classes" } else { "" };
        report::say(format_args!(
            "attribute   {}: {} to {}{unit} ({}{classes})",
            a.name,
            report::number(a.min),
            report::number(a.max),
            a.kind
        ));
        histogram(&a.name);
    }
    if !info.crs.is_empty() {
        let unit = info.length_unit.map_or_else(String::new, |unit| format!(", lengths in {unit}"));
        report::say(format_args!("reference   {}{unit}", name_of(&info.crs)));
    }
    if let Some(unit) = info.length_unit.filter(|_| info.crs.is_empty()) {
        report::say(format_args!("lengths     in {unit}"));
    }
    let readable: Vec<String> = info.attributes.iter().map(|a| units::readable(&a.name, &a.unit)).collect();
    let used = readable.iter().map(String::as_str).chain(info.length_unit);
    if let Some(words) = units::explained(used) {
        report::say(format_args!("units       {words}"));
    }
    info.guess.iter().for_each(Guess::describe);
    for source in &info.sources {
        report::say(format_args!("source      {source}"));
    }
    report::say(format_args!(
        "file        {}, {} + {} pages of {}, {} nodes, {:.1} % index",
        report::bytes(info.file_bytes),
        info.point_pages,
        info.node_pages,
        report::bytes(u64::from(info.page_bytes)),
        info.nodes,
        100.0 * info.index_fraction
    ));
    if let Some(stored) = info.render_memory_stored {
        report::say(format_args!(
            "renders in  {} by default, as set when it was built",
            report::bytes(stored)
        ));
    }
    report::say(format_args!(
        "memory      a 512x512 picture runs in {} and runs well in {}",
        report::bytes(info.render_memory_least),
        report::bytes(info.render_memory_comfortable)
    ));
    Ok(())
}

/// The name of a reference system: of a long text the first words in quotes.
fn name_of(crs: &str) -> String {
    /// Longer texts are no names.
    const LONGEST: usize = 64;
    match crs.split('"').nth(1) {
        Some(name) if crs.chars().count() > LONGEST => {
            format!("{name} ({} characters; --json has them all)", crs.chars().count())
        }
        _ => crs.to_owned(),
    }
}
