//! Opens any input, building what has not been built.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use rayset::build::{self, BuildControl, BuildOptions, GridBuildOptions, Progress};
use rayset::volumes::{RawLayout, VolumeSource};
use rayset::{Cloud, Grid};

use super::cache::{self, CacheArgs, Place};
use super::columns;
use super::files;
use super::kinds::{self, Built};
use super::magnitude;
use super::sources::{has_volume, open_points, remark_about};
use crate::choices::BuildChoices;
use crate::host::{Host, Reported};
use crate::speed::with_speeds;
use crate::text;

/// What an input is.
pub enum Input {
    /// A scene file, which is not opened yet.
    Scene(PathBuf),
    /// Points.
    Cloud(Arc<Cloud>),
    /// Voxels.
    Grid(Box<Grid>),
}

/// An opened input, with every file that it was read from.
pub struct Opened {
    /// What it is.
    pub input: Input,
    /// The files, and what was built of them.
    pub files: Vec<PathBuf>,
    /// Removed with this, if nothing is kept.
    _place: Option<Place>,
}

/// The resources that building may use.
#[derive(Clone, Copy)]
pub struct Resources<'a> {
    /// Most bytes that a build allocates.
    pub memory: u64,
    /// As many as there are processors if `None`.
    pub threads: Option<usize>,
    /// Who asks.
    pub host: &'a dyn Host,
}

/// Opens inputs: one scene, one cloud or grid file, one volume, or any number of files of points, folders and patterns.
pub fn open(inputs: &[PathBuf], cache: &CacheArgs, resources: Resources<'_>) -> Result<Opened> {
    let files = files::expand(inputs, resources.host)?;
    if let [file] = files.as_slice() {
        if let Some(option) = cache.choices.given()
            && (kinds::is_scene(file)? || kinds::is_built(file)?)
        {
            bail!(
                "{option} says how an input is built, and {} is a scene or has been built: build it with {option}",
                file.display()
            );
        }
        if kinds::is_scene(file)? {
            return Ok(Opened { input: Input::Scene(file.clone()), files, _place: None });
        }
        if kinds::is_built(file)? {
            return Ok(Opened { input: built(file)?, files, _place: None });
        }
    }
    for file in &files {
        if kinds::is_scene(file)? || kinds::is_built(file)? {
            bail!(
                "{} is a scene or has been built: it is rendered by itself, or with others as objects of a scene \
                 (docs/scene.md)",
                file.display()
            );
        }
    }
    of_raw(files, cache, resources)
}

fn built(path: &Path) -> Result<Input> {
    Ok(match kinds::open_built(path)? {
        Built::Cloud(cloud) => Input::Cloud(cloud),
        Built::Grid(grid) => Input::Grid(grid),
    })
}

/// Builds files of points or voxels, unless that has been done before.
fn of_raw(files: Vec<PathBuf>, cache: &CacheArgs, resources: Resources<'_>) -> Result<Opened> {
    let place = cache.place(&files, &cache.choices.key(), resources.host)?;
    if let Place::Kept(path) = &place
        && path.exists()
    {
        // One that does not open was damaged: it is built again.
        if let Ok(input) = built(path) {
            cache::touch(path);
            resources.host.remark(&format!("using {}, built before", path.display()));
            return Ok(Opened { input, files: with(files, path), _place: None });
        }
        std::fs::remove_file(path).with_context(|| format!("cannot replace {}", path.display()))?;
    }
    let started = Instant::now();
    resources.host.writes(place.path(), &files)?;
    build(&files, &cache.choices, place.path(), resources)?;
    let input = built(place.path())?;
    let seconds = started.elapsed().as_secs_f64();
    match &place {
        Place::Kept(path) => {
            cache.prune(path, resources.host);
            resources.host.remark(&format!(
                "built {} in {seconds:.1} s; it is used again until the input changes (--cache, --no-cache)",
                path.display()
            ));
        }
        Place::Temporary { .. } => {
            resources.host.remark(&format!("built in {seconds:.1} s; nothing is kept"));
        }
    }
    Ok(Opened { input, files: with(files, place.path()), _place: Some(place) })
}

fn with(mut files: Vec<PathBuf>, built: &Path) -> Vec<PathBuf> {
    files.push(built.to_owned());
    files
}

fn build(files: &[PathBuf], choices: &BuildChoices, output: &Path, resources: Resources<'_>) -> Result<()> {
    let Resources { memory, host, .. } = resources;
    if choices.raw().is_some() || has_volume(files)? {
        let [file] = files else {
            bail!("these are {} files, volumes among them, {}", files.len(), what_to_do_with_volumes(files))
        };
        return build_volume(file, choices.raw().as_ref(), output, resources);
    }
    let options = choices.applied(BuildOptions::default().with_memory_bytes(memory))?;
    let threads = resources.threads.unwrap_or(options.threads);
    let sources = with_speeds(open_points(files, &choices.read_options(), host)?);
    let columns = columns::wanted(choices.attributes(), &sources);
    if let Some(remark) = columns.remark() {
        resources.host.remark(&remark);
    }
    let options = options.with_attributes(columns.kept);
    let reported = Reported { host, unit: "points" };
    let done = build::to_file(sources, output, &options.with_threads(threads), &control(&reported))?;
    let skipped = done.skipped.total();
    if done.points == 0 && skipped == 0 {
        let [first, others @ ..] = files else { bail!("no input files") };
        let more = if others.is_empty() { String::new() } else { format!(" and {} more", others.len()) };
        bail!(
            "{}{more}: no points: the header says that there are none, so there is nothing to see",
            first.display()
        );
    }
    if skipped > 0 {
        resources.host.remark(&format!("skipped {} invalid records", text::count(skipped)));
    }
    Ok(())
}

/// What makes one volume of several files.
fn what_to_do_with_volumes(files: &[PathBuf]) -> String {
    let ends = |file: &PathBuf| {
        file.extension().is_some_and(|e| e.to_ascii_lowercase().to_string_lossy().starts_with("tif"))
    };
    if !files.iter().all(ends) {
        return "and a grid is built from one volume at a time; name one of them".into();
    }
    let folder =
        files.first().and_then(|file| file.parent()).map_or_else(String::new, |f| f.display().to_string());
    format!(
        "slices in TIFF, which is not read; from Python, `numpy.save(\"volume.npy\", \
         tifffile.imread(\"{folder}/*.tif\"))` makes one volume of them that opens"
    )
}

/// Builds a grid; once more with its values multiplied, if scenes cannot hold them as they are.
fn build_volume(
    file: &Path,
    raw: Option<&RawLayout>,
    output: &Path,
    Resources { memory, host, .. }: Resources<'_>,
) -> Result<()> {
    let open = || match raw {
        Some(layout) => VolumeSource::open_raw(file, layout),
        None => VolumeSource::open(file),
    };
    let options = GridBuildOptions::default().with_memory_bytes(memory);
    let build = |source| {
        build::grid_to_file(source, output, &options, &control(&Reported { host, unit: "slices" }))?;
        anyhow::Ok(())
    };
    let source = open()?;
    remark_about(file, &source, host);
    build(source)?;
    let Some(exponent) = magnitude::exponent(&Grid::open(output)?)? else { return Ok(()) };
    let mut source = open()?;
    let sentence = format!("values are multiplied by 1e{exponent}, because scenes hold numbers up to 1e18");
    host.remark(&format!("{}: {sentence}", file.display()));
    let factor = 10_f64.powi(exponent);
    (source.scale, source.offset) = (source.scale * factor, source.offset * factor);
    source.about.push(sentence);
    build(source)
}

fn control<'a>(reported: &'a Reported<'_>) -> BuildControl<'a> {
    let mut control = BuildControl::from(reported as &dyn Progress);
    control.cancel = reported.host.cancel();
    control
}
