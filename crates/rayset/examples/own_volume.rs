//! A custom procedural volume, combined with others by operators, lit and shadowed like them:
//! `cargo run --release --example own_volume -- [picture.png]`.
#![allow(clippy::print_stdout, reason = "an example says what it did")]

use std::path::PathBuf;
use std::sync::Arc;

use rayset::Session;
use rayset::geometry::{Aabb, DAffine3, DVec3};
use rayset::scene::{
    Camera, Compositing, Form, Light, LightKind, Lighting, Node, Operator, Procedural, ProceduralSample,
    RenderSettings, Scene, Shape, Solid,
};

/// A gyroid shell, sin x cos y + sin y cos z + sin z cos x = 0, of a given thickness, in a cube.
#[derive(Debug)]
struct Gyroid {
    /// Factor from lengths to the angles x, y and z.
    frequency: f64,
    thickness: f64,
}

impl Procedural for Gyroid {
    fn bounds(&self) -> Aabb {
        Aabb::new(DVec3::NEG_ONE, DVec3::ONE)
    }

    fn detail(&self) -> f64 {
        self.thickness
    }

    fn sample(&self, p: DVec3) -> ProceduralSample {
        let q = p * self.frequency;
        let (s, c) =
            (DVec3::new(q.x.sin(), q.y.sin(), q.z.sin()), DVec3::new(q.x.cos(), q.y.cos(), q.z.cos()));
        let value = s.x * c.y + s.y * c.z + s.z * c.x;
        let slope = DVec3::new(c.x * c.y - s.z * s.x, c.y * c.z - s.x * s.y, c.z * c.x - s.y * s.z);
        // Signed distance to the shell to first order; negative inside.
        let steepness = (slope.length() * self.frequency).max(1e-9);
        let implicit = value.abs() / steepness - 0.5 * self.thickness;
        let gradient = slope.normalize_or(DVec3::Y) * value.signum();
        let inside = implicit < 0.0 && self.bounds().contains(p);
        ProceduralSample {
            opacity: if inside { 1.0 } else { 0.0 },
            implicit,
            gradient,
            color: if value > 0.0 { [0.75, 0.35, 0.15] } else { [0.15, 0.35, 0.65] },
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let output = std::env::args_os().nth(1).map_or_else(|| PathBuf::from("gyroid.png"), PathBuf::from);
    let leaf = |field: Arc<dyn Procedural>| Node::new(Shape::Procedural(field));
    let shell = leaf(Arc::new(Gyroid { frequency: 5.5, thickness: 0.07 }));
    let ball = leaf(Arc::new(Solid::new(Form::Sphere { radius: 1.0 })));
    let corner = leaf(Arc::new(Solid::new(Form::Box { size: DVec3::ONE })))
        .moved(DAffine3::from_translation(DVec3::splat(0.5)));
    let round = Node::operator(Operator::Intersection, [shell, ball]);
    let root = Arc::new(Node::operator(Operator::Difference, [round, corner]));
    let light = |kind, brightness, shadow| Light { kind, color: [brightness; 3], shadow };
    let lights = vec![
        light(LightKind::Ambient, 0.35, false),
        light(LightKind::Directional { direction: DVec3::new(-0.6, -1.0, -0.5) }, 0.9, true),
    ];
    let scene = Scene {
        root,
        lighting: Lighting::Lit(lights),
        background: Some([0.02; 3]),
        unit_distance: 0.02,
        compositing: Compositing::Linear,
    };
    let camera = Camera::look_at(DVec3::new(2.2, 1.7, 2.4), DVec3::ZERO, DVec3::Y, 0.6);
    let settings = RenderSettings::default().with_size(240, 240).with_samples(2);
    let session = Session::builder().build()?;
    let picture = session.prepare(&scene, &settings)?.view(&camera)?.picture()?;
    let warm = picture.pixels.iter().filter(|pixel| pixel[0] > 2.0 * pixel[2]).count();
    let cold = picture.pixels.iter().filter(|pixel| pixel[2] > 2.0 * pixel[0]).count();
    assert!(warm > 1000 && cold > 1000, "both sides are seen, in {warm} and {cold} pixels");
    picture.save_png(&output)?;
    println!("{}", output.display());
    Ok(())
}
