//! Sizes and inks that everything drawn over a picture shares.

use zeno::Command;

use super::canvas::{Color, Piece, Shape, rectangle};
use super::sheet::{AXES_EMS, COLUMN_EMS, Sheet, em_of};
use super::text::Font;

const DARK: Color = [18, 21, 26];
const LIGHT: Color = [248, 249, 250];

/// What all that is drawn over a picture shares; lengths are in pixels.
pub(super) struct Layout {
    pub(super) font: Font,
    pub(super) em: f32,
    pub(super) margin: f32,
    /// Width of thin lines.
    pub(super) line: f32,
    /// The colour of texts and lines. Around them lies a halo of the opposite brightness, so that
    /// they are read over whatever the picture shows.
    pub(super) ink: Color,
    halo: Color,
    size: (u32, u32),
    /// Where the picture lies, if it has a place of its own.
    sheet: Option<Sheet>,
}

impl Layout {
    /// For a picture of this size, before a background of this brightness as displayed; `None` if
    /// it is transparent.
    pub(super) fn new(font: Font, size: (u32, u32), background: Option<f32>) -> Self {
        let em = em_of(size);
        // What is transparent is mostly laid on paper.
        let (ink, halo) = if background.is_some_and(|v| v < 0.5) { (LIGHT, DARK) } else { (DARK, LIGHT) };
        let line = (em / 14.0).round().max(1.0);
        Self { font, em, margin: (1.2 * em).round(), line, ink, halo, size, sheet: None }
    }

    /// The same beside a picture that has its place on a sheet.
    pub(super) fn beside(self, sheet: Option<Sheet>) -> Self {
        Self { sheet, ..self }
    }

    /// Whether what is drawn lies beside the picture.
    pub(super) fn is_beside(&self) -> bool {
        self.sheet.is_some()
    }

    /// Right end of what belongs below the picture.
    pub(super) fn right_below(&self) -> f32 {
        self.sheet.map_or(self.width() - self.margin, |sheet| (sheet.corner.0 + sheet.picture.0) as f32)
    }

    /// Upper and lower end of what stands at the right: between the caption and the axes, if these
    /// are there.
    pub(super) fn at_the_right(&self) -> (f32, f32) {
        self.sheet.map_or((0.0, self.height()), |sheet| {
            (sheet.corner.1 as f32, self.height() - self.margin - AXES_EMS * self.em)
        })
    }

    /// The most that what stands at the right is wide: `part` of the picture, or the room beside
    /// it.
    pub(super) fn room_at_the_right(&self, part: f32) -> f32 {
        match self.sheet {
            Some(_) => (COLUMN_EMS - 1.0) * self.em - self.margin,
            None => part * self.width(),
        }
    }

    pub(super) fn width(&self) -> f32 {
        self.size.0 as f32
    }

    pub(super) fn height(&self) -> f32 {
        self.size.1 as f32
    }

    /// A piece for what lies within a box, and its halo.
    pub(super) fn piece(&self, (left, top): (f32, f32), (right, bottom): (f32, f32)) -> Piece {
        let around = self.halo_width() + 2.0;
        Piece::within((left - around, top - around), (right + around, bottom + around), self.size)
    }

    pub(super) fn halo_width(&self) -> f32 {
        0.16 * self.em
    }

    /// The halo around a path.
    pub(super) fn halo(&self, path: &[Command]) -> Shape {
        Shape::Halo { path: path.to_vec(), width: self.halo_width(), color: self.halo, opacity: 0.72 }
    }

    /// A piece on a panel that dims what lies behind: for what is larger than a line.
    pub(super) fn panel(&self, (left, top): (f32, f32), (right, bottom): (f32, f32)) -> Piece {
        let padding = 0.55 * self.em;
        let corner = 0.35 * self.em;
        let inset = padding - corner;
        let mut piece = self.piece((left - padding, top - padding), (right + padding, bottom + padding));
        let path =
            rectangle(left - inset, top - inset, right - left + 2.0 * inset, bottom - top + 2.0 * inset);
        piece.shapes.push(Shape::Halo { path, width: corner, color: self.halo, opacity: 0.5 });
        piece
    }

    /// Draws text with its halo.
    pub(super) fn write(&self, piece: &mut Piece, text: Vec<Command>) {
        piece.shapes.push(self.halo(&text));
        piece.shapes.push(Shape::Fill { path: text, color: self.ink });
    }
}
