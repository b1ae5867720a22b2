//! Gaussian splats as PLY compressed by PlayCanvas: every 256 vertices share a chunk, which has the
//! bounds that their packed integers are fractions of.
//!
//! Chunks and vertices are two elements of the file, read side by side.

use std::path::Path;

use super::gaussian::{self, Gaussian, unit};
use super::ply::UP;
use crate::points::file_source::{FileSource, RecordReader, Request};
use crate::points::ply_body::{Body, Part};
use crate::points::ply_header::{Element, Header, Property, Scalar};
use crate::points::{ColorDepth, Place, PointBatch, ReadError};

/// Vertices that share a chunk.
const CHUNK: u64 = 256;
/// The bounds of a chunk: smallest and largest positions, logarithms of deviations, and colours,
/// which are 0 and 1 where a file does not have them.
const BOUNDS: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];
const NEEDED_BOUNDS: usize = 12;
const PACKED: [&str; 4] = ["packed_position", "packed_scale", "packed_color", "packed_rotation"];

/// Some properties of an element, read record by record.
#[derive(Debug)]
struct Records<const N: usize> {
    body: Body,
    element: Element,
    /// The place among the wanted properties of each property of a record.
    places: Vec<Option<usize>>,
    next: u64,
    values: [f64; N],
}

impl<const N: usize> Records<N> {
    /// Opens the file again, at the beginning of an element.
    fn open(path: &Path, element: &Element, names: [&str; N], values: [f64; N]) -> Result<Self, ReadError> {
        let (header, mut body) = Body::open(path)?;
        for before in header.elements.iter().take_while(|e| e.name != element.name) {
            body.skip(before)?;
        }
        let places = element.properties.iter().map(|p| names.iter().position(|name| *name == p.name()));
        Ok(Self { body, element: element.clone(), places: places.collect(), next: 0, values })
    }

    /// Reads the next record into `values`.
    fn advance(&mut self) -> Result<(), ReadError> {
        let (places, values) = (&self.places, &mut self.values);
        self.body.record(
            &self.element,
            self.next,
            |_| false,
            |property, part| {
                if let (Some(place), Part::Scalar(value)) = (places[property], part) {
                    values[place] = value;
                }
                Ok(())
            },
        )?;
        self.next += 1;
        Ok(())
    }
}

/// The Gaussians of a compressed PLY file.
pub(in crate::points) struct CompressedPlyReader {
    chunks: Records<18>,
    vertices: Records<4>,
}

impl CompressedPlyReader {
    /// Whether vertices with these properties are packed Gaussians.
    pub(in crate::points) fn has_layout(names: &[&str]) -> bool {
        PACKED.iter().all(|packed| names.contains(packed))
    }

    /// Opens a file whose vertices [are packed](Self::has_layout).
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be read, or its chunks are missing or incomplete.
    pub(in crate::points) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        let (header, _) = Body::open(path)?;
        let fail = |what: String| ReadError::malformed(path, Place::Line(header.lines), what);
        let (chunk, vertex, view_dependent) = elements(&header).map_err(fail)?;
        let mut whole = [0.0; 18];
        whole[15..].fill(1.0);
        let chunks = Records::open(path, chunk, BOUNDS, whole)?;
        let vertices = Records::open(path, vertex, PACKED, [0.0; 4])?;
        let what = format!("compressed {}", header.description);
        let schema = gaussian::schema(&what, ColorDepth::Unit, view_dependent, UP);
        Ok(FileSource::new(path, schema, Some(vertex.count), Self { chunks, vertices }))
    }

    /// The vertex that was read last, with the bounds of its chunk.
    fn gaussian(&self) -> Gaussian {
        let bounds = &self.chunks.values;
        let [position, scale, color, rotation] = self.vertices.values.map(|packed| packed as u32);
        let within = |first: usize, fractions: [f64; 3]| {
            [0, 1, 2].map(|axis| {
                let (low, high) = (bounds[first + axis], bounds[first + 3 + axis]);
                low * (1.0 - fractions[axis]) + high * fractions[axis]
            })
        };
        let byte = |shift: u32| fraction(color >> shift, 8);
        Gaussian {
            position: within(0, three(position)),
            deviations: within(6, three(scale)).map(f64::exp),
            color: within(12, [byte(24), byte(16), byte(8)]).map(unit),
            opacity: byte(0),
            rotation: smallest_three(rotation),
        }
    }
}

/// The elements of chunks and vertices, and whether there are coefficients of view-dependent
/// colours.
fn elements(header: &Header) -> Result<(&Element, &Element, bool), String> {
    let element = |name: &str| header.elements.iter().find(|e| e.name == name);
    let vertex = element("vertex").ok_or("no `vertex` element")?;
    let chunk = element("chunk").ok_or("packed splats without a `chunk` element, which has their bounds")?;
    let kind = |element: &Element, name: &str| {
        element.properties.iter().find_map(|p| match p {
            Property::Scalar { name: found, kind } if found == name => Some(*kind),
            _ => None,
        })
    };
    if let Some(name) = PACKED.iter().find(|name| kind(vertex, name) != Some(Scalar::U32)) {
        return Err(format!("`{name}` is not of type uint"));
    }
    if let Some(name) = BOUNDS[..NEEDED_BOUNDS].iter().find(|name| kind(chunk, name).is_none()) {
        return Err(format!("the `chunk` element lacks `{name}`"));
    }
    if chunk.count < vertex.count.div_ceil(CHUNK) {
        return Err(format!(
            "{} chunks are too few for {} splats; expected one for each {CHUNK}",
            chunk.count, vertex.count
        ));
    }
    Ok((chunk, vertex, element("sh").is_some_and(|e| !e.properties.is_empty())))
}

/// The lower `bits` bits as a fraction of their largest value.
fn fraction(packed: u32, bits: u32) -> f64 {
    let largest = (1 << bits) - 1;
    f64::from(packed & largest) / f64::from(largest)
}

/// A quaternion without its largest component, which the uppermost two bits name, in the order w,
/// x, y, z; the others are from −√½ to √½, in 10 bits each.
fn smallest_three(packed: u32) -> [f64; 4] {
    let others = [20, 10, 0].map(|shift| (fraction(packed >> shift, 10) - 0.5) * std::f64::consts::SQRT_2);
    let largest = (1.0 - others.iter().map(|v| v * v).sum::<f64>()).max(0.0).sqrt();
    let [a, b, c] = others;
    match packed >> 30 {
        0 => [a, b, c, largest],
        1 => [largest, b, c, a],
        2 => [b, largest, c, a],
        _ => [b, c, largest, a],
    }
}

/// Fractions of 11, 10 and 11 bits.
fn three(packed: u32) -> [f64; 3] {
    [fraction(packed >> 21, 11), fraction(packed >> 11, 10), fraction(packed, 11)]
}

impl RecordReader for CompressedPlyReader {
    fn memory_needed(&self) -> u64 {
        // The two read buffers.
        512 << 10
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        for _ in 0..request.most {
            if self.vertices.next.is_multiple_of(CHUNK) {
                self.chunks.advance()?;
            }
            self.vertices.advance()?;
            self.gaussian().append(request.selected, batch);
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), ReadError> {
        self.vertices.body.check_rest()
    }
}
