//! `rayset render`

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::{Args, ValueEnum};
use rayset::field::{Kernel, SimdLevel, linear_from_srgb};
use rayset::geometry::DVec3;
use rayset::image::{Band, PngBands};
use rayset::octree::Cloud;
use rayset::octree::format::Header;
use rayset::scene::{
    Camera, ColorRule, Colormap, MapInput, Phase, Projection, RenderSettings, Scene, Shading, Step,
    TransferFunction,
};
use rayset::trace::memory::{self, MemoryPlan};
use rayset::trace::predict::{NoPredictor, PacketPredictor, Predictor};
use rayset::trace::{ExecSettings, Region, RenderCounts, Sink, render_region};
use rayset::working_set::read::{self, BackendKind, Delayed, FileStorage};
use rayset::working_set::{CloudPages, Limits, WorkingSet};

use crate::memory::{PROCESS_BYTES, peak_rss};
use crate::progress::Meter;
use crate::{report, values};

/// Memory where neither the command line nor the file says any.
const DEFAULT_MEMORY: u64 = 256 << 20;

/// Render a cloud to a PNG picture.
///
/// The picture depends on the cloud and on the options under "Picture"; those under "Work" never change a pixel.
#[derive(Args, Clone)]
pub(crate) struct RenderArgs {
    /// Cloud file
    cloud: PathBuf,
    /// Picture to write
    #[arg(short, long)]
    output: PathBuf,
    #[command(flatten)]
    picture: PictureArgs,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    work: WorkArgs,
    /// Write statistics to this file, as JSON
    #[arg(long)]
    stats: Option<PathBuf>,
}

#[derive(Args, Clone)]
#[command(next_help_heading = "Picture")]
pub(crate) struct PictureArgs {
    /// Width and height in pixels
    #[arg(long, value_parser = values::dimensions, default_value = "512x512")]
    pub(crate) size: (u32, u32),
    /// Only a part of the picture: left,top,width,height
    #[arg(long, value_delimiter = ',')]
    crop: Option<Vec<u32>>,
    /// Kernel: wyvill, chen, gaussian, cubic-spline, wendland-c2, epanechnikov, triweight
    #[arg(long, default_value = "wyvill")]
    kernel: Kernel,
    /// Kernels integrate to one (smoothed-particle hydrodynamics)
    #[arg(long)]
    normalised: bool,
    /// Opacity from density: clamp, extinction:K, or a curve like 0:0,1:0.5,4:1
    #[arg(long, default_value = "clamp")]
    opacity: String,
    /// Length that opacity refers to, in units of the cloud; the mean radius by default
    #[arg(long)]
    unit_distance: Option<f64>,
    /// One colour for all, as #c8b090
    #[arg(long, value_parser = values::color, conflicts_with_all = ["colormap", "color_by"])]
    color: Option<[f64; 3]>,
    /// Colour map: viridis, inferno, magma, plasma, turbo, grey, coolwarm; with _r reversed
    #[arg(long)]
    colormap: Option<Colormap>,
    /// What the colour map shows: density, or a stored attribute
    #[arg(long)]
    color_by: Option<String>,
    /// Values at the ends of the colour map, as 0:10
    #[arg(long, value_parser = values::range)]
    value_range: Option<(f64, f64)>,
    /// Light: from the eye, or none
    #[arg(long, value_enum, default_value = "headlight")]
    shading: ShadingArg,
    /// Background colour; transparent by default
    #[arg(long, value_parser = values::color)]
    background: Option<[f64; 3]>,
    /// Distance between samples, in units of the cloud, or `auto`
    #[arg(long, default_value = "auto")]
    step: String,
    /// Automatic distance between samples as a fraction of the radius
    #[arg(long, default_value_t = 0.25)]
    step_fraction: f64,
    /// Samples of a ray begin half a step from the eye, or a different fraction for each pixel
    #[arg(long, value_enum, default_value = "half")]
    phase: PhaseArg,
    /// Rays end where less than this is seen through
    #[arg(long, default_value_t = 0.01)]
    stop: f32,
}

#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Camera (by default it frames the whole cloud)")]
pub(crate) struct CameraArgs {
    /// Eye
    #[arg(long, value_parser = values::vector, allow_hyphen_values = true)]
    pub(crate) position: Option<[f64; 3]>,
    /// What the eye looks at; the centre of the cloud by default
    #[arg(long, value_parser = values::vector, allow_hyphen_values = true, requires = "position")]
    pub(crate) look_at: Option<[f64; 3]>,
    /// Viewing direction: with an eye instead of --look-at, without one to frame the cloud from another side
    #[arg(long, value_parser = values::vector, allow_hyphen_values = true, conflicts_with = "look_at")]
    pub(crate) direction: Option<[f64; 3]>,
    /// Up
    #[arg(long, value_parser = values::vector, allow_hyphen_values = true)]
    pub(crate) up: Option<[f64; 3]>,
    /// Vertical field of view in degrees
    #[arg(long, default_value_t = 45.0)]
    pub(crate) fovy: f64,
    /// Parallel rays
    #[arg(long)]
    pub(crate) orthographic: bool,
    /// Height of an orthographic picture, in units of the cloud
    #[arg(long, requires = "orthographic")]
    pub(crate) height: Option<f64>,
}

#[derive(Args, Clone)]
#[command(next_help_heading = "Work")]
pub(crate) struct WorkArgs {
    /// Memory for the whole process. By default what the cloud was built with (--render-memory), else 256MiB
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
    #[arg(long, default_value_t = 8, hide = true)]
    pub(crate) tile: u32,
    /// Samples worked on at a time, 1 to 32
    #[arg(long, default_value_t = 32, hide = true)]
    pub(crate) slab: usize,
}

#[derive(Clone, Copy, ValueEnum)]
enum ShadingArg {
    None,
    Headlight,
}

#[derive(Clone, Copy, ValueEnum)]
enum PhaseArg {
    Half,
    Hashed,
}

#[derive(Clone, Copy, ValueEnum, PartialEq, Eq)]
pub(crate) enum PredictorArg {
    None,
    Packet,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum IoArg {
    Auto,
    Uring,
    Pool,
}

pub(crate) fn run(args: &RenderArgs) -> Result<()> {
    let started = Instant::now();
    let cloud = Arc::new(Cloud::open(&args.cloud)?);
    let header = cloud.header();
    let settings = args.picture.settings()?;
    let scene = args.picture.scene(&cloud)?;
    let camera = args.camera.camera(header, settings)?;
    let region = args.picture.region(settings)?;
    warn_of_small_radii(header, &camera, settings);
    let (work, plan) = Work::prepare(&args.work, &cloud, settings)?;
    let mut sink = PngSink::create(&args.output, &region)?;
    let counts =
        render_region(&scene, &camera, &settings, &region, &work.exec, &work.pages, &work.object, &mut sink)?;
    sink.finish()?;
    let statistics = Statistics::new(&work, &plan, counts, header, started.elapsed());
    if let Some(path) = &args.stats {
        let text = serde_json::to_string_pretty(&statistics)?;
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    statistics.describe(&args.output);
    if statistics.memory_bytes < plan.comfortable_bytes && statistics.reads_per_page > 2.0 {
        report::remark(format_args!(
            "pages were read {:.1} times each; --memory {} would do better",
            statistics.reads_per_page,
            report::bytes(plan.comfortable_bytes)
        ));
    }
    Ok(())
}

impl PictureArgs {
    fn settings(&self) -> Result<RenderSettings> {
        let step = match self.step.as_str() {
            "auto" => Step::Automatic { fraction: self.step_fraction },
            number => Step::Fixed(
                number.parse().with_context(|| format!("--step {number}: expected a length or `auto`"))?,
            ),
        };
        Ok(RenderSettings {
            width: self.size.0,
            height: self.size.1,
            step,
            phase: match self.phase {
                PhaseArg::Half => Phase::Half,
                PhaseArg::Hashed => Phase::Hashed,
            },
            stop_transmittance: self.stop,
        })
    }

    fn region(&self, settings: RenderSettings) -> Result<Region> {
        let Some(crop) = &self.crop else {
            return Ok(Region { columns: 0..settings.width, rows: 0..settings.height });
        };
        let &[x, y, width, height] = crop.as_slice() else {
            bail!("--crop takes four numbers: left,top,width,height")
        };
        let (right, bottom) = (x.saturating_add(width), y.saturating_add(height));
        ensure!(
            width > 0 && height > 0 && right <= settings.width && bottom <= settings.height,
            "--crop {x},{y},{width},{height} does not lie within the picture"
        );
        Ok(Region { columns: x..right, rows: y..bottom })
    }

    fn scene(&self, cloud: &Arc<Cloud>) -> Result<Scene> {
        let header = cloud.header();
        let linear = |c: [f64; 3]| c.map(|v| linear_from_srgb(v) as f32);
        Ok(Scene {
            cloud: cloud.clone(),
            kernel: self.kernel,
            normalised: self.normalised,
            transfer: TransferFunction {
                opacity: values::opacity(&self.opacity)?,
                unit_distance: self.unit_distance.unwrap_or(header.radius_mean),
                color: self.color_rule(header)?,
            },
            shading: match self.shading {
                ShadingArg::None => Shading::None,
                ShadingArg::Headlight => Shading::Headlight,
            },
            background: self.background.map(linear),
        })
    }

    fn color_rule(&self, header: &Header) -> Result<ColorRule> {
        if let Some(color) = self.color {
            return Ok(ColorRule::Uniform(color.map(|v| linear_from_srgb(v) as f32)));
        }
        if self.colormap.is_none() && self.color_by.is_none() {
            /// Unpainted plaster.
            const PLAIN: [f64; 3] = [0.86, 0.80, 0.70];
            return Ok(if header.has_color {
                ColorRule::Points
            } else {
                ColorRule::Uniform(PLAIN.map(|v| linear_from_srgb(v) as f32))
            });
        }
        let map = match self.colormap {
            Some(map) => map,
            None => "viridis".parse()?,
        };
        let (input, known_range) = match self.color_by.as_deref() {
            None | Some("density") => (MapInput::Density, (0.0, 1.0)),
            Some(name) => {
                let found = header.attributes.iter().position(|a| a.name == name);
                let index = found.ok_or_else(|| {
                    let stored: Vec<&str> = header.attributes.iter().map(|a| a.name.as_str()).collect();
                    anyhow!(
                        "--color-by {name}: the cloud stores {}; keep columns with `build --attributes`",
                        if stored.is_empty() { "no attributes".to_owned() } else { stored.join(", ") }
                    )
                })?;
                let attribute = &header.attributes[index];
                let (low, high) = (f64::from(attribute.min), f64::from(attribute.max));
                (MapInput::Attribute(index), (low, if high > low { high } else { low + 1.0 }))
            }
        };
        Ok(ColorRule::Map { map, input, range: self.value_range.unwrap_or(known_range) })
    }
}

impl CameraArgs {
    fn camera(&self, header: &Header, settings: RenderSettings) -> Result<Camera> {
        let aspect = f64::from(settings.width) / f64::from(settings.height);
        let bounds = header.bounds.inflated(0.5 * header.radius_mean);
        let (view, vertical) = customary_view(header);
        let vector = |v: [f64; 3]| DVec3::from_array(v);
        let direction = self.direction.map_or(view, vector);
        let up = self.up.map_or(vertical, vector);
        // A direction along up says nothing of the roll: any will do.
        let up = if direction.cross(up).length_squared() > 1e-12 * direction.length_squared() {
            up
        } else {
            direction.any_orthonormal_vector()
        };
        let fovy = self.fovy.to_radians();
        ensure!(
            self.fovy > 0.0 && self.fovy < 180.0,
            "--fovy {} is not between 0 and 180 degrees",
            self.fovy
        );
        let mut camera = Camera::framing(&bounds, direction, up, fovy, aspect, self.orthographic);
        if let Some(position) = self.position {
            camera.position = vector(position);
            camera.direction = match (self.look_at, self.direction) {
                (Some(target), _) => vector(target) - camera.position,
                (None, Some(direction)) => vector(direction),
                (None, None) => bounds.center() - camera.position,
            };
            camera.up = up;
        }
        if let Some(height) = self.height {
            camera.projection = Projection::Orthographic { height };
        }
        Ok(camera)
    }
}

/// The side from which a cloud is customarily seen: terrain obliquely from the south, everything else from the front,
/// slightly from above.
fn customary_view(header: &Header) -> (DVec3, DVec3) {
    let size = header.bounds.size();
    if size.z < 0.5 * size.x.min(size.y) {
        (DVec3::new(0.3, 1.0, -0.9), DVec3::Z)
    } else {
        (DVec3::new(-0.15, -0.15, -1.0), DVec3::Y)
    }
}

/// Points smaller than a pixel are missed by most rays.
fn warn_of_small_radii(header: &Header, camera: &Camera, settings: RenderSettings) {
    let distance = (header.bounds.center() - camera.position).length();
    let pixel = match camera.projection {
        Projection::Perspective { fovy } => 2.0 * distance * (fovy * 0.5).tan() / f64::from(settings.height),
        Projection::Orthographic { height } => height / f64::from(settings.height),
    };
    if header.points > 0 && header.radius_mean < pixel * 0.5 {
        report::remark(format_args!(
            "the mean radius ({:.3e}) is under a pixel ({pixel:.3e}): expect noise; a larger picture or a larger \
             --radius-scale helps",
            header.radius_mean
        ));
    }
}

/// The means of a render: settings that change no pixel, and pages.
pub(crate) struct Work {
    pub(crate) exec: ExecSettings,
    pub(crate) pages: WorkingSet,
    pub(crate) object: Arc<rayset::working_set::Object>,
    pub(crate) memory: u64,
    pub(crate) io: String,
}

impl Work {
    pub(crate) fn prepare(
        args: &WorkArgs,
        cloud: &Arc<Cloud>,
        settings: RenderSettings,
    ) -> Result<(Self, MemoryPlan)> {
        let header = cloud.header();
        let threads = args.threads.unwrap_or_else(|| ExecSettings::default().threads).max(1);
        let stored = (header.render_memory > 0).then_some(header.render_memory);
        let memory = args.memory.or(stored).unwrap_or(DEFAULT_MEMORY);
        let plan = memory::plan(header, settings.width, settings.height, threads, PROCESS_BYTES, memory).map_err(
            |least| {
                anyhow!(
                    "--memory {} is too small for this picture with {threads} threads; the smallest that would do \
                     is {least} bytes ({})",
                    report::bytes(memory),
                    report::bytes(least)
                )
            },
        )?;
        let storage = FileStorage::open(cloud.path(), args.direct)
            .with_context(|| format!("cannot open {}", cloud.path().display()))?;
        let kind = match args.io {
            IoArg::Auto => BackendKind::Auto,
            IoArg::Uring => BackendKind::Uring,
            IoArg::Pool => BackendKind::Pool,
        };
        let mut backend = read::backend(kind).context("io_uring is not available here; try --io pool")?;
        if let Some(milliseconds) = args.read_delay {
            ensure!((0.0..1e6).contains(&milliseconds), "--read-delay {milliseconds} is out of range");
            backend = Arc::new(Delayed::new(backend, Duration::from_secs_f64(milliseconds / 1e3))?);
        }
        let io = format!("{}{}", backend.name(), if args.direct { ", direct" } else { "" });
        let pages = WorkingSet::new(Limits::total(plan.page_bytes), backend);
        let object = pages.add(Arc::new(CloudPages::new(cloud.clone(), Arc::new(storage))));
        let predictor: Arc<dyn Predictor> = match args.predictor {
            PredictorArg::None => Arc::new(NoPredictor),
            PredictorArg::Packet => Arc::new(PacketPredictor),
        };
        let exec = ExecSettings {
            threads,
            predictor,
            simd: args.simd,
            tile_pixels: args.tile,
            slab_samples: args.slab,
            band_rows: plan.band_rows,
        };
        Ok((Self { exec, pages, object, memory, io }, plan))
    }
}

/// Writes bands to a PNG file beside its name, which it gets when it is whole.
struct PngSink {
    png: PngBands<BufWriter<File>>,
    partial: PathBuf,
    path: PathBuf,
    meter: Meter,
}

impl PngSink {
    fn create(path: &Path, region: &Region) -> Result<Self> {
        let name = path.file_name().context("--output names no file")?.to_string_lossy();
        let partial = path.with_file_name(format!(".{name}.partial"));
        let file = File::create(&partial).with_context(|| format!("cannot write {}", path.display()))?;
        let png = PngBands::new(BufWriter::new(file), region.columns.len() as u32, region.rows.len() as u32)?;
        Ok(Self { png, partial, path: path.to_owned(), meter: Meter::new("pixels", false) })
    }

    fn finish(self) -> Result<()> {
        self.meter.finish();
        self.png.finish()?;
        std::fs::rename(&self.partial, &self.path)
            .with_context(|| format!("cannot write {}", self.path.display()))
    }
}

impl Sink for PngSink {
    fn band(&mut self, band: &Band) -> Result<(), String> {
        self.png.write(band).map_err(|e| e.to_string())
    }

    fn progress(&mut self, done: u64, total: u64) -> bool {
        self.meter.show("tracing", done, total);
        true
    }
}

/// A render in numbers.
#[derive(serde::Serialize, Clone)]
pub(crate) struct Statistics {
    pub(crate) seconds: f64,
    pub(crate) threads: usize,
    pub(crate) simd: &'static str,
    pub(crate) predictor: &'static str,
    pub(crate) io: String,
    pub(crate) page_bytes: u32,
    pub(crate) memory_bytes: u64,
    pub(crate) pages_budget_bytes: u64,
    pub(crate) peak_rss_bytes: Option<u64>,
    pub(crate) kernel_evaluations: u64,
    pub(crate) pairs_tested: u64,
    pub(crate) samples: u64,
    pub(crate) nonzero_samples: u64,
    pub(crate) packets: u64,
    pub(crate) tiles_put_off: u64,
    pub(crate) slabs: u64,
    pub(crate) runs_decoded: u64,
    pub(crate) stall_seconds: f64,
    pub(crate) reads_per_page: f64,
    pub(crate) working_set_peak_bytes: u64,
    pub(crate) working_set: Vec<KindStatistics>,
}

#[derive(serde::Serialize, Clone)]
pub(crate) struct KindStatistics {
    kind: &'static str,
    pub(crate) hits: u64,
    pub(crate) misses: u64,
    late: u64,
    hinted: u64,
    hinted_in_time: u64,
    stalls: u64,
    stall_nanoseconds: u64,
    pub(crate) reads: u64,
    pub(crate) bytes_read: u64,
    bytes_unique: u64,
    pub(crate) evictions: u64,
    pub(crate) peak_bytes: u64,
}

impl Statistics {
    pub(crate) fn new(
        work: &Work,
        plan: &MemoryPlan,
        counts: RenderCounts,
        header: &Header,
        elapsed: Duration,
    ) -> Self {
        let set = work.pages.statistics();
        let unique = set.total(|k| k.bytes_unique);
        let working_set = rayset::working_set::Kind::ALL
            .into_iter()
            .map(|kind| (kind, *set.kind(kind)))
            .filter(|(_, k)| k.hits + k.misses > 0)
            .map(|(kind, k)| KindStatistics {
                kind: kind.name(),
                hits: k.hits,
                misses: k.misses,
                late: k.late,
                hinted: k.hinted,
                hinted_in_time: k.hinted_in_time,
                stalls: k.stalls,
                stall_nanoseconds: k.stall_nanoseconds,
                reads: k.reads,
                bytes_read: k.bytes_read,
                bytes_unique: k.bytes_unique,
                evictions: k.evictions,
                peak_bytes: k.peak_bytes,
            })
            .collect();
        Self {
            seconds: elapsed.as_secs_f64(),
            threads: work.exec.threads,
            simd: work.exec.simd.name(),
            predictor: work.exec.predictor.name(),
            io: work.io.clone(),
            page_bytes: header.page_bytes,
            memory_bytes: work.memory,
            pages_budget_bytes: plan.page_bytes,
            peak_rss_bytes: peak_rss(),
            kernel_evaluations: counts.splats.kernel_evaluations,
            pairs_tested: counts.splats.pairs_tested,
            samples: counts.samples,
            nonzero_samples: counts.nonzero_samples,
            packets: counts.packets,
            tiles_put_off: counts.put_off,
            slabs: counts.slabs,
            runs_decoded: counts.runs,
            stall_seconds: set.total(|k| k.stall_nanoseconds) as f64 / 1e9,
            reads_per_page: if unique > 0 { set.total(|k| k.bytes_read) as f64 / unique as f64 } else { 0.0 },
            working_set_peak_bytes: set.peak_bytes,
            working_set,
        }
    }

    /// The total over all kinds of pages.
    pub(crate) fn total(&self, number: impl Fn(&KindStatistics) -> u64) -> u64 {
        self.working_set.iter().map(number).sum()
    }

    fn describe(&self, output: &Path) {
        report::say(format_args!(
            "{}: {:.2} s, {} million kernel evaluations, {}{}",
            output.display(),
            self.seconds,
            self.kernel_evaluations / 1_000_000,
            self.simd,
            self.peak_rss_bytes.map_or_else(String::new, |b| format!(", peak memory {}", report::bytes(b)))
        ));
        self.describe_working_set();
    }

    /// One line on what the working set did.
    pub(crate) fn describe_working_set(&self) {
        report::say(format_args!(
            "working set: {} page requests, {} reads of {} ({:.2} a page), {} evictions, waited {:.3} s, at most {} of {}",
            report::count(self.total(|k| k.hits + k.misses)),
            report::count(self.total(|k| k.reads)),
            report::bytes(u64::from(self.page_bytes)),
            self.reads_per_page,
            report::count(self.total(|k| k.evictions)),
            self.stall_seconds,
            report::bytes(self.working_set_peak_bytes),
            report::bytes(self.pages_budget_bytes)
        ));
    }
}

/// The options of a render with default values, for commands that render on the way.
pub(crate) fn defaults(cloud: &Path, output: &Path) -> Result<RenderArgs> {
    #[derive(clap::Parser)]
    struct Wrapper {
        #[command(flatten)]
        args: RenderArgs,
    }
    let words = [Path::new("render"), cloud, Path::new("--output"), output];
    Ok(<Wrapper as clap::Parser>::try_parse_from(words.map(Path::as_os_str))?.args)
}

impl RenderArgs {
    pub(crate) fn with_memory(mut self, memory: u64) -> Self {
        self.work.memory = Some(memory);
        self
    }

    pub(crate) fn with_camera(mut self, camera: CameraArgs) -> Self {
        self.camera = camera;
        self
    }

    pub(crate) fn with_size(mut self, width: u32, height: u32) -> Self {
        self.picture.size = (width, height);
        self
    }
}
