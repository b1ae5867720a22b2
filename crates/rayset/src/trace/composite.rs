//! From the field at samples to the colour of a ray: transfer function, light, absorption, front to back.

use fearless_simd::dispatch;

use crate::field::{FieldSamples, LANES, Packet, SLAB_SAMPLES, SampleRow, SimdLevel, Slab};
use crate::scene::{
    ColorRule, MAX_OPACITY, MapInput, OpacityRule, RenderSettings, Scene, Shading, TransferFunction,
    headlight,
};

/// Entries of a colour map's table.
const TABLE: usize = 1024;
/// Attributes are 0 where their weights sum to less than this times the largest weight.
const LEAST_WEIGHT: f32 = 1e-12;

/// What a ray has gathered so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RayState {
    pub(super) color: [f32; 3],
    pub(super) transmittance: f32,
}

impl RayState {
    pub(super) const START: Self = Self { color: [0.0; 3], transmittance: 1.0 };
}

enum Color {
    Uniform([f32; 3]),
    Points,
    Map { table: Vec<[f32; 3]>, attribute: bool, low: f32, scale: f32 },
}

/// A transfer function and light, prepared for rows of samples.
pub(super) struct Compositor {
    transfer: TransferFunction,
    max_extinction: f32,
    color: Color,
    shading: Shading,
    background: Option<[f32; 3]>,
    least_weight: f32,
    pub(super) stop_transmittance: f32,
    simd: SimdLevel,
}

impl Compositor {
    pub(super) fn new(scene: &Scene, settings: &RenderSettings, simd: SimdLevel) -> Self {
        let weight = scene.cloud.header().weight;
        let color = match &scene.transfer.color {
            ColorRule::Uniform(color) => Color::Uniform(*color),
            ColorRule::Points => Color::Points,
            ColorRule::Map { map, input, range: (low, high) } => Color::Map {
                table: map.linear_table(TABLE),
                attribute: matches!(input, MapInput::Attribute(_)),
                low: *low as f32,
                scale: ((TABLE - 1) as f64 / (high - low)) as f32,
            },
        };
        Self {
            transfer: scene.transfer.clone(),
            max_extinction: scene.transfer.max_extinction() as f32,
            color,
            shading: scene.shading,
            background: scene.background,
            least_weight: weight.max().abs().max(weight.min().abs()) * LEAST_WEIGHT,
            stop_transmittance: settings.stop_transmittance,
            simd,
        }
    }

    /// The one colour that every sample has, if so: a ray's colour then follows from its transmittance.
    fn flat_color(&self) -> Option<[f32; 3]> {
        match self.color {
            Color::Uniform(color) if self.shading == Shading::None => Some(color),
            _ => None,
        }
    }

    /// The pixel of a ray that has ended.
    pub(super) fn pixel(&self, state: &RayState) -> [f32; 4] {
        let RayState { color, transmittance } = *state;
        let color = self.flat_color().map_or(color, |flat| flat.map(|v| v * (1.0 - transmittance)));
        match self.background {
            Some(background) => {
                let behind = |c: usize| color[c] + transmittance * background[c];
                [behind(0), behind(1), behind(2), 1.0]
            }
            None => [color[0], color[1], color[2], 1.0 - transmittance],
        }
    }

    /// Takes the rays in `lanes` through a slab. Returns the lanes that go on, and counts samples that are not
    /// transparent.
    pub(super) fn composite(
        &self,
        packet: &Packet,
        slab: Slab,
        samples: &FieldSamples,
        lanes: u64,
        states: &mut [RayState; LANES],
        nonzero: &mut u64,
    ) -> u64 {
        let mut going = lanes;
        let mut touched = lanes & samples.touched;
        while touched != 0 {
            let lane = touched.trailing_zeros() as usize;
            touched &= touched - 1;
            let passed = self.passed(&samples.density[lane], packet.step() as f32);
            if !self.through(packet, lane, slab, samples, &passed, &mut states[lane], nonzero) {
                going &= !(1 << lane);
            }
        }
        going
    }

    /// The part of the light that passes each sample's step.
    fn passed(&self, density: &SampleRow, step: f32) -> SampleRow {
        match &self.transfer.opacity {
            OpacityRule::Extinction(kappa) => {
                let (kappa, most) = (*kappa as f32, self.max_extinction);
                dispatch!(self.simd.level(), _simd => passed_extinction(density, kappa, most, step))
            }
            OpacityRule::Clamp => {
                let per_unit = self.steps_per_unit(step);
                dispatch!(self.simd.level(), _simd => passed_opacity(density, per_unit))
            }
            OpacityRule::Curve(_) => {
                let opacity = |d| if d > 0.0 { self.transfer.opacity(f64::from(d)) as f32 } else { 0.0 };
                let (opacity, per_unit) = (SampleRow(density.0.map(opacity)), self.steps_per_unit(step));
                dispatch!(self.simd.level(), _simd => passed_opacity(&opacity, per_unit))
            }
        }
    }

    /// A step in units of the distance that opacity refers to.
    fn steps_per_unit(&self, step: f32) -> f32 {
        (f64::from(step) / self.transfer.unit_distance) as f32
    }

    /// One ray through the samples of a slab, front to back; false where it ends.
    #[expect(clippy::too_many_arguments, reason = "the state of one ray, spelled out")]
    fn through(
        &self,
        packet: &Packet,
        lane: usize,
        slab: Slab,
        samples: &FieldSamples,
        passed: &SampleRow,
        state: &mut RayState,
        nonzero: &mut u64,
    ) -> bool {
        let mut opaque = 0_u32;
        for (j, &p) in passed.0[..slab.samples].iter().enumerate() {
            opaque |= u32::from(p < 1.0) << j;
        }
        let flat = self.flat_color().is_some();
        while opaque != 0 {
            let j = opaque.trailing_zeros() as usize & (SLAB_SAMPLES - 1);
            opaque &= opaque - 1;
            *nonzero += 1;
            if flat {
                state.transmittance *= passed.0[j];
                if state.transmittance < self.stop_transmittance {
                    return false;
                }
                continue;
            }
            let share = state.transmittance * (1.0 - passed.0[j]);
            let color = self.lit(packet, lane, j, samples, self.color(samples, lane, j));
            for channel in 0..3 {
                state.color[channel] += share * color[channel];
            }
            state.transmittance *= passed.0[j];
            if state.transmittance < self.stop_transmittance {
                return false;
            }
        }
        true
    }

    fn color(&self, samples: &FieldSamples, lane: usize, j: usize) -> [f32; 3] {
        let density = samples.density[lane].0[j];
        let mean = |channel: usize| {
            if density.abs() > self.least_weight {
                samples.attribute[channel][lane].0[j] / density
            } else {
                0.0
            }
        };
        match &self.color {
            Color::Uniform(color) => *color,
            Color::Points => [mean(0), mean(1), mean(2)],
            Color::Map { table, attribute, low, scale } => {
                let value = if *attribute { mean(0) } else { density };
                let x = ((value - low) * scale).clamp(0.0, (TABLE - 1) as f32);
                // A value that is not a number casts to 0.
                let i = (x as usize).min(TABLE - 2);
                let f = if x.is_nan() { 0.0 } else { x - i as f32 };
                std::array::from_fn(|c| table[i][c] + (table[i + 1][c] - table[i][c]) * f)
            }
        }
    }

    fn lit(
        &self,
        packet: &Packet,
        lane: usize,
        j: usize,
        samples: &FieldSamples,
        color: [f32; 3],
    ) -> [f32; 3] {
        if self.shading == Shading::None {
            return color;
        }
        let n = samples.gradient.each_ref().map(|g| g[lane].0[j]);
        let d = packet.direction_f32(lane);
        let length_squared = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
        let dot = n[0] * d[0] + n[1] * d[1] + n[2] * d[2];
        // No normal, or one that is not a number: ambient light only.
        let cosine = if length_squared > 0.0 && length_squared.is_finite() {
            (dot / length_squared.sqrt()).abs()
        } else {
            0.0
        };
        shade(color, cosine)
    }
}

/// Colour under a headlight, from the cosine between normal and ray.
fn shade(color: [f32; 3], cosine: f32) -> [f32; 3] {
    let c2 = cosine * cosine;
    let c4 = c2 * c2;
    let c8 = c4 * c4;
    let c16 = c8 * c8;
    let specular = headlight::SPECULAR * c16 * c16;
    color.map(|v| v * (headlight::AMBIENT + headlight::DIFFUSE * cosine) + specular)
}

#[inline(always)]
fn passed_extinction(density: &SampleRow, kappa: f32, most: f32, step: f32) -> SampleRow {
    let mut passed = SampleRow([1.0; SLAB_SAMPLES]);
    for (p, &d) in passed.0.iter_mut().zip(&density.0) {
        // A density that is negative or not a number absorbs nothing.
        let extinction = if d > 0.0 { (kappa * d).min(most) } else { 0.0 };
        *p = exp_minus(extinction * step);
    }
    passed
}

/// As [`passed_extinction`], from opacities per unit distance; what exceeds 1 counts as 1.
#[inline(always)]
fn passed_opacity(opacity: &SampleRow, step_units: f32) -> SampleRow {
    let mut passed = SampleRow([1.0; SLAB_SAMPLES]);
    for (p, &o) in passed.0.iter_mut().zip(&opacity.0) {
        let o = if o > 0.0 { o.min(MAX_OPACITY as f32) } else { 0.0 };
        *p = exp_minus(-ln(1.0 - o) * step_units);
    }
    passed
}

/// ln x for x from 2⁻¹² to 1, relative error of 1 − x below 1e-6; exactly 0 at 1. For the same reasons as `exp_minus`.
#[inline(always)]
fn ln(x: f32) -> f32 {
    let bits = x.to_bits();
    let mantissa = f32::from_bits(bits & 0x007f_ffff | 0x3f80_0000);
    let high = mantissa > std::f32::consts::SQRT_2;
    let mantissa = if high { mantissa * 0.5 } else { mantissa };
    let exponent = (bits >> 23) as i32 - 127 + i32::from(high);
    // 2 artanh((m − 1)/(m + 1)), whose series converges fast for m from √½ to √2.
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    let z = s * s;
    let series = 1.0 + z * (1.0 / 3.0 + z * (1.0 / 5.0 + z * (1.0 / 7.0 + z * (1.0 / 9.0))));
    exponent as f32 * std::f32::consts::LN_2 + 2.0 * s * series
}

/// exp(−x) for x ≥ 0, absolute error below 2e-7; exactly 1 at 0. Without branches, so that it vectorises, and the same on
/// every machine, which the system's own is not.
#[inline(always)]
fn exp_minus(x: f32) -> f32 {
    let z = (x * std::f32::consts::LOG2_E).min(126.0);
    let whole = z as i32;
    // 2^−f for f in [0, 1): Taylor about ½ in f − ½, times 2^−½.
    let y = (0.5 - (z - whole as f32)) * std::f32::consts::LN_2;
    let mut p = y * (1.0 / 5040.0) + 1.0 / 720.0;
    p = p * y + 1.0 / 120.0;
    p = p * y + 1.0 / 24.0;
    p = p * y + 1.0 / 6.0;
    p = p * y + 0.5;
    p = p * y + 1.0;
    p = p * y + 1.0;
    let result = p * std::f32::consts::FRAC_1_SQRT_2 * f32::from_bits(((127 - whole) as u32) << 23);
    if x > 0.0 { result.min(1.0) } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ln_is_exact_at_one_and_close_elsewhere() {
        assert_eq!(ln(1.0), 0.0);
        for i in 0..200_000_u32 {
            let x = 1.0 - (1.0 - 1.0 / 4096.0) * i as f32 / 200_000.0;
            let error = (f64::from(ln(x)) - f64::from(x).ln()).abs();
            assert!(
                error <= 1e-6 * (1.0 - f64::from(x)) + 2e-7 * f64::from(x).ln().abs(),
                "x = {x}: {error}"
            );
        }
    }

    #[test]
    fn exp_minus_is_exact_at_zero_and_close_elsewhere() {
        assert_eq!(exp_minus(0.0), 1.0);
        for i in 0..200_000 {
            let x = i as f32 * 4e-4;
            assert!((f64::from(exp_minus(x)) - f64::from(-x).exp()).abs() < 2e-7, "x = {x}");
        }
        assert!(exp_minus(f32::INFINITY) < 1e-37);
    }
}
