//! The options of a picture that hold for every input.

use anyhow::{Result, bail, ensure};
use clap::Args;
use rayset::Region;
use rayset::image::DisplayTransform;
use rayset::scene::RenderSettings;

use rayset_inputs::style::Style;
use rayset_inputs::values;

#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Picture")]
pub(crate) struct PictureArgs {
    /// Width and height in pixels; 512x512 by default
    #[arg(long, value_parser = values::dimensions)]
    pub(crate) size: Option<(u32, u32)>,
    /// Only a part of the picture: left,top,width,height
    #[arg(long, value_delimiter = ',')]
    crop: Option<Vec<u32>>,
}

impl PictureArgs {
    /// Width and height of a picture whose scene says nothing of them.
    pub(super) fn size(&self) -> (u32, u32) {
        let plain = RenderSettings::default();
        self.size.unwrap_or((plain.width, plain.height))
    }

    /// Overrides the settings of a scene with those given on the command line.
    pub(super) fn apply(
        &self,
        style: &Style,
        settings: &mut RenderSettings,
        display_transform: &mut DisplayTransform,
    ) {
        if let Some((width, height)) = self.size {
            (settings.width, settings.height) = (width, height);
        }
        settings.lod = style.lod.unwrap_or(settings.lod);
        settings.samples = style.samples.unwrap_or(settings.samples);
        display_transform.exposure = style.exposure.unwrap_or(display_transform.exposure);
        settings.samples = settings.samples.shown_with(display_transform.exposure);
    }

    /// The part of a picture of a size that is asked for.
    pub(super) fn region(&self, whole: (u32, u32)) -> Result<Region> {
        let Some(crop) = &self.crop else {
            return Ok(Region { columns: 0..whole.0, rows: 0..whole.1 });
        };
        let &[x, y, width, height] = crop.as_slice() else {
            bail!("--crop takes four numbers: left,top,width,height")
        };
        let (right, bottom) = (x.saturating_add(width), y.saturating_add(height));
        ensure!(
            width > 0 && height > 0 && right <= whole.0 && bottom <= whole.1,
            "--crop {x},{y},{width},{height} does not lie within the picture"
        );
        Ok(Region { columns: x..right, rows: y..bottom })
    }
}
