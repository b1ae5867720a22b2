//! What pictures cost as people make them: whole commands without options, on files of theirs and
//! on inputs that were found to be slow.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};

use crate::scenes::million_instructions;
use crate::workloads::median;
use rayset_terminal::children;
use rayset_terminal::outputs::{self, Outputs};
use rayset_terminal::report;

/// Pixels of a picture of a file.
const SIZE: [u32; 2] = [960, 640];
/// Of a picture whose instructions are counted, each edge is this part of that of others.
const COUNTED_PART: u32 = 3;

/// How pictures are measured.
pub(crate) struct Options<'a> {
    /// For what is generated, what is built, and the pictures.
    pub(crate) folder: &'a Path,
    /// Inputs of `rayset render`; the inputs that were slow if there are none.
    pub(crate) inputs: &'a [String],
    /// Another program to measure, beside this one.
    pub(crate) beside: Option<&'a Path>,
    pub(crate) repeat: usize,
    /// A command that takes longer is stopped.
    pub(crate) limit: Duration,
    /// Instructions are counted, too, by Valgrind.
    pub(crate) instructions: bool,
}

/// An input, and the size of its picture.
struct Case {
    name: String,
    input: PathBuf,
    size: [u32; 2],
}

/// One line of the table.
#[derive(serde::Serialize)]
pub(crate) struct Measured {
    picture: String,
    width: u32,
    height: u32,
    cost: Cost,
    #[serde(skip_serializing_if = "Option::is_none")]
    beside: Option<Cost>,
}

/// What a picture costs one program.
#[derive(serde::Serialize)]
struct Cost {
    /// Processor time, all threads; median. `None` if the command was stopped at the limit.
    cpu_seconds: Option<f64>,
    /// Median.
    seconds: Option<f64>,
    all_cpu_seconds: Vec<f64>,
    peak_rss_bytes: Option<u64>,
    /// Millions, of a picture of a ninth of the pixels, on one thread with AVX2.
    #[serde(skip_serializing_if = "Option::is_none")]
    million_instructions: Option<u64>,
}

/// Renders each input with each program, in turns, after one round that does not count: what is
/// built is kept for the others.
pub(crate) fn measure(options: &Options<'_>) -> Result<Vec<Measured>> {
    let own = std::env::current_exe().context("cannot find this program's own file")?;
    let programs: Vec<&Path> = std::iter::once(own.as_path()).chain(options.beside).collect();
    let mut results = Vec::new();
    for case in cases(options)? {
        let mut runs: Vec<Runs> = programs.iter().map(|_| Runs::default()).collect();
        for round in 0..=options.repeat.max(1) {
            for (number, program) in programs.iter().enumerate() {
                runs[number].run(options, &case, (number, program), round > 0)?;
            }
        }
        let mut costs = Vec::new();
        for ((number, program), runs) in programs.iter().enumerate().zip(runs) {
            costs.push(runs.cost(options, &case, (number, program))?);
        }
        let beside = (costs.len() > 1).then(|| costs.remove(1));
        let [width, height] = case.size;
        results.push(Measured { picture: case.name, width, height, cost: costs.remove(0), beside });
    }
    Ok(results)
}

/// The runs of one program on one input.
#[derive(Default)]
struct Runs {
    seconds: Vec<f64>,
    cpu_seconds: Vec<f64>,
    peak: Option<u64>,
    stopped: bool,
}

impl Runs {
    /// Renders once, unless it took too long before.
    fn run(
        &mut self,
        options: &Options<'_>,
        case: &Case,
        program: (usize, &Path),
        counts: bool,
    ) -> Result<()> {
        if self.stopped {
            return Ok(());
        }
        let stats = options.folder.join("stats.json");
        let mut command = render(options.folder, case, program, case.size);
        command.arg("--stats").arg(&stats).stdout(Stdio::null()).stderr(Stdio::null());
        let ended = children::run_within(&mut command, options.limit)
            .with_context(|| format!("cannot start {}", program.1.display()))?;
        let Some(status) = ended.status else {
            self.stopped = true;
            return Ok(());
        };
        if !status.success() {
            bail!("{command:?} failed; run it by hand to see why");
        }
        if counts {
            self.seconds.push(ended.seconds);
            self.cpu_seconds.push(ended.cpu_seconds);
        }
        let said: Option<serde_json::Value> =
            fs::read(&stats).ok().and_then(|text| serde_json::from_slice(&text).ok());
        self.peak = said.and_then(|said| said["peak_rss_bytes"].as_u64());
        Ok(())
    }

    fn cost(self, options: &Options<'_>, case: &Case, program: (usize, &Path)) -> Result<Cost> {
        let known = |values: &[f64]| (!self.stopped).then(|| median(values));
        let (cpu_seconds, seconds) = (known(&self.cpu_seconds), known(&self.seconds));
        let of = if program.0 == 0 { "" } else { ", beside" };
        match cpu_seconds {
            Some(cpu) => {
                report::remark(format_args!("{}{of}: {cpu:.2} CPU s", case.name));
            }
            None => {
                let limit = options.limit.as_secs();
                report::remark(format_args!("{}{of}: stopped after {limit} s", case.name));
            }
        }
        let million_instructions = if options.instructions && !self.stopped {
            let mut command =
                render(options.folder, case, program, case.size.map(|edge| edge.div_ceil(COUNTED_PART)));
            command.args(["--threads", "1", "--simd", "avx2"]);
            Some(million_instructions(options.folder, &command)?)
        } else {
            None
        };
        Ok(Cost {
            cpu_seconds,
            seconds,
            all_cpu_seconds: self.cpu_seconds,
            peak_rss_bytes: self.peak,
            million_instructions,
        })
    }
}

/// The command of one program. Each keeps what it builds in a folder of its own.
fn render(folder: &Path, case: &Case, (number, program): (usize, &Path), size: [u32; 2]) -> Command {
    let mut command = Command::new(program);
    command.arg("render").arg(&case.input).arg("-o").arg(folder.join("picture.png"));
    command.arg("--size").arg(format!("{}x{}", size[0], size[1]));
    command.arg("--cache").arg(folder.join(format!("cache-{number}")));
    command
}

/// The inputs that are asked for, or those that were slow.
fn cases(options: &Options<'_>) -> Result<Vec<Case>> {
    if options.inputs.is_empty() {
        return slow(options.folder);
    }
    let case = |input: &String| -> Result<Case> {
        let path = PathBuf::from(input);
        ensure!(path.exists(), "there is no {input}; --pictures takes files and folders to render");
        let name = path.file_name().map_or_else(|| input.clone(), |name| name.to_string_lossy().into_owned());
        Ok(Case { name, input: path, size: SIZE })
    };
    options.inputs.iter().map(case).collect()
}

/// Writes inputs that were found to be slow: many points in one place, one large particle among
/// small ones, mirrors.
fn slow(folder: &Path) -> Result<Vec<Case>> {
    let write = |name: &str, text: &str| -> Result<PathBuf> {
        let path = folder.join(name);
        outputs::write(&Outputs::default().add(&path, None)?, text.as_bytes())?;
        Ok(path)
    };
    let mut particles = String::from("x,y,z,radius\n");
    for i in 0..20_000 {
        // Evenly in a cube: multiples of the powers of 1/1.2207, the root of x⁴ = x + 1.
        let [x, y, z] =
            [0.819_172_5, 0.671_043_6, 0.549_700_5].map(|step| 100.0 * (step * f64::from(i)).fract());
        let _ = writeln!(particles, "{x},{y},{z},1.5");
    }
    let one_place = format!("x,y,z\n{}", "1,2,3\n".repeat(100_000));
    crate::figure::prepare(folder)?;
    let case = |name: &str, input, size| Case { name: name.into(), input, size };
    Ok(vec![
        case("20 000 particles", write("particles.csv", &particles)?, [64, 48]),
        case(
            "and one of radius 1e4",
            write("one-large.csv", &format!("{particles}50,50,50,10000\n"))?,
            [64, 48],
        ),
        case("100 000 points in one place", write("one-place.csv", &one_place)?, [384, 384]),
        case("mirrors", write("mirrors.json", include_str!("../../../examples/mirrors.json"))?, SIZE),
    ])
}

/// The table.
pub(crate) fn describe(results: &[Measured]) {
    report::say(
        "| picture | pixels | CPU s | seconds | peak MiB | M instructions, a ninth of the pixels | CPU s, beside | peak MiB | M instructions | CPU, of beside |",
    );
    report::say("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    for m in results {
        let mut line = format!("| {} | {}×{} | {}", m.picture, m.width, m.height, two(m.cost.cpu_seconds));
        let _ = write!(line, " | {} | {} |", two(m.cost.seconds), m.cost.others());
        if let Some(beside) = &m.beside {
            let ratio = m.cost.cpu_seconds.zip(beside.cpu_seconds).map(|(own, other)| own / other);
            let _ = write!(line, " {} | {} | {} |", two(beside.cpu_seconds), beside.others(), two(ratio));
        } else {
            line.push_str(" - | - | - | - |");
        }
        report::say(line);
    }
}

impl Cost {
    /// Peak memory and instructions, as cells of the table.
    fn others(&self) -> String {
        let peak = self.peak_rss_bytes.map_or_else(|| "-".to_owned(), |b| (b >> 20).to_string());
        let instructions = self.million_instructions.map_or_else(|| "-".to_owned(), report::count);
        format!("{peak} | {instructions}")
    }
}

/// A number with two digits behind the point; a dash for what a command that was stopped lacks.
fn two(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"))
}
