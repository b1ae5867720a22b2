//! Gaussian splats: INRIA's PLY, PlayCanvas's compressed PLY, SPZ, glTF, SOG, `.splat` and
//! `.ksplat`.

mod bounded_json;
mod compressed_ply;
mod gaussian;
mod gltf;
mod gltf_document;
mod harmonics;
mod ksplat;
mod ksplat_header;
mod ply;
mod sog;
mod sog_images;
mod sog_meta;
mod splat;
mod spz;
mod spz_header;
mod spz_plane;
mod turned;

pub(super) use self::compressed_ply::CompressedPlyReader;
pub(super) use self::gltf::GltfReader;
pub(super) use self::ksplat::KsplatReader;
pub(super) use self::ply::GaussianPlyReader;
pub(super) use self::sog::SogReader;
pub(super) use self::splat::SplatReader;
pub(super) use self::spz::SpzReader;
