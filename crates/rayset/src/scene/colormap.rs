//! Named colour maps.
//!
//! Tables: viridis, inferno, magma and plasma by Smith, van der Walt and Firing (released into the public domain under
//! CC0), turbo by Mikhailov (Google, 2019), coolwarm after Moreland, *Diverging Color Maps for Scientific
//! Visualization* (2009). Each is sampled at 33 places and interpolated linearly in between (to within 5/255).

use std::fmt;
use std::str::FromStr;

use crate::parse::ParseError;

/// A named colour map: a colour for every number from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Colormap {
    knots: &'static [u32],
    name: &'static str,
    reversed: bool,
}

const KNOTS: usize = 33;

const GREY: [u32; 2] = [0x00_0000, 0xff_ffff];

const NAMED: [(&str, &[u32]); 7] = [
    ("viridis", &VIRIDIS),
    ("inferno", &INFERNO),
    ("magma", &MAGMA),
    ("plasma", &PLASMA),
    ("turbo", &TURBO),
    ("grey", &GREY),
    ("coolwarm", &COOLWARM),
];

impl Colormap {
    /// The colour at `x` (clamped to 0–1), display-encoded (sRGB), 0 to 1.
    #[must_use]
    pub fn display_color(&self, x: f64) -> [f64; 3] {
        // NaN has no place on the scale; it gets the colour of the lower end.
        let x = if x.is_nan() { 0.0 } else { x.clamp(0.0, 1.0) };
        let x = if self.reversed { 1.0 - x } else { x } * (self.knots.len() - 1) as f64;
        let i = (x as usize).min(self.knots.len() - 2);
        let channel = |knot: u32, shift: u32| f64::from(knot >> shift & 255) / 255.0;
        [16, 8, 0].map(|shift| {
            let (a, b) = (channel(self.knots[i], shift), channel(self.knots[i + 1], shift));
            a + (b - a) * (x - i as f64)
        })
    }
}

impl Colormap {
    /// The colours with their places from 0 to 1; colours in between are interpolated linearly.
    pub(super) fn stops(&self) -> Vec<(f64, [f64; 3])> {
        let last = (self.knots.len() - 1) as f64;
        (0..self.knots.len()).map(|i| i as f64 / last).map(|at| (at, self.display_color(at))).collect()
    }
}

impl fmt::Display for Colormap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.name, if self.reversed { "_r" } else { "" })
    }
}

impl FromStr for Colormap {
    type Err = ParseError;

    fn from_str(s: &str) -> Result<Self, Self::Err> {
        let (base, reversed) = s.strip_suffix("_r").map_or((s, false), |base| (base, true));
        let found = NAMED.iter().find(|(name, _)| *name == base);
        found
            .map(|&(name, knots)| Self { knots, name, reversed })
            .ok_or_else(|| {
                ParseError::new(s, |s| {
                    format!(
                        "unknown colour map `{s}`; expected viridis, inferno, magma, plasma, turbo, grey or coolwarm, \
                         or one of these with `_r`"
                    )
                })
            })
    }
}

const VIRIDIS: [u32; KNOTS] = [
    0x44_0154, 0x47_0d60, 0x48_186a, 0x48_2374, 0x47_2d7b, 0x45_3781, 0x42_4086, 0x3e_4989, 0x3b_528b,
    0x37_5b8d, 0x33_638d, 0x2f_6b8e, 0x2c_728e, 0x29_7a8e, 0x26_828e, 0x23_898e, 0x21_918c, 0x1f_988b,
    0x1f_a088, 0x22_a785, 0x28_ae80, 0x32_b67a, 0x3f_bc73, 0x4e_c36b, 0x5e_c962, 0x70_cf57, 0x84_d44b,
    0x98_d83e, 0xad_dc30, 0xc2_df23, 0xd8_e219, 0xec_e51b, 0xfd_e725,
];
const INFERNO: [u32; KNOTS] = [
    0x00_0004, 0x04_0312, 0x0b_0724, 0x15_0b37, 0x21_0c4a, 0x2f_0a5b, 0x3d_0965, 0x4a_0c6b, 0x57_106e,
    0x64_156e, 0x71_196e, 0x7d_1e6d, 0x8a_226a, 0x97_2766, 0xa3_2c61, 0xb0_315b, 0xbc_3754, 0xc7_3e4c,
    0xd2_4644, 0xdb_503b, 0xe4_5a31, 0xeb_6628, 0xf1_731d, 0xf6_8013, 0xf9_8e09, 0xfb_9d07, 0xfc_ac11,
    0xfb_bc21, 0xf9_cb35, 0xf5_db4c, 0xf2_ea69, 0xf3_f68a, 0xfc_ffa4,
];
const MAGMA: [u32; KNOTS] = [
    0x00_0004, 0x03_0312, 0x0a_0822, 0x13_0d34, 0x1d_1147, 0x29_115a, 0x36_106b, 0x44_0f76, 0x51_127c,
    0x5d_177f, 0x6a_1c81, 0x76_2181, 0x83_2681, 0x90_2a81, 0x9c_2e7f, 0xaa_337d, 0xb7_3779, 0xc4_3c75,
    0xd0_416f, 0xdc_4869, 0xe7_5263, 0xef_5d5e, 0xf5_6b5c, 0xf9_795d, 0xfc_8961, 0xfd_9869, 0xfe_a772,
    0xfe_b67c, 0xfe_c488, 0xfe_d395, 0xfd_e2a3, 0xfc_f0b2, 0xfc_fdbf,
];
const PLASMA: [u32; KNOTS] = [
    0x0d_0887, 0x22_0690, 0x31_0597, 0x3f_049c, 0x4c_02a1, 0x59_01a5, 0x66_00a7, 0x72_01a8, 0x7e_03a8,
    0x8a_09a5, 0x95_11a1, 0xa0_1a9c, 0xaa_2395, 0xb3_2c8e, 0xbc_3587, 0xc4_3e7f, 0xcc_4778, 0xd3_5171,
    0xda_5a6a, 0xe0_6363, 0xe6_6c5c, 0xeb_7655, 0xf0_804e, 0xf5_8b47, 0xf8_9540, 0xfb_a139, 0xfd_ac33,
    0xfe_b82c, 0xfd_c527, 0xfc_d225, 0xf8_df25, 0xf4_ed27, 0xf0_f921,
];
const TURBO: [u32; KNOTS] = [
    0x30_123b, 0x39_2a73, 0x40_40a2, 0x44_56c7, 0x46_6be3, 0x46_80f6, 0x42_94ff, 0x37_a8fa, 0x28_bceb,
    0x1c_cdd8, 0x18_ddc2, 0x1f_e9af, 0x32_f298, 0x4e_f97d, 0x6d_fe62, 0x8b_ff4b, 0xa4_fc3c, 0xb9_f635,
    0xcd_ec34, 0xdf_df37, 0xee_cf3a, 0xf8_be39, 0xfd_ac34, 0xfe_962b, 0xfb_7e21, 0xf4_6617, 0xeb_500e,
    0xdf_3f08, 0xd0_2f05, 0xbe_2102, 0xa9_1601, 0x92_0b01, 0x7a_0403,
];
const COOLWARM: [u32; KNOTS] = [
    0x3b_4cc0, 0x44_5acc, 0x4e_68d8, 0x58_75e1, 0x62_82ea, 0x6c_8ff1, 0x77_9af7, 0x82_a6fb, 0x8d_b0fe,
    0x98_b9ff, 0xa3_c2fe, 0xae_c9fc, 0xb9_d0f9, 0xc3_d5f4, 0xcc_d9ed, 0xd5_dbe5, 0xdd_dcdc, 0xe5_d8d1,
    0xec_d3c5, 0xf1_ccb8, 0xf5_c4ac, 0xf7_ba9f, 0xf7_b093, 0xf6_a586, 0xf4_987a, 0xf0_8b6e, 0xeb_7d62,
    0xe4_6e56, 0xdd_5f4b, 0xd4_4e41, 0xca_3b37, 0xbe_242e, 0xb4_0426,
];
