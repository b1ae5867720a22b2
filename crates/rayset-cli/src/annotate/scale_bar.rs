//! A bar of a round length.

use rayset::scene::{Camera, Projection};

use super::canvas::{Piece, Shape, rectangle};
use super::layout::Layout;
use super::space::Space;
use super::ticks::{plain, round_below};
use rayset::geometry::DVec3;

/// The most that the bar takes of the picture's width.
const MOST: f32 = 0.25;

/// A length, in the units of the scene and in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scale {
    pub(super) length: f64,
    pub(super) pixels: f32,
}

impl Scale {
    /// A round length at the depth of `center`, in a picture of `size`; `None` if the centre does
    /// not lie in front of the eye.
    pub(super) fn new(camera: &Camera, center: DVec3, size: (u32, u32)) -> Option<Self> {
        let (width, height) = (f64::from(size.0), f64::from(size.1));
        let shown = match camera.projection {
            Projection::Perspective { fovy } => {
                let depth = (center - camera.position).dot(camera.direction.normalize_or_zero());
                2.0 * depth * (0.5 * fovy).tan()
            }
            Projection::Orthographic { height } => height,
            _ => return None,
        };
        let per_pixel = shown / height;
        let length = round_below(f64::from(MOST) * width * per_pixel);
        (per_pixel > 0.0 && length.is_finite() && length > 0.0)
            .then(|| Self { length, pixels: (length / per_pixel) as f32 })
    }

    /// `50 m`
    fn label(&self, unit: Option<&str>) -> String {
        // Of simulations: the next larger or smaller unit of the same kind.
        if let Some(unit) = unit.filter(|unit| unit.contains("pc")) {
            let (length, unit) = match self.length {
                large if large >= 1000.0 && unit.contains("kpc") => {
                    (large / 1000.0, unit.replace("kpc", "Mpc"))
                }
                small if small < 1.0 && unit.contains("kpc") => (small * 1000.0, unit.replace("kpc", "pc")),
                small if small < 1.0 && unit.contains("Mpc") => (small * 1000.0, unit.replace("Mpc", "kpc")),
                same => (same, unit.to_owned()),
            };
            return text(length, &unit);
        }
        let (length, unit) = match unit {
            Some("m") if self.length >= 1000.0 => (self.length / 1000.0, "km"),
            Some("m") if self.length < 0.01 => (self.length * 1000.0, "mm"),
            Some("m") if self.length < 1.0 => (self.length * 100.0, "cm"),
            Some(unit) => (self.length, unit),
            None if self.length == 1.0 => (self.length, "unit"),
            None => (self.length, "units"),
        };
        text(length, unit)
    }

    /// The bar, at the right below. Its box is the same for every length.
    pub(super) fn piece(scale: Option<&Self>, space: Space, layout: &Layout) -> Piece {
        let em = layout.em;
        let (right, bottom) = (layout.right_below(), layout.height() - layout.margin);
        let widest = (MOST * layout.width()).max(12.0 * em);
        let mut piece = layout.piece((right - widest, bottom - 2.2 * em), (right, bottom));
        let Some(scale) = scale else { return piece };
        let (thick, tall) = ((0.18 * em).round().max(2.0), 0.55 * em);
        let left = right - scale.pixels;
        let top = (bottom - tall).round();
        let mut bar = rectangle(left, top + tall - thick, scale.pixels, thick);
        bar.extend(rectangle(left, top, thick, tall));
        bar.extend(rectangle(right - thick, top, thick, tall));
        piece.shapes.push(layout.halo(&bar));
        piece.shapes.push(Shape::Fill { path: bar, color: layout.ink });
        let label = scale.label(space.unit);
        let width = layout.font.width(&label, em);
        // In the middle of the bar, but not beyond the margin.
        let start = (right - 0.5 * (scale.pixels + width)).min(right - width);
        let mut text = Vec::new();
        layout.font.write(&label, em, (start, top - 0.3 * em), &mut text);
        layout.write(&mut piece, text);
        piece
    }
}

/// `50 m`
fn text(length: f64, unit: &str) -> String {
    if (1e-4..1e7).contains(&length) {
        let decimals = (-(length.log10() + 1e-9).floor()).max(0.0) as usize;
        format!("{} {unit}", plain(length, decimals))
    } else {
        format!("{length:e} {unit}")
    }
}

#[cfg(test)]
mod tests {
    use super::super::text::Font;
    use super::*;

    /// The place of a point in a picture, in pixels, by the formulas of the documentation.
    fn projected(camera: &Camera, (width, height): (u32, u32), p: DVec3) -> (f64, f64) {
        let forward = camera.direction.normalize();
        let right = forward.cross(camera.up).normalize();
        let up = right.cross(forward);
        let offset = p - camera.position;
        let half = match camera.projection {
            Projection::Perspective { fovy } => offset.dot(forward) * (0.5 * fovy).tan(),
            Projection::Orthographic { height } => 0.5 * height,
            _ => unreachable!(),
        };
        let (a, b) = (offset.dot(right) / half, offset.dot(up) / half);
        (0.5 * (a * f64::from(height) + f64::from(width)), 0.5 * (1.0 - b) * f64::from(height))
    }

    #[test]
    fn the_bar_is_as_long_as_its_length_is_in_the_picture_at_the_centres_depth() {
        let size = (900, 500);
        let center = DVec3::new(3.0, -20.0, 7.0);
        let (position, up) = (DVec3::new(40.0, 60.0, 30.0), DVec3::Z);
        let direction = center - position + DVec3::new(1.0, 2.0, 0.5);
        for projection in [Projection::Perspective { fovy: 0.7 }, Projection::Orthographic { height: 77.0 }] {
            let camera = Camera { position, direction, up, projection };
            let scale = Scale::new(&camera, center, size).expect("a scale");
            let right = direction.cross(up).normalize();
            let ends = [-0.5, 0.5].map(|t| projected(&camera, size, center + right * (t * scale.length)));
            let length = (ends[1].0 - ends[0].0).hypot(ends[1].1 - ends[0].1);
            assert!((length - f64::from(scale.pixels)).abs() < 1e-3, "{length} {scale:?}");
            assert!((0.1 * 900.0..=0.25 * 900.0).contains(&length), "{length}");
            // And so many pixels are drawn.
            let layout = Layout::new(Font::carried().expect("a typeface"), size, Some(0.0));
            let piece = Scale::piece(Some(&scale), Space { unit: None, y_is_north: false }, &layout);
            let mut row = vec![0; 4 * 900];
            piece.drawn().over((500.0 - layout.margin) as u32 - 1, 0, &mut row);
            let covered: f64 =
                row.chunks_exact(4).map(|p| f64::from(p[0].max(18)) - 18.0).sum::<f64>() / 230.0;
            assert!((covered - length).abs() < 1.0, "{covered} of {length}");
        }
        // Nothing has a length behind the eye.
        let camera =
            Camera { position, direction: -direction, up, projection: Projection::Perspective { fovy: 0.7 } };
        assert_eq!(Scale::new(&camera, center, size), None);
    }

    #[test]
    fn lengths_are_written_in_the_unit_that_suits_them() {
        let label = |length, unit| Scale { length, pixels: 1.0 }.label(unit);
        assert_eq!(label(2000.0, Some("m")), "2 km");
        assert_eq!(label(0.2, Some("m")), "20 cm");
        assert_eq!(label(0.005, Some("m")), "5 mm");
        assert_eq!(label(50.0, Some("mm")), "50 mm");
        assert_eq!(label(10_000.0, Some("ckpc/h")), "10 cMpc/h");
        assert_eq!(label(200.0, Some("kpc")), "200 kpc");
        assert_eq!(label(0.05, Some("Mpc")), "50 kpc");
        assert_eq!(label(0.05, None), "0.05 units");
        assert_eq!(label(1.0, None), "1 unit");
        assert_eq!(label(2e-9, None), "2e-9 units");
    }
}
