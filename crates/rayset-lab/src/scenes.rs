//! What whole scenes cost: a fixed set of grids, figures of the paper, lights, mirrors and glass,
//! all of generated data.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use rayset::build::{BuildControl, GridBuildOptions, grid_to_file};
use rayset::geometry::DAffine3;
use rayset::geometry::DVec3;
use rayset::memory::Limits;
use rayset::scene_file::SceneFile;
use rayset::volumes::RawLayout;
use rayset::{CancelToken, Picture, RenderCounts, Session, SimdLevel};

use crate::workloads::median;
use rayset_terminal::children;
use rayset_terminal::memory::{peak_rss, process_cpu_seconds, reset_peak_rss};
use rayset_terminal::outputs::{self, Outputs};
use rayset_terminal::report;
use rayset_terminal::statistics::{PageStatistics, WorkStatistics};

/// Bytes for pages: enough that nothing is ever evicted.
const PAGES: u64 = 1 << 32;
/// Pixels of a picture whose instructions are counted.
const COUNTED_SIZE: &str = "128x128";

/// Of a grid that is lit.
const LIGHTS_OF_GRIDS: &str =
    r#"[{"type": "ambient", "intensity": 0.3}, {"type": "headlight", "intensity": 0.7}]"#;

/// How scenes are measured.
pub(crate) struct Options<'a> {
    /// The files of the scenes; what is there already is used again.
    pub(crate) folder: &'a Path,
    /// Renders of each scene and number of threads.
    pub(crate) repeat: usize,
    pub(crate) simd: SimdLevel,
    /// Only scenes whose names contain one of these; all if empty.
    pub(crate) only: &'a [String],
    /// Instructions are counted, too, by Valgrind.
    pub(crate) instructions: bool,
}

/// One line of the table: one scene on one number of threads.
#[derive(serde::Serialize)]
pub(crate) struct Measured {
    scene: String,
    threads: usize,
    width: u32,
    height: u32,
    /// Median.
    seconds: f64,
    /// Processor time, all threads; median.
    cpu_seconds: f64,
    all_seconds: Vec<f64>,
    /// Requests for pages: those that were there and those that were not.
    page_requests: u64,
    peak_rss_bytes: Option<u64>,
    /// Millions, of a whole run of `rayset render` on one thread with AVX2; 128 × 128 pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    million_instructions: Option<u64>,
    #[serde(flatten)]
    counts: WorkStatistics,
    #[serde(flatten)]
    pages: PageStatistics,
}

/// Prepares the scenes and renders each of them on one thread and on two, in turns, after one round
/// that does not count.
pub(crate) fn measure(options: &Options<'_>) -> Result<Vec<Measured>> {
    let scenes = prepare(options.folder, options.only)?;
    let mut results = Vec::new();
    for (name, path) in &scenes {
        let file = SceneFile::load(path)?;
        let mut runs: Vec<Run> =
            [1, 2].into_iter().map(|threads| Run::new(threads, options.simd)).collect::<Result<_>>()?;
        for round in 0..=options.repeat.max(1) {
            for run in &mut runs {
                run.render(&file, round > 0)?;
            }
        }
        let instructions =
            if options.instructions { Some(instructions(options.folder, path)?) } else { None };
        for run in runs {
            results.push(run.measured(name, &file, instructions));
        }
    }
    Ok(results)
}

/// One number of threads, on one scene.
struct Run {
    session: Session,
    threads: usize,
    seconds: Vec<f64>,
    cpu_seconds: Vec<f64>,
    counts: RenderCounts,
    peak: Option<u64>,
}

impl Run {
    fn new(threads: usize, simd: SimdLevel) -> Result<Self> {
        let session =
            Session::builder().page_limits(Limits::total(PAGES)).threads(threads).simd(simd).build()?;
        let (seconds, cpu_seconds) = (Vec::new(), Vec::new());
        Ok(Self { session, threads, seconds, cpu_seconds, counts: RenderCounts::default(), peak: None })
    }

    /// Renders once; tables of shadows are computed anew, the pages of files are there from the
    /// second time on.
    fn render(&mut self, file: &SceneFile, counts: bool) -> Result<()> {
        self.session.reset_statistics();
        reset_peak_rss();
        let (started, cpu) = (Instant::now(), process_cpu_seconds());
        let view = self.session.prepare(&file.scene, &file.settings)?.view(&file.camera)?;
        let (whole, mut picture) = (view.region(), Picture::default());
        self.counts = view.render_bands(&whole, u32::MAX, &CancelToken::new(), &mut picture)?;
        if counts {
            self.seconds.push(started.elapsed().as_secs_f64());
            self.cpu_seconds.push(process_cpu_seconds() - cpu);
        }
        self.peak = peak_rss();
        Ok(())
    }

    fn measured(self, name: &str, file: &SceneFile, million_instructions: Option<u64>) -> Measured {
        let pages = PageStatistics::from(&self.session.statistics());
        let measured = Measured {
            scene: name.to_owned(),
            threads: self.threads,
            width: file.settings.width,
            height: file.settings.height,
            seconds: median(&self.seconds),
            cpu_seconds: median(&self.cpu_seconds),
            all_seconds: self.seconds,
            page_requests: pages.working_set.hits + pages.working_set.misses,
            peak_rss_bytes: self.peak,
            million_instructions,
            counts: self.counts.into(),
            pages,
        };
        report::remark(format_args!("{name}, {} thread(s): {:.3} s", measured.threads, measured.seconds));
        measured
    }
}

/// Instructions of a small picture, in millions.
fn instructions(folder: &Path, scene: &Path) -> Result<u64> {
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let picture = folder.join("counted.png");
    let arguments = ["--size", COUNTED_SIZE, "--threads", "1", "--simd", "avx2", "--memory", "2GiB"];
    let mut command = Command::new(program);
    command.arg("render").arg(scene).arg("-o").arg(picture).args(arguments);
    million_instructions(folder, &command)
}

/// The instructions of a command, in millions, as Valgrind counts them.
pub(crate) fn million_instructions(folder: &Path, command: &Command) -> Result<u64> {
    let counted = folder.join("callgrind.out");
    let mut valgrind = Command::new("valgrind");
    valgrind.arg("--tool=callgrind").arg("--quiet");
    valgrind.arg(format!("--callgrind-out-file={}", counted.display()));
    valgrind.arg(command.get_program()).args(command.get_args());
    valgrind.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::null());
    let status = children::run(&mut valgrind).context("cannot start valgrind, which counts instructions")?;
    ensure!(status.success(), "valgrind could not run {command:?}");
    let text = fs::read_to_string(&counted).with_context(|| format!("cannot read {}", counted.display()))?;
    let total =
        text.lines().find_map(|line| line.strip_prefix("summary: ").or(line.strip_prefix("totals: ")));
    let total = total.and_then(|total| total.trim().parse::<u64>().ok());
    Ok(total.context("valgrind's report has no total")? / 1_000_000)
}

/// Writes scenes and data into a folder; returns the scenes to measure, each with its name.
/// Only scenes whose names contain one of some words; all if there are none.
pub(crate) fn prepare(folder: &Path, only: &[String]) -> Result<Vec<(String, PathBuf)>> {
    let wanted = |name: &str| only.is_empty() || only.iter().any(|word| name.contains(word));
    crate::figure::prepare(folder)?;
    let mut scenes = Vec::new();
    let mut add = |name: &str, text: &str| -> Result<()> {
        let path = folder.join(format!("{name}.json"));
        if wanted(name) {
            outputs::write(&Outputs::default().add(&path, None)?, text.as_bytes())?;
            scenes.push((name.to_owned(), path));
        }
        Ok(())
    };
    for side in [64_u64, 512] {
        for (look, lights) in [("unlit", "\"none\""), ("lit", LIGHTS_OF_GRIDS)] {
            let name = format!("grid-{side}-{look}");
            if !wanted(&name) {
                continue;
            }
            grid(folder, side)?;
            let spacing = 1.0 / (side - 1) as f64;
            let text = include_str!("scenes/grid.json");
            let text = text.replace("LIGHTS", lights).replace("STEP", &(0.9 * spacing).to_string());
            let text =
                text.replace("FILE", &format!("grid-{side}.rset")).replace("SCALE", &spacing.to_string());
            add(&name, &text)?;
        }
    }
    add("ct-in-scan", include_str!("scenes/ct-in-scan.json"))?;
    for number in [1, 2, 4, 10, 11] {
        let text = fs::read_to_string(folder.join(format!("fig{number}.json")))?;
        add(&format!("figure-{number}"), &text)?;
    }
    add("mirrors", include_str!("../../../examples/mirrors.json"))?;
    let lights = include_str!("scenes/three-lights.json");
    for (shadows, size) in [("cached", "[512, 512]"), ("exact", "[256, 256]")] {
        let text = lights.replace("SHADOWS", shadows).replace("SIZE", size);
        add(&format!("three-lights-{shadows}"), &text)?;
    }
    add("glass", include_str!("scenes/glass.json"))?;
    Ok(scenes)
}

/// Builds a grid of bytes, `side` voxels a side: a head of skin, skull and brain, roughly. Its
/// voxels stay beside it in a raw file, for other programs to read.
fn grid(folder: &Path, side: u64) -> Result<()> {
    let (raw, path) = (folder.join(format!("grid-{side}.raw")), folder.join(format!("grid-{side}.rset")));
    if path.exists() {
        return Ok(());
    }
    let place = |n: u64| 2.0 * n as f64 / (side - 1) as f64 - 1.0;
    let mut voxels = Vec::with_capacity((side * side * side) as usize);
    for k in 0..side {
        for j in 0..side {
            voxels.extend((0..side).map(|i| head(DVec3::new(place(i), place(j), place(k)))));
        }
    }
    outputs::write(&Outputs::default().add(&raw, None)?, &voxels)?;
    let layout: RawLayout = format!("{side}x{side}x{side},u8").parse()?;
    let mut source = layout.open(&raw)?;
    source.space_from_voxel = DAffine3::IDENTITY;
    Outputs::default().add(&path, None)?;
    grid_to_file(source, &path, &GridBuildOptions::default(), &BuildControl::default())?;
    Ok(())
}

/// The value of a place in the cube from −1 to 1.
fn head(p: DVec3) -> u8 {
    let ripple = |scale: f64| (p.x * scale).sin() * (p.y * scale * 1.1).sin() * (p.z * scale * 0.9).sin();
    // Distance from an ellipsoid, roughly; negative inside.
    let depth = (p / DVec3::new(0.72, 0.9, 0.8)).length() - 1.0 + 0.03 * ripple(7.0);
    let shell = |at: f64, width: f64| (1.0 - ((depth - at) / width).abs()).max(0.0);
    let skin = 95.0 * shell(-0.02, 0.05);
    let skull = 220.0 * shell(-0.14, 0.055) * (1.0 + 0.15 * ripple(13.0));
    let brain = if depth < -0.2 { 70.0 + 22.0 * ripple(23.0) } else { 0.0 };
    let teeth = if p.y < -0.45 && p.z > 0.2 { 60.0 * ripple(31.0).max(0.0) } else { 0.0 };
    let around = if depth > 0.05 { 4.0 } else { 30.0 };
    (around + skin + skull + brain + teeth).clamp(0.0, 255.0) as u8
}

/// The table.
pub(crate) fn describe(results: &[Measured]) {
    report::say(
        "| scene | pixels | threads | seconds | CPU s | M instructions, 128×128 | page requests | M samples seen | shadow rays | bounced rays | peak MiB |",
    );
    report::say("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    for m in results {
        let mut line = String::new();
        let _ = write!(
            line,
            "| {} | {}×{} | {} | {:.3} | {:.3} | {} | {} | {:.2} | {} | {} | {} |",
            m.scene,
            m.width,
            m.height,
            m.threads,
            m.seconds,
            m.cpu_seconds,
            m.million_instructions.map_or_else(|| "-".to_owned(), report::count),
            report::count(m.page_requests),
            m.counts.nonzero_samples as f64 / 1e6,
            report::count(m.counts.shadow_rays),
            report::count(m.counts.bounced_rays),
            m.peak_rss_bytes.map_or_else(|| "-".to_owned(), |b| (b >> 20).to_string()),
        );
        report::say(line);
    }
}
