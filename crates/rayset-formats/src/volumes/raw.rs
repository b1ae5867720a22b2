//! Raw files, which contain nothing but voxels.

use std::path::Path;
use std::str::FromStr;

use super::data::VoxelSpan;
use rayset_base::geometry::{DAffine3, DVec3};
use rayset_base::numbers::Stored;
use rayset_base::parse::ParseError;
use rayset_files::grid::VolumeError;
use rayset_files::grid::{Described, VolumeSource};

/// The layout of a raw file: `256x256x128,u16`, then optionally `be` or `le`, `skip=512` (bytes),
/// `spacing=1x1x2.5`. The file may continue after the voxels.
#[derive(Clone, Debug, PartialEq)]
pub struct RawLayout {
    size: [u64; 3],
    stored: Stored,
    big_endian: bool,
    skip: u64,
    spacing: [f64; 3],
}

impl FromStr for RawLayout {
    type Err = ParseError;

    fn from_str(text: &str) -> Result<Self, ParseError> {
        parse(text).ok_or_else(|| {
            ParseError::new(text, |text| {
                format!(
                    "`{text}` is not a layout; write it as 256x256x128,u16 or 256x256x128,f32,be,skip=512,spacing=1x1x2.5"
                )
            })
        })
    }
}

fn parse(text: &str) -> Option<RawLayout> {
    let mut words = text.split(',').map(str::trim);
    let size: Vec<u64> = words.next()?.split('x').map(|n| n.parse().ok()).collect::<Option<_>>()?;
    let stored = match words.next()? {
        "i8" => Stored::I8,
        "u8" => Stored::U8,
        "i16" => Stored::I16,
        "u16" => Stored::U16,
        "i32" => Stored::I32,
        "u32" => Stored::U32,
        "f32" => Stored::F32,
        "f64" => Stored::F64,
        _ => return None,
    };
    let mut layout =
        RawLayout { size: size.try_into().ok()?, stored, big_endian: false, skip: 0, spacing: [1.0; 3] };
    for word in words {
        match word.split_once('=') {
            None if word == "be" => layout.big_endian = true,
            None if word == "le" => layout.big_endian = false,
            Some(("skip", bytes)) => layout.skip = bytes.parse().ok()?,
            Some(("spacing", lengths)) => {
                let all: Vec<f64> = lengths.split('x').map(|n| n.parse().ok()).collect::<Option<_>>()?;
                layout.spacing = all.try_into().ok()?;
            }
            _ => return None,
        }
    }
    Some(layout)
}

impl RawLayout {
    /// Opens a raw file of this layout, which contains nothing but voxels.
    ///
    /// # Errors
    /// [`VolumeError`] if it cannot be opened, the layout is invalid, or the file is shorter than
    /// it requires.
    pub fn open(&self, path: impl AsRef<Path>) -> Result<VolumeSource, VolumeError> {
        let path = path.as_ref();
        let described = Described {
            size: self.size,
            stored: self.stored,
            big_endian: self.big_endian,
            scale: 1.0,
            offset: 0.0,
            space_from_voxel: DAffine3::from_scale(DVec3::from_array(self.spacing)),
            size_place: "its layout".into(),
            axes_place: "its layout, spacing".into(),
        };
        let bytes = described.check(path)?;
        let voxels = VoxelSpan { path, start: self.skip, bytes, rest: None }.plain()?;
        Ok(VolumeSource::new(&described, bytes, voxels))
    }
}
