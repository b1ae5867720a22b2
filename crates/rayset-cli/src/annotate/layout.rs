//! Sizes and inks that everything drawn over a picture shares.

use zeno::Command;

use super::canvas::{Color, Piece, Shape, rectangle};
use super::text::Font;

/// Heights of a picture in an em.
const EMS: f32 = 44.0;
/// An em in pixels: smaller is not readable, larger takes memory to no avail.
const EM_RANGE: (f32, f32) = (9.0, 128.0);

const DARK: Color = [18, 21, 26];
const LIGHT: Color = [248, 249, 250];

/// What all that is drawn over a picture shares; lengths are in pixels.
pub(super) struct Layout {
    pub(super) font: Font,
    pub(super) em: f32,
    pub(super) margin: f32,
    /// Width of thin lines.
    pub(super) line: f32,
    /// The colour of texts and lines. Around them lies a halo of the opposite brightness, so that they are read over
    /// whatever the picture shows.
    pub(super) ink: Color,
    halo: Color,
    size: (u32, u32),
}

impl Layout {
    /// For a picture of this size, before a background of this brightness as displayed; `None` if it is transparent.
    pub(super) fn new(font: Font, size: (u32, u32), background: Option<f32>) -> Self {
        let em = (size.1.min(2 * size.0) as f32 / EMS).clamp(EM_RANGE.0, EM_RANGE.1);
        // What is transparent is mostly laid on paper.
        let (ink, halo) = if background.is_some_and(|v| v < 0.5) { (LIGHT, DARK) } else { (DARK, LIGHT) };
        let line = (em / 14.0).round().max(1.0);
        Self { font, em, margin: (1.2 * em).round(), line, ink, halo, size }
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
