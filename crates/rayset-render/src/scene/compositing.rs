//! In which values light is added up along rays.

/// In which values the light of samples is added up along a ray, and the colours of points are
/// averaged where they overlap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Compositing {
    /// Linear light, as light adds up.
    #[default]
    Linear,
    /// The values that displays are given (sRGB, IEC 61966-2-1, which goes on above 1), as Gaussian
    /// splats are trained to be blended. Lights, colour maps and colours of solids stay linear;
    /// what a sample scatters is converted, and the pixel back. For scenes whose rays are neither
    /// reflected nor refracted, and without ambient occlusion: these add light after the fact.
    Display,
}
