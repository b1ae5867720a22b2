//! Sampling any number of points on the triangles of a mesh.

use std::path::{Path, PathBuf};

use super::triangles::{Description, Mesh, Sink, Survey};
use super::{obj, off, ply, stl};
use crate::points::{ColorDepth, ColumnInfo, ColumnType, PointBatch, PointSource, ReadError, Schema};
use rayset_base::cancel::CancelToken;

/// Points on a triangle, on average, where their number is not given.
const POINTS_PER_TRIANGLE: u64 = 10;
/// The fewest of these on a mesh.
const FEWEST_POINTS: u64 = 1_000_000;
/// The most of these on a mesh.
const MOST_POINTS: u64 = 20_000_000;

/// The columns of points: colours, if the mesh has any, and the normal of their triangle, of length
/// one.
const COLORS: [&str; 3] = ["red", "green", "blue"];
const NORMAL: [&str; 3] = ["nx", "ny", "nz"];

/// The formats of meshes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::points) enum MeshFormat {
    Ply,
    Obj,
    Off,
    Stl,
}

impl MeshFormat {
    /// By the name of a file. PLY files are known by what they begin with, which their reader looks
    /// at.
    fn of(path: &Path) -> Self {
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        match extension.to_str() {
            Some("obj") => Self::Obj,
            Some("off") => Self::Off,
            Some("stl") => Self::Stl,
            _ => Self::Ply,
        }
    }

    fn read(self, path: &Path, sink: &mut impl Sink) -> Result<Description, ReadError> {
        match self {
            Self::Ply => ply::read(path, sink),
            Self::Obj => obj::read(path, sink),
            Self::Off => off::read(path, sink),
            Self::Stl => stl::read(path, sink),
        }
    }
}

/// Points on the surface of a mesh, evenly distributed by area, with the normals of its faces; the
/// same for the same mesh and number. The mesh is held in memory: 24 bytes per vertex, with a
/// colour 36, and 20 bytes per triangle, with a colour of its own 32.
///
/// Equal shares of the area, triangle after triangle, have a point each. Where in its triangle it
/// lies follows from its number by a sequence of low discrepancy, of which any part in a row is
/// spread evenly; random points would leave holes of several spacings.
pub struct MeshSource {
    path: PathBuf,
    format: MeshFormat,
    survey: Survey,
    /// Empty until the first points are asked for.
    mesh: Mesh,
    /// Cumulative area of the triangles, up to and including each.
    area: Vec<f64>,
    /// Number of points, and of those that have been delivered.
    points: u64,
    next: u64,
    schema: Schema,
    selected: Vec<usize>,
    /// Stops loading the mesh.
    cancel: CancelToken,
}

impl MeshSource {
    /// Reads the vertices and faces of a PLY, OBJ, OFF or STL file. Colours of vertices, if all
    /// have them, are interpolated; otherwise points have the colours of their faces, if all of
    /// these have any.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read, has no faces with an area, or a face refers to a vertex
    /// that does not exist.
    pub fn open(path: impl AsRef<Path>, points: u64) -> Result<Self, ReadError> {
        let path = path.as_ref();
        let mut source = Self::survey(path, MeshFormat::of(path), Some(points))?;
        source.load()?;
        Ok(source)
    }

    /// Reads a file through without keeping its mesh, which is loaded when points are asked for.
    /// Without a number of `points`, this follows from that of the triangles.
    ///
    /// # Errors
    /// As [`open`](Self::open), but for faces without an area.
    pub(in crate::points) fn survey(
        path: &Path,
        format: MeshFormat,
        points: Option<u64>,
    ) -> Result<Self, ReadError> {
        let mut survey = Survey::default();
        let description = format.read(path, &mut survey)?;
        let by_triangles =
            survey.triangles.saturating_mul(POINTS_PER_TRIANGLE).clamp(FEWEST_POINTS, MOST_POINTS);
        let points_wanted = points.unwrap_or(by_triangles);
        let has_colors = survey.has_colors() || survey.has_face_colors();
        let names = COLORS.into_iter().filter(|_| has_colors).chain(NORMAL);
        let columns = names.map(|name| ColumnInfo::new(name, ColumnType::F32)).collect();
        let depth = if has_colors { description.depth } else { ColorDepth::Unit };
        let mut schema = Schema { description: description.text, ..Schema::new(columns, depth) };
        if points.is_none() {
            schema.warnings = vec![format!(
                "{points_wanted} points are sampled on the {} triangles of a mesh",
                survey.triangles
            )];
        }
        Ok(Self {
            path: path.to_owned(),
            format,
            survey,
            mesh: Mesh::default(),
            area: Vec::new(),
            points: points_wanted,
            next: 0,
            schema,
            selected: Vec::new(),
            cancel: CancelToken::new(),
        })
    }

    /// The usual number of points on the faces of a file; `None` if it has none with an area, or is
    /// damaged.
    pub(in crate::points) fn of_faces(path: &Path, format: MeshFormat) -> Option<Self> {
        let mut source = Self::survey(path, format, None).ok().filter(|source| source.triangles() > 0)?;
        source.load().ok()?;
        Some(source)
    }

    /// Number of triangles.
    pub(in crate::points) fn triangles(&self) -> u64 {
        self.survey.triangles
    }

    /// Number of vertices.
    pub(in crate::points) fn vertices(&self) -> u64 {
        self.survey.vertices
    }

    fn load(&mut self) -> Result<(), ReadError> {
        let mut mesh = Mesh::with_room(&self.survey, &self.cancel);
        let description = self.format.read(&self.path, &mut mesh)?;
        let fail = |what: &str| ReadError::malformed(&self.path, description.place, what);
        let mut sum = 0.0;
        let mut area = Vec::with_capacity(mesh.triangles.len());
        for triangle in &mesh.triangles {
            mesh.check()?;
            let corners = triangle.map(|corner| mesh.vertices.get(corner as usize).copied());
            let [Some(a), Some(b), Some(c)] = corners else {
                return Err(fail("the file has changed while it was read"));
            };
            sum += 0.5 * (b - a).cross(c - a).length();
            area.push(sum);
        }
        if !sum.is_finite() {
            return Err(fail("a face has a corner that is not finite, or the area of the mesh overflows"));
        }
        if sum <= 0.0 {
            return Err(fail("the mesh has no faces with an area"));
        }
        (self.mesh, self.area) = (mesh, area);
        Ok(())
    }
}

impl PointSource for MeshSource {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        Some(self.points - self.next)
    }

    fn path(&self) -> Option<&Path> {
        Some(&self.path)
    }

    fn memory_needed(&self) -> u64 {
        // The mesh, and the buffer that it is read through.
        self.survey.bytes().saturating_add(512 << 10)
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
    }

    fn watch(&mut self, cancel: &CancelToken) {
        self.cancel = cancel.clone();
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &self.selected);
        if self.area.is_empty() {
            self.load()?;
        }
        let end = self.points.min(self.next.saturating_add(limit as u64));
        let whole = self.area.last().copied().unwrap_or(0.0);
        let last = self.mesh.triangles.len() - 1;
        let colors = self.schema.columns.len() - NORMAL.len();
        let place = |number: u64| (number as f64 + 0.5) / self.points as f64 * whole;
        let mut triangle = self.area.partition_point(|&area| area <= place(self.next)).min(last);
        for number in self.next..end {
            while self.area[triangle] <= place(number) && triangle < last {
                triangle += 1;
            }
            let corners = self.mesh.triangles[triangle];
            let [a, b, c] = corners.map(|corner| self.mesh.vertices[corner as usize]);
            let shares = shares(number);
            let p = a * shares[0] + b * shares[1] + c * shares[2];
            batch.position.push(p.to_array());
            let normal = || (b - a).cross(c - a).normalize_or_zero().to_array();
            let face = self.mesh.face_colors.get(triangle);
            for (column, &channel) in batch.columns.iter_mut().zip(&self.selected) {
                if let Some(axis) = channel.checked_sub(colors) {
                    column.push(normal()[axis]);
                    continue;
                }
                if let Some(color) = face {
                    column.push(color[channel].into());
                    continue;
                }
                let of_corner = corners.map(|corner| f64::from(self.mesh.colors[corner as usize][channel]));
                column.push(shares.iter().zip(of_corner).map(|(share, color)| share * color).sum());
            }
        }
        self.next = end;
        Ok(())
    }
}

/// The shares of the corners of a triangle in the point of this number: Roberts's sequence R2 in a
/// square, which is folded to a triangle such that areas remain and neighbours stay near each other
/// (Heitz 2019).
fn shares(number: u64) -> [f64; 3] {
    /// 1/g and 1/g², where g³ = g + 1, in units of 2⁻⁶⁴.
    const STEPS: [u64; 2] = [0xc13f_a9a9_02a6_328f, 0x91e1_0da5_c79e_7b1c];
    let [u, v] = STEPS.map(|step| number.wrapping_mul(step) as f64 / 2_f64.powi(64));
    let (u, v) = if v > u { (0.5 * u, v - 0.5 * u) } else { (u - 0.5 * v, 0.5 * v) };
    [1.0 - u - v, u, v]
}
