//! What is likely to disappoint, said before it is rendered, with the option that helps.

use rayset::file::Header;
use rayset::geometry::DVec3;
use rayset::scene::{Camera, Projection, RenderSettings};

use rayset_terminal::report;

/// Points smaller than a pixel are missed by most rays. `framed` is about the middle of those in
/// the picture: the middle of the bounds may be far away.
pub(super) fn of_small_radii(
    header: &Header,
    framed: Option<DVec3>,
    camera: &Camera,
    settings: RenderSettings,
) {
    let distance = (framed.unwrap_or(header.bounds.center()) - camera.position).length();
    let pixel = match camera.projection {
        Projection::Perspective { fovy } => 2.0 * distance * (fovy * 0.5).tan() / f64::from(settings.height),
        Projection::Orthographic { height } => height / f64::from(settings.height),
        _ => return,
    };
    if header.points > 0 && header.radius_mean < pixel * 0.5 {
        report::remark(format_args!(
            "the mean radius ({:.3e}) is under a pixel ({pixel:.3e}): expect noise; a larger picture or a larger \
             --radius-scale helps",
            header.radius_mean
        ));
    }
}

/// Rays that pass strays very far away are long.
pub(super) fn of_strays(header: &Header) {
    /// Bounds that are larger than this by the mean radius have next to nothing in them.
    const WIDE: f64 = 1e8;
    let bounds = header.bounds.size().max_element();
    if header.points > 0 && bounds > WIDE * header.radius_mean {
        report::remark(format_args!(
            "the bounds ({bounds:.1e}) are {:.0e} times as large as the points: strays far away make rendering slow; leave \
             them out of the file",
            bounds / header.radius_mean
        ));
    }
}
