//! Points on the triangles of a mesh, as many as one likes.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use super::ply_header::{Encoding, Header, Property, Scalar};
use super::synthetic::SplitMix;
use super::{ColorDepth, Place, PointBatch, PointSource, ReadError, Schema};
use crate::geometry::DVec3;

/// Points drawn at random from the surface of a mesh, evenly by area; the same for the same mesh and number. The mesh is
/// held in memory.
pub struct MeshSource {
    corners: Vec<[DVec3; 3]>,
    /// Area of each triangle and all before.
    area: Vec<f64>,
    random: SplitMix,
    left: u64,
    schema: Schema,
}

impl MeshSource {
    /// Reads the vertices and faces of a PLY file.
    ///
    /// # Errors
    /// [`ReadError`] where it cannot be read, or has no faces.
    pub fn open(path: &Path, points: u64) -> Result<Self, ReadError> {
        let io = |source| ReadError::Io { path: path.to_owned(), source };
        let mut input = BufReader::with_capacity(1 << 18, File::open(path).map_err(io)?);
        let header = Header::read(path, &mut input)?;
        let mut values =
            Values { path, input, encoding: header.encoding, word: String::new(), line: header.lines + 1 };
        let (mut vertices, mut corners): (Vec<DVec3>, Vec<[DVec3; 3]>) = (Vec::new(), Vec::new());
        for element in &header.elements {
            for record in 0..element.count {
                let mut position = DVec3::ZERO;
                for property in &element.properties {
                    match property {
                        Property::Scalar { name, kind } => {
                            let value = values.next(*kind)?;
                            if let Some(axis) = ["x", "y", "z"].iter().position(|axis| axis == name) {
                                position[axis] = value;
                            }
                        }
                        Property::List { count, item } => {
                            let count = values.next(*count)? as u64;
                            let list =
                                (0..count).map(|_| values.next(*item)).collect::<Result<Vec<f64>, _>>()?;
                            if element.name == "face" {
                                let corner = |i: usize| vertices.get(list[i] as usize).copied();
                                // A polygon is a fan of triangles.
                                for i in 2..list.len() {
                                    let (Some(a), Some(b), Some(c)) = (corner(0), corner(i - 1), corner(i))
                                    else {
                                        let what = format!("face {record} names a vertex that is not there");
                                        return Err(ReadError::malformed(
                                            path,
                                            Place::Line(header.lines),
                                            what,
                                        ));
                                    };
                                    corners.push([a, b, c]);
                                }
                            }
                        }
                    }
                }
                if element.name == "vertex" {
                    vertices.push(position);
                }
            }
        }
        let mut sum = 0.0;
        let area = corners.iter().map(|[a, b, c]| {
            sum += 0.5 * (*b - *a).cross(*c - *a).length();
            sum
        });
        let area: Vec<f64> = area.collect();
        if !(sum > 0.0 && sum.is_finite()) {
            return Err(ReadError::malformed(
                path,
                Place::Line(header.lines),
                "the mesh has no faces with an area",
            ));
        }
        let schema = Schema::new(Vec::new(), ColorDepth::Unit);
        Ok(Self { corners, area, random: SplitMix(42), left: points, schema })
    }
}

impl PointSource for MeshSource {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        Some(self.left)
    }

    fn select(&mut self, _: &[usize]) {}

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &[]);
        let count = self.left.min(limit as u64);
        let whole = self.area.last().copied().unwrap_or(0.0);
        for _ in 0..count {
            let at = self.random.unit() * whole + self.random.unit() * whole / f64::from(1 << 24);
            let triangle = self.area.partition_point(|&a| a <= at).min(self.corners.len() - 1);
            let [a, b, c] = self.corners[triangle];
            // Evenly over the triangle (Osada et al. 2002).
            let (u, v) = (self.random.unit().sqrt(), self.random.unit());
            let p = a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v);
            batch.position.push(p.to_array());
        }
        self.left -= count;
        Ok(())
    }
}

/// Values of a PLY file, one after another.
struct Values<'a> {
    path: &'a Path,
    input: BufReader<File>,
    encoding: Encoding,
    word: String,
    line: u64,
}

impl Values<'_> {
    fn next(&mut self, kind: Scalar) -> Result<f64, ReadError> {
        let early = |source| ReadError::Io { path: self.path.to_owned(), source };
        if self.encoding != Encoding::Ascii {
            let mut bytes = [0; 8];
            self.input.read_exact(&mut bytes[..kind.size()]).map_err(early)?;
            return Ok(kind.decode(&bytes, self.encoding == Encoding::BigEndian));
        }
        self.word.clear();
        loop {
            let mut byte = [0];
            let read = self.input.read(&mut byte).map_err(early)?;
            self.line += u64::from(read == 1 && byte[0] == b'\n');
            let end = read == 0 || byte[0].is_ascii_whitespace();
            if end && (read == 0 || !self.word.is_empty()) {
                break;
            }
            if !end {
                self.word.push(byte[0] as char);
            }
        }
        let what = || format!("`{}` is no number, or the file ends early", self.word);
        self.word.parse().map_err(|_| ReadError::malformed(self.path, Place::Line(self.line), what()))
    }
}
