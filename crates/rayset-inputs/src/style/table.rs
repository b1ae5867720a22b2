//! The table of a style's options. Each option is defined here and nowhere else.

use rayset::scene::{Kernel, Lod, NamedPalette, OpacityRule, Samples, SplatFilter};

use super::kinds::{
    Behind, Color, Detail, Kind, LENGTH, Named, Number, Opacity, Range, Rays, Step, Switch, Text, Vector,
    Word,
};
use super::option::{OptionOf, Options, options};
use super::values::{
    Background, Compositing, Flag, LookName, Phase, Rgb, Shading, Side, StepLength, ValueRange,
};
use crate::values;

/// An option of a [`Style`].
pub type StyleOption = OptionOf<Style>;

/// All options of a style.
pub const OPTIONS: &[StyleOption] = Style::TABLE;

options! {
    /// Options for the look of a cloud or grid and for its camera. Unset options are chosen from
    /// the data.
    Style
    Picture {
        /// Rays along each side of a pixel, 1 to 64, or `auto`: one, and two where the picture
        /// is not smooth. 2 by default, 1 of scenes and where all is smooth, auto of gas
        samples: Samples = Rays;
        /// Exposure in stops, -32 to 32: light is multiplied by two to this power
        exposure: f64 = Number(-32.0, 32.0);
        /// Level of detail, of clouds with aggregates: off (every point is seen), auto, or how
        /// many times as wide pixels are taken to be, 0.0625 to 64. auto of gas, off otherwise
        lod: Lod = Detail;
    }
    Look {
        /// Look; chosen from the data by default, and said
        look: LookName = Word;
        /// Kernel: wyvill (by default), chen, gaussian, cubic-spline, wendland-c2, epanechnikov,
        /// triweight, splat
        kernel: Kernel = Named;
        /// Filter of splats, so that none is seen smaller than a pixel: none, 3dgs, mip; the one
        /// that their file was trained with, 3dgs if it does not say
        splat_filter: SplatFilter = Named;
        /// Kernels integrate to one (smoothed-particle hydrodynamics); left out where weights are
        /// densities already, as those of snapshots are
        normalised: Flag = Switch;
        /// Radii of the points, as a factor of those in the file, 0.001 to 1000
        radius_scale: f64 = Number(1e-3, 1e3);
        /// Opacity from density, or from a grid's values: clamp, extinction:K, or a curve like
        /// 0:0,1:0.5,4:1
        opacity: OpacityRule = Opacity;
        /// Length that opacity refers to, in units of the input
        unit_distance: f64 = LENGTH;
        /// One colour for all, as #c8b090
        color: Rgb = Color, excludes ["colormap", "color-by"];
        /// Colour map: viridis, inferno, magma, plasma, turbo, grey, coolwarm, cividis, thermal,
        /// haline, deep, dense, ice, balance, RdBu, terrain; with _r reversed
        colormap: NamedPalette = Named;
        /// What the colour map shows: density, a stored attribute, or a coordinate: x, y, z, height
        color_by: String = Text;
        /// Values at the ends of the colour map: numbers, as 0:10, or percentiles of what it shows,
        /// as 1%:99%
        value_range: ValueRange = Range;
        /// The colour map is over the logarithm; from 1 % to 99 % of the positive values, if
        /// --value-range says nothing
        log: Flag = Switch;
        /// Light: from the eye, or none
        shading: Shading = Word;
        /// Values in which light is added up along rays; display of splats, linear by default
        compositing: Compositing = Word;
        /// How much darker creases and what lies close behind edges become, 0 to 4
        ambient_occlusion: f64 = Number(0.0, 4.0);
        /// Background colour, or `none`: transparent
        background: Background = Behind;
        /// Distance between samples, in units of the input, or `auto` (by default)
        step: StepLength = Step;
        /// Automatic distance between samples as a fraction of the radius, 0.001 to 4; 0.25 by
        /// default
        step_fraction: f64 = Number(1e-3, 4.0);
        /// Samples of a ray begin half a step from the eye (by default), or a different fraction
        /// for each pixel
        phase: Phase = Word;
        /// Rays end where less than this is seen through, 0 to 0.999; 0.01 by default
        stop: f64 = Number(0.0, 0.999);
    }
    Camera {
        /// Side to look from; iso, a three-quarter view, by default
        view: Side = Word, excludes ["position", "direction"];
        /// Eye
        position: [f64; 3] = Vector(values::vector);
        /// What the eye looks at; the middle of the input by default
        look_at: [f64; 3] = Vector(values::vector), excludes ["direction"], needs ["position"];
        /// Viewing direction: with an eye instead of --look-at, without one to frame the input from
        /// another side
        direction: [f64; 3] = Vector(values::direction);
        /// Up: x, y, z, -x, -y, -z or a vector; chosen from the data by default
        up: [f64; 3] = Vector(values::axis);
        /// Vertical field of view in degrees, 0.001 to 179; 35 by default
        fovy: f64 = Number(1e-3, 179.0);
        /// Parallel rays
        orthographic: Flag = Switch;
        /// Height of an orthographic picture, in units of the input
        height: f64 = LENGTH, needs ["orthographic"];
    }
}
