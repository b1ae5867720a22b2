//! A session allocates no more than it was given, whatever is rendered: measured as the memory of a
//! process of its own.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use rayset::cancel::CancelToken;
use rayset::field::Kernel;
use rayset::geometry::{DAffine3, DVec3};
use rayset::octree::Cloud;
use rayset::scene::{
    Form, Light, LightKind, Lighting, Material, Node, Operator, RenderSettings, Scene, Shadows,
};
use rayset::trace::{FinishedTile, RenderError, Session, Work};

use crate::common::{camera, folder, scene, settings, workload_cloud};
use crate::graph::solid;

/// Says which cloud and what multiple of the least memory the child is to render with.
const JOB: &str = "RAYSET_SESSION_MEMORY";

/// A number of kibibytes that the system says of this process, in bytes; `None` if it says none.
fn status(name: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with(name))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib << 10)
}

/// Bare, with everything that takes memory (shadows from tables, mirrors, glass, layers), and cut,
/// with a cap.
fn scenes(cloud: &Arc<Cloud>) -> [(Scene, RenderSettings); 3] {
    let bare = scene(cloud, Kernel::Wyvill, true);
    let kind = LightKind::Directional { direction: DVec3::new(0.3, -1.0, -0.4) };
    let mut rich = Scene {
        lighting: Lighting::Lit(vec![Light { kind, color: [0.7; 3], shadow: true }]),
        ..bare.clone()
    };
    let glass = Material { reflectance: 0.3, refractive_index: 1.2, ..Material::default() };
    rich.root = Arc::new((*rich.root).clone().of(glass));
    let quarter = solid(Form::Box { size: DVec3::splat(4.0) }, [1.0; 3])
        .moved(DAffine3::from_translation(DVec3::splat(2.0)));
    let cut = Node::operator(Operator::Difference, [(*bare.root).clone(), quarter]).capped([1.0, 0.0, 0.0]);
    let cut = Scene { root: Arc::new(cut), ..bare.clone() };
    let settings = settings(64, 64);
    let shadows = Shadows::Cached { resolution: 512 };
    let all = RenderSettings { shadows, layers: true, max_depth: 2, ..settings };
    [(bare, settings), (rich, all), (cut, settings.with_cap_resolution(300))]
}

/// The least memory that a session must be given for a scene.
fn least(threads: usize, scene: &Scene, settings: &RenderSettings) -> u64 {
    let session = Session::builder().memory(1).threads(threads).build().expect("a session");
    match session.prepare(scene, settings) {
        Err(RenderError::Memory { needed, .. }) => needed,
        other => panic!("{other:?}"),
    }
}

/// Renders in this process, and asserts what it took.
fn measured(cloud: &Path, times: f64) {
    let cloud = Arc::new(Cloud::open(cloud).expect("it opens"));
    for (place, (scene, settings)) in scenes(&cloud).into_iter().enumerate() {
        let memory = (least(2, &scene, &settings) as f64 * times) as u64;
        std::fs::write("/proc/self/clear_refs", "5").expect("the peak is forgotten");
        let (before, code_before) = (status("VmRSS").expect("a size"), status("RssFile").expect("a size"));
        let session = Session::builder().memory(memory).threads(2).build().expect("a session");
        let prepared = session.prepare(&scene, &settings).expect("it is enough");
        let view = prepared.view(&camera()).expect("a view");
        let work = Work::tiles(view.tiles(&view.region()));
        view.render(&work, &CancelToken::new(), &mut |_: &FinishedTile<'_>| Ok(())).expect("a picture");
        // The program's own code, mapped where it is run for the first time, is nothing that the
        // session allocates.
        let code = status("RssFile").expect("a size").saturating_sub(code_before);
        let took = status("VmHWM").expect("a peak").saturating_sub(before + code);
        assert!(took <= memory, "scene {place}: {took} of {memory} bytes");
        // Or the budget was not asked for anything.
        assert!(times > 2.0 || took > memory / 5, "scene {place}: {took} of {memory} bytes");
    }
}

#[test]
fn a_session_allocates_no_more_than_it_was_given() {
    if let Some(job) = std::env::var_os(JOB) {
        let job = job.into_string().expect("words");
        let (times, cloud) = job.split_once(' ').expect("two words");
        return measured(Path::new(cloud), times.parse().expect("a number"));
    }
    if status("VmHWM").is_none() || std::fs::write("/proc/self/clear_refs", "5").is_err() {
        return;
    }
    let folder = folder();
    workload_cloud("sphere-1m", folder.path());
    let cloud: PathBuf = std::fs::read_dir(folder.path())
        .expect("the folder")
        .map(|entry| entry.expect("an entry").path())
        .find(|path| path.extension().is_some_and(|e| e == "rset"))
        .expect("a cloud");
    for times in ["1", "1.5", "4"] {
        let output = Command::new(std::env::current_exe().expect("this program"))
            .args(["--exact", "session_memory::a_session_allocates_no_more_than_it_was_given", "--nocapture"])
            .env(JOB, format!("{times} {}", cloud.display()))
            // What the allocator keeps for later is no memory that the session asked for.
            .env("MALLOC_ARENA_MAX", "1")
            .env("MALLOC_TRIM_THRESHOLD_", "65536")
            .env("MALLOC_MMAP_THRESHOLD_", "65536")
            .output()
            .expect("it runs");
        let words = String::from_utf8_lossy(&output.stdout);
        assert!(words.contains("1 passed"), "{words}{}", String::from_utf8_lossy(&output.stderr));
        assert!(output.status.success(), "{words}{}", String::from_utf8_lossy(&output.stderr));
    }
}
