//! Results as Markdown, CSV and SVG.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, anyhow};
use plotters::prelude::*;
use rayset::image::{Band, DisplayTransform, PngBands};

use crate::engine::Picture;

/// A table of results.
pub struct Table {
    /// What stands above it.
    pub title: String,
    /// Sentences that say how it came about.
    pub notes: Vec<String>,
    columns: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table without rows.
    #[must_use]
    pub fn new(title: &str, columns: &[&str]) -> Self {
        let columns = columns.iter().map(|c| (*c).to_owned()).collect();
        Self { title: title.into(), notes: Vec::new(), columns, rows: Vec::new() }
    }

    /// Adds a row, a cell for each column.
    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }

    /// Says how the table came about.
    pub fn note(&mut self, sentence: impl Into<String>) {
        self.notes.push(sentence.into());
    }

    fn markdown(&self) -> String {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let rule: Vec<String> = self.columns.iter().map(|_| "---:".into()).collect();
        let mut text = format!("# {}\n\n", self.title);
        for note in &self.notes {
            let _ = writeln!(text, "{note}\n");
        }
        text += &line(&self.columns);
        text += &line(&rule);
        self.rows.iter().for_each(|row| text += &line(row));
        text
    }

    fn csv(&self) -> String {
        let quoted = |cell: &String| {
            if cell.contains([',', '"', '\n']) {
                format!("\"{}\"", cell.replace('"', "\"\""))
            } else {
                cell.clone()
            }
        };
        let line = |cells: &[String]| cells.iter().map(quoted).collect::<Vec<_>>().join(",") + "\n";
        std::iter::once(&self.columns).chain(&self.rows).map(|cells| line(cells)).collect()
    }

    /// Writes `name.md` and `name.csv` into a folder.
    ///
    /// # Errors
    /// What the system says.
    pub fn write(&self, folder: &Path, name: &str) -> Result<()> {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        for (ending, text) in [("md", self.markdown()), ("csv", self.csv())] {
            let path = folder.join(format!("{name}.{ending}"));
            std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }
}

/// A line of a plot.
pub struct Series {
    /// Its name.
    pub name: String,
    /// Its points, in ascending order of x; both coordinates above 0.
    pub points: Vec<(f64, f64)>,
}

/// Writes lines as an SVG picture, both axes logarithmic.
///
/// # Errors
/// What the system says.
pub fn plot(path: &Path, title: &str, axes: (&str, &str), series: &[Series]) -> Result<()> {
    const WIDTH: u32 = 920;
    const NAMES: u32 = 260;
    const COLORS: [RGBColor; 10] = [
        RGBColor(31, 119, 180),
        RGBColor(214, 39, 40),
        RGBColor(44, 160, 44),
        RGBColor(148, 103, 189),
        RGBColor(255, 127, 14),
        RGBColor(90, 90, 90),
        RGBColor(140, 86, 75),
        RGBColor(227, 119, 194),
        RGBColor(188, 189, 34),
        RGBColor(23, 190, 207),
    ];
    let all = || series.iter().flat_map(|s| &s.points);
    let span = |values: Vec<f64>| {
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(0.0, f64::max);
        (low / 1.3)..(high * 1.3)
    };
    if all().next().is_none() {
        return Ok(());
    }
    let (x, y) = (span(all().map(|p| p.0).collect()), span(all().map(|p| p.1).collect()));
    let failed = |e: &dyn std::fmt::Display| anyhow!("cannot draw {}: {e}", path.display());
    let area = SVGBackend::new(path, (WIDTH, 440)).into_drawing_area();
    area.fill(&WHITE).map_err(|e| failed(&e))?;
    let mut chart = ChartBuilder::on(&area)
        .caption(title, ("sans-serif", 18))
        .margin(12)
        .margin_right(NAMES)
        .x_label_area_size(44)
        .y_label_area_size(72)
        .build_cartesian_2d(x.log_scale(), y.log_scale())
        .map_err(|e| failed(&e))?;
    chart
        .configure_mesh()
        .x_desc(axes.0)
        .y_desc(axes.1)
        .x_label_formatter(&|v| tick(*v))
        .y_label_formatter(&|v| tick(*v))
        .light_line_style(WHITE)
        .draw()
        .map_err(|e| failed(&e))?;
    // Names stand beside the lines, which leave no corner free for certain.
    let left = (WIDTH - NAMES) as i32 + 12;
    for (row, (one, color)) in series.iter().zip(COLORS.iter().cycle()).enumerate() {
        let line = LineSeries::new(one.points.iter().copied(), color.stroke_width(2)).point_size(3);
        chart.draw_series(line).map_err(|e| failed(&e))?;
        let y = 60 + 20 * row as i32;
        let stroke = PathElement::new([(left, y), (left + 18, y)], color.stroke_width(2));
        area.draw(&stroke).map_err(|e| failed(&e))?;
        let name = Text::new(one.name.clone(), (left + 24, y - 6), ("sans-serif", 12).into_font());
        area.draw(&name).map_err(|e| failed(&e))?;
    }
    area.present().map_err(|e| failed(&e))
}

/// A place on a logarithmic axis in as few digits as say it; only ones, twos and fives, so that
/// names do not meet.
fn tick(v: f64) -> String {
    let power = 10_f64.powf((v.log10() + 1e-9).floor());
    let leading = (v / power).round();
    if [1.0, 2.0, 5.0].contains(&leading) {
        format!("{}", (leading * power * 1e9).round() / 1e9)
    } else {
        String::new()
    }
}

/// Writes values as bars, one below the other.
///
/// # Errors
/// What the system says.
pub fn bars(path: &Path, title: &str, unit: &str, values: &[(String, f64)]) -> Result<()> {
    let failed = |e: &dyn std::fmt::Display| anyhow!("cannot draw {}: {e}", path.display());
    let most = values.iter().map(|v| v.1).fold(0.0, f64::max);
    if !(most > 0.0 && most.is_finite()) {
        return Ok(());
    }
    let rows = values.len();
    let area = SVGBackend::new(path, (760, 90 + 20 * rows as u32)).into_drawing_area();
    area.fill(&WHITE).map_err(|e| failed(&e))?;
    let mut chart = ChartBuilder::on(&area)
        .caption(title, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(290)
        .build_cartesian_2d(0.0..most * 1.05, 0.0..rows as f64)
        .map_err(|e| failed(&e))?;
    // The labels of an axis stand at ticks, and bars between them: names are drawn beside their
    // bars instead.
    chart
        .configure_mesh()
        .disable_y_mesh()
        .disable_y_axis()
        .x_desc(unit)
        .light_line_style(WHITE)
        .draw()
        .map_err(|e| failed(&e))?;
    let style = ("sans-serif", 13).into_font();
    for (row, (name, value)) in values.iter().enumerate() {
        let top = (rows - row) as f64;
        let bar = Rectangle::new([(0.0, top - 0.85), (*value, top - 0.15)], RGBColor(31, 119, 180).filled());
        chart.draw_series(std::iter::once(bar)).map_err(|e| failed(&e))?;
        let (_, y) = chart.backend_coord(&(0.0, top - 0.25));
        area.draw(&Text::new(format!("{name}: {}", number(*value)), (16, y), style.clone()))
            .map_err(|e| failed(&e))?;
    }
    area.present().map_err(|e| failed(&e))
}

/// Writes square pictures in rows and columns, all of one side, over a grey ground.
///
/// # Errors
/// What the system says.
pub fn sheet(path: &Path, side: u32, rows: &[Vec<Picture>]) -> Result<()> {
    const GAP: u32 = 4;
    const GROUND: f32 = 0.6;
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0) as u32;
    let (width, height) = (columns * (side + GAP) + GAP, rows.len() as u32 * (side + GAP) + GAP);
    let mut band = Band::new(0, width, height, false);
    band.pixels.fill([1.0; 4]);
    for (row, pictures) in rows.iter().enumerate() {
        for (column, picture) in pictures.iter().enumerate() {
            let (left, top) = (GAP + column as u32 * (side + GAP), GAP + row as u32 * (side + GAP));
            for (i, [r, g, b, opacity]) in picture.iter().enumerate() {
                let (x, y) = (left + i as u32 % side, top + i as u32 / side);
                let behind = (1.0 - opacity) * GROUND;
                band.pixels[(y * width + x) as usize] = [r + behind, g + behind, b + behind, 1.0];
            }
        }
    }
    let file = std::fs::File::create(path).with_context(|| format!("cannot write {}", path.display()))?;
    let mut png = PngBands::new(std::io::BufWriter::new(file), width, height, DisplayTransform::default())?;
    png.write(&band)?;
    Ok(png.finish()?)
}

/// A number with three digits that count.
#[must_use]
pub fn number(v: f64) -> String {
    if v == 0.0 || !v.is_finite() {
        return v.to_string();
    }
    let digits = (2 - v.abs().log10().floor() as i32).clamp(0, 6) as usize;
    format!("{v:.digits$}")
}

/// Bytes in MB, as the paper counts them.
#[must_use]
pub fn megabytes(bytes: u64) -> String {
    number(bytes as f64 / 1e6)
}
