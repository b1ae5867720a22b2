//! A custom source of points: anything that can provide points in batches can be built like a file,
//! out of core if necessary. This one generates terrain on demand:
//! `cargo run --release --example own_source -- [picture.png]`.
#![allow(clippy::print_stdout, reason = "an example says what it did")]

use std::path::PathBuf;
use std::sync::Arc;

use rayset::build::{BuildOptions, Rule};
use rayset::points::{ColorDepth, ColumnInfo, ColumnType, PointBatch, PointSource, ReadError, Schema};
use rayset::scene::{Camera, CloudObject, ColorMap, ColorRule, MapInput, RenderSettings, Scene};
use rayset::{Cloud, Session};

/// Hills on a lattice of `side` by `side` points, generated row by row; a column holds the height
/// of each point.
struct Hills {
    schema: Schema,
    /// The columns that the build has selected, in that order.
    selected: Vec<usize>,
    side: u32,
    next: u32,
}

impl Hills {
    fn new(side: u32) -> Self {
        let columns = vec![ColumnInfo::new("height", ColumnType::F32)];
        Self { schema: Schema::new(columns, ColorDepth::Unit), selected: Vec::new(), side, next: 0 }
    }

    fn point(&self, number: u32) -> [f64; 3] {
        let place = |v: u32| f64::from(v) / f64::from(self.side) * 2.0 - 1.0;
        let (x, z) = (place(number % self.side), place(number / self.side));
        let height = 0.18 * (5.0 * x).sin() * (4.0 * z + x).cos() + 0.06 * (13.0 * x * z + 9.0 * z).sin();
        [x, height, z]
    }
}

impl PointSource for Hills {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        Some(u64::from(self.side) * u64::from(self.side))
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &self.selected);
        let end = (self.side * self.side).min(self.next + limit as u32);
        for number in self.next..end {
            let point = self.point(number);
            batch.position.push(point);
            // The only column is the height.
            batch.columns.iter_mut().for_each(|column| column.push(point[1]));
        }
        self.next = end;
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let output = std::env::args_os().nth(1).map_or_else(|| PathBuf::from("hills.png"), PathBuf::from);
    let file = output.with_extension("rset");
    let options = BuildOptions::default()
        .with_radius(Some(Rule::Number(0.01)))
        .with_attributes(vec!["height".into()])
        .with_memory_bytes(32 << 20);
    let report = Cloud::builder().source(Hills::new(600)).options(options).write(&file)?;
    assert_eq!(report.points, 360_000);

    let cloud = Arc::new(Cloud::open(&file)?);
    let height = &cloud.header().attributes[0];
    let map = ColorMap::named("viridis".parse()?, (height.min, height.max));
    let mut object = CloudObject::plain(cloud);
    object.transfer.color = ColorRule::Map { map, input: MapInput::Attribute(0) };
    let scene = Scene::of_cloud(object);
    let (view, up) = ([0.4, -0.8, -1.0].into(), [0.0, 1.0, 0.0].into());
    let camera = Camera::framing(&scene.root.bounds(), view, up, 0.6, 4.0 / 3.0, false);
    let settings = RenderSettings::default().with_size(320, 240);
    let session = Session::builder().memory(32 << 20).build()?;
    let picture = session.prepare(&scene, &settings)?.view(&camera)?.picture()?;
    let covered = picture.pixels.iter().filter(|pixel| pixel[3] > 0.9).count();
    assert!(covered > 10_000, "the hills cover {covered} pixels");
    picture.save_png(&output)?;
    drop((session, scene));
    std::fs::remove_file(&file)?;
    println!("{}: {} points", output.display(), report.points);
    Ok(())
}
