//! Lines of text as outlines, in DejaVu Sans Condensed.

use ttf_parser::{Face, GlyphId, OutlineBuilder};
use zeno::Command;

use super::canvas::point;

/// Lines of text of one size.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Wrapped {
    /// An em in pixels.
    pub(super) em: f32,
    pub(super) lines: Vec<String>,
}

/// From one baseline to the next, in ems.
const LINE_EMS: f32 = 1.2;

impl Wrapped {
    /// From the first baseline to the last, in pixels.
    pub(super) fn drop(&self) -> f32 {
        LINE_EMS * self.em * self.lines.len().saturating_sub(1) as f32
    }

    /// The width of the widest line, in pixels.
    pub(super) fn width(&self, font: &Font) -> f32 {
        self.lines.iter().map(|line| font.width(line, self.em)).fold(0.0, f32::max)
    }

    /// Appends the outlines of all lines, the first of which has its baseline at `(x, y)`.
    pub(super) fn write(&self, font: &Font, (x, y): (f32, f32), path: &mut Vec<Command>) {
        for (i, line) in self.lines.iter().enumerate() {
            font.write(line, self.em, (x, y + LINE_EMS * self.em * i as f32), path);
        }
    }
}

/// A typeface that the program carries.
pub(super) struct Font {
    face: Face<'static>,
}

impl Font {
    /// `None` if the typeface is damaged, which would be an error of the program.
    pub(super) fn carried() -> Option<Self> {
        Face::parse(dejavu::sans_condensed::regular(), 0).ok().map(|face| Self { face })
    }

    /// The width of a line, in pixels, if an em is `em` pixels.
    pub(super) fn width(&self, text: &str, em: f32) -> f32 {
        text.chars().map(|c| self.advance(self.glyph(c))).sum::<f32>() * self.scale(em)
    }

    /// The beginning of a line that is at most `width` wide, with an ellipsis if anything is left
    /// out.
    pub(super) fn shortened(&self, text: &str, em: f32, width: f32) -> String {
        if self.width(text, em) <= width {
            return text.to_owned();
        }
        let room = width - self.width("…", em);
        let mut used = 0.0;
        let kept: String = text
            .chars()
            .take_while(|&c| {
                used += self.advance(self.glyph(c)) * self.scale(em);
                used <= room
            })
            .collect();
        format!("{}…", kept.trim_end())
    }

    /// Both ends of a line that is at most `width` wide, with an ellipsis in between if anything is
    /// left out: of names that are alike, the ends tell which is which.
    pub(super) fn shortened_within(&self, text: &str, em: f32, width: f32) -> String {
        if self.width(text, em) <= width {
            return text.to_owned();
        }
        let letters: Vec<char> = text.chars().collect();
        let without = |left_out: usize| -> String {
            let kept = letters.len() - left_out;
            let (begin, end) = letters.split_at(kept.div_ceil(2));
            [begin, &['…'], &end[left_out..]].concat().into_iter().collect()
        };
        let fits = |line: &String| self.width(line, em) <= width;
        (1..=letters.len()).map(without).find(fits).unwrap_or_default()
    }

    /// A text in at most `most` lines that are at most `width` wide: in the size of an em if it
    /// fits, otherwise in smaller ones. What does not fit even so is left out, with an ellipsis.
    pub(super) fn wrapped(&self, text: &str, em: f32, width: f32, most: usize) -> Wrapped {
        let sizes = [1.0, 0.9, 0.8].map(|part| part * em);
        let whole = sizes.iter().map(|&em| (em, self.broken(text, em, width)));
        if let Some((em, lines)) = whole.into_iter().find(|(_, lines)| lines.len() <= most) {
            return Wrapped { em, lines: lines.into_iter().map(str::to_owned).collect() };
        }
        let em = sizes[sizes.len() - 1];
        let lines = self.broken(text, em, width);
        let (kept, cut) = lines.split_at(most.saturating_sub(1));
        // With the first letter that does not fit, so that an ellipsis is needed.
        let rest = cut.first().map_or("", |line| &text[line.as_ptr() as usize - text.as_ptr() as usize..]);
        let last = self.shortened(rest, em, width);
        Wrapped { em, lines: kept.iter().map(|line| (*line).to_owned()).chain([last]).collect() }
    }

    /// The lines of a text that are at most `width` wide, or one letter: broken between words where
    /// that is possible.
    fn broken<'t>(&self, text: &'t str, em: f32, width: f32) -> Vec<&'t str> {
        let mut lines = Vec::new();
        let mut rest = text.trim();
        while !rest.is_empty() {
            let (mut used, mut between) = (0.0, None);
            let mut end = rest.len();
            for (at, c) in rest.char_indices() {
                if at > 0 && matches!(c, ' ' | '(' | '[' | '×') {
                    between = Some(at);
                }
                used += self.advance(self.glyph(c)) * self.scale(em);
                if used > width && at > 0 {
                    end = between.unwrap_or(at);
                    break;
                }
                if matches!(c, '_' | '-' | '/') {
                    between = Some(at + c.len_utf8());
                }
            }
            let (line, behind) = rest.split_at(end);
            lines.push(line.trim_end());
            rest = behind.trim_start();
        }
        lines
    }

    /// Appends the outline of a line whose baseline begins at `(x, y)`.
    pub(super) fn write(&self, text: &str, em: f32, (x, y): (f32, f32), path: &mut Vec<Command>) {
        let scale = self.scale(em);
        let mut outline = Outline { path, x, y: y.round(), scale };
        for glyph in text.chars().map(|c| self.glyph(c)) {
            // A glyph without an outline is a space.
            self.face.outline_glyph(glyph, &mut outline);
            outline.x += self.advance(glyph) * scale;
        }
    }

    /// The glyph of a character; the one for missing characters if there is none.
    fn glyph(&self, c: char) -> GlyphId {
        self.face.glyph_index(c).unwrap_or(GlyphId(0))
    }

    fn advance(&self, glyph: GlyphId) -> f32 {
        f32::from(self.face.glyph_hor_advance(glyph).unwrap_or(0))
    }

    fn scale(&self, em: f32) -> f32 {
        em / f32::from(self.face.units_per_em())
    }
}

/// Adds outlines to a path: from units of the typeface, y up, to pixels, y down.
struct Outline<'a> {
    path: &'a mut Vec<Command>,
    x: f32,
    y: f32,
    scale: f32,
}

impl Outline<'_> {
    fn place(&self, x: f32, y: f32) -> zeno::Point {
        point(self.x + x * self.scale, self.y - y * self.scale)
    }
}

impl OutlineBuilder for Outline<'_> {
    fn move_to(&mut self, x: f32, y: f32) {
        self.path.push(Command::MoveTo(self.place(x, y)));
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.path.push(Command::LineTo(self.place(x, y)));
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.path.push(Command::QuadTo(self.place(x1, y1), self.place(x, y)));
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        self.path.push(Command::CurveTo(self.place(x1, y1), self.place(x2, y2), self.place(x, y)));
    }

    fn close(&mut self) {
        self.path.push(Command::Close);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_as_wide_as_their_outlines_and_are_shortened_to_fit() {
        let font = Font::carried().expect("a typeface");
        let mut path = Vec::new();
        font.write("10⁻³ µm² Höhe", 20.0, (100.0, 50.0), &mut path);
        let width = font.width("10⁻³ µm² Höhe", 20.0);
        let (low, high) = path.iter().fold((f32::MAX, f32::MIN), |(low, high), command| match command {
            Command::MoveTo(p) | Command::LineTo(p) | Command::QuadTo(_, p) | Command::CurveTo(_, _, p) => {
                (low.min(p.x), high.max(p.x))
            }
            Command::Close => (low, high),
        });
        assert!(low >= 99.0 && (high - 100.0 - width).abs() < 2.0, "{low} {high} {width}");
        // Every character has a glyph of its own.
        assert!("⁰¹²³⁴⁵⁶⁷⁸⁹⁻×µ°·−…".chars().all(|c| font.glyph(c) != GlyphId(0)));
        let long = "a name that goes on and on and does not end";
        let short = font.shortened(long, 10.0, 60.0);
        assert!(short.ends_with('…') && font.width(&short, 10.0) <= 60.0, "{short}");
        assert_eq!(font.shortened("short", 10.0, 60.0), "short");
    }
}
