//! Opens any input, building what has not been built.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Result, bail};
use rayset::build::{
    self, AggregateError, BuildControl, BuildError, BuildOptions, GridBuildError, GridBuildOptions, Progress,
};
use rayset::output::OutputError;
use rayset::points::ReadError;
use rayset::storage;
use rayset::volumes;
use rayset::{Cloud, Grid};

use super::aggregates::{Aggregating, aggregate};
use super::cache::{self, BuildTarget, Cache, Found, Name};
use super::columns;
use super::files::{self, Files};
use super::kinds::{self, Built};
use super::magnitude;
use super::sources::{Points, has_volume, open_points, remark_about};
use crate::host::{Host, Remembering, Reported, Resources};
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
    _place: Option<BuildTarget>,
}

/// Opens inputs: one scene, one cloud or grid file, one volume, or any number of files of points,
/// folders and patterns.
pub fn open(inputs: &[PathBuf], cache: &Cache, resources: Resources<'_>) -> Result<Opened> {
    let files = files::expand(inputs, resources.host)?;
    if let [file] = files.paths.as_slice() {
        if let Some(option) = cache.choices.given().map(|option| format!("--{}", option.name))
            && (kinds::is_scene(file)? || kinds::is_built(file)?)
        {
            bail!(
                "{option} says how an input is built, and {} is a scene or has been built: build it with {option}",
                file.display()
            );
        }
        if kinds::is_scene(file)? {
            return Ok(Opened { input: Input::Scene(file.clone()), files: files.paths, _place: None });
        }
        if kinds::is_built(file)? {
            return Ok(Opened { input: built(file)?, files: files.paths, _place: None });
        }
    }
    for file in &files.paths {
        if kinds::is_scene(file)? || kinds::is_built(file)? {
            bail!(
                "{} is a scene or has been built: it is rendered by itself, or with others as objects of a scene \
                 (docs/scene.md)",
                file.display()
            );
        }
    }
    of_raw(inputs, &files, cache, resources)
}

fn built(path: &Path) -> Result<Input> {
    Ok(match kinds::open_built(path)? {
        Built::Cloud(cloud) => Input::Cloud(cloud),
        Built::Grid(grid) => Input::Grid(grid),
    })
}

/// Builds files of points or voxels, unless that has been done before.
fn of_raw(inputs: &[PathBuf], files: &Files, cache: &Cache, resources: Resources<'_>) -> Result<Opened> {
    let options = format!("{} strict {}", cache.choices.key(), cache.strict);
    let name = Name::of(inputs, &files.paths, &options)?;
    // A pipe has other bytes the next time.
    let is_pipe = |file: &PathBuf| matches!(storage::look(file), Ok(storage::Named::Other));
    let nothing = Cache::none();
    let keeping = if files.paths.iter().any(is_pipe) { &nothing } else { cache };
    if let Some(opened) = kept(files, keeping.find(&name), resources.host) {
        return Ok(opened);
    }
    let started = Instant::now();
    let mut place = keeping.place(&name, resources.host)?;
    let mut work = Work { files, cache, resources, said: Remembering::of(resources.host) };
    let pulled_in = match (work.build(place.path()), &place) {
        (Err(error), BuildTarget::Kept(_)) if no_room(&error) => {
            resources.host.remark(&format!("nothing is kept: {error:#}; --cache names another folder"));
            place = nothing.place(&name, resources.host)?;
            work.build(place.path())?
        }
        (built, _) => built?,
    };
    let input = built(place.path())?;
    let all: Vec<PathBuf> = [&*files.paths, &*pulled_in.files].concat();
    let seconds = started.elapsed().as_secs_f64();
    match &mut place {
        BuildTarget::Kept(entry) => {
            // The disk may be full just now: what was built is there all the same.
            match entry.complete(&all, pulled_in.stamps, &work.said.into_inner()) {
                Ok(()) => {
                    cache.prune(entry, resources.host);
                    resources.host.note(&format!(
                        "built {} in {seconds:.1} s; it is used again until the input changes (--cache, --no-cache)",
                        entry.data().display()
                    ));
                }
                Err(error) => resources.host.remark(&format!(
                    "built in {seconds:.1} s; nothing is kept: {error:#}; --cache names another folder"
                )),
            }
        }
        BuildTarget::Temporary { .. } => {
            resources.host.note(&format!("built in {seconds:.1} s; nothing is kept"));
        }
    }
    Ok(Opened { input, files: with(all, place.path()), _place: Some(place) })
}

/// The first of some entries that opens. One that does not was damaged, which is said, and goes.
fn kept(files: &Files, found: Vec<Found>, host: &dyn Host) -> Option<Opened> {
    for Found { entry, files: pulled_in, remarks } in found {
        let path = entry.data().to_owned();
        match built(&path) {
            Ok(input) => {
                entry.touch();
                remarks.iter().for_each(|remark| host.remark(remark));
                host.note(&format!("using {}, built before", path.display()));
                let files = with([&*files.paths, &*pulled_in].concat(), &path);
                return Some(Opened { input, files, _place: Some(BuildTarget::Kept(entry)) });
            }
            Err(error) => {
                host.remark(&format!("what was kept of this input is damaged and made again: {error:#}"));
                entry.discard();
            }
        }
    }
    None
}

/// Whether a build failed because nothing more can be written where it was.
fn no_room(error: &anyhow::Error) -> bool {
    use std::io::ErrorKind;
    let of_output = |error: &OutputError| match error {
        OutputError::Io { source, .. } => Some(source.kind()),
        _ => None,
    };
    let of_build = |error: &BuildError| match error {
        BuildError::Io { source, .. } => Some(source.kind()),
        BuildError::Output(error) => of_output(error),
        _ => None,
    };
    let of_grid = |error: &GridBuildError| match error {
        GridBuildError::Write { source, .. } | GridBuildError::Temporary { source, .. } => {
            Some(source.kind())
        }
        GridBuildError::Output(error) => of_output(error),
        _ => None,
    };
    let kind = error.downcast_ref().and_then(of_build).or_else(|| error.downcast_ref().and_then(of_grid));
    matches!(
        kind,
        Some(
            ErrorKind::StorageFull
                | ErrorKind::QuotaExceeded
                | ErrorKind::FileTooLarge
                | ErrorKind::ReadOnlyFilesystem
                | ErrorKind::PermissionDenied
        )
    )
}

fn with(mut files: Vec<PathBuf>, built: &Path) -> Vec<PathBuf> {
    files.push(built.to_owned());
    files
}

/// Files that inputs pull in by themselves.
#[derive(Default)]
struct PulledIn {
    files: Vec<PathBuf>,
    /// Taken before they were read.
    stamps: Vec<(PathBuf, String)>,
}

impl PulledIn {
    /// Those of all files that are read which were not named.
    fn of(read: impl Iterator<Item = PathBuf>, files: &Files) -> Result<Self> {
        let named: HashSet<&Path> = files.paths.iter().map(PathBuf::as_path).collect();
        let files: Vec<PathBuf> = read.filter(|file| !named.contains(&**file)).collect();
        Ok(Self { stamps: cache::stamps(&files)?, files })
    }
}

/// A build of files of points, or of a volume.
struct Work<'a> {
    files: &'a Files,
    cache: &'a Cache,
    resources: Resources<'a>,
    said: Remembering<'a>,
}

impl Work<'_> {
    /// Builds the file at `output`. Returns what the inputs pull in.
    fn build(&mut self, output: &Path) -> Result<PulledIn> {
        self.said.forget();
        let choices = &self.cache.choices;
        if choices.raw.is_none() && !has_volume(&self.files.paths)? {
            if let Some(index) = choices.volume_index {
                bail!("--volume-index {index} is for volumes, and these are points");
            }
            return self.cloud(output);
        }
        let [file] = self.files.paths.as_slice() else {
            let files = &self.files.paths;
            bail!("these are {} files, volumes among them, {}", files.len(), what_to_do_with_volumes(files))
        };
        self.volume(file, output)
    }

    fn cloud(&self, output: &Path) -> Result<PulledIn> {
        let Resources { memory, host, .. } = self.resources;
        let choices = &self.cache.choices;
        let options = choices.applied(BuildOptions::default().with_memory_bytes(memory))?;
        let threads = self.resources.threads.unwrap_or(options.threads);
        let points = open_points(self.files, &choices.read_options(), self.cache.strict, &self.said)?;
        let pulled_in = PulledIn::of(points.files(), self.files)?;
        host.writes(output, &[&*self.files.paths, &*pulled_in.files].concat())?;
        let Points { sources, left_out } = points;
        let sources = with_speeds(sources);
        let columns = columns::wanted(choices.attributes.as_deref(), &sources);
        if let Some(remark) = columns.remark() {
            self.said.remark(&remark);
        }
        if let Some(remark) = columns::remark_on_normals(&sources, &options) {
            self.said.remark(&remark);
        }
        let options = options.with_attributes(columns.kept);
        let reported = Reported { host, unit: "points" };
        let leaves_out = |source: usize, error: &ReadError| left_out.takes(source, error);
        let control = control(&reported).with_leaving_out(&leaves_out);
        let done = Cloud::builder()
            .sources(sources)
            .options(options.with_threads(threads))
            .control(control)
            .write(output)?;
        done.remarks.iter().for_each(|remark| self.said.remark(remark));
        if let Some(remark) = left_out.remark() {
            self.said.remark(&remark);
        }
        let skipped = done.skipped.total();
        if done.points == 0 && skipped == 0 {
            let [first, others @ ..] = self.files.paths.as_slice() else { bail!("no input files") };
            let more = if others.is_empty() { String::new() } else { format!(" and {} more", others.len()) };
            bail!(
                "{}{more}: no points: the header says that there are none, so there is nothing to see",
                first.display()
            );
        }
        if skipped > 0 {
            self.said.remark(&format!("skipped {} invalid records", text::count(skipped)));
        }
        self.aggregate(output)?;
        Ok(pulled_in)
    }

    /// Adds aggregates to a cloud that is shown as gas.
    fn aggregate(&self, output: &Path) -> Result<()> {
        let resources = Resources { host: &self.said, ..self.resources };
        let Err(error) = aggregate(output, Aggregating::default(), resources, None) else { return Ok(()) };
        match error.downcast::<AggregateError>() {
            // Pictures must not depend on memory.
            Ok(AggregateError::Memory { given, needed }) => Err(BuildError::Memory { given, needed }.into()),
            Ok(AggregateError::Cancelled) => Err(BuildError::Cancelled.into()),
            Ok(error) => {
                // The cloud is whole without.
                self.said.remark(&format!("every point will be looked at: {error}"));
                Ok(())
            }
            Err(other) => Err(other),
        }
    }

    /// Builds a grid; once more with its values multiplied, if scenes cannot hold them as they are.
    fn volume(&self, file: &Path, output: &Path) -> Result<PulledIn> {
        let Resources { memory, host, .. } = self.resources;
        let options = GridBuildOptions::default().with_memory_bytes(memory);
        let build = |source| {
            build::grid_to_file(source, output, &options, &control(&Reported { host, unit: "slices" }))?;
            anyhow::Ok(())
        };
        let choices = &self.cache.choices;
        let raw = choices.raw()?;
        let open = || match &raw {
            Some(layout) => layout.open(file),
            None => volumes::open(file, choices.volume_index),
        };
        let source = open()?;
        let pulled_in = PulledIn::of(source.paths().into_iter().map(Path::to_owned), self.files)?;
        host.writes(output, &[&*self.files.paths, &*pulled_in.files].concat())?;
        remark_about(file, &source, &self.said);
        build(source)?;
        let Some(exponent) = magnitude::exponent(&Grid::open(output)?)? else { return Ok(pulled_in) };
        let mut source = open()?;
        let sentence =
            format!("values are multiplied by 1e{exponent}, because scenes hold numbers up to 1e18");
        self.said.remark(&format!("{}: {sentence}", file.display()));
        let factor = 10_f64.powi(exponent);
        (source.scale, source.offset) = (source.scale * factor, source.offset * factor);
        source.about.push(sentence);
        build(source)?;
        Ok(pulled_in)
    }
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

fn control<'a>(reported: &'a Reported<'_>) -> BuildControl<'a> {
    let mut control = BuildControl::from(reported as &dyn Progress);
    control.cancel = reported.host.cancel();
    control
}
