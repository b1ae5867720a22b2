//! What is drawn over a picture: pieces, each a list of shapes within a box, which become pixels
//! once and are laid over the picture row by row.

use zeno::{Cap, Command, Fill, Format, Join, Mask, Placement, Point, Stroke};

/// Colours as displayed (sRGB).
pub(super) type Color = [u8; 3];

pub(super) fn point(x: f32, y: f32) -> Point {
    Point { x, y }
}

/// A path of straight lines.
pub(super) fn polyline(points: &[(f32, f32)], closed: bool) -> Vec<Command> {
    let mut path: Vec<Command> = Vec::with_capacity(points.len() + 1);
    for (i, &(x, y)) in points.iter().enumerate() {
        path.push(if i == 0 { Command::MoveTo(point(x, y)) } else { Command::LineTo(point(x, y)) });
    }
    if closed {
        path.push(Command::Close);
    }
    path
}

/// The outline of a rectangle.
pub(super) fn rectangle(left: f32, top: f32, width: f32, height: f32) -> Vec<Command> {
    let (right, bottom) = (left + width, top + height);
    polyline(&[(left, top), (right, top), (right, bottom), (left, bottom)], true)
}

/// Something drawn, in pixels of the whole picture.
pub(super) enum Shape {
    /// The inside of a path.
    Fill { path: Vec<Command>, color: Color },
    /// What lies within `width` of a path, and its inside, mixed over what is below.
    Halo { path: Vec<Command>, width: f32, color: Color, opacity: f32 },
    /// Opaque rows of one colour each.
    Rows { left: u32, top: u32, width: u32, colors: Vec<Color> },
}

/// Shapes within a box of the picture.
pub(super) struct Piece {
    left: u32,
    top: u32,
    width: u32,
    height: u32,
    pub(super) shapes: Vec<Shape>,
}

impl Piece {
    /// A piece within the part of a box, given by its left upper and right lower corner, that lies
    /// in a picture.
    pub(super) fn within(
        (left, top): (f32, f32),
        (right, bottom): (f32, f32),
        (width, height): (u32, u32),
    ) -> Self {
        // Negative numbers become 0 in the casts.
        let (left, top) = ((left.floor() as u32).min(width), (top.floor() as u32).min(height));
        let (right, bottom) = ((right.ceil() as u32).min(width), (bottom.ceil() as u32).min(height));
        let (width, height) = (right.saturating_sub(left), bottom.saturating_sub(top));
        Self { left, top, width, height, shapes: Vec::new() }
    }

    /// The bytes that its pixels take, and a mask of them while they are made.
    pub(super) fn bytes(&self) -> u64 {
        6 * u64::from(self.width) * u64::from(self.height)
    }

    /// Draws the shapes, in their order.
    pub(super) fn drawn(&self) -> Raster {
        let mut raster = Raster {
            left: self.left,
            top: self.top,
            width: self.width,
            pixels: vec![[0; 4]; self.width as usize * self.height as usize],
        };
        for shape in &self.shapes {
            match shape {
                Shape::Fill { path, color } => {
                    let (mask, placement) =
                        Mask::new(path).style(Fill::NonZero).format(Format::Alpha).render();
                    raster.mix(&mask, &placement, *color, 1.0);
                }
                Shape::Halo { path, width, color, opacity } => {
                    let (mask, placement) = halo(path, *width);
                    raster.mix(&mask, &placement, *color, *opacity);
                }
                Shape::Rows { left, top, width, colors } => raster.rows(*left, *top, *width, colors),
            }
        }
        raster
    }
}

/// How much of each pixel lies within `width` of a path, or inside it.
fn halo(path: &[Command], width: f32) -> (Vec<u8>, Placement) {
    let mut stroke = Stroke::new(2.0 * width);
    stroke.join(Join::Round).cap(Cap::Round);
    let (mut around, placement) = Mask::new(path).style(stroke).format(Format::Alpha).render();
    let (inside, within) = Mask::new(path).style(Fill::NonZero).format(Format::Alpha).render();
    for (i, &covered) in inside.iter().enumerate() {
        let (x, y) = (i as i32 % within.width as i32, i as i32 / within.width as i32);
        let (x, y) = (x + within.left - placement.left, y + within.top - placement.top);
        if (0..placement.width as i32).contains(&x) && (0..placement.height as i32).contains(&y) {
            let at = y as usize * placement.width as usize + x as usize;
            around[at] = around[at].max(covered);
        }
    }
    (around, placement)
}

/// Pixels to be laid over a picture: premultiplied, as displayed.
pub(super) struct Raster {
    left: u32,
    top: u32,
    width: u32,
    pixels: Vec<[u8; 4]>,
}

impl Raster {
    /// The pixel of the raster at a place of the picture.
    fn at(&mut self, x: i64, y: i64) -> Option<&mut [u8; 4]> {
        let (x, y) = (x - i64::from(self.left), y - i64::from(self.top));
        let within = (0..i64::from(self.width)).contains(&x) && y >= 0;
        within.then(|| y as usize * self.width as usize + x as usize).and_then(|at| self.pixels.get_mut(at))
    }

    /// Mixes a colour over what is there.
    fn mix(&mut self, mask: &[u8], placement: &Placement, color: Color, opacity: f32) {
        for (i, &covered) in mask.iter().enumerate().filter(|(_, covered)| **covered > 0) {
            let (x, y) = (i as i64 % i64::from(placement.width), i as i64 / i64::from(placement.width));
            let place = (x + i64::from(placement.left), y + i64::from(placement.top));
            if let Some(pixel) = self.at(place.0, place.1) {
                let alpha = f32::from(covered) / 255.0 * opacity;
                let source = [color[0], color[1], color[2], 255];
                *pixel = std::array::from_fn(|c| {
                    (f32::from(source[c]) * alpha + f32::from(pixel[c]) * (1.0 - alpha)).round() as u8
                });
            }
        }
    }

    fn rows(&mut self, left: u32, top: u32, width: u32, colors: &[Color]) {
        for (y, [red, green, blue]) in (i64::from(top)..).zip(colors) {
            for x in i64::from(left)..i64::from(left) + i64::from(width) {
                if let Some(pixel) = self.at(x, y) {
                    *pixel = [*red, *green, *blue, 255];
                }
            }
        }
    }

    /// Appends all of it to bytes.
    pub(super) fn encode(&self, bytes: &mut Vec<u8>) {
        let rows = self.pixels.len() / self.width.max(1) as usize;
        for number in [self.left, self.top, self.width, rows as u32] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes.extend_from_slice(self.pixels.as_flattened());
    }

    /// Takes one from the front of bytes; `None` if none is there.
    pub(super) fn decode(bytes: &mut &[u8]) -> Option<Self> {
        let mut number = || bytes.split_off(..4)?.try_into().ok().map(u32::from_le_bytes);
        let (left, top, width, rows) = (number()?, number()?, number()?, number()?);
        let length = u64::from(width) * u64::from(rows) * 4;
        let (pixels, _) = bytes.split_off(..usize::try_from(length).ok()?)?.as_chunks();
        Some(Self { left, top, width, pixels: pixels.to_vec() })
    }

    /// Lays its row number `y` of the picture over pixels of straight alpha that begin at column
    /// `left`.
    pub(super) fn over(&self, y: u32, left: u32, rgba: &mut [u8]) {
        let Some(row) = y.checked_sub(self.top) else { return };
        let first = row as usize * self.width as usize;
        let Some(row) = self.pixels.get(first..first + self.width as usize) else { return };
        for (x, &above) in (self.left..).zip(row).filter(|(_, above)| above[3] > 0) {
            let Some(at) = x.checked_sub(left).map(|x| 4 * x as usize) else { continue };
            if let Some(pixel) = rgba.get_mut(at..at + 4) {
                lay(above, pixel);
            }
        }
    }
}

/// Lays a premultiplied pixel over one of straight alpha.
fn lay(above: [u8; 4], pixel: &mut [u8]) {
    let below = f32::from(pixel[3]) / 255.0 * (1.0 - f32::from(above[3]) / 255.0);
    let opacity = f32::from(above[3]) / 255.0 + below;
    for (channel, above) in pixel.iter_mut().zip(&above[..3]) {
        *channel = ((f32::from(*above) + f32::from(*channel) * below) / opacity).round() as u8;
    }
    pixel[3] = (opacity * 255.0).round() as u8;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_laid_over_others_as_their_opacities_say() {
        let laid = |above, mut pixel: [u8; 4]| {
            lay(above, &mut pixel);
            pixel
        };
        assert_eq!(laid([10, 20, 30, 255], [200, 100, 50, 255]), [10, 20, 30, 255]);
        // Half of white over opaque black, and over nothing.
        assert_eq!(laid([128, 128, 128, 128], [0, 0, 0, 255]), [128, 128, 128, 255]);
        assert_eq!(laid([128, 128, 128, 128], [9, 9, 9, 0]), [255, 255, 255, 128]);
    }

    #[test]
    fn a_piece_is_drawn_where_its_shapes_are_and_only_within_its_box() {
        let mut piece = Piece::within((10.0, 10.0), (40.0, 30.0), (36, 100));
        let path = rectangle(20.0, 15.0, 30.0, 5.0);
        piece.shapes.push(Shape::Halo { path: path.clone(), width: 2.0, color: [0; 3], opacity: 0.5 });
        piece.shapes.push(Shape::Fill { path, color: [250, 240, 230] });
        piece.shapes.push(Shape::Rows { left: 12, top: 26, width: 2, colors: vec![[1, 2, 3], [4, 5, 6]] });
        let raster = piece.drawn();
        assert_eq!((raster.left, raster.top, raster.width, raster.pixels.len()), (10, 10, 26, 26 * 20));
        let row = |y: u32| {
            let mut row = [9_u8; 4 * 60];
            raster.over(y, 2, &mut row);
            row
        };
        let pixel = |y: u32, x: usize| -> [u8; 4] { std::array::from_fn(|c| row(y)[4 * (x - 2) + c]) };
        assert_eq!(pixel(17, 22), [250, 240, 230, 255]);
        assert_eq!(pixel(17, 35), [250, 240, 230, 255]);
        assert_eq!(pixel(17, 36), [9; 4], "outside of the box, and of the picture");
        assert_eq!((pixel(26, 12), pixel(27, 13)), ([1, 2, 3, 255], [4, 5, 6, 255]));
        assert_eq!(pixel(13, 25)[3], 128 + 4, "the halo is half opaque, over 9 of 255");
        assert_eq!(row(9), [9; 240]);
    }
}
