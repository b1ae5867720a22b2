//! Vertices and triangles, as they come from a file.

use crate::points::{ColorDepth, Place, ReadError};
use rayset_base::cancel::CancelToken;
use rayset_base::geometry::DVec3;

/// Takes what is read of a mesh, in the order of its file. Faces may come before their vertices.
pub(super) trait Sink {
    fn vertex(&mut self, position: DVec3, color: Option<[f32; 3]>);
    fn triangle(&mut self, corners: [u32; 3]);
    /// The colour of the triangles that came last, back to the one of this number.
    fn face_color(&mut self, first: u64, color: [f32; 3]);
    /// The number of triangles so far.
    fn triangles(&self) -> u64;
    /// Whether reading is to end. Asked at every vertex and every face.
    fn is_cancelled(&self) -> bool;

    /// An error if reading is to end.
    fn check(&self) -> Result<(), ReadError> {
        if self.is_cancelled() { Err(ReadError::Cancelled) } else { Ok(()) }
    }
}

/// What a file says of its mesh besides the mesh.
#[derive(Clone, Debug)]
pub(super) struct Description {
    /// Format, and what the file says of itself.
    pub(super) text: String,
    /// Of the colours of vertices, or of faces if these alone have any.
    pub(super) depth: ColorDepth,
    /// The place in the file of what is wrong with the mesh as a whole.
    pub(super) place: Place,
}

/// How much there is of a mesh.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Survey {
    pub(super) vertices: u64,
    pub(super) triangles: u64,
    colored: u64,
    colored_triangles: u64,
}

impl Survey {
    /// Whether every triangle has a colour, and not every vertex.
    pub(super) fn has_face_colors(&self) -> bool {
        !self.has_colors() && self.triangles > 0 && self.colored_triangles == self.triangles
    }

    /// Whether every vertex has a colour.
    pub(super) fn has_colors(&self) -> bool {
        self.vertices > 0 && self.colored == self.vertices
    }

    /// Memory that the mesh takes, in bytes.
    pub(super) fn bytes(&self) -> u64 {
        let vertex = size_of::<DVec3>() + if self.has_colors() { size_of::<[f32; 3]>() } else { 0 };
        let color = if self.has_face_colors() { size_of::<[f32; 3]>() } else { 0 };
        let triangle = size_of::<[u32; 3]>() + size_of::<f64>() + color;
        self.vertices
            .saturating_mul(vertex as u64)
            .saturating_add(self.triangles.saturating_mul(triangle as u64))
    }
}

impl Sink for Survey {
    fn vertex(&mut self, _: DVec3, color: Option<[f32; 3]>) {
        self.vertices += 1;
        self.colored += u64::from(color.is_some());
    }

    fn triangle(&mut self, _: [u32; 3]) {
        self.triangles += 1;
    }

    fn face_color(&mut self, first: u64, _: [f32; 3]) {
        self.colored_triangles += self.triangles - first;
    }

    fn triangles(&self) -> u64 {
        self.triangles
    }

    fn is_cancelled(&self) -> bool {
        false
    }
}

/// A mesh in memory.
#[derive(Debug, Default)]
pub(super) struct Mesh {
    pub(super) vertices: Vec<DVec3>,
    /// Of every vertex, or none.
    pub(super) colors: Vec<[f32; 3]>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Of every triangle, or none.
    pub(super) face_colors: Vec<[f32; 3]>,
    has_colors: bool,
    has_face_colors: bool,
    cancel: CancelToken,
}

impl Mesh {
    /// Room for what was counted when the file was read to its end, which bounds it by what the
    /// file holds.
    pub(super) fn with_room(survey: &Survey, cancel: &CancelToken) -> Self {
        let (vertices, triangles) = (survey.vertices as usize, survey.triangles as usize);
        let has_colors = survey.has_colors();
        Self {
            vertices: Vec::with_capacity(vertices),
            colors: Vec::with_capacity(if has_colors { vertices } else { 0 }),
            triangles: Vec::with_capacity(triangles),
            face_colors: Vec::with_capacity(if survey.has_face_colors() { triangles } else { 0 }),
            has_colors,
            has_face_colors: survey.has_face_colors(),
            cancel: cancel.clone(),
        }
    }
}

impl Sink for Mesh {
    fn vertex(&mut self, position: DVec3, color: Option<[f32; 3]>) {
        self.vertices.push(position);
        if self.has_colors {
            self.colors.push(color.unwrap_or_default());
        }
    }

    fn triangle(&mut self, corners: [u32; 3]) {
        self.triangles.push(corners);
    }

    fn face_color(&mut self, _: u64, color: [f32; 3]) {
        if self.has_face_colors {
            self.face_colors.resize(self.triangles.len(), color);
        }
    }

    fn triangles(&self) -> u64 {
        self.triangles.len() as u64
    }

    fn is_cancelled(&self) -> bool {
        self.cancel.is_cancelled()
    }
}

/// Splits a polygon, whose corners come one after another, into a fan of triangles.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Fan {
    first: u32,
    last: u32,
    seen: u32,
}

impl Fan {
    pub(super) fn corner(&mut self, corner: u32, sink: &mut impl Sink) {
        if self.seen == 0 {
            self.first = corner;
        } else if self.seen > 1 {
            sink.triangle([self.first, self.last, corner]);
        }
        (self.last, self.seen) = (corner, self.seen.saturating_add(1));
    }
}
