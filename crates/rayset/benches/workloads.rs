//! Building and rendering the standard workloads, for comparing two states of the code:
//! `cargo bench -p rayset --bench workloads -- --save-baseline before`, then with
//! `--baseline before`; a word like `1m` picks among them.
//!
//! `rayset bench` measures the same with memory, reads and stalls; this measures time alone.

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use rayset::PagedFiles;
use rayset::field::Kernel;
use rayset::octree::Cloud;
use rayset::octree::build::{self, BuildControl, BuildOptions, Rule};
use rayset::output::Destination;
use rayset::points::{self, PlyWriter, PointBatch, ReadOptions, Workload};
use rayset::scene::{
    Camera, CloudObject, ColorRule, Lighting, OpacityRule, RenderSettings, Scene, TransferFunction,
};
use rayset::trace::{ExecSettings, RenderCounts, render_once};
use rayset::working_set::read::{self, BackendKind};
use rayset::working_set::{Limits, WorkingSet};

/// A standard workload as a PLY file and as a cloud, in a folder that stays between runs.
struct Prepared {
    workload: Workload,
    ply: PathBuf,
    rset: PathBuf,
}

impl Prepared {
    fn all() -> Vec<Self> {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("workloads");
        std::fs::create_dir_all(&folder).expect("a folder for the workloads");
        Workload::STANDARD.iter().map(|name| Self::new(&folder, name)).collect()
    }

    fn new(folder: &Path, name: &str) -> Self {
        let workload: Workload = name.parse().expect("a standard workload");
        let (ply, rset) = (folder.join(format!("{name}.ply")), folder.join(format!("{name}.rset")));
        Self { workload, ply, rset }
    }

    /// Writes the PLY file where it is not there.
    fn write(&self) {
        if self.ply.exists() {
            return;
        }
        let to = Destination::new(&self.ply).expect("a place for the file");
        let mut writer = PlyWriter::create(&to, &[], self.workload.points()).expect("the file is created");
        let (mut source, mut batch) = (self.workload.source(), PointBatch::default());
        source.select(&[]);
        loop {
            source.fill(&mut batch, 1 << 14).expect("points");
            if batch.is_empty() {
                break;
            }
            writer.write(&batch).expect("the file is written");
        }
        writer.finish().expect("the file is written");
    }

    fn build(&self) {
        let source = points::open(&self.ply, &ReadOptions::default()).expect("the file opens");
        let radius = self.workload.radius().map(Rule::Number);
        let options = BuildOptions { radius, threads: 2, ..BuildOptions::default() };
        build::run(vec![source], &self.rset, &options, &BuildControl::default()).expect("the cloud builds");
    }
}

/// A cloud that is in memory after its first render.
struct InCore {
    cloud: Arc<Cloud>,
    paged: PagedFiles,
}

impl InCore {
    fn open(prepared: &Prepared) -> Self {
        if !prepared.rset.exists() {
            prepared.build();
        }
        let cloud = Arc::new(Cloud::open(&prepared.rset).expect("the cloud opens"));
        let backend = read::backend(BackendKind::Auto).expect("a way to read");
        let mut paged = PagedFiles::new(WorkingSet::new(Limits::total(cloud.header().file_bytes), backend));
        paged.open(&cloud, false).expect("the cloud opens");
        Self { cloud, paged }
    }

    fn render(&self, workload: &Workload, translucent: bool) -> RenderCounts {
        let radius = self.cloud.header().radius_mean;
        let (kappa, stop_transmittance) = if translucent { (0.02, 0.0) } else { (2.0, 0.01) };
        let object = CloudObject {
            kernel: Kernel::Triweight,
            transfer: TransferFunction {
                opacity: OpacityRule::Extinction(kappa / radius),
                color: ColorRule::Uniform([1.0; 3]),
            },
            ..CloudObject::plain(self.cloud.clone())
        };
        let scene = Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object) };
        let view = workload.view();
        let camera = Camera::look_at(view.position, view.look_at, view.up, view.fovy_degrees.to_radians());
        let settings = RenderSettings { stop_transmittance, ..RenderSettings::default() };
        let exec = ExecSettings { threads: 1, ..ExecSettings::default() };
        render_once(&scene, &camera, &settings, &exec, &self.paged).expect("a picture").1
    }
}

fn builds(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("build");
    group.sample_size(10).measurement_time(Duration::from_secs(10));
    for prepared in Prepared::all() {
        group.throughput(Throughput::Elements(prepared.workload.points()));
        group.bench_function(BenchmarkId::from_parameter(prepared.workload), |bencher| {
            prepared.write();
            bencher.iter(|| prepared.build());
        });
    }
}

fn renders(criterion: &mut Criterion) {
    for (name, translucent) in [("opaque", false), ("translucent", true)] {
        let mut group = criterion.benchmark_group(name);
        group.sample_size(10).measurement_time(Duration::from_secs(10));
        for prepared in Prepared::all() {
            group.bench_function(BenchmarkId::from_parameter(prepared.workload), |bencher| {
                prepared.write();
                let cloud = InCore::open(&prepared);
                bencher.iter(|| black_box(cloud.render(&prepared.workload, translucent)));
            });
        }
    }
}

criterion_group!(workloads, builds, renders);
criterion_main!(workloads);
