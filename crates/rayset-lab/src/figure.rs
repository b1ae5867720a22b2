//! `rayset figure`: the figures of the paper, from scene files under `examples/`.

use std::f64::consts::FRAC_PI_2;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use rayset::Cloud;
use rayset::build::{BuildOptions, Rule};
use rayset::build::{GridBuildOptions, grid_to_file};
use rayset::geometry::{Aabb, DAffine3, DVec3};
use rayset::output::Destination;
use rayset::points::{self, MeshSource, PointBatch, PointSource, ReadError, ReadOptions, Schema, Workload};
use rayset::scene::{NoiseCloud, Pattern, Procedural};
use rayset::volumes::{self, RawLayout, VolumeSource};

use rayset_inputs::values;
use rayset_terminal::children;
use rayset_terminal::interrupts::TemporaryFolder;
use rayset_terminal::memory::{PROCESS_BYTES, peak_rss, reset_peak_rss};
use rayset_terminal::outputs::{self, Outputs};

use rayset_terminal::{ply, report};

/// A figure: its number, its scene and what it shows.
struct Figure {
    number: u32,
    scene: &'static str,
    title: &'static str,
}

const FIGURES: [Figure; 7] = [
    Figure {
        number: 1,
        scene: include_str!("../../../examples/fig1.json"),
        title: "a translucent scan with a grid volume inside, cut open by a cylinder",
    },
    Figure {
        number: 2,
        scene: include_str!("../../../examples/fig2.json"),
        title: "four scans in clouds, sharing one cloud file",
    },
    Figure {
        number: 3,
        scene: include_str!("../../../examples/fig3.json"),
        title: "a statue of 14 027 872 points",
    },
    Figure {
        number: 4,
        scene: include_str!("../../../examples/fig4.json"),
        title: "union, intersection and difference of a scan and a cylinder",
    },
    Figure {
        number: 5,
        scene: include_str!("../../../examples/fig5.json"),
        title: "a close-up at growing radius",
    },
    Figure {
        number: 10,
        scene: include_str!("../../../examples/fig10.json"),
        title: "six objects of two clouds in a grid of cloud over a floor, three lights",
    },
    Figure {
        number: 11,
        scene: include_str!("../../../examples/fig11.json"),
        title: "twenty objects, three lights",
    },
];

/// Number of points of the statue in the paper.
const STATUE_POINTS: u64 = 14_027_872;
/// Height of the statue, in the units of its radii.
const STATUE_HEIGHT: f64 = 1597.0;
/// Radii of figure 5, in the same units; figure 3 uses 2.
const STATUE_RADII: [f64; 6] = [0.25, 0.5, 1.0, 2.0, 4.0, 6.0];

/// Make a figure of the paper: prepare its data, render its scene.
///
/// Without --scan and --volume it makes data of its own. The data and the scene stay in the folder
/// given with --data.
#[derive(Args)]
pub struct FigureArgs {
    /// 1, 2, 3, 4, 5, 10 or 11
    number: u32,
    /// Picture to write; figN.png by default
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// Scan to show: points (PLY, LAS, text …); figures 3 and 5 take a mesh in PLY
    #[arg(long)]
    scan: Option<PathBuf>,
    /// Axis that points up in the scan
    #[arg(long, value_enum, default_value = "y")]
    scan_up: Up,
    /// Degrees by which the scan is turned about the vertical
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    scan_turn: f64,
    /// Second scan, of figures 10 and 11
    #[arg(long)]
    other: Option<PathBuf>,
    /// Axis that points up in the second scan
    #[arg(long, value_enum, default_value = "y")]
    other_up: Up,
    /// Degrees by which the second scan is turned about the vertical
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    other_turn: f64,
    /// Volume to show, of figures 1, 2 and 10
    #[arg(long)]
    volume: Option<PathBuf>,
    /// Folder for data and scene; what is there already is used again
    #[arg(long)]
    data: Option<PathBuf>,
    /// Picture size
    #[arg(long, value_parser = values::dimensions)]
    size: Option<(u32, u32)>,
    /// Memory for the whole process
    #[arg(long, value_parser = values::size, default_value = "64MiB")]
    memory: u64,
}

/// Makes the data of a figure and renders it.
///
/// # Errors
/// Whatever ends a build or a render.
pub fn run(args: &FigureArgs) -> Result<()> {
    let Some(figure) = FIGURES.iter().find(|figure| figure.number == args.number) else {
        bail!("there is no figure {}; there are 1, 2, 3, 4, 5, 10 and 11", args.number);
    };
    report::say(format_args!("figure {}: {}", figure.number, figure.title));
    let output = args.output.clone().unwrap_or_else(|| format!("fig{}.png", figure.number).into());
    // Checked first, although it is written last.
    Outputs::beside([&args.scan, &args.other, &args.volume].into_iter().flatten()).add(&output, None)?;
    let Some(folder) = &args.data else {
        return make(figure, args, TemporaryFolder::new("figure")?.path(), &output);
    };
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    make(figure, args, folder, &output)
}

fn make(figure: &Figure, args: &FigureArgs, folder: &Path, output: &Path) -> Result<()> {
    let preparation = Preparation { args, folder };
    let scene = preparation.scene(figure)?;
    let radius = |radius: f64| radius / STATUE_HEIGHT;
    match figure.number {
        3 => preparation.statue(radius(2.0))?,
        5 => {
            for (frame, r) in STATUE_RADII.into_iter().enumerate() {
                report::say(format_args!("r = {r}"));
                preparation.statue(radius(r))?;
                render(args, &scene, &output.with_extension(format!("{frame}.png")))?;
            }
            return Ok(());
        }
        _ => preparation.data(figure.number)?,
    }
    render(args, &scene, output)
}

/// Prepares the data of figures 1, 2, 4, 10 and 11 in a folder, all of it generated, and their
/// scenes, `fig1.json` and so on.
pub(crate) fn prepare(folder: &Path) -> Result<()> {
    for figure in FIGURES.iter().filter(|figure| !matches!(figure.number, 3 | 5)) {
        let args = FigureArgs {
            number: figure.number,
            output: None,
            scan: None,
            scan_up: Up::Y,
            scan_turn: 0.0,
            other: None,
            other_up: Up::Y,
            other_turn: 0.0,
            volume: None,
            data: None,
            size: None,
            memory: 1 << 30,
        };
        let preparation = Preparation { args: &args, folder };
        preparation.scene(figure)?;
        preparation.data(figure.number)?;
    }
    Ok(())
}

fn render(args: &FigureArgs, scene: &Path, output: &Path) -> Result<()> {
    // In a process of its own, so that its memory is that of the render alone.
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let mut command = Command::new(program);
    command.arg("render").arg(scene).arg("--output").arg(output);
    command.arg("--memory").arg(args.memory.to_string());
    if let Some((width, height)) = args.size {
        command.arg("--size").arg(format!("{width}x{height}"));
    }
    let status = children::run(&mut command).context("cannot start a render")?;
    ensure!(status.success(), "no picture was made");
    Ok(())
}

/// Prepares the data of a figure in a folder.
struct Preparation<'a> {
    args: &'a FigureArgs,
    folder: &'a Path,
}

impl Preparation<'_> {
    /// The destination of a file to write in the folder.
    fn output(&self, path: &Path) -> Result<Destination> {
        let FigureArgs { scan, other, volume, .. } = self.args;
        Outputs::beside([scan, other, volume].into_iter().flatten()).add(path, None)
    }

    /// Writes the scene of a figure.
    fn scene(&self, figure: &Figure) -> Result<PathBuf> {
        let path = self.folder.join(format!("fig{}.json", figure.number));
        outputs::write(&self.output(&path)?, figure.scene.as_bytes())?;
        Ok(path)
    }

    /// Prepares clouds and volume of a figure that has no statue.
    fn data(&self, number: u32) -> Result<()> {
        let args = self.args;
        self.cloud("scan.rset", args.scan.as_deref(), args.scan_pose(), "vase-300k")?;
        if matches!(number, 10 | 11) {
            let pose = Pose { up: args.other_up, turn_degrees: args.other_turn };
            self.cloud("other.rset", args.other.as_deref(), pose, "knot-200k")?;
        }
        if matches!(number, 1 | 2 | 10) {
            self.volume()?;
        }
        Ok(())
    }

    fn build_options(&self) -> BuildOptions {
        BuildOptions::default().with_memory_bytes(self.args.memory.saturating_sub(PROCESS_BYTES))
    }

    /// Prepares a cloud that fits a cube of edge 1 and stands on the ground, from a scan or a
    /// workload.
    fn cloud(&self, name: &str, scan: Option<&Path>, pose: Pose, workload: &str) -> Result<()> {
        let path = self.folder.join(name);
        if path.exists() {
            return Ok(());
        }
        let open = || -> Result<Box<dyn PointSource>> {
            match scan {
                Some(scan) => Ok(points::open(scan, &ReadOptions::default())?),
                None => Ok(workload.parse::<Workload>()?.source()),
            }
        };
        self.output(&path)?;
        let pose = if scan.is_some() { pose } else { Pose::default() };
        let standing = standing(&mut *open()?, pose)?;
        let moved = Moved { source: open()?, by: standing, selected: Vec::new() };
        Cloud::builder().source(moved).options(self.build_options()).write(&path)?;
        Ok(())
    }

    /// Prepares the statue: as many points as in the paper, sampled on a mesh or from a vase.
    fn statue(&self, radius: f64) -> Result<()> {
        let ply = self.folder.join("statue.ply");
        if !ply.exists() {
            let to = self.output(&ply)?;
            match &self.args.scan {
                None => {
                    let vase: Workload = format!("vase-{STATUE_POINTS}").parse()?;
                    ply::write_source(&mut *vase.source(), &to)?;
                }
                Some(mesh) => {
                    let by = standing(&mut MeshSource::open(mesh, 100_000)?, self.args.scan_pose())?;
                    let source = Box::new(MeshSource::open(mesh, STATUE_POINTS)?);
                    ply::write_source(&mut Moved { source, by, selected: Vec::new() }, &to)?;
                }
            }
        }
        let options = self
            .build_options()
            .with_radius(Some(Rule::Number(radius)))
            .with_weight(Some(Rule::Number(0.4)))
            .with_keep_color(false);
        reset_peak_rss();
        let source = points::open(&ply, &ReadOptions::default())?;
        let started = std::time::Instant::now();
        let cloud = self.folder.join("statue.rset");
        self.output(&cloud)?;
        let built = Cloud::builder().sources([source]).options(options).write(&cloud)?;
        report::say(format_args!(
            "{} points, {} on disk, {:.1} s, peak memory {}",
            report::count(built.points),
            report::bytes(built.header.file_bytes),
            started.elapsed().as_secs_f64(),
            report::bytes(peak_rss().unwrap_or(0))
        ));
        Ok(())
    }

    /// Prepares a volume of size 1 about the origin, with its values scaled to 0 to 1.
    fn volume(&self) -> Result<()> {
        let path = self.folder.join("volume.rset");
        if path.exists() {
            return Ok(());
        }
        self.output(&path)?;
        let source = match &self.args.volume {
            Some(volume) => self.rescaled(volume)?,
            None => centred(self.noise()?),
        };
        grid_to_file(source, &path, &self.grid_options(), &rayset::build::BuildControl::default())?;
        Ok(())
    }

    /// A volume to be read with its values scaled to 0 to 1. A first build finds their range.
    fn rescaled(&self, volume: &Path) -> Result<VolumeSource> {
        let open = || Ok::<_, anyhow::Error>(centred(volumes::open(volume, None)?));
        let first = TemporaryFolder::within(self.folder, "range")?;
        let header = grid_to_file(
            open()?,
            first.path().join("volume.rset"),
            &self.grid_options(),
            &rayset::build::BuildControl::default(),
        )?;
        let (low, high) = header.value_range();
        let mut source = open()?;
        if high > low {
            source.offset = (source.offset - low) / (high - low);
            source.scale /= high - low;
        }
        Ok(source)
    }

    fn grid_options(&self) -> GridBuildOptions {
        GridBuildOptions::default().with_memory_bytes(self.args.memory.saturating_sub(PROCESS_BYTES))
    }

    /// Fractal noise as a volume of bytes.
    fn noise(&self) -> Result<VolumeSource> {
        const SIDE: u32 = 112;
        let noise = NoiseCloud {
            radii: DVec3::ONE,
            scale: 0.55,
            octaves: 5,
            roughness: 0.55,
            opacity: 1.0,
            cover: 0.75,
            seed: 7,
            pattern: Pattern::Uniform([1.0; 3]),
        };
        let mut voxels = Vec::with_capacity(SIDE.pow(3) as usize);
        for k in 0..SIDE {
            for j in 0..SIDE {
                for i in 0..SIDE {
                    let place = |n: u32| 2.0 * f64::from(n) / f64::from(SIDE - 1) - 1.0;
                    let sample = noise.sample(DVec3::new(place(i), place(j), place(k)));
                    voxels.push((255.0 * sample.opacity).round() as u8);
                }
            }
        }
        let raw = self.folder.join("volume.raw");
        outputs::write(&self.output(&raw)?, &voxels)?;
        let layout: RawLayout = format!("{SIDE}x{SIDE}x{SIDE},u8").parse()?;
        let mut source = layout.open(&raw)?;
        source.scale = 1.0 / 255.0;
        Ok(source)
    }
}

/// A volume moved and scaled to size 1 about the origin.
fn centred(mut source: VolumeSource) -> VolumeSource {
    let last = DVec3::from_array(source.size.map(|n| n.max(2) as f64 - 1.0));
    let bounds = Aabb::new(DVec3::ZERO, last).transformed(&source.space_from_voxel);
    let scale = 1.0 / bounds.size().max_element();
    source.space_from_voxel = DAffine3::from_scale(DVec3::splat(scale))
        * DAffine3::from_translation(-bounds.center())
        * source.space_from_voxel;
    source
}

/// Which axis points up in a scan.
#[derive(Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
enum Up {
    #[default]
    Y,
    Z,
}

/// The orientation of a scan.
#[derive(Clone, Copy, Default)]
struct Pose {
    up: Up,
    turn_degrees: f64,
}

impl FigureArgs {
    fn scan_pose(&self) -> Pose {
        Pose { up: self.scan_up, turn_degrees: self.scan_turn }
    }
}

/// The transform that scales points to a largest extent of 1 and makes them stand on the ground
/// about the y axis.
fn standing(source: &mut dyn PointSource, pose: Pose) -> Result<DAffine3> {
    let upright = match pose.up {
        Up::Y => DAffine3::IDENTITY,
        Up::Z => DAffine3::from_rotation_x(-FRAC_PI_2),
    };
    let turn = DAffine3::from_rotation_y(pose.turn_degrees.to_radians()) * upright;
    let (mut bounds, mut batch) = (Aabb::EMPTY, PointBatch::default());
    source.select(&[]);
    loop {
        source.fill(&mut batch, 1 << 14)?;
        if batch.is_empty() {
            break;
        }
        batch.position.iter().for_each(|p| bounds.include(turn.transform_point3(DVec3::from_array(*p))));
    }
    let size = bounds.size();
    // Points that are wider than high are scaled to a width of 1.
    let scale = 1.0 / size.max_element().max(f64::MIN_POSITIVE);
    let center = bounds.center();
    let foot = DVec3::new(center.x, bounds.min.y, center.z);
    Ok(DAffine3::from_scale(DVec3::splat(scale)) * DAffine3::from_translation(-foot) * turn)
}

/// A source whose points are transformed as they are read, radii included.
struct Moved {
    source: Box<dyn PointSource>,
    by: DAffine3,
    selected: Vec<usize>,
}

impl PointSource for Moved {
    fn schema(&self) -> &Schema {
        self.source.schema()
    }

    fn count_hint(&self) -> Option<u64> {
        self.source.count_hint()
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
        self.source.select(columns);
    }

    fn memory_needed(&self) -> u64 {
        self.source.memory_needed()
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        self.source.fill(batch, limit)?;
        for p in &mut batch.position {
            *p = self.by.transform_point3(DVec3::from_array(*p)).to_array();
        }
        let scale = self.by.matrix3.x_axis.length();
        let radius = self.source.schema().find("radius");
        for (column, &index) in batch.columns.iter_mut().zip(&self.selected) {
            if radius == Some(index) {
                column.scale(scale);
            }
        }
        Ok(())
    }
}
