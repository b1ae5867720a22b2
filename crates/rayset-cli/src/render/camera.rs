//! Where a picture is taken from.

use anyhow::Result;
use clap::Args;
use rayset::file::Header;
use rayset::geometry::DVec3;
use rayset::scene::{Camera, Projection, RenderSettings};

use crate::{report, values};

#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Camera (by default it frames the whole cloud)")]
pub(crate) struct CameraArgs {
    /// Eye
    #[arg(long, value_parser = values::vector, allow_hyphen_values = true)]
    pub(crate) position: Option<[f64; 3]>,
    /// What the eye looks at; the centre of the cloud by default
    #[arg(long, value_parser = values::vector, allow_hyphen_values = true, requires = "position")]
    pub(crate) look_at: Option<[f64; 3]>,
    /// Viewing direction: with an eye instead of --look-at, without one to frame the cloud from another side
    #[arg(long, value_parser = values::direction, allow_hyphen_values = true, conflicts_with = "look_at")]
    pub(crate) direction: Option<[f64; 3]>,
    /// Up
    #[arg(long, value_parser = values::direction, allow_hyphen_values = true)]
    pub(crate) up: Option<[f64; 3]>,
    /// Vertical field of view in degrees, 0.001 to 179; 45 by default
    #[arg(long, value_parser = degrees)]
    pub(crate) fovy: Option<f64>,
    /// Parallel rays
    #[arg(long)]
    pub(crate) orthographic: bool,
    /// Height of an orthographic picture, in units of the cloud
    #[arg(long, value_parser = values::length, requires = "orthographic")]
    pub(crate) height: Option<f64>,
}

fn degrees(text: &str) -> Result<f64, String> {
    values::number_within(text, 1e-3, 179.0)
}

impl CameraArgs {
    /// Whether any of these was given.
    pub(super) fn is_given(&self) -> bool {
        self.position.is_some()
            || self.direction.is_some()
            || self.up.is_some()
            || self.fovy.is_some()
            || self.orthographic
    }

    pub(super) fn camera(&self, header: &Header, settings: RenderSettings) -> Result<Camera> {
        let aspect = f64::from(settings.width) / f64::from(settings.height);
        let bounds = header.bounds.inflated(0.5 * header.radius_mean);
        let (view, vertical) = customary_view(header);
        let vector = |v: [f64; 3]| DVec3::from_array(v);
        let direction = self.direction.map_or(view, vector);
        let up = self.up.map_or(vertical, vector);
        // A direction along up leaves the roll undefined: any roll will do if no up vector is given.
        let up = if self.up.is_some()
            || direction.cross(up).length_squared() > 1e-12 * direction.length_squared()
        {
            up
        } else {
            direction.any_orthonormal_vector()
        };
        let fovy = self.fovy.unwrap_or(45.0).to_radians();
        let mut camera = Camera::framing(&bounds, direction, up, fovy, aspect, self.orthographic);
        if let Some(position) = self.position {
            camera.position = vector(position);
            camera.direction = match (self.look_at, self.direction) {
                (Some(target), _) => vector(target) - camera.position,
                (None, Some(direction)) => vector(direction),
                (None, None) => bounds.center() - camera.position,
            };
            camera.up = up;
        }
        if let Some(height) = self.height {
            camera.projection = Projection::Orthographic { height };
        }
        camera.check()?;
        if self.up.is_some() && self.position.is_none() {
            // Framing chooses an up vector of its own if the given one is parallel to the view.
            Camera { up, ..camera }.check()?;
        }
        Ok(camera)
    }
}

/// The default viewing direction and up vector for a cloud: terrain is seen obliquely from the south, everything else
/// from the front, slightly from above.
fn customary_view(header: &Header) -> (DVec3, DVec3) {
    let size = header.bounds.size();
    if size.z < 0.5 * size.x.min(size.y) {
        (DVec3::new(0.3, 1.0, -0.9), DVec3::Z)
    } else {
        (DVec3::new(-0.15, -0.15, -1.0), DVec3::Y)
    }
}

/// Points smaller than a pixel are missed by most rays.
pub(super) fn warn_of_small_radii(header: &Header, camera: &Camera, settings: RenderSettings) {
    let distance = (header.bounds.center() - camera.position).length();
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
