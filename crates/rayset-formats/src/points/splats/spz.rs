//! Gaussian splats as SPZ, versions 1 to 4: positions in fixed point (version 1: half precision),
//! opacities, colours and the coefficients of their harmonics in bytes, logarithms of deviations in
//! sixteenths.

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use flate2::read::GzDecoder;

use super::gaussian::{self, Gaussian, color_of};
use super::harmonics::{self, Harmonics};
use super::spz_header::{HEADER_BYTES, MAGIC, SpzHeader, StreamPlace};
use super::spz_plane::{Packing, Plane, READER_BYTES};
use crate::points::file_source::{FileSource, RecordReader, Request};
use crate::points::packed::{WINDOW_LIMIT, zstd_window};
use crate::points::{ColorDepth, Place, PointBatch, ReadError};
use rayset_base::cancel::CancelToken;
use rayset_base::geometry::DVec3;
use rayset_base::numbers::half;
use rayset_files::points::harmonics::{CHANNELS, coefficients};
use rayset_store::storage::input_file::InputFile;

/// Gaussians decoded at a time.
const CHUNK: usize = 1024;
/// Attributes of a file. The last may be missing.
const ATTRIBUTES: usize = 6;
const NAMES: [&str; ATTRIBUTES] = ["positions", "opacities", "colours", "scales", "rotations", "harmonics"];
/// Coordinates are right, up and back, as in OpenGL.
const UP: DVec3 = DVec3::Y;
/// Colours are stored with this factor on the coefficient of the zeroth spherical harmonic.
const COLOR_SCALE: f64 = 0.15;

/// Where the attributes lie.
#[derive(Clone, Copy, Debug)]
enum Layout {
    /// One behind the other.
    Planar(Packing),
    /// Each a stream of its own, with its window in bytes.
    Streams([Option<(StreamPlace, u64)>; ATTRIBUTES]),
}

/// The Gaussians of an SPZ file.
pub(in crate::points) struct SpzReader {
    header: SpzHeader,
    layout: Layout,
    /// Degree of the harmonics that are kept, and the first column of the file's own.
    degree: u8,
    own: usize,
    /// Readers of the attributes, from the first read on.
    planes: Vec<Plane>,
    buffers: [Vec<u8>; ATTRIBUTES],
    /// Stops the unpacking of what lies before the attributes, and behind.
    cancel: CancelToken,
}

impl SpzReader {
    /// Whether a file that begins with these bytes is an SPZ file.
    pub(in crate::points) fn begins(head: &[u8]) -> bool {
        if !head.starts_with(&[0x1f, 0x8b]) {
            return head.starts_with(MAGIC);
        }
        let mut start = [0; MAGIC.len()];
        GzDecoder::new(head).read_exact(&mut start).is_ok() && start == *MAGIC
    }

    /// Opens a file and reads its header.
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be read, or is not an SPZ file of version 1 to 4.
    pub(in crate::points) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        let fail = |byte: u64, what: String| ReadError::malformed(path, Place::Byte(byte), what);
        let mut file = InputFile::open(path).map_err(ReadError::io(path))?;
        let mut start = Vec::new();
        (&mut file).take(2).read_to_end(&mut start).map_err(ReadError::io(path))?;
        let packing = if start == [0x1f, 0x8b] { Packing::Gzip } else { Packing::Plain };
        let mut bytes = [0; HEADER_BYTES];
        if Plane::open(path, packing, 0, &CancelToken::new())?.read(&mut bytes)? < HEADER_BYTES {
            return Err(fail(0, "not an SPZ file: its header of 16 bytes is not there".into()));
        }
        let header = SpzHeader::parse(&bytes).map_err(|what| fail(0, what))?;
        let layout = if header.has_streams() {
            if matches!(packing, Packing::Gzip) {
                return Err(fail(0, "an SPZ file of version 4 in gzip; expected it as it is".into()));
            }
            let bytes = file.length().map_err(ReadError::io(path))?;
            let streams = header.streams(path, &mut file, bytes)?;
            Layout::Streams(with_windows(path, &mut file, streams)?)
        } else {
            Layout::Planar(packing)
        };
        let what = format!("SPZ {}", header.version);
        let degree = harmonics::degree(header.coefficients());
        let mut schema = gaussian::schema(&what, ColorDepth::Unit, degree, UP);
        if header.is_antialiased {
            gaussian::say_antialiased(&mut schema);
        }
        if header.coefficients() + 1 > coefficients(degree) {
            schema.warnings = vec![harmonics::left_out(degree)];
        }
        let own = schema.columns.len();
        let (count, planes, cancel) = (header.count, Vec::new(), CancelToken::new());
        let reader = Self { header, layout, own, degree, planes, buffers: Default::default(), cancel };
        Ok(FileSource::new(path, schema, Some(count), reader))
    }

    /// Opens a reader for each attribute.
    fn open_planes(&mut self, path: &Path) -> Result<(), ReadError> {
        let mut skip = HEADER_BYTES as u64;
        for (attribute, width) in self.header.widths().into_iter().take(self.header.attributes()).enumerate()
        {
            self.planes.push(match self.layout {
                Layout::Planar(packing) => Plane::open(path, packing, skip, &self.cancel)?,
                Layout::Streams(streams) => {
                    // Without Gaussians, nothing is read.
                    let Some((place, window)) = streams[attribute] else { continue };
                    Plane::open(path, Packing::Zstd(place, window), 0, &self.cancel)?
                }
            });
            skip += width * self.header.count;
        }
        Ok(())
    }

    /// Gaussian `index` of the buffers.
    fn gaussian(&self, index: usize) -> Gaussian {
        let [positions, alphas, colors, scales, rotations, rest] = &self.buffers;
        let position = match self.header.fractional_bits {
            Some(bits) => {
                let p = &positions[9 * index..][..9];
                let unit = 2_f64.powi(-i32::from(bits));
                [0, 1, 2].map(|axis| {
                    // The sign is in the uppermost of 24 bits.
                    let fixed = i32::from_le_bytes([0, p[3 * axis], p[3 * axis + 1], p[3 * axis + 2]]) >> 8;
                    f64::from(fixed) * unit
                })
            }
            None => {
                let p = &positions[6 * index..][..6];
                [0, 1, 2].map(|axis| f64::from(half::from_le_bytes([p[2 * axis], p[2 * axis + 1]])))
            }
        };
        let constant =
            [0, 1, 2].map(|channel| (f64::from(colors[3 * index + channel]) / 255.0 - 0.5) / COLOR_SCALE);
        let mut harmonics = Harmonics { constant, ..Harmonics::NONE };
        let (width, kept) = (CHANNELS * self.header.coefficients(), harmonics::rest(self.degree));
        for (i, to) in harmonics.rest[..kept].iter_mut().enumerate() {
            // The channels of a coefficient follow each other.
            let (channel, k) = (i / (kept / CHANNELS), i % (kept / CHANNELS));
            *to = (f32::from(rest[width * index + CHANNELS * k + channel]) - 128.0) / 128.0;
        }
        Gaussian {
            position,
            color: constant.map(color_of),
            harmonics,
            opacity: f64::from(alphas[index]) / 255.0,
            deviations: [0, 1, 2].map(|axis| (f64::from(scales[3 * index + axis]) / 16.0 - 10.0).exp()),
            rotation: if self.header.version >= 3 {
                smallest_three(&rotations[4 * index..])
            } else {
                first_three(&rotations[3 * index..])
            },
        }
    }
}

/// x, y and z of a quaternion, in a byte each, whose w is not negative.
fn first_three(bytes: &[u8]) -> [f64; 4] {
    let [x, y, z] = [0, 1, 2].map(|axis| f64::from(bytes[axis]) / 127.5 - 1.0);
    [x, y, z, (1.0 - x * x - y * y - z * z).max(0.0).sqrt()]
}

/// A quaternion without its largest component, which the uppermost two bits name, in the order x,
/// y, z, w. The others have a sign and nine bits each, up to √½, the last of them lowest.
fn smallest_three(bytes: &[u8]) -> [f64; 4] {
    let packed = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let largest = (packed >> 30) as usize;
    let (mut rotation, mut left) = ([0.0; 4], packed);
    for component in (0..4).rev().filter(|component| *component != largest) {
        let size = f64::from(left & 0x1ff) / 511.0 * std::f64::consts::FRAC_1_SQRT_2;
        rotation[component] = if left & 0x200 == 0 { size } else { -size };
        left >>= 10;
    }
    let squares: f64 = rotation.iter().map(|v| v * v).sum();
    rotation[largest] = (1.0 - squares).max(0.0).sqrt();
    rotation
}

/// The streams with the windows in bytes that unpacking them needs.
fn with_windows(
    path: &Path,
    file: &mut (impl Read + Seek),
    streams: [Option<StreamPlace>; ATTRIBUTES],
) -> Result<[Option<(StreamPlace, u64)>; ATTRIBUTES], ReadError> {
    let mut all = [None; ATTRIBUTES];
    for (found, place) in all.iter_mut().zip(streams) {
        let Some(place) = place else { continue };
        let mut frame = Vec::new();
        let read = file.seek(SeekFrom::Start(place.offset));
        read.and_then(|_| file.take(place.bytes.min(18)).read_to_end(&mut frame))
            .map_err(ReadError::io(path))?;
        let window = zstd_window(&frame).filter(|window| *window <= WINDOW_LIMIT).ok_or_else(|| {
            let what = "not the beginning of a zstd stream that can be unpacked in 128 MiB";
            ReadError::malformed(path, Place::Byte(place.offset), what)
        })?;
        *found = Some((place, window));
    }
    Ok(all)
}

impl RecordReader for SpzReader {
    fn memory_needed(&self) -> u64 {
        let windows = match self.layout {
            Layout::Planar(_) => 0,
            Layout::Streams(streams) => streams.iter().flatten().map(|(_, window)| window).sum::<u64>(),
        };
        // The ring of a zstd stream grows to a power of two.
        ATTRIBUTES as u64 * READER_BYTES + 2 * windows
    }

    fn watch(&mut self, cancel: &CancelToken) {
        self.cancel = cancel.clone();
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        if self.planes.is_empty() {
            self.open_planes(request.path())?;
        }
        let (rows, widths) = (request.most.min(CHUNK), self.header.widths());
        for (attribute, (plane, buffer)) in self.planes.iter_mut().zip(&mut self.buffers).enumerate() {
            buffer.resize(rows * widths[attribute] as usize, 0);
            plane.read_exact(buffer, NAMES[attribute], request.first, request.count)?;
        }
        for index in 0..rows {
            self.gaussian(index).append(self.own, request.selected, batch);
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), ReadError> {
        if matches!(self.layout, Layout::Planar(_)) && !self.planes.is_empty() {
            // The last sees all that is left.
            self.planes.drain(..self.header.attributes() - 1);
        }
        self.planes.iter_mut().try_for_each(Plane::finish)
    }
}
