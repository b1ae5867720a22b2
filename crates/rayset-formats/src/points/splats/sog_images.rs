//! The images of a SOG file: WebP without loss, beside its JSON or with it in a ZIP archive.

use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

use image_webp::WebPDecoder;
use serde_json::Value;

use super::bounded_json;
use super::sog_meta::{Meta, MetaHarmonics};
use crate::array_file::{Fault, Member, members};
use crate::points::{Place, ReadError, quiet};
use rayset_store::storage::input_file::InputFile;

/// Most bytes of the JSON: of levels of detail it grows with the files.
const MOST_JSON: u64 = 4 << 20;
/// The name of the JSON in an archive.
const META: &str = "meta.json";

/// Where the parts of a SOG file are.
#[derive(Debug)]
pub(super) enum Parts {
    /// Beside the JSON, which is this file.
    Beside(PathBuf),
    /// In an archive.
    Archive(PathBuf, Vec<Member>),
}

/// An image.
#[derive(Debug)]
pub(super) struct Image {
    pub(super) width: usize,
    pub(super) height: usize,
    channels: usize,
    bytes: Vec<u8>,
}

impl Image {
    /// The bytes of a pixel: red, green, blue, and opacity, which is 255 where there is none.
    pub(super) fn pixel(&self, index: usize) -> [u8; 4] {
        let mut pixel = [255; 4];
        let at = index * self.channels;
        pixel[..self.channels].copy_from_slice(&self.bytes[at..at + self.channels]);
        pixel
    }
}

/// The images of the splats of a file.
#[derive(Debug)]
pub(super) struct Images {
    pub(super) means: [Image; 2],
    pub(super) quats: Image,
    pub(super) scales: Image,
    pub(super) colors: Image,
    /// The palette of the coefficients, and each splat's number in it.
    pub(super) harmonics: Option<[Image; 2]>,
}

/// What images of so many splats have at most: they are filled up to whole rows.
pub(super) fn most_pixels(count: u64) -> u64 {
    count + count / 8 + (1 << 14)
}

impl Parts {
    /// Opens an archive, or finds parts beside a file.
    pub(super) fn open(path: &Path) -> Result<Self, ReadError> {
        let mut head = [0; 2];
        let mut file = InputFile::open(path).map_err(ReadError::io(path))?;
        let is_archive = file.read_exact(&mut head).is_ok() && head == *b"PK";
        if !is_archive {
            return Ok(Self::Beside(path.to_owned()));
        }
        let members = members(path).map_err(|fault| match fault {
            Fault::Io(source) => ReadError::io(path)(source),
            Fault::Wrong { at, what } => ReadError::malformed(path, Place::Byte(at), what),
        })?;
        Ok(Self::Archive(path.to_owned(), members))
    }

    /// The file that it is, or its JSON.
    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Beside(path) | Self::Archive(path, _) => path,
        }
    }

    /// The files that it is of.
    pub(super) fn files(&self, meta: &Meta) -> Vec<PathBuf> {
        let Self::Beside(path) = self else { return vec![self.path().to_owned()] };
        let others = meta.images().into_iter().map(|name| path.with_file_name(name));
        std::iter::once(path.clone()).chain(others).collect()
    }

    /// The JSON.
    pub(super) fn json(&self) -> Result<Value, ReadError> {
        let name = match self {
            Self::Beside(path) => path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            Self::Archive(..) => META.to_owned(),
        };
        let (text, at) = self.read(&name, MOST_JSON)?;
        bounded_json::parse(&text).map_err(|error| {
            ReadError::malformed(self.path(), Place::Byte(at), format!("not the JSON of SOG: {error}"))
        })
    }

    /// A part, and where it begins in the file.
    fn read(&self, name: &str, most: u64) -> Result<(Vec<u8>, u64), ReadError> {
        let (path, bytes, at, stream): (_, _, _, Box<dyn Read>) = match self {
            Self::Beside(path) => {
                let path = path.with_file_name(name);
                let file = InputFile::open(&path).map_err(ReadError::io(&path))?;
                let bytes = file.length().map_err(ReadError::io(&path))?;
                (path, bytes, 0, Box::new(file))
            }
            Self::Archive(path, members) => {
                let member = members.iter().find(|member| member.name == name).ok_or_else(|| {
                    let what =
                        format!("`{name}` is not in this archive, or packed in a way that is not read");
                    ReadError::malformed(path, Place::Byte(0), what)
                })?;
                let stream = member.open(path, 0).map_err(ReadError::io(path))?;
                (path.clone(), member.bytes, member.start, stream)
            }
        };
        if bytes > most {
            let what = format!("`{name}` has {bytes} bytes; expected at most {most}");
            return Err(ReadError::malformed(&path, Place::Byte(at), what));
        }
        let mut content = Vec::new();
        stream.take(bytes).read_to_end(&mut content).map_err(ReadError::io(&path))?;
        if content.len() as u64 != bytes {
            return Err(ReadError::malformed(&path, Place::Byte(at), format!("`{name}` is cut off")));
        }
        Ok((content, at))
    }

    /// Reads an image with at least `least` and at most `most` pixels.
    fn image(&self, name: &str, (least, most): (u64, u64)) -> Result<Image, ReadError> {
        // Bytes that are packed without loss are hardly more than those that they stand for.
        let (bytes, at) = self.read(name, 5 * most + (1 << 16))?;
        let path = match self {
            Self::Beside(path) => path.with_file_name(name),
            Self::Archive(path, _) => path.clone(),
        };
        let fail = |what: String| ReadError::malformed(&path, Place::Byte(at), format!("`{name}`: {what}"));
        // Decoders of others may panic on bytes that are made to be wrong.
        let damaged = || fail("damaged WebP".into());
        let decoder = quiet::catch(|| WebPDecoder::new(Cursor::new(bytes))).ok_or_else(damaged)?;
        let mut decoder = decoder.map_err(|error| fail(format!("not WebP: {error}")))?;
        let (width, height) = decoder.dimensions();
        let pixels = u64::from(width) * u64::from(height);
        if decoder.is_animated() {
            return Err(fail("an animation".into()));
        }
        if !(least..=most).contains(&pixels) {
            return Err(fail(format!("{width}×{height} pixels; expected {least} to {most}")));
        }
        if decoder.is_lossy() {
            return Err(fail("packed with loss, which leaves nothing of what the bytes mean".into()));
        }
        let channels = if decoder.has_alpha() { 4 } else { 3 };
        let mut content = vec![0; pixels as usize * channels];
        let read = quiet::catch(|| decoder.read_image(&mut content)).ok_or_else(damaged)?;
        read.map_err(|error| fail(format!("damaged WebP: {error}")))?;
        Ok(Image { width: width as usize, height: height as usize, channels, bytes: content })
    }

    /// Reads all images of the splats.
    pub(super) fn images(&self, meta: &Meta) -> Result<Images, ReadError> {
        let pixels = (meta.count, most_pixels(meta.count));
        let image = |name: &str| self.image(name, pixels);
        let harmonics = |of: &MetaHarmonics| {
            let (width, rows) = of.palette_size();
            let palette = self.image(&of.palette, (width, width * rows))?;
            if palette.width as u64 != width {
                let what = format!("`{}`: {} pixels wide; expected {width}", of.palette, palette.width);
                return Err(ReadError::malformed(self.path(), Place::Byte(0), what));
            }
            Ok([palette, image(&of.labels)?])
        };
        Ok(Images {
            means: [image(&meta.means[0])?, image(&meta.means[1])?],
            quats: image(&meta.quats)?,
            scales: image(&meta.scales.1)?,
            colors: image(&meta.colors.1)?,
            harmonics: meta.harmonics.as_ref().map(harmonics).transpose()?,
        })
    }
}
