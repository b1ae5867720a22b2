//! The vector instruction set in use, chosen at run time.

use std::fmt;
use std::str::FromStr;

use fearless_simd::Level;

use crate::parse::ParseError;

/// A vector instruction set. The same source is compiled for each; results may differ in the last bits between those
/// with fused multiply–add (AVX2, AVX-512, NEON) and those without.
#[derive(Clone, Copy, Debug)]
pub struct SimdLevel(Level);

impl Default for SimdLevel {
    /// The best instruction set of this processor.
    fn default() -> Self {
        Self(Level::new())
    }
}

impl SimdLevel {
    /// The instruction set that every processor of the architecture has: SSE2 on x86-64, NEON on 64-bit ARM, otherwise
    /// scalar code.
    #[must_use]
    pub fn baseline() -> Self {
        Self(Level::baseline())
    }

    /// All instruction sets of this processor, the best first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        let best = Level::new();
        let mut levels = vec![Self(best)];
        #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
        {
            let lower = [best.as_avx2().map(Level::Avx2), best.as_sse4_2().map(Level::Sse4_2)];
            levels.extend(lower.into_iter().flatten().map(Self));
        }
        levels.push(Self::baseline());
        levels.dedup_by_key(|l| l.name());
        levels
    }

    /// The name used on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self.0 {
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Level::Avx512(_) => "avx512",
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Level::Avx2(_) => "avx2",
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Level::Sse4_2(_) => "sse4.2",
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Level::Sse2(_) => "sse2",
            #[cfg(target_arch = "aarch64")]
            Level::Neon(_) => "neon",
            _ => "scalar",
        }
    }

    /// Whether it multiplies and adds with one rounding: all sets that do give the same bits, and so do all that do not.
    #[doc(hidden)]
    #[must_use]
    pub fn is_fused(self) -> bool {
        matches!(self.name(), "avx512" | "avx2" | "neon")
    }

    pub(crate) fn level(self) -> Level {
        self.0
    }
}

impl fmt::Display for SimdLevel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for SimdLevel {
    type Err = ParseError;

    fn from_str(s: &str) -> Result<Self, Self::Err> {
        if s == "auto" {
            return Ok(Self::default());
        }
        let levels = Self::available();
        let names: Vec<&str> = levels.iter().map(|l| l.name()).collect();
        let available = names.join(", ");
        levels.into_iter().find(|l| l.name() == s).ok_or_else(|| {
            ParseError::new(s, |s| {
                format!("`{s}` is no instruction set of this processor; expected auto, {available}")
            })
        })
    }
}
