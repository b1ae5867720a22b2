//! Sampling any number of points on the triangles of a mesh.

use std::path::Path;

use super::ply_body::{Body, Part};
use super::ply_header::{Element, Property};
use super::synthetic::SplitMix;
use super::{ColorDepth, Place, PointBatch, PointSource, ReadError, Schema};
use crate::geometry::DVec3;

/// Largest number of corners of a face; a larger count is taken for damage.
const CORNER_LIMIT: u32 = 1 << 16;

/// Random points on the surface of a mesh, uniformly distributed by area; the same for the same mesh and number. The mesh is
/// held in memory: 24 bytes per vertex and 20 bytes per triangle.
pub struct MeshSource {
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// Cumulative area of the triangles, up to and including each.
    area: Vec<f64>,
    random: SplitMix,
    left: u64,
    schema: Schema,
}

impl MeshSource {
    /// Reads the vertices and faces of a PLY file.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read, has no faces with an area, or a face refers to a vertex that does not exist.
    pub fn open(path: &Path, points: u64) -> Result<Self, ReadError> {
        let (header, mut body) = Body::open(path)?;
        let fail = |what: String| ReadError::malformed(path, Place::Line(header.lines), what);
        let element = |name: &str| {
            let found = header.elements.iter().find(|e| e.name == name);
            found.ok_or_else(|| fail(format!("no `{name}` element; a mesh has vertices and faces")))
        };
        let (vertex, face) = (element("vertex")?, element("face")?);
        let axes = vertex.axes().map_err(fail)?;
        let corners = corners(face).map_err(fail)?;
        if vertex.count > u64::from(u32::MAX) {
            return Err(fail(format!("{} vertices; at most {} can be read", vertex.count, u32::MAX)));
        }
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for element in &header.elements {
            match element.name.as_str() {
                "vertex" => read_vertices(&mut body, vertex, axes, &mut vertices)?,
                "face" => read_faces(&mut body, face, corners, vertex.count, &mut triangles)?,
                _ => body.skip(element)?,
            }
        }
        body.check_rest()?;
        let mut sum = 0.0;
        let area = triangles.iter().map(|triangle: &[u32; 3]| {
            let [a, b, c]: [DVec3; 3] = triangle.map(|corner| vertices[corner as usize]);
            sum += 0.5 * (b - a).cross(c - a).length();
            sum
        });
        let area: Vec<f64> = area.collect();
        if !sum.is_finite() {
            return Err(fail(
                "a face has a corner that is not finite, or the area of the mesh overflows".into(),
            ));
        }
        if sum <= 0.0 {
            return Err(fail("the mesh has no faces with an area".into()));
        }
        let schema = Schema { description: header.description, ..Schema::new(Vec::new(), ColorDepth::Unit) };
        Ok(Self { vertices, triangles, area, random: SplitMix(42), left: points, schema })
    }
}

/// The property of a face that lists its corners.
fn corners(face: &Element) -> Result<usize, String> {
    let is_list = |p: &Property| matches!(p, Property::List { .. });
    let named = |p: &Property| is_list(p) && matches!(p.name(), "vertex_indices" | "vertex_index");
    let place = face.properties.iter().position(named);
    let only = || {
        (face.properties.iter().filter(|p| is_list(p)).count() == 1)
            .then(|| face.properties.iter().position(is_list))
    };
    place
        .or_else(|| only().flatten())
        .ok_or_else(|| "the `face` element has no list called `vertex_indices`".to_owned())
}

fn read_vertices(
    body: &mut Body,
    element: &Element,
    axes: [usize; 3],
    vertices: &mut Vec<DVec3>,
) -> Result<(), ReadError> {
    for index in 0..element.count {
        let mut position = DVec3::ZERO;
        body.record(
            element,
            index,
            |_| false,
            |place, part| {
                if let (Some(axis), Part::Scalar(value)) = (axes.iter().position(|&a| a == place), part) {
                    position[axis] = value;
                }
                Ok(())
            },
        )?;
        vertices.push(position);
    }
    Ok(())
}

/// Reads the faces; polygons are split into fans of triangles. `vertices` is the number of vertices.
fn read_faces(
    body: &mut Body,
    element: &Element,
    corners: usize,
    vertices: u64,
    triangles: &mut Vec<[u32; 3]>,
) -> Result<(), ReadError> {
    for index in 0..element.count {
        // The first corner, the previous one, and the number of corners so far.
        let (mut first, mut last, mut seen) = (0, 0, 0_u32);
        body.record(element, index, |place| place == corners, |place, part| {
            match part {
                Part::Count(count) if place == corners && count > CORNER_LIMIT => {
                    return Err(format!("face {index} has {count} corners; at most {CORNER_LIMIT} are believed"));
                }
                Part::Item(corner) => {
                    if !(corner >= 0.0 && corner < vertices as f64 && corner.fract() == 0.0) {
                        return Err(format!(
                            "a corner of face {index} is vertex {corner}, which is not there: there are {vertices}, \
                             counted from 0"
                        ));
                    }
                    let corner = corner as u32;
                    if seen == 0 {
                        first = corner;
                    } else if seen > 1 {
                        triangles.push([first, last, corner]);
                    }
                    (last, seen) = (corner, seen + 1);
                }
                _ => {}
            }
            Ok(())
        })?;
    }
    Ok(())
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
            let triangle = self.area.partition_point(|&a| a <= at).min(self.triangles.len() - 1);
            let [a, b, c] = self.triangles[triangle].map(|corner| self.vertices[corner as usize]);
            // Uniform over the triangle (Osada et al. 2002).
            let (u, v) = (self.random.unit().sqrt(), self.random.unit());
            let p = a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v);
            batch.position.push(p.to_array());
        }
        self.left -= count;
        Ok(())
    }
}
