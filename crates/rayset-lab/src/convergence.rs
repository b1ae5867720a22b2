//! How far pictures are from those with an eighth of the step: whether the steps that are chosen by
//! default are fine enough.

use std::ffi::OsStr;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use rayset::memory::Limits;
use rayset::scene::{RenderSettings, Samples, Step};
use rayset::scene_file::SceneFile;
use rayset::{CancelToken, Picture, Session, SimdLevel};

use crate::scenes;
use rayset_terminal::report;

/// The longer edge of the pictures that are compared, in pixels.
const LONGER_EDGE: u32 = 192;
/// The finer step, as a part of the other.
const FINER: f64 = 1.0 / 8.0;
/// A channel that differs by more than this, in linear light, differs visibly.
const VISIBLE: f64 = 2.0 / 255.0;
/// Bytes for pages: enough that nothing is ever evicted.
const PAGES: u64 = 1 << 32;

/// What is compared.
pub(crate) struct Options<'a> {
    /// For what is generated and what is built.
    pub(crate) folder: &'a Path,
    /// Scenes, and anything else that `rayset render` takes; generated scenes if there are none.
    pub(crate) inputs: &'a [String],
    pub(crate) simd: SimdLevel,
}

/// One line of the table. Differences are of linear light, of the picture less the finer one, over
/// the pixels in which there is anything.
#[derive(serde::Serialize)]
pub(crate) struct Measured {
    picture: String,
    width: u32,
    height: u32,
    shown_pixels: usize,
    /// Of all channels of light, with its sign: how much too bright the picture is.
    mean_difference: f64,
    mean_absolute_difference: f64,
    largest_difference: f64,
    /// The part of the pixels of which a channel differs by more than 2/255.
    visibly_different: f64,
}

/// Renders each input with its steps, and with an eighth of them.
pub(crate) fn measure(options: &Options<'_>) -> Result<Vec<Measured>> {
    let mut results = Vec::new();
    for (name, path) in cases(options)? {
        let mut file = SceneFile::load(&path)?;
        // So that it is seen where there is anything.
        file.scene.background = None;
        let scale = f64::from(LONGER_EDGE) / f64::from(file.settings.width.max(file.settings.height));
        let edge = |pixels: u32| ((f64::from(pixels) * scale).round() as u32).max(1);
        let (width, height) = (edge(file.settings.width), edge(file.settings.height));
        let mut settings = file.settings.with_samples(Samples::Fixed(1));
        (settings.width, settings.height) = (width, height);
        let finer = match settings.step {
            Step::Automatic { fraction } => Step::Automatic { fraction: FINER * fraction },
            Step::Fixed(step) => Step::Fixed(FINER * step),
            other => other,
        };
        let picture = render(options, &file, &settings)?;
        let finer = render(options, &file, &settings.with_step(finer))?;
        let measured = compare(name, &settings, &picture, &finer);
        report::remark(format_args!("{}: {:+.4}", measured.picture, measured.mean_difference));
        results.push(measured);
    }
    Ok(results)
}

fn render(options: &Options<'_>, file: &SceneFile, settings: &RenderSettings) -> Result<Picture> {
    let session = Session::builder().page_limits(Limits::total(PAGES)).simd(options.simd).build()?;
    let view = session.prepare(&file.scene, settings)?.view(&file.camera)?;
    let mut picture = Picture::default();
    view.render_bands(&view.region(), u32::MAX, &CancelToken::new(), &mut picture)?;
    Ok(picture)
}

fn compare(picture: String, settings: &RenderSettings, coarse: &Picture, fine: &Picture) -> Measured {
    let pairs = coarse.pixels.iter().zip(&fine.pixels).filter(|(a, b)| a[3] > 0.0 || b[3] > 0.0);
    let (mut shown, mut sum, mut absolute, mut largest, mut visible) = (0, 0.0, 0.0, 0.0_f64, 0);
    for (a, b) in pairs {
        shown += 1;
        let differences = [0, 1, 2].map(|channel| f64::from(a[channel]) - f64::from(b[channel]));
        sum += differences.iter().sum::<f64>();
        absolute += differences.iter().map(|d| d.abs()).sum::<f64>();
        let worst = differences.iter().fold(0.0, |worst: f64, d| worst.max(d.abs()));
        largest = largest.max(worst);
        visible += usize::from(worst > VISIBLE);
    }
    let channels = 3.0 * (shown.max(1) as f64);
    Measured {
        picture,
        width: settings.width,
        height: settings.height,
        shown_pixels: shown,
        mean_difference: sum / channels,
        mean_absolute_difference: absolute / channels,
        largest_difference: largest,
        visibly_different: visible as f64 / shown.max(1) as f64,
    }
}

/// The scenes that are asked for, each with its name, or generated ones.
fn cases(options: &Options<'_>) -> Result<Vec<(String, PathBuf)>> {
    if options.inputs.is_empty() {
        return scenes::prepare(options.folder, &[]);
    }
    let case = |(number, input): (usize, &String)| -> Result<(String, PathBuf)> {
        Ok((name_of(input), scene_of(options.folder, number, input)?))
    };
    options.inputs.iter().enumerate().map(case).collect()
}

fn name_of(input: &str) -> String {
    Path::new(input).file_name().map_or_else(|| input.to_owned(), |name| name.to_string_lossy().into_owned())
}

/// The scene of an input: itself, or the one that `rayset render` makes of it.
fn scene_of(folder: &Path, number: usize, input: &str) -> Result<PathBuf> {
    if Path::new(input).extension() == Some(OsStr::new("json")) {
        return Ok(input.into());
    }
    let scene = folder.join(format!("{number}-{}.json", name_of(input)));
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let mut command = Command::new(program);
    command.arg("render").arg(input).arg("-o").arg(folder.join("picture.png"));
    command.arg("--cache").arg(folder.join("cache")).arg("--write-scene").arg(&scene);
    command.args(["--size", "96x64", "--samples", "1"]).stdout(Stdio::null()).stderr(Stdio::null());
    let status = rayset_terminal::children::run(&mut command).context("cannot start this program")?;
    ensure!(status.success(), "{command:?} failed; run it by hand to see why");
    Ok(scene)
}

/// The table.
pub(crate) fn describe(results: &[Measured]) {
    report::say(
        "| picture | pixels | shown | too bright | mean difference | largest | visibly different, % |",
    );
    report::say("| --- | --- | ---: | ---: | ---: | ---: | ---: |");
    for m in results {
        let mut line = format!("| {} | {}×{} | {}", m.picture, m.width, m.height, m.shown_pixels);
        let _ = write!(line, " | {:+.4} | {:.4}", m.mean_difference, m.mean_absolute_difference);
        let _ = write!(line, " | {:.3} | {:.2} |", m.largest_difference, 100.0 * m.visibly_different);
        report::say(line);
    }
}
