//! Level of detail against the truth: opacities of pixels from aggregates, by one ray, and from all
//! points, by many. `cargo bench -p rayset --bench lod [SCENE] [--coarse]` prints a line for
//! each scene, transfer function and width of pixels.

#![allow(missing_docs, clippy::print_stdout, reason = "a table is printed")]

use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

use rayset::build::{AggregateOptions, BuildControl, BuildOptions, Rule, add_aggregates};
use rayset::field::Kernel;
use rayset::geometry::{DQuat, DVec3};
use rayset::points::ArraySource;
use rayset::scene::{
    Camera, CloudObject, ColorRule, Lighting, Lod, OpacityRule, Projection, RenderSettings, Samples, Scene,
    Step, TransferFunction,
};
use rayset::trace::reference::far::{Far, FarPixel, pixels};
use rayset::{CancelToken, Cloud, Session};

/// Rays of a part of a pixel of the truth: so many in half a spacing of points.
const RAYS: u32 = 16;

/// splitmix64, as numbers of 0 to 1.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn sign(&mut self) -> f64 {
        2.0 * self.unit() - 1.0
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.unit().max(1e-300).ln()).sqrt() * (2.0 * PI * self.unit()).cos()
    }
}

/// Points whose spacing is about one, seen along z.
struct Case {
    name: String,
    positions: Vec<[f64; 3]>,
    /// One radius for all, or one of each; measured, with shapes, if there is none.
    radii: Vec<f32>,
    /// Width of what is looked at.
    width: f64,
    /// By name.
    rules: Vec<(&'static str, OpacityRule)>,
    unit_distance: f64,
    widths: Vec<f64>,
}

const WIDE: [f64; 6] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0];

fn turned(points: &mut [[f64; 3]], degrees: f64) {
    let turn = DQuat::from_rotation_x(degrees.to_radians());
    points.iter_mut().for_each(|p| *p = (turn * DVec3::from_array(*p)).to_array());
}

fn band(from: f64, to: f64) -> OpacityRule {
    let soft = 0.15 * (to - from);
    OpacityRule::Curve(vec![(from, 0.0), (from + soft, 0.9), (to - soft, 0.9), (to, 0.0)])
}

fn cases() -> Vec<Case> {
    let column = Kernel::Wyvill.integral();
    let mut cases = Vec::new();
    for (r, seed) in [(1.5_f64, 1), (0.5, 2)] {
        let mut random = Random(seed);
        let (width, depth) = (44.0, 24.0);
        let count = (width * width * depth) as usize;
        let place = |random: &mut Random| [random.sign() * 22.0, random.sign() * 22.0, random.sign() * 12.0];
        let mass = column * r.powi(3) * depth;
        let clamp = if r < 1.0 { r } else { 8.0 * r };
        cases.push(Case {
            name: format!("volume r={r}"),
            positions: (0..count).map(|_| place(&mut random)).collect(),
            radii: vec![r as f32],
            width: 32.0,
            rules: vec![
                ("linear .3", OpacityRule::Extinction(0.3 / mass)),
                ("linear 3", OpacityRule::Extinction(3.0 / mass)),
                ("linear 30", OpacityRule::Extinction(30.0 / mass)),
                ("clamp", OpacityRule::Clamp),
                ("band", if r < 1.0 { band(0.3, 0.6) } else { band(2.8, 3.4) }),
            ],
            unit_distance: clamp,
            widths: WIDE[1..].to_vec(),
        });
    }
    for (r, random_places) in [(1.5_f64, false), (2.5, false), (1.5, true)] {
        for degrees in [0.0_f64, 45.0, 80.0] {
            let mut random = Random(7);
            let (wide, long) = (74.0, 74.0 / degrees.to_radians().cos());
            let mut positions = Vec::new();
            for j in 0..long as i32 {
                for i in 0..wide as i32 {
                    let (x, y) = match random_places {
                        true => (random.unit() * wide, random.unit() * long),
                        false => (f64::from(i) + 0.3 * random.sign(), f64::from(j) + 0.3 * random.sign()),
                    };
                    positions.push([x - 0.5 * wide, y - 0.5 * long, 0.1 * random.normal()]);
                }
            }
            turned(&mut positions, degrees);
            let mass = column * r.powi(3);
            cases.push(Case {
                name: format!("sheet{} r={r} {degrees}", if random_places { " random" } else { "" }),
                positions,
                radii: vec![r as f32],
                width: 64.0,
                rules: vec![
                    ("linear .3", OpacityRule::Extinction(0.3 / mass)),
                    ("linear 6", OpacityRule::Extinction(6.0 / mass)),
                    ("clamp", OpacityRule::Clamp),
                    ("band", band(0.3, 0.6)),
                ],
                unit_distance: r,
                widths: WIDE.to_vec(),
            });
        }
    }
    cases.push(clumps(column));
    for measured in [false, true] {
        cases.push(sphere(column, measured));
    }
    cases.push(rods(column));
    cases.push(mixed(column));
    cases
}

fn clumps(column: f64) -> Case {
    let mut random = Random(11);
    let mut positions = Vec::new();
    for _ in 0..300 {
        let center = [random.sign() * 40.0, random.sign() * 40.0, random.sign() * 10.0];
        for _ in 0..40 {
            positions.push(center.map(|v| v + 0.7 * random.normal()));
        }
    }
    let mass = column * 40.0 * 300.0 / 6400.0;
    Case {
        name: "clumps".into(),
        positions,
        radii: vec![1.0],
        width: 64.0,
        rules: vec![
            ("linear .3", OpacityRule::Extinction(0.3 / mass)),
            ("linear 3", OpacityRule::Extinction(3.0 / mass)),
            ("linear 30", OpacityRule::Extinction(30.0 / mass)),
            ("clamp", OpacityRule::Clamp),
        ],
        unit_distance: 1.0,
        widths: WIDE.to_vec(),
    }
}

fn sphere(column: f64, measured: bool) -> Case {
    let mut random = Random(13);
    let count = 20_106;
    let golden = PI * (3.0 - 5_f64.sqrt());
    let positions = (0..count).map(|i| {
        let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(count);
        let (s, a) = ((1.0 - z * z).sqrt(), golden * f64::from(i));
        let radius = 40.0 + 0.1 * random.normal();
        [radius * s * a.cos() + 0.3 * random.sign(), radius * s * a.sin() + 0.3 * random.sign(), radius * z]
    });
    let mut positions: Vec<[f64; 3]> = positions.collect();
    turned(&mut positions, 17.0);
    let mass = column * 1.5_f64.powi(3);
    let linear = [
        ("linear .3", OpacityRule::Extinction(0.15 / mass)),
        ("linear 6", OpacityRule::Extinction(3.0 / mass)),
    ];
    Case {
        name: if measured { "sphere of discs".into() } else { "sphere".into() },
        positions,
        radii: if measured { Vec::new() } else { vec![1.5] },
        width: 96.0,
        rules: linear
            .into_iter()
            .filter(|_| !measured)
            .chain([("clamp", OpacityRule::Clamp), ("band", band(0.3, 0.6))])
            .collect(),
        unit_distance: if measured { 0.3 } else { 1.5 },
        widths: WIDE.to_vec(),
    }
}

fn rods(column: f64) -> Case {
    let mut random = Random(17);
    let (mut positions, mut radii) = (Vec::new(), Vec::new());
    for k in 0..6 {
        let (a, k) = (0.3 + 0.5 * f64::from(k), f64::from(k));
        let (o, d) = ([-25.0 + 10.0 * k, 0.0, 2.0 * k], [a.cos(), a.sin(), 0.3]);
        for i in 0..120 {
            let t = f64::from(i) / 3.0 - 20.0;
            positions.push(std::array::from_fn(|q| o[q] + t * d[q] + 0.35 * random.sign()));
            radii.push(0.6);
        }
    }
    for _ in 0..40 {
        let o = [random.sign() * 28.0, random.sign() * 28.0, random.sign() * 5.0];
        let (a, b) = (random.unit() * PI, random.sign());
        let (u, v) = ([a.cos(), a.sin(), 0.0], [-a.sin() * b, a.cos() * b, (1.0 - b * b).sqrt()]);
        for i in -5..=5 {
            for j in -1..=1 {
                let (i, j) = (f64::from(i), f64::from(j));
                positions
                    .push(std::array::from_fn(|q| o[q] + 0.6 * (u[q] * i + v[q] * j) + 0.1 * random.sign()));
                radii.push(0.8);
            }
        }
    }
    let mass = column * 0.5;
    Case {
        name: "rods and leaves".into(),
        positions,
        radii,
        width: 64.0,
        rules: vec![
            ("linear .3", OpacityRule::Extinction(0.1 / mass)),
            ("linear 6", OpacityRule::Extinction(2.0 / mass)),
            ("clamp", OpacityRule::Clamp),
            ("band", band(0.3, 0.6)),
        ],
        unit_distance: 0.7,
        widths: WIDE.to_vec(),
    }
}

/// A halo: radii over three decades, finest in the middle.
fn mixed(column: f64) -> Case {
    let mut random = Random(19);
    let (mut positions, mut radii) = (Vec::new(), Vec::new());
    for _ in 0..30_000 {
        let distance = 24.0 * random.unit().powi(3) + 0.02;
        let way = DVec3::new(random.normal(), random.normal(), random.normal()).normalize();
        positions.push((way * distance).to_array());
        radii.push((0.15 * distance) as f32);
    }
    let mass: f64 = radii.iter().map(|r| column * f64::from(*r).powi(3)).sum::<f64>() / 1024.0;
    Case {
        name: "halo".into(),
        positions,
        radii,
        width: 32.0,
        rules: vec![
            ("linear .3", OpacityRule::Extinction(0.3 / mass)),
            ("linear 3", OpacityRule::Extinction(3.0 / mass)),
            ("linear 30", OpacityRule::Extinction(30.0 / mass)),
        ],
        unit_distance: 1.0,
        widths: WIDE.to_vec(),
    }
}

fn built(case: &Case, folder: &Path) -> Arc<Cloud> {
    let path = folder.join("case.rset");
    let one = (case.radii.len() == 1).then(|| f64::from(case.radii[0]));
    let columns = if case.radii.len() > 1 { vec![("radius", case.radii.clone())] } else { Vec::new() };
    let source = ArraySource::new(case.positions.clone(), columns);
    let radius = match (one, case.radii.is_empty()) {
        (Some(radius), _) => Some(Rule::Number(radius)),
        (None, true) => Some(Rule::Auto),
        (None, false) => None,
    };
    let options = BuildOptions { radius, ..BuildOptions::default() };
    let control = BuildControl::default();
    Cloud::builder().source(source).options(options).control(control).write(&path).expect("it builds");
    add_aggregates(&path, &path, &AggregateOptions::default(), &|_, _| {}, &CancelToken::new())
        .expect("aggregates");
    Arc::new(Cloud::open(&path).expect("it opens"))
}

/// How errors compare with their bounds, in pixels of which something is seen from afar.
#[derive(Default)]
struct Told {
    pixels: u64,
    within: u64,
    bounds: f64,
    errors: f64,
}

impl Told {
    fn add(&mut self, seen: &[FarPixel], errors: &[f64]) {
        for (seen, error) in seen.iter().zip(errors).filter(|(seen, _)| seen.bound_of_error > 0.0) {
            self.pixels += 1;
            self.within += u64::from(error.abs() <= seen.bound_of_error);
            self.bounds += seen.bound_of_error;
            self.errors += error.abs();
        }
    }
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|arg| !arg.starts_with('-')).collect();
    let lod = if std::env::args().any(|arg| arg == "--coarse") { Lod::Coarse(2.0) } else { Lod::AUTO };
    let folder = tempfile::tempdir().expect("a folder");
    let session = Session::builder().memory(1 << 30).build().expect("a session");
    println!(
        "{:<22} {:<10} {:>5} {:>7} {:>7} {:>7} {:>7} {:>9} {:>9}",
        "scene", "opacity", "pixel", "truth", "bias", "error", "largest", "gaussians", "points"
    );
    let (mut all, mut told) = (Vec::new(), Told::default());
    for case in cases() {
        if !wanted.is_empty() && !wanted.iter().any(|name| case.name.contains(name.as_str())) {
            continue;
        }
        let cloud = built(&case, folder.path());
        for (rule_name, rule) in &case.rules {
            let color = ColorRule::Uniform([1.0; 3]);
            let transfer = TransferFunction { opacity: rule.clone(), color };
            let object = CloudObject { transfer, ..CloudObject::plain(cloud.clone()) };
            let lighting = Lighting::Unlit;
            let scene =
                Scene { lighting, unit_distance: case.unit_distance, ..Scene::of_cloud(object.clone()) };
            for &pixel in &case.widths {
                let size = (case.width / pixel + 1e-9) as u32;
                let camera = Camera {
                    position: DVec3::new(0.0, 0.0, -200.0),
                    direction: DVec3::Z,
                    up: DVec3::Y,
                    projection: Projection::Orthographic { height: f64::from(size) * pixel },
                };
                // Divided, so that rays lie closer than the points.
                let parts = (2.0 * pixel).ceil().max(1.0) as u32;
                let settings = RenderSettings {
                    step: Step::Automatic { fraction: 0.2 },
                    stop_transmittance: 1e-4,
                    samples: Samples::Fixed(RAYS),
                    ..RenderSettings::default()
                }
                .with_size(size * parts, size * parts);
                let view = session.prepare(&scene, &settings).and_then(|scene| scene.view(&camera));
                let truth = view.and_then(|view| view.picture()).expect("a picture");
                let mut truths = vec![0.0; (size * size) as usize];
                for (at, fine) in (0..).zip(&truth.pixels) {
                    let (x, y) = (at % (size * parts) / parts, at / (size * parts) / parts);
                    truths[(y * size + x) as usize] += f64::from(fine[3]) / f64::from(parts * parts);
                }
                let far = Far::new(&object, case.unit_distance, (&camera, size, size), lod).expect("a file");
                let far = far.expect("aggregates");
                let seen = pixels(&far, (&camera, size, size));
                let count = f64::from(size * size);
                let errors: Vec<f64> =
                    seen.iter().zip(&truths).map(|(is, truth)| is.opacity - truth).collect();
                told.add(&seen, &errors);
                let mean = truths.iter().sum::<f64>() / count;
                let bias = errors.iter().sum::<f64>() / count;
                let error = errors.iter().map(|error| error.abs()).sum::<f64>() / count;
                let largest = errors.iter().fold(0.0, |most: f64, error| most.max(error.abs()));
                let (gaussians, points) = far.counts();
                println!(
                    "{:<22} {:<10} {:>5} {:>7.3} {:>+7.3} {:>7.3} {:>7.3} {:>9} {:>9}",
                    case.name, rule_name, pixel, mean, bias, error, largest, gaussians, points
                );
                all.push((bias.abs(), largest, pixel));
            }
        }
    }
    let count = all.len().max(1) as f64;
    let mean = all.iter().map(|(bias, ..)| bias).sum::<f64>() / count;
    let most = all.iter().fold(0.0, |most: f64, (bias, ..)| most.max(*bias));
    let within = all.iter().filter(|(bias, ..)| *bias <= 0.05).count() as f64 / count;
    println!(
        "{} cases: mean |bias| {mean:.3}, largest {most:.3}, within .05 {:.0} %",
        all.len(),
        100.0 * within
    );
    println!(
        "{} pixels from afar: errors of {:.1} % within their bounds, of which the mean is {:.2} times that of errors",
        told.pixels,
        100.0 * told.within as f64 / told.pixels.max(1) as f64,
        told.bounds / told.errors
    );
}
