//! `rayset bench`

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::Args;
use rayset::Session;
use rayset::SimdLevel;
use rayset::points::Workload;

use crate::bare::{BARE_SAMPLES, bare_loop};
use crate::convergence;
use crate::features::{self, Cost};
use crate::pictures;
use crate::scenes;
use crate::workloads::{Case, Measured, Prepared};
use rayset_inputs::values;
use rayset_terminal::interrupts::TemporaryFolder;

use rayset_terminal::report;

/// Build and render the standard workloads, and say how long it took.
///
/// Each workload is written as a PLY file, built from that, and rendered several times in one
/// process at 512x512 from (0, 0, 3), with the triweight kernel, steps of a quarter radius, no
/// shading; opaque (extinction 2/r, rays end at 1 %) or translucent (0.02/r, every sample taken).
/// Times are medians.
#[derive(Args)]
pub struct BenchArgs {
    /// sphere-N or cube-N; the four standard ones by default. With --scenes, words that the names
    /// of scenes contain; with --pictures and --convergence, files
    workloads: Vec<String>,
    /// Every sample is taken
    #[arg(long)]
    translucent: bool,
    /// Threads that render and build
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// Memory for the whole process; enough for all pages by default
    #[arg(long, value_parser = values::size)]
    memory: Option<u64>,
    /// Also out of core: a tenth of the pages, past the page cache, as the disk is and with 2 ms
    /// added to every read
    #[arg(long)]
    out_of_core: bool,
    /// What each feature of a scene costs instead: light, shadows, mirrors, operators; over
    /// knot-200k by default
    #[arg(long, conflicts_with_all = ["translucent", "memory", "out_of_core"])]
    features: bool,
    /// Whole scenes instead, of generated data, on one thread and on two: grids, figures, lights,
    /// mirrors, glass
    #[arg(long, group = "whole", conflicts_with_all = ["translucent", "memory", "out_of_core", "features", "threads"])]
    scenes: bool,
    /// Whole commands instead, as people give them: `rayset render FILE -o PICTURE --size 960x640`
    /// on each of these files; without files, on inputs that were found to be slow
    #[arg(long, group = "whole", conflicts_with_all = ["translucent", "memory", "out_of_core", "features", "threads"])]
    pictures: bool,
    /// Measure another rayset's pictures in turns with this one's, as that of the commit before
    #[arg(long, value_name = "PROGRAM", requires = "pictures")]
    beside: Option<PathBuf>,
    /// Instead, how far pictures of these inputs are from those with an eighth of the step;
    /// without files, of the scenes of --scenes
    #[arg(long, group = "whole", conflicts_with_all = ["translucent", "memory", "out_of_core", "features", "threads", "repeat", "instructions"])]
    convergence: bool,
    /// Stop a picture's command after so many seconds
    #[arg(long, value_name = "SECONDS", requires = "pictures", default_value_t = 120)]
    limit: u64,
    /// Count the instructions of each scene or picture, too, with Valgrind
    #[arg(long, requires = "whole")]
    instructions: bool,
    /// Renders of each case
    #[arg(long, default_value_t = 5)]
    repeat: usize,
    /// Vector instructions: auto, or one of those that this processor has
    #[arg(long, default_value = "auto")]
    simd: SimdLevel,
    /// Folder for the files, which are kept and used again; a temporary one by default
    #[arg(long)]
    dir: Option<PathBuf>,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// Everything measured in one run.
#[derive(serde::Serialize)]
struct Report {
    processor: String,
    simd: &'static str,
    threads: usize,
    /// Kernel evaluations per second of the loop alone, on one thread.
    bare_evaluations_per_second: f64,
    results: Vec<Measured>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    features: Vec<Cost>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    scenes: Vec<scenes::Measured>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pictures: Vec<pictures::Measured>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    convergence: Vec<convergence::Measured>,
}

/// Measures, and reports.
///
/// # Errors
/// Whatever ends a build or a render.
pub fn run(args: &BenchArgs) -> Result<()> {
    let report = if let Some(folder) = &args.dir {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        measure(args, folder)?
    } else {
        measure(args, TemporaryFolder::new("bench")?.path())?
    };
    if args.json { report::json(&report) } else { describe(&report) }
}

/// The workloads that are asked for, or those that are measured by default.
fn workloads(args: &BenchArgs) -> Result<Vec<Workload>> {
    if args.workloads.is_empty() && args.features {
        return Ok(vec!["knot-200k".parse()?]);
    }
    let standard: Vec<String> = Workload::STANDARD.iter().map(|&name| name.to_owned()).collect();
    let names = if args.workloads.is_empty() { &standard } else { &args.workloads };
    Ok(names.iter().map(|name| name.parse()).collect::<Result<_, _>>()?)
}

fn measure(args: &BenchArgs, folder: &std::path::Path) -> Result<Report> {
    let bare = bare_evaluations_per_second(args.simd);
    let (mut results, mut features, mut scenes) = (Vec::new(), Vec::new(), Vec::new());
    let (mut pictures, mut convergence) = (Vec::new(), Vec::new());
    if args.convergence {
        convergence =
            convergence::measure(&convergence::Options { folder, inputs: &args.workloads, simd: args.simd })?;
    }
    if args.pictures {
        pictures = pictures::measure(&pictures::Options {
            folder,
            inputs: &args.workloads,
            beside: args.beside.as_deref(),
            repeat: args.repeat,
            limit: Duration::from_secs(args.limit),
            instructions: args.instructions,
        })?;
    }
    if args.scenes {
        scenes = scenes::measure(&scenes::Options {
            folder,
            repeat: args.repeat,
            simd: args.simd,
            only: &args.workloads,
            instructions: args.instructions,
        })?;
    }
    let whole = args.scenes || args.pictures || args.convergence;
    for workload in &if whole { Vec::new() } else { workloads(args)? } {
        let prepared = Prepared::new(workload, folder, args.threads)?;
        if args.features {
            let session = Session::builder().threads(args.threads).simd(args.simd);
            features.extend(features::measure(&prepared.cloud, &prepared.camera(), &session, args.repeat)?);
            continue;
        }
        let mut cases = vec![Case::in_core(args.memory)];
        if args.out_of_core {
            cases.extend(Case::out_of_core());
        }
        // Each round goes through all cases, so that other load on the machine affects all of them
        // alike.
        results.extend(prepared.measure(
            &cases,
            args.translucent,
            args.threads,
            args.simd,
            args.repeat,
            bare,
        )?);
    }
    Ok(Report {
        processor: processor(),
        simd: args.simd.name(),
        threads: args.threads,
        bare_evaluations_per_second: bare,
        results,
        features,
        scenes,
        pictures,
        convergence,
    })
}

/// Kernel evaluations per second in the best of several bursts: what the processor can do
/// undisturbed.
fn bare_evaluations_per_second(simd: SimdLevel) -> f64 {
    const POINTS: usize = 4096;
    let points: Vec<[f32; 5]> = (0..POINTS)
        .map(|i| {
            let u = i as f32 / POINTS as f32;
            [u, (u * 37.0).fract(), (u * 91.0).fract(), 4.0, 1.0]
        })
        .collect();
    let mut samples = [[0.0; BARE_SAMPLES]; 3];
    for (axis, column) in samples.iter_mut().enumerate() {
        for (i, v) in column.iter_mut().enumerate() {
            *v = (i as f32 * (0.13 + 0.21 * axis as f32)).fract();
        }
    }
    let mut best = 0.0_f64;
    for _ in 0..60 {
        let started = Instant::now();
        for _ in 0..20 {
            std::hint::black_box(bare_loop(simd, std::hint::black_box(&points), &samples));
        }
        best = best.max((20 * POINTS * BARE_SAMPLES) as f64 / started.elapsed().as_secs_f64());
    }
    best
}

fn processor() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let line = info.lines().find(|l| l.starts_with("model name"));
    line.and_then(|l| l.split(": ").nth(1)).unwrap_or("unknown processor").to_owned()
}

fn describe(report: &Report) -> Result<()> {
    // Commands have the threads that they choose themselves.
    let threads =
        if report.pictures.is_empty() { format!(", {} thread(s)", report.threads) } else { String::new() };
    report::say(format_args!(
        "{}, {}{threads}; bare loop {:.2} G evaluations a second",
        report.processor,
        report.simd,
        report.bare_evaluations_per_second / 1e9
    ));
    report::say("");
    if !report.scenes.is_empty() {
        scenes::describe(&report.scenes);
        return Ok(());
    }
    if !report.convergence.is_empty() {
        convergence::describe(&report.convergence);
        return Ok(());
    }
    if !report.pictures.is_empty() {
        pictures::describe(&report.pictures);
        return Ok(());
    }
    if !report.features.is_empty() {
        features::describe(&report.features);
        return Ok(());
    }
    report::say(
        "| workload | case | build s | render s | of in-core | G evaluations/s | of bare loop | stalls s | reads a page | peak MB |",
    );
    report::say("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    for m in &report.results {
        report::say(format_args!(
            "| {} {} | {} | {:.2} | {:.3} | {:.2} | {:.2} | {:.2} | {:.3} | {:.2} | {} |",
            m.workload,
            m.look,
            m.case,
            m.build_seconds,
            m.render_seconds,
            m.of_in_core,
            m.counts.kernel_evaluations as f64 / m.render_seconds / 1e9,
            m.of_bare_loop,
            m.pages.stall_seconds,
            m.pages.reads_per_page,
            m.peak_rss_bytes.map_or_else(|| "-".to_owned(), |b| (b / 1_000_000).to_string())
        ));
    }
    Ok(())
}
