//! The scenes of the figures, over small clouds of the same names.

use std::path::{Path, PathBuf};

use rayset::geometry::{DAffine3, DVec3};
use rayset::grid::build::{GridBuildOptions, build as build_grid};
use rayset::octree::build::{BuildOptions, Rule};
use rayset::points::Workload;
use rayset::scene::{RenderSettings, Shadows, Step};
use rayset::scene_file::SceneFile;
use rayset::trace::ExecSettings;
use rayset::trace::predict::NoPredictor;
use rayset::volumes::RawLayout;

use crate::common::{bits, build_at, folder, paged, picture};

const FIGURES: [u32; 7] = [1, 2, 3, 4, 5, 10, 11];

fn examples() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples")
}

/// A folder with all figure scenes and what they name: points of a few radii, so that steps differ
/// between rays.
fn prepared() -> tempfile::TempDir {
    let folder = folder();
    for figure in FIGURES {
        let name = format!("fig{figure}.json");
        std::fs::copy(examples().join(&name), folder.path().join(&name)).expect("the scene is copied");
    }
    for (name, workload, radius) in
        [("scan.rset", "vase-8k", 0.03), ("other.rset", "knot-6k", 0.05), ("statue.rset", "vase-40k", 0.014)]
    {
        let workload: Workload = workload.parse().expect("a workload");
        let radius = Some(Rule::Number(radius));
        let options = BuildOptions { radius, page_bytes: Some(16 << 10), ..BuildOptions::default() };
        build_at(&folder.path().join(name), workload.source(), &options);
    }
    // A ball with a dent, in bytes, of size 1 about the origin.
    let place = |n: usize| 2.0 * n as f64 / 39.0 - 1.0;
    let value = |i, j, k| {
        let (x, y, z): (f64, f64, f64) = (place(i), place(j), place(k));
        let inside = 1.0 - (x * x + y * y + z * z).sqrt() - 0.6 * (-9.0 * ((x - 0.3).powi(2) + y * y)).exp();
        (255.0 * (0.5 + inside).clamp(0.0, 1.0)) as u8
    };
    let voxels: Vec<u8> = (0..40_usize.pow(3)).map(|n| value(n % 40, n / 40 % 40, n / 1600)).collect();
    let raw = folder.path().join("volume.raw");
    std::fs::write(&raw, voxels).expect("the voxels are written");
    let layout: RawLayout = "40x40x40,u8".parse().expect("a layout");
    let mut source = layout.open(&raw).expect("a volume");
    source.scale = 1.0 / 255.0;
    source.space_from_voxel =
        DAffine3::from_scale(DVec3::splat(1.0 / 39.0)) * DAffine3::from_translation(DVec3::splat(-19.5));
    build_grid(
        source,
        folder.path().join("volume.rset"),
        &GridBuildOptions::default(),
        &rayset::build::BuildControl::default(),
    )
    .expect("a grid");
    folder
}

fn the_same_whatever_the_means(shadows: Shadows, step_fraction: f64) {
    let folder = prepared();
    for figure in FIGURES {
        let path = folder.path().join(format!("fig{figure}.json"));
        let SceneFile { scene, camera, settings, .. } = SceneFile::load(&path).expect("a scene");
        let step = Step::Automatic { fraction: step_fraction };
        let settings = RenderSettings { width: 96, height: 96, shadows, step, ..settings };
        let found = |exec: &ExecSettings, bytes: u64| {
            bits(&picture(&scene, &camera, &settings, exec, &paged(&scene, bytes)).expect("a picture"))
        };
        let first = found(&ExecSettings { threads: 1, ..ExecSettings::default() }, 1 << 30);
        assert!(first.iter().filter(|p| **p != first[0]).count() > 500, "figure {figure} shows nothing");
        let tight = ExecSettings { threads: 2, slab_samples: 19, tile_pixels: 5, ..ExecSettings::default() };
        assert!(found(&tight, 1 << 20) == first, "figure {figure}: a tight budget, two threads");
        let waits = ExecSettings {
            threads: 3,
            predictor: std::sync::Arc::new(NoPredictor),
            ..ExecSettings::default()
        };
        assert!(found(&waits, 4 << 20) == first, "figure {figure}: no predictor, three threads, bands");
    }
}

#[test]
fn figures_with_exact_shadows_are_the_same_whatever_the_means() {
    // From every sample of a mist rays go to every light: with fewer samples this takes seconds,
    // not minutes.
    the_same_whatever_the_means(Shadows::Exact, 1.5);
}

#[test]
fn figures_with_cached_shadows_are_the_same_whatever_the_means() {
    the_same_whatever_the_means(Shadows::Cached { resolution: 64 }, 0.25);
}
