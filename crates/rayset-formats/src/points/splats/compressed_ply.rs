//! Gaussian splats as PLY compressed by PlayCanvas: every 256 vertices share a chunk, which has the
//! bounds that their packed integers are fractions of.
//!
//! Chunks and vertices are two elements of the file, read side by side.

use std::path::Path;

use super::gaussian::{self, Gaussian, unit};
use super::harmonics::{self, Harmonics, MOST_REST};
use super::ply::UP;
use crate::points::file_source::{FileSource, RecordReader, Request};
use crate::points::ply_body::{Body, Part};
use crate::points::ply_header::{Element, Header, Property, Scalar};
use crate::points::{ColorDepth, HARMONIC, Place, PointBatch, ReadError};
use rayset_files::points::harmonics::CHANNELS;

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
    /// The coefficients of their harmonics, and how many a channel has; if there are any.
    harmonics: Option<(Records<MOST_REST>, usize)>,
    /// Coefficients of all channels that are kept.
    rest: usize,
    /// The first column of the file's own.
    own: usize,
}

/// The elements of a file.
struct Elements<'h> {
    chunk: &'h Element,
    vertex: &'h Element,
    harmonics: Option<&'h Element>,
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
        let Elements { chunk, vertex, harmonics } = elements(&header).map_err(fail)?;
        let mut whole = [0.0; 18];
        whole[15..].fill(1.0);
        let chunks = Records::open(path, chunk, BOUNDS, whole)?;
        let vertices = Records::open(path, vertex, PACKED, [0.0; 4])?;
        let harmonics = harmonics.map(|element| {
            let names: [String; MOST_REST] = std::array::from_fn(|i| format!("{HARMONIC}{i}"));
            let found = names.iter().filter(|name| element.properties.iter().any(|p| p.name() == **name));
            let (per_channel, names) = (found.count() / CHANNELS, names.each_ref().map(String::as_str));
            Records::open(path, element, names, [0.0; MOST_REST]).map(|records| (records, per_channel))
        });
        let harmonics = harmonics.transpose()?;
        let degree = harmonics::degree(harmonics.as_ref().map_or(0, |(_, per_channel)| *per_channel));
        let what = format!("compressed {}", header.description);
        let mut schema = gaussian::schema(&what, ColorDepth::Unit, degree, UP);
        if gaussian::is_antialiased(&what) {
            gaussian::say_antialiased(&mut schema);
        }
        let own = schema.columns.len();
        let reader = Self { chunks, vertices, harmonics, rest: harmonics::rest(degree), own };
        Ok(FileSource::new(path, schema, Some(vertex.count), reader))
    }

    /// The coefficients that were read last, with those of a colour.
    fn coefficients(&self, color: [f64; CHANNELS]) -> Harmonics {
        let mut harmonics = Harmonics::of_color(color);
        if let Some((records, per_channel)) = &self.harmonics {
            let kept = self.rest / CHANNELS;
            for (i, to) in harmonics.rest[..self.rest].iter_mut().enumerate() {
                *to = coefficient(records.values[i / kept * per_channel + i % kept]);
            }
        }
        harmonics
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
        let color = within(12, [byte(24), byte(16), byte(8)]);
        Gaussian {
            position: within(0, three(position)),
            deviations: within(6, three(scale)).map(f64::exp),
            color: color.map(unit),
            harmonics: self.coefficients(color),
            opacity: byte(0),
            rotation: smallest_three(rotation),
        }
    }
}

/// The elements of chunks and vertices, and of coefficients if there are any.
fn elements(header: &Header) -> Result<Elements<'_>, String> {
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
    let harmonics = element("sh").filter(|e| !e.properties.is_empty());
    if let Some(sh) = harmonics.filter(|sh| sh.count != vertex.count) {
        return Err(format!("{} coefficients of colours for {} splats", sh.count, vertex.count));
    }
    Ok(Elements { chunk, vertex, harmonics })
}

/// A coefficient, of a byte.
fn coefficient(byte: f64) -> f32 {
    let fraction = match byte {
        0.0 => 0.0,
        255.0 => 1.0,
        inside => (inside + 0.5) / 256.0,
    };
    (8.0 * (fraction - 0.5)) as f32
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
        // The three read buffers.
        768 << 10
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        for _ in 0..request.most {
            if self.vertices.next.is_multiple_of(CHUNK) {
                self.chunks.advance()?;
            }
            self.vertices.advance()?;
            if let Some((records, _)) = &mut self.harmonics {
                records.advance()?;
            }
            self.gaussian().append(self.own, request.selected, batch);
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), ReadError> {
        match &mut self.harmonics {
            Some((records, _)) => records.body.check_rest(),
            None => self.vertices.body.check_rest(),
        }
    }
}
