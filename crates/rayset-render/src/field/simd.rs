//! The vector instruction set in use, chosen at run time.
//!
//! Inner loops are compiled for what every processor has and for what makes them faster by much: on
//! x86-64 SSE2, AVX2 and AVX-512. On processors older than AVX2, SSE4.2 would take at most 3 % off
//! pictures of points, and 20 to 45 % off those of grids; but for every set, all loops are compiled
//! once more.

use std::fmt;
use std::str::FromStr;

use fearless_simd::Level;

use rayset_base::parse::ParseError;

/// A vector instruction set. The same source is compiled for each; results may differ in the last
/// bits between those with fused multiply–add (AVX2, AVX-512, NEON) and those without.
#[derive(Clone, Copy, Debug)]
pub struct SimdLevel(Level);

impl Default for SimdLevel {
    /// The best instruction set of this processor.
    fn default() -> Self {
        Self::of(Level::new())
    }
}

impl SimdLevel {
    /// The best set that loops are compiled for of those that a level includes.
    fn of(level: Level) -> Self {
        match level {
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Level::Sse4_2(_) => Self::baseline(),
            level => Self(level),
        }
    }

    /// The instruction set that every processor of the architecture has: SSE2 on x86-64, NEON on
    /// 64-bit ARM, otherwise scalar code.
    #[must_use]
    pub fn baseline() -> Self {
        Self(Level::baseline())
    }

    /// All instruction sets of this processor, the best first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        let best = Self::default();
        let mut levels = vec![best];
        #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
        levels.extend(best.0.as_avx2().map(|avx2| Self(Level::Avx2(avx2))));
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
            Level::Sse4_2(_) | Level::Sse2(_) => "sse2",
            #[cfg(target_arch = "aarch64")]
            Level::Neon(_) => "neon",
            _ => "scalar",
        }
    }

    /// Whether it multiplies and adds with one rounding: all sets that do give the same bits, and
    /// so do all that do not.
    #[doc(hidden)]
    #[must_use]
    pub fn is_fused(self) -> bool {
        matches!(self.name(), "avx512" | "avx2" | "neon")
    }

    /// The class as `fearless_simd` has it.
    #[doc(hidden)]
    #[must_use]
    pub fn level(self) -> Level {
        self.0
    }
}

/// Calls a function that is generic over `Simd`, compiled for an instruction set:
/// `dispatch!(level, simd => call)`. What is called has to be inlined (`#[inline(always)]`) to be
/// compiled for it. As the macro of `fearless_simd`, which also compiles for SSE4.2.
#[cfg(all(any(target_arch = "x86", target_arch = "x86_64"), target_feature = "sse2"))]
macro_rules! dispatch {
    (@with $token:expr, $simd:pat => $call:expr) => {{
        let token = $token;
        let $simd = token;
        ::fearless_simd::Simd::vectorize(
            token,
            #[inline(always)]
            || $call,
        )
    }};
    ($level:expr, $simd:pat => $call:expr) => {
        match $level {
            ::fearless_simd::Level::Avx512(token) => $crate::field::dispatch!(@with token, $simd => $call),
            ::fearless_simd::Level::Avx2(token) => $crate::field::dispatch!(@with token, $simd => $call),
            level => match level.as_sse2() {
                Some(token) => $crate::field::dispatch!(@with token, $simd => $call),
                None => unreachable!("what is compiled for SSE2 runs where it is"),
            },
        }
    };
}
#[cfg(all(any(target_arch = "x86", target_arch = "x86_64"), target_feature = "sse2"))]
pub(crate) use dispatch;
#[cfg(not(all(any(target_arch = "x86", target_arch = "x86_64"), target_feature = "sse2")))]
pub(crate) use fearless_simd::dispatch;

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
