//! Meshes in Wavefront OBJ files.

use std::path::Path;

use super::obj_reader::{ObjReader, Statement};
use super::triangles::{Description, Fan, Sink};
use crate::points::{ColorDepth, Place, ReadError};
use rayset_base::geometry::DVec3;

/// Reads the vertices and faces of an OBJ file.
pub(super) fn read(path: &Path, sink: &mut impl Sink) -> Result<Description, ReadError> {
    let mut reader = ObjReader::open(path)?;
    let mut vertices = 0_u64;
    while let Some(statement) = reader.next()? {
        sink.check()?;
        match statement {
            Statement::Vertex { position, color } => {
                vertices += 1;
                sink.vertex(DVec3::from_array(position), color);
            }
            Statement::Others => {}
            Statement::Face(corners) => {
                let mut fan = Fan::default();
                for &corner in corners {
                    // Larger ones are refused below, or at the end of the file as not being there.
                    fan.corner(u32::try_from(corner).unwrap_or(u32::MAX), sink);
                }
            }
        }
    }
    let fail = |what: String| Err(ReadError::malformed(path, Place::Line(1), what));
    match vertices {
        0 => fail("no vertices: no line begins with `v`".into()),
        1..=0xffff_ffff => {
            Ok(Description { text: "OBJ".into(), depth: ColorDepth::Guess, place: Place::Line(1) })
        }
        _ => fail(format!("{vertices} vertices; at most {} can be read", u32::MAX)),
    }
}
