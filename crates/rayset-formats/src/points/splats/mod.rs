//! Gaussian splats as round points: INRIA's PLY, PlayCanvas's compressed PLY, SPZ, `.splat` and
//! `.ksplat`.

mod compressed_ply;
mod gaussian;
mod ksplat;
mod ksplat_header;
mod ply;
mod splat;
mod spz;
mod spz_header;
mod spz_plane;

pub(super) use self::compressed_ply::CompressedPlySource;
pub(super) use self::ksplat::KsplatSource;
pub(super) use self::ply::GaussianPlySource;
pub(super) use self::splat::SplatSource;
pub(super) use self::spz::SpzSource;
