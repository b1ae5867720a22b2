//! The resources of a render, none of which changes a pixel: memory, threads, reads.

use std::time::Duration;

use anyhow::{Result, anyhow, ensure};
use clap::{Args, ValueEnum};
use rayset::SimdLevel;
use rayset::memory::{Kind, Limits};
use rayset::memory::{MemoryPlan, SceneNeeds};
use rayset::storage::BackendKind;
use rayset::{Prediction, RenderError, Session};

use rayset_inputs::values;
use rayset_terminal::memory::PROCESS_BYTES;

use rayset_terminal::report;

/// Memory if neither the command line nor the file specifies any.
pub(super) const DEFAULT_MEMORY: u64 = 256 << 20;

#[derive(Args, Clone)]
#[command(next_help_heading = "Work")]
pub(crate) struct WorkArgs {
    /// Memory for the whole process. By default what the cloud was built with (--render-memory),
    /// else 256MiB
    #[arg(long, value_parser = values::size)]
    pub(crate) memory: Option<u64>,
    /// Threads; as many as there are processors by default
    #[arg(long)]
    pub(crate) threads: Option<usize>,
    /// What brings pages in before they are needed
    #[arg(long, value_enum, default_value = "packet")]
    pub(crate) predictor: PredictorArg,
    /// How pages are read: io_uring where there is one, or a pool of threads
    #[arg(long, value_enum, default_value = "auto")]
    pub(crate) io: IoArg,
    /// Read past the operating system's page cache
    #[arg(long)]
    pub(crate) direct: bool,
    /// Add this many milliseconds to every read, as a distant disk would
    #[arg(long)]
    pub(crate) read_delay: Option<f64>,
    /// Vector instructions: auto, or one of those that this processor has
    #[arg(long, default_value = "auto")]
    pub(crate) simd: SimdLevel,
    /// Edge of a tile of rays in pixels, 1 to 8
    #[arg(long, default_value_t = 8, hide = true, value_parser = clap::value_parser!(u32).range(1..=8))]
    pub(crate) tile: u32,
    /// Samples worked on at a time, 1 to 32
    #[arg(long, default_value_t = 32, hide = true, value_parser = slab)]
    pub(crate) slab: usize,
}

fn processors() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

fn slab(text: &str) -> Result<usize, String> {
    let samples = text.parse().ok().filter(|samples| (1..=32).contains(samples));
    samples.ok_or_else(|| format!("`{text}` is not a number from 1 to 32"))
}

#[derive(Clone, Copy, ValueEnum, PartialEq, Eq)]
pub(crate) enum PredictorArg {
    None,
    Line,
    Packet,
}

impl PredictorArg {
    pub(crate) fn prediction(self) -> Prediction {
        match self {
            Self::None => Prediction::None,
            Self::Line => Prediction::Line,
            Self::Packet => Prediction::Packet,
        }
    }
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum IoArg {
    Auto,
    Uring,
    Pool,
}

/// The resources of a render: pages and threads, and how they are used.
pub(crate) struct Work {
    pub(crate) session: Session,
    pub(crate) memory: u64,
    pub(crate) prediction: Prediction,
}

impl Work {
    pub(super) fn prepare(args: &WorkArgs, needs: &SceneNeeds) -> Result<(Self, MemoryPlan)> {
        let threads = args.threads.unwrap_or_else(processors).max(1);
        let stored = needs.clouds().iter().map(|cloud| cloud.header().render_memory).max().filter(|&m| m > 0);
        let memory = args.memory.or(stored).unwrap_or(DEFAULT_MEMORY);
        let needs = needs.clone().with_threads(threads).with_process(PROCESS_BYTES);
        let plan = needs.plan(memory).map_err(|least| {
            anyhow!(
                "--memory {} is too small for this picture with {threads} threads; the smallest that would do \
                 is {least} bytes ({})",
                report::bytes(memory),
                report::bytes(least)
            )
        })?;
        let kind = match args.io {
            IoArg::Auto => BackendKind::Auto,
            IoArg::Uring => BackendKind::Uring,
            IoArg::Pool => BackendKind::Pool,
        };
        let milliseconds = args.read_delay.unwrap_or(0.0);
        ensure!((0.0..1e6).contains(&milliseconds), "--read-delay {milliseconds} is out of range");
        let limits = Limits::total(plan.page_bytes).with_kind(Kind::Shadows, plan.shadow_bytes);
        let session = Session::builder()
            .page_limits(limits)
            .caps_bytes(plan.caps_bytes)
            .threads(threads)
            .prediction(args.predictor.prediction())
            .simd(args.simd)
            .tile_pixels(args.tile)
            .slab_samples(args.slab)
            .estimates_after(Duration::from_secs(2))
            .io(kind)
            .direct(args.direct)
            .read_delay(Duration::from_secs_f64(milliseconds / 1e3))
            .build();
        let session = session.map_err(|error| match error {
            RenderError::Io(_) => anyhow!("{error}; try --io pool"),
            other => other.into(),
        })?;
        Ok((Self { session, memory, prediction: args.predictor.prediction() }, plan))
    }
}
