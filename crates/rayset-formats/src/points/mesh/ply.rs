//! Meshes in PLY files.

use std::path::Path;

use super::triangles::{Description, Fan, Sink};
use crate::points::ply_body::{Body, Part};
use crate::points::ply_header::{Element, Property, Scalar};
use crate::points::{ColorDepth, ColumnInfo, Place, ReadError, roles};
use rayset_base::geometry::DVec3;

/// Largest number of corners of a face; a larger count is taken for damage.
const CORNER_LIMIT: u32 = 1 << 16;

/// Reads the vertices and faces of a PLY file.
pub(super) fn read(path: &Path, sink: &mut impl Sink) -> Result<Description, ReadError> {
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
    let (colors, depth) = colors_of(vertex);
    let (face_colors, face_depth) = colors_of(face);
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => read_vertices(&mut body, vertex, axes, colors, sink)?,
            "face" => read_faces(&mut body, face, (corners, face_colors), vertex.count, sink)?,
            _ => body.skip(element)?,
        }
    }
    body.check_rest()?;
    let depth = if colors.is_some() { depth } else { face_depth };
    Ok(Description { text: header.description, depth, place: Place::Line(header.lines) })
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

/// The properties of an element that are its colour, and their range.
fn colors_of(element: &Element) -> (Option<[usize; 3]>, ColorDepth) {
    let scalars = element.properties.iter().enumerate().filter_map(|(place, property)| match property {
        Property::Scalar { name, kind } => Some((place, *kind, ColumnInfo::new(name, kind.column_type()))),
        Property::List { .. } => None,
    });
    let scalars: Vec<(usize, Scalar, ColumnInfo)> = scalars.collect();
    let columns: Vec<ColumnInfo> = scalars.iter().map(|(_, _, column)| column.clone()).collect();
    let named = roles::colors(&columns);
    let [Some(red), Some(green), Some(blue)] =
        ["red", "green", "blue"].map(|name| roles::find(&columns, &named, name))
    else {
        return (None, ColorDepth::Guess);
    };
    let depth = match [red, green, blue].map(|column| scalars[column].1) {
        [Scalar::U8, Scalar::U8, Scalar::U8] => ColorDepth::Byte,
        [Scalar::U16, Scalar::U16, Scalar::U16] => ColorDepth::Word,
        _ => ColorDepth::Guess,
    };
    (Some([red, green, blue].map(|column| scalars[column].0)), depth)
}

fn read_vertices(
    body: &mut Body,
    element: &Element,
    axes: [usize; 3],
    colors: Option<[usize; 3]>,
    sink: &mut impl Sink,
) -> Result<(), ReadError> {
    for index in 0..element.count {
        sink.check()?;
        let (mut position, mut color) = (DVec3::ZERO, [0.0; 3]);
        body.record(
            element,
            index,
            |_| false,
            |place, part| {
                let Part::Scalar(value) = part else { return Ok(()) };
                if let Some(axis) = axes.iter().position(|&a| a == place) {
                    position[axis] = value;
                }
                if let Some(channel) = colors.and_then(|colors| colors.iter().position(|&c| c == place)) {
                    color[channel] = value as f32;
                }
                Ok(())
            },
        )?;
        sink.vertex(position, colors.map(|_| color));
    }
    Ok(())
}

/// Reads the faces; `vertices` is the number of vertices.
fn read_faces(
    body: &mut Body,
    element: &Element,
    (corners, colors): (usize, Option<[usize; 3]>),
    vertices: u64,
    sink: &mut impl Sink,
) -> Result<(), ReadError> {
    for index in 0..element.count {
        sink.check()?;
        let (mut fan, mut color) = (Fan::default(), [0.0; 3]);
        let first = sink.triangles();
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
                    fan.corner(corner as u32, sink);
                }
                Part::Scalar(value) => {
                    if let Some(channel) = colors.and_then(|colors| colors.iter().position(|&c| c == place)) {
                        color[channel] = value as f32;
                    }
                }
                Part::Count(_) => {}
            }
            Ok(())
        })?;
        if colors.is_some() && sink.triangles() > first {
            sink.face_color(first, color);
        }
    }
    Ok(())
}
