//! Gaussian splats as SOG (PlayCanvas): the bytes of images without loss stand for coordinates,
//! rotations, deviations and colours. A bundle (`.sog`), the JSON of one that is not (`meta.json`),
//! or that of levels of detail (`lod-meta.json`), of which the finest is read.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::gaussian::{self, Gaussian, color_of};
use super::harmonics::{self, Harmonics};
use super::ply::UP;
use super::sog_images::{Images, Parts, most_pixels};
use super::sog_meta::{self, ACROSS, Chosen, Meta, MetaHarmonics};
use crate::points::file_source::{FileSource, RecordReader, Request};
use crate::points::{ColorDepth, Place, PointBatch, ReadError};
use rayset_files::points::harmonics::{CHANNELS, coefficients};

/// Bytes of the images of a splat, and what one of them takes while it is unpacked.
const BYTES_A_PIXEL: u64 = 6 * 4 + 12;
/// Of the palette of coefficients.
const BYTES_OF_PALETTE: u64 = 4 + 12;
/// What is known of a file: three lists of codes, names, members of an archive.
const BYTES_A_FILE: u64 = 8 << 10;
/// Tags of rotations: 252 and the number of the largest component.
const FIRST_TAG: u8 = 252;

/// A file of splats.
struct File {
    parts: Parts,
    meta: Meta,
    /// First and count of the splats that are read.
    stretches: Vec<(u64, u64)>,
}

/// The Gaussians of a SOG file.
pub(in crate::points) struct SogReader {
    files: Vec<File>,
    degree: u8,
    /// The first column of the file's own.
    own: usize,
    /// The file and the stretch that are read, and how many Gaussians of it were.
    file: usize,
    stretch: usize,
    done: u64,
    /// Of the file that is read.
    images: Option<Images>,
}

impl SogReader {
    /// Whether a file that begins with these bytes is the JSON of splats, or of their levels.
    pub(in crate::points) fn begins(head: &[u8]) -> bool {
        let has = |word: &[u8]| head.windows(word.len()).any(|part| part == word);
        let is_json = head.trim_ascii_start().first() == Some(&b'{');
        is_json && (has(b"\"means\"") && has(b"\"mins\"") || has(b"\"lodLevels\"") && has(b"\"filenames\""))
    }

    /// Opens a file and reads its JSON, and that of the files that it tells of.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read, or is not SOG of version 2.
    pub(in crate::points) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        let parts = Parts::open(path)?;
        let json = parts.json()?;
        let wrong = |what: String| ReadError::malformed(path, Place::Byte(0), what);
        let files = if sog_meta::has_levels(&json) {
            let chosen = sog_meta::finest(&json).map_err(wrong)?;
            chosen.iter().map(|of| File::open(path, of)).collect::<Result<_, _>>()?
        } else {
            let meta = Meta::parse(&json).map_err(wrong)?;
            let stretches = vec![(0, meta.count)];
            vec![File { parts, meta, stretches }]
        };
        let of_file = |file: &File| file.meta.harmonics.as_ref().map_or(0, |of| of.degree);
        let degree = files.iter().map(of_file).max().unwrap_or(0);
        let mut schema = gaussian::schema("SOG 2", ColorDepth::Unit, degree, UP);
        if !files.is_empty() && files.iter().all(|file| file.meta.is_antialiased) {
            gaussian::say_antialiased(&mut schema);
        }
        let own = schema.columns.len();
        let count = files.iter().flat_map(|file| &file.stretches).map(|(_, count)| count).sum();
        // Coarser levels are of the same splats: who reads this file does not read those.
        let of_levels = sog_meta::file_names(&json).map(|name| path.with_file_name(name));
        let of_levels = of_levels.filter(|file| file.is_file());
        let others: BTreeSet<PathBuf> =
            files.iter().flat_map(|file| file.parts.files(&file.meta)).chain(of_levels).collect();
        let paths = std::iter::once(path.to_owned()).chain(others.into_iter().filter(|of| of != path));
        let reader = Self { files, degree, own, file: 0, stretch: 0, done: 0, images: None };
        Ok(FileSource::of_files(paths.collect(), schema, Some(count), reader))
    }

    /// Gaussian `index` of the file that is read.
    fn gaussian(&self, images: &Images, index: usize) -> Gaussian {
        let meta = &self.files[self.file].meta;
        let [low, high] = images.means.each_ref().map(|image| image.pixel(index));
        let position = [0, 1, 2].map(|axis| {
            let share = f64::from(u16::from_le_bytes([low[axis], high[axis]])) / 65535.0;
            let [least, most] = meta.ranges[axis];
            let logarithm = least * (1.0 - share) + most * share;
            logarithm.abs().exp_m1().copysign(logarithm)
        });
        let (scales, colors) = (images.scales.pixel(index), images.colors.pixel(index));
        let constant = [0, 1, 2].map(|channel| meta.colors.0[usize::from(colors[channel])]);
        let mut harmonics = Harmonics { constant, ..Harmonics::NONE };
        self.add_harmonics(images, index, &mut harmonics);
        Gaussian {
            position,
            color: constant.map(color_of),
            opacity: f64::from(colors[3]) / 255.0,
            deviations: [0, 1, 2].map(|axis| meta.scales.0[usize::from(scales[axis])].exp()),
            rotation: rotation(images.quats.pixel(index)),
            harmonics,
        }
    }

    /// Looks up the coefficients of a Gaussian in the palette. Numbers beyond it stand for none.
    fn add_harmonics(&self, images: &Images, index: usize, out: &mut Harmonics) {
        let of = self.files[self.file].meta.harmonics.as_ref();
        let (Some(of), Some([palette, labels])) = (of, &images.harmonics) else { return };
        let [low, high, ..] = labels.pixel(index);
        let label = usize::from(u16::from_le_bytes([low, high]));
        let per_channel = coefficients(of.degree) - 1;
        let kept = harmonics::rest(self.degree) / CHANNELS;
        let (row, first) = (label / ACROSS, label % ACROSS * per_channel);
        if row >= palette.height {
            return;
        }
        for k in 0..per_channel {
            let bytes = palette.pixel(row * palette.width + first + k);
            for channel in 0..CHANNELS {
                out.rest[channel * kept + k] = of.codes[usize::from(bytes[channel])] as f32;
            }
        }
    }
}

impl File {
    /// A file that another tells of.
    fn open(path: &Path, of: &Chosen) -> Result<Self, ReadError> {
        let path = path.parent().unwrap_or(Path::new("")).join(&of.name);
        let parts = Parts::open(&path)?;
        let wrong = |what: String| ReadError::malformed(&path, Place::Byte(0), what);
        let meta = Meta::parse(&parts.json()?).map_err(wrong)?;
        let stretches = if of.stretches.is_empty() { vec![(0, meta.count)] } else { of.stretches.clone() };
        let is_within =
            |(first, count): &(u64, u64)| first.checked_add(*count).is_some_and(|end| end <= meta.count);
        if !stretches.iter().all(is_within) {
            return Err(wrong(format!("{} splats, fewer than its tree says", meta.count)));
        }
        Ok(Self { parts, meta, stretches })
    }
}

/// A quaternion without its largest component, whose number the last byte tells, in the order w, x,
/// y, z; the others are from −√½ to √½.
fn rotation([a, b, c, tag]: [u8; 4]) -> [f64; 4] {
    let Some(largest) = tag.checked_sub(FIRST_TAG).map(usize::from) else { return [0.0, 0.0, 0.0, 1.0] };
    let others =
        [a, b, c].map(|byte| (f64::from(byte) / 255.0 * 2.0 - 1.0) * std::f64::consts::FRAC_1_SQRT_2);
    let rest = (1.0 - others.iter().map(|v| v * v).sum::<f64>()).max(0.0).sqrt();
    let mut others = others.into_iter();
    let [w, x, y, z] = [0, 1, 2, 3].map(|i| if i == largest { rest } else { others.next().unwrap_or(0.0) });
    [x, y, z, w]
}

impl RecordReader for SogReader {
    fn memory_needed(&self) -> u64 {
        let of_file = |file: &File| {
            let size = file.meta.harmonics.as_ref().map_or((0, 0), MetaHarmonics::palette_size);
            BYTES_A_PIXEL * most_pixels(file.meta.count) + BYTES_OF_PALETTE * size.0 * size.1
        };
        self.files.iter().map(of_file).max().unwrap_or(0) + self.files.len() as u64 * BYTES_A_FILE
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        while let Some(file) = self.files.get(self.file) {
            let Some(&(first, count)) = file.stretches.get(self.stretch) else {
                (self.file, self.stretch, self.images) = (self.file + 1, 0, None);
                continue;
            };
            if self.done == count {
                (self.stretch, self.done) = (self.stretch + 1, 0);
                continue;
            }
            let images = match self.images.take() {
                Some(images) => images,
                None => file.parts.images(&file.meta)?,
            };
            let most = (count - self.done).min(request.most as u64);
            for index in first + self.done..first + self.done + most {
                self.gaussian(&images, index as usize).append(self.own, request.selected, batch);
            }
            self.done += most;
            self.images = Some(images);
            return Ok(());
        }
        Ok(())
    }
}
