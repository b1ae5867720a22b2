//! The scene that several examples share: a knot of points under a lamp that casts shadows.

use std::sync::Arc;

use rayset::Cloud;
use rayset::geometry::DVec3;
use rayset::points::Workload;
use rayset::scene::{Camera, CloudObject, Light, LightKind, Lighting, Scene};

/// A cloud of 30 000 points in memory, under a lamp.
pub(crate) fn knot_under_a_lamp() -> Result<Scene, Box<dyn std::error::Error>> {
    let knot: Workload = "knot-30k".parse()?;
    let cloud = Cloud::builder().sources([knot.source()]).build()?;
    let lights = vec![
        Light { kind: LightKind::Ambient, color: [0.25; 3], shadow: false },
        Light {
            kind: LightKind::Directional { direction: DVec3::new(-0.4, -1.0, -0.5) },
            color: [0.9; 3],
            shadow: true,
        },
    ];
    let scene = Scene::of_cloud(CloudObject::plain(Arc::new(cloud)));
    Ok(Scene { lighting: Lighting::Lit(lights), background: Some([0.03, 0.035, 0.05]), ..scene })
}

/// A camera that frames the scene after the given number of turns around it.
pub(crate) fn camera(scene: &Scene, turns: f64) -> Camera {
    let angle = turns * std::f64::consts::TAU;
    let toward = DVec3::new(-angle.sin(), -0.4, -angle.cos());
    Camera::framing(&scene.root.bounds(), toward, DVec3::Y, 0.7, 4.0 / 3.0, false)
}
