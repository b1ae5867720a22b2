//! Gaussian splats as glTF, by the extension `KHR_gaussian_splatting`. Scales are deviations and
//! opacities go from 0 to 1, as they are; nodes turn, move and scale splats.

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::gaussian::{self, Gaussian, unit};
use super::gltf_document::{Accessor, Document, Primitive};
use super::harmonics::{self, Harmonics};
use super::turned::Turn;
use crate::points::file_source::{FileSource, RecordReader, Request, unreadable};
use crate::points::{ColorDepth, Place, PointBatch, ReadError};
use rayset_base::geometry::{DMat3, DQuat, DVec3};
use rayset_base::srgb::srgb_from_linear;
use rayset_files::points::harmonics::{CHANNELS, CONSTANT};
use rayset_store::storage::input_file::InputFile;

/// Gaussians decoded at a time.
const CHUNK: usize = 4096;
/// What is called a similarity may stretch one axis by this part more than another.
const SAME: f64 = 1e-4;

/// The Gaussians of a glTF file.
pub(in crate::points) struct GltfReader {
    document: Document,
    files: Vec<InputFile>,
    degree: u8,
    /// The first column of the file's own.
    own: usize,
    /// The primitive that is read, how its node places it, and how many Gaussians of it were read.
    primitive: usize,
    placed: Option<Placed>,
    done: u64,
    /// Bytes of one attribute at a time, and the numbers of all.
    buffer: Vec<u8>,
    values: Vec<Vec<f64>>,
}

/// How a node places splats.
struct Placed {
    scale: f64,
    rotation: DQuat,
    /// `None` if it does not turn them.
    turn: Option<Turn>,
}

impl GltfReader {
    /// Opens a file; `None` if it has no splats.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read, is malformed, or has splats of another kind.
    pub(in crate::points) fn open(path: &Path) -> Result<Option<FileSource<Self>>, ReadError> {
        let Some(document) = Document::read(path)? else { return Ok(None) };
        let files: Vec<InputFile> = (document.files.iter())
            .map(|file| InputFile::open(file).map_err(ReadError::io(file)))
            .collect::<Result<_, _>>()?;
        for primitive in &document.primitives {
            placed(path, primitive)?;
        }
        // Colours in linear light are not those of a sum of harmonics as displays show it.
        let is_linear = document.primitives.iter().any(|primitive| primitive.is_linear);
        let most = document.primitives.iter().map(|primitive| primitive.degree).max().unwrap_or(0);
        let degree = if is_linear { 0 } else { most };
        let mut schema = gaussian::schema("glTF 2.0", ColorDepth::Unit, degree, DVec3::Y);
        if most > degree {
            schema.warnings = vec![harmonics::left_out(degree) + ": they are of linear light"];
        }
        let own = schema.columns.len();
        let count = document.primitives.iter().map(|primitive| primitive.count).sum();
        let all = document.files.clone();
        let (buffer, values) = (Vec::new(), Vec::new());
        let reader =
            Self { document, files, degree, own, primitive: 0, placed: None, done: 0, buffer, values };
        Ok(Some(FileSource::of_files(all, schema, Some(count), reader)))
    }

    /// Reads the numbers of an attribute of up to `count` Gaussians into `values`.
    fn attribute(&mut self, at: usize, count: usize) -> Result<(), ReadError> {
        let accessor: &Accessor = &self.document.primitives[self.primitive].accessors[at];
        let (stride, own) = (accessor.stride as usize, accessor.bytes());
        let offset = accessor.offset + self.done * accessor.stride;
        self.buffer.resize((count - 1) * stride + own, 0);
        let (file, path) = (&mut self.files[accessor.file], &self.document.files[accessor.file]);
        let read = file.seek(SeekFrom::Start(offset)).and_then(|_| file.read_exact(&mut self.buffer));
        read.map_err(|source| unreadable(path, offset, source))?;
        if self.values.len() <= at {
            self.values.resize_with(at + 1, Vec::new);
        }
        let values = &mut self.values[at];
        values.clear();
        values.reserve_exact(count * accessor.width);
        for bytes in self.buffer.chunks(stride) {
            values.extend((0..accessor.width).map(|number| accessor.value(bytes, number)));
        }
        Ok(())
    }

    /// A Gaussian of those that were read.
    fn gaussian(&self, i: usize, placed: &Placed) -> Gaussian {
        let primitive = &self.document.primitives[self.primitive];
        let three = |at: usize| [0, 1, 2].map(|axis| self.values[at][3 * i + axis]);
        let position = primitive.world_from_local.transform_point3(DVec3::from_array(three(0)));
        let own = DQuat::from_slice(&self.values[1][4 * i..4 * i + 4]);
        let constant = three(4);
        let light = constant.map(|coefficient| 0.5 + CONSTANT * coefficient);
        let color = if primitive.is_linear { light.map(srgb_from_linear) } else { light };
        let mut harmonics = Harmonics::of_color(color);
        // Of a primitive with fewer, the others are 0.
        let kept = harmonics::rest(self.degree) / CHANNELS;
        for k in 0..(harmonics::rest(primitive.degree) / CHANNELS).min(kept) {
            for (channel, value) in three(5 + k).into_iter().enumerate() {
                harmonics.rest[channel * kept + k] = value as f32;
            }
        }
        if let Some(turn) = &placed.turn {
            turn.apply(&mut harmonics.rest, self.degree);
        }
        Gaussian {
            position: position.to_array(),
            color: color.map(unit),
            opacity: self.values[3][i],
            deviations: three(2).map(|deviation| deviation * placed.scale),
            rotation: (placed.rotation * own).to_array(),
            harmonics,
        }
    }
}

/// How a node places a primitive.
fn placed(path: &Path, primitive: &Primitive) -> Result<Placed, ReadError> {
    let linear = primitive.world_from_local.matrix3;
    let scale = linear.determinant().cbrt();
    let rotation = linear * (1.0 / scale);
    let rest = rotation.transpose() * rotation - DMat3::IDENTITY;
    let is_similar = scale > 0.0 && rest.to_cols_array().iter().all(|v| v.abs() < SAME);
    if !is_similar {
        let what =
            "a node mirrors splats, or scales them differently along its axes, which is not read".to_owned();
        return Err(ReadError::malformed(path, Place::Byte(0), what));
    }
    let is_turned = !rotation.abs_diff_eq(DMat3::IDENTITY, 1e-9);
    let turn = is_turned.then(|| Turn::new(&rotation, primitive.degree));
    Ok(Placed { scale, rotation: DQuat::from_mat3(&rotation), turn })
}

impl RecordReader for GltfReader {
    fn memory_needed(&self) -> u64 {
        // Numbers of all attributes, and the bytes of one.
        let of = |primitive: &Primitive| {
            let numbers: usize = primitive.accessors.iter().map(|accessor| accessor.width).sum();
            let widest = primitive.accessors.iter().map(|accessor| accessor.stride).max().unwrap_or(0);
            CHUNK as u64 * (8 * numbers as u64 + widest)
        };
        self.document.primitives.iter().map(of).max().unwrap_or(0)
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        while let Some(primitive) = self.document.primitives.get(self.primitive) {
            let left = primitive.count - self.done;
            if left == 0 {
                (self.primitive, self.done, self.placed) = (self.primitive + 1, 0, None);
                continue;
            }
            let count = left.min(request.most.min(CHUNK) as u64) as usize;
            let attributes = primitive.accessors.len();
            let placed = match self.placed.take() {
                Some(placed) => placed,
                None => placed(request.path(), primitive)?,
            };
            for at in 0..attributes {
                self.attribute(at, count)?;
            }
            if let Some(wrong) = self.values[2].iter().position(|deviation| *deviation < 0.0) {
                let accessor = &self.document.primitives[self.primitive].accessors[2];
                let byte = accessor.offset + (self.done + wrong as u64 / 3) * accessor.stride;
                let what = "a scale below 0: drafts of KHR_gaussian_splatting had logarithms there; write the file again"
                    .to_owned();
                let path = &self.document.files[accessor.file];
                return Err(ReadError::malformed(path, Place::Byte(byte), what));
            }
            for i in 0..count {
                self.gaussian(i, &placed).append(self.own, request.selected, batch);
            }
            self.done += count as u64;
            self.placed = Some(placed);
            return Ok(());
        }
        Ok(())
    }
}
