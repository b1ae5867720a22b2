//! Where the axes point.

use rayset::geometry::DVec3;
use rayset::scene::Camera;

use super::canvas::{Color, Piece, Shape, polyline};
use super::layout::Layout;
use super::sheet::AXES_REACH_EMS;
use super::space::Space;

/// The customary colours of x, y and z.
const COLORS: [Color; 3] = [[222, 72, 64], [70, 166, 70], [66, 128, 226]];
/// Ems from the middle to the tip of an axis across the view.
const ARM: f32 = 2.6;

/// The axes, at the left below, or at the right beside the picture: those that point away from the
/// eye are drawn first. The box is the same for every camera.
pub(super) fn piece(camera: &Camera, space: Space, layout: &Layout) -> Piece {
    let em = layout.em;
    let reach = AXES_REACH_EMS * em;
    let x = if layout.is_beside() { layout.width() - reach - em } else { layout.margin + 0.85 * reach };
    let y = layout.height() - layout.margin - 0.85 * reach;
    let mut piece = layout.piece((x - reach, y - reach), (x + reach + em, y + reach));
    let forward = camera.direction.normalize_or_zero();
    let right = forward.cross(camera.up).normalize_or_zero();
    let up = right.cross(forward);
    let mut axes: Vec<(usize, DVec3)> = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().enumerate().collect();
    axes.sort_by(|a, b| b.1.dot(forward).total_cmp(&a.1.dot(forward)));
    for (index, axis) in axes {
        let across = (axis.dot(right) as f32, -axis.dot(up) as f32);
        let length = across.0.hypot(across.1);
        // An axis along the view is a dot.
        let toward = if length > 0.05 { (across.0 / length, across.1 / length) } else { (0.7, -0.7) };
        let path = arrow((x, y), toward, length * ARM * em, em);
        piece.shapes.push(layout.halo(&path));
        piece.shapes.push(Shape::Fill { path, color: COLORS[index] });
        let name = match (index, space.y_is_north) {
            (1, true) => "y, N",
            _ => ["x", "y", "z"][index],
        };
        let distance = length * ARM * em + 0.75 * em;
        let width = layout.font.width(name, em);
        // Names stand beside their tips, whichever side that is.
        let place = (
            x + toward.0 * distance - 0.5 * width * (1.0 - toward.0 * 0.6),
            y + toward.1 * distance + 0.32 * em,
        );
        let mut text = Vec::new();
        layout.font.write(name, em, place, &mut text);
        layout.write(&mut piece, text);
    }
    piece
}

/// An arrow from a place in a direction.
fn arrow((x, y): (f32, f32), (dx, dy): (f32, f32), length: f32, em: f32) -> Vec<zeno::Command> {
    let (shaft, head) = (0.09 * em, 0.26 * em);
    let neck = (length - 0.75 * em).max(0.0);
    // How far along, and how far to the side.
    let at = |along: f32, aside: f32| (x + dx * along - dy * aside, y + dy * along + dx * aside);
    polyline(
        &[
            at(-shaft, -shaft),
            at(neck, -shaft),
            at(neck, -head),
            at(length.max(neck + shaft), 0.0),
            at(neck, head),
            at(neck, shaft),
            at(-shaft, shaft),
        ],
        true,
    )
}

#[cfg(test)]
mod tests {
    use super::super::text::Font;
    use super::*;
    use rayset::scene::Projection;

    #[test]
    fn axes_point_where_they_do_in_the_picture() {
        let layout = Layout::new(Font::carried().expect("a typeface"), (400, 400), Some(0.0));
        let projection = Projection::Orthographic { height: 1.0 };
        // From the front: x to the right, z up, y away.
        let camera = Camera { position: DVec3::ZERO, direction: DVec3::Y, up: DVec3::Z, projection };
        let space = Space { unit: None, y_is_north: true };
        let raster = piece(&camera, space, &layout).drawn();
        let reach = AXES_REACH_EMS * layout.em;
        let (x, y) = (layout.margin + 0.85 * reach, 400.0 - layout.margin - 0.85 * reach);
        let pixel = |x: f32, y: f32| {
            let mut row = vec![0; 4 * 400];
            raster.over(y as u32, 0, &mut row);
            let at = 4 * x as usize;
            [row[at], row[at + 1], row[at + 2]]
        };
        let tip = (ARM - 0.55) * layout.em;
        assert_eq!(pixel(x + tip, y), COLORS[0]);
        assert_eq!(pixel(x, y - tip), COLORS[2]);
        assert_eq!(pixel(x - tip, y), [0; 3]);
        assert_eq!(pixel(x, y + tip), [0; 3]);
    }
}
