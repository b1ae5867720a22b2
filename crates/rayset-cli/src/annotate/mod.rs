//! `--annotate`: a colour bar, a scale bar, the axes and a caption beside a picture, or over it.
//!
//! All that is drawn is laid out in pixels of the whole sheet that is written, becomes pixels of
//! its own once, and is laid over the encoded rows as they come: bands, crops and budgets change
//! nothing, and no picture is read again.

mod canvas;
mod classes;
mod color_bar;
mod layout;
mod scale_bar;
mod sheet;
mod space;
mod text;
mod ticks;
mod triad;

use anyhow::{Context, Result};
use clap::Args;
use rayset::geometry::DVec3;
use rayset::image::DisplayTransform;
use rayset::memory::SceneNeeds;
use rayset::scene::{Camera, Scene};

use self::canvas::{Piece, Raster};
use self::classes::View;
use self::color_bar::LabelledMap;
use self::layout::Layout;
use self::scale_bar::Scale;
pub(crate) use self::sheet::{Mount, Sheet};
pub(crate) use self::space::{Space, of_header, of_reference_system};
use self::text::Font;
use rayset_terminal::report;

#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Annotations (of PNG)")]
pub(crate) struct AnnotateArgs {
    /// Draw the colour map with its values, a scale, the axes and a caption beside the picture,
    /// which leaves them a margin
    #[arg(long)]
    pub(crate) annotate: bool,
    /// Draw them over the picture instead
    #[arg(long)]
    pub(crate) annotate_over: bool,
    /// The caption; by default the name of the input, its size and its look. A line break is
    /// written \n
    #[arg(long)]
    pub(crate) caption: Option<String>,
}

impl AnnotateArgs {
    /// Whether anything is drawn.
    pub(crate) fn is_wanted(&self) -> bool {
        self.annotate || self.annotate_over
    }

    /// The lines of the caption, if there is one.
    fn lines(&self) -> Option<Vec<String>> {
        self.caption.as_ref().map(|text| text.split("\\n").map(str::to_owned).collect())
    }

    /// The sheet of `size` on which a picture leaves room for its annotations; `None` if nothing is
    /// drawn, or over the picture.
    pub(crate) fn sheet(&self, size: (u32, u32)) -> Option<Sheet> {
        if self.annotate_over || !self.annotate {
            return None;
        }
        let sheet = Sheet::new(size, self.lines().map_or(2, |lines| lines.len()));
        if sheet.is_none() {
            report::remark(format_args!(
                "--annotate: {}x{} pixels are too few for a margin; annotations lie over the picture",
                size.0, size.1
            ));
        }
        sheet
    }
}

/// What the program needs for drawing besides pixels: outlines, and pages of the typeface and of
/// code that are read in.
const DRAWING_BYTES: u64 = 1536 << 10;

/// What is drawn over every picture of a scene.
pub(crate) struct Annotations {
    layout: Layout,
    space: Space,
    shown: Option<LabelledMap>,
    caption: Vec<String>,
    center: DVec3,
    /// Of the picture itself.
    size: (u32, u32),
    /// A row of the sheet, if the picture has a place on it.
    row_bytes: u64,
}

impl Annotations {
    /// For pictures of `size` of a scene, or with a place on `sheet`. `name` is that of the input,
    /// `look` the one that was chosen for it.
    pub(crate) fn new(
        args: &AnnotateArgs,
        scene: &Scene,
        size: (u32, u32),
        sheet: Option<Sheet>,
        display: DisplayTransform,
        name: &str,
        look: Option<&str>,
    ) -> Result<Self> {
        let font = Font::carried().context("--annotate: the program's typeface is damaged")?;
        let brightness = scene.background.map(|[red, green, blue]| {
            let light = display.apply(0.2126 * red + 0.7152 * green + 0.0722 * blue);
            // Roughly as displayed.
            light.clamp(0.0, 1.0).powf(1.0 / 2.2)
        });
        let space = Space::of(scene);
        let mut maps = LabelledMap::all_of(scene, space);
        if maps.len() > 1 {
            report::remark(format_args!(
                "--annotate: the scene has {} colour maps; the bar shows the first",
                maps.len()
            ));
        }
        maps.truncate(1);
        let caption = args.lines().unwrap_or_else(|| vec![name.to_owned(), contents(scene, look)]);
        let bounds = scene.root.bounds();
        let center = if bounds.is_empty() { DVec3::ZERO } else { bounds.center() };
        let whole = sheet.map_or(size, |sheet| sheet.size);
        let layout = Layout::new(font, whole, brightness).beside(sheet);
        let row_bytes = sheet.map_or(0, |sheet| 20 * u64::from(sheet.size.0));
        Ok(Self { layout, space, shown: maps.pop(), caption, center, size, row_bytes })
    }

    /// An upper bound of the memory that drawing takes, and keeps until the picture is written.
    pub(crate) fn bytes(&self, camera: &Camera) -> u64 {
        let pieces = self.pieces(camera, None).iter().map(Piece::bytes).sum::<u64>();
        DRAWING_BYTES + self.row_bytes + pieces + self.shown.as_ref().map_or(0, LabelledMap::bytes)
    }

    /// What is drawn over the picture that a camera sees.
    pub(crate) fn overlay(&self, camera: &Camera) -> Overlay {
        let view = View { camera, size: self.size };
        Overlay { rasters: self.pieces(camera, Some(&view)).iter().map(Piece::drawn).collect() }
    }

    /// All pieces; of classes those that `view` sees, or all.
    fn pieces(&self, camera: &Camera, view: Option<&View<'_>>) -> Vec<Piece> {
        let layout = &self.layout;
        let scale = Scale::new(camera, self.center, self.size);
        let mut pieces = vec![self.heading()];
        pieces.extend(self.shown.as_ref().map(|shown| shown.piece(layout, view)));
        pieces.push(triad::piece(camera, self.space, layout));
        pieces.push(Scale::piece(scale.as_ref(), self.space, layout));
        pieces
    }

    /// The caption, at the left above; its first line is larger.
    fn heading(&self) -> Piece {
        let layout = &self.layout;
        let room = (layout.width() - 2.0 * layout.margin).max(layout.em);
        let mut text = Vec::new();
        let (mut y, mut widest) = (layout.margin, 0.0_f32);
        for (i, line) in self.caption.iter().enumerate() {
            let em = if i == 0 { 1.2 * layout.em } else { layout.em };
            let line = layout.font.shortened(line, em, room);
            y += em;
            layout.font.write(&line, em, (layout.margin, y), &mut text);
            y += 0.35 * em;
            widest = widest.max(layout.font.width(&line, em));
        }
        let mut piece =
            layout.piece((layout.margin, layout.margin), (layout.margin + widest, y + 0.3 * layout.em));
        layout.write(&mut piece, text);
        piece
    }
}

/// `1 065 points, look classes`
fn contents(scene: &Scene, look: Option<&str>) -> String {
    let needs = SceneNeeds::of(scene, &rayset::scene::RenderSettings::default());
    let points: u64 = needs.clouds().iter().map(|cloud| cloud.header().points).sum();
    let mut parts = Vec::new();
    if points > 0 {
        parts.push(format!("{} points", report::count(points)));
    }
    match needs.grids() {
        [] => {}
        [grid] => parts.push(format!("{} voxels", grid.header().size.map(|n| n.to_string()).join(" × "))),
        grids => {
            let voxels = grids.iter().map(|grid| grid.header().size.iter().product::<u64>()).sum();
            parts.push(format!("{} voxels", report::count(voxels)));
        }
    }
    parts.extend(look.map(|look| format!("look {look}")));
    parts.join(", ")
}

/// Pixels to be laid over a picture.
pub(crate) struct Overlay {
    rasters: Vec<Raster>,
}

impl Overlay {
    /// Its pixels as bytes.
    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.rasters.iter().for_each(|raster| raster.encode(&mut bytes));
        bytes
    }

    /// What [`encode`](Self::encode) made bytes of; `None` if they are anything else.
    pub(crate) fn decode(mut bytes: &[u8]) -> Option<Self> {
        let mut rasters = Vec::new();
        while !bytes.is_empty() {
            rasters.push(Raster::decode(&mut bytes)?);
        }
        Some(Self { rasters })
    }

    /// Lays row `y` of the picture over encoded pixels (RGBA, straight alpha) that begin at column
    /// `left`.
    pub(crate) fn over(&self, y: u32, left: u32, rgba: &mut [u8]) {
        self.rasters.iter().for_each(|raster| raster.over(y, left, rgba));
    }
}
