//! PLY: ASCII and both binary byte orders, properties of any type and in any order; lists are
//! skipped.

use std::path::Path;

use super::file_source::{FileSource, RecordReader, Request, set_axis};
use super::ply_body::{BUFFER_BYTES, Body, Part};
use super::ply_header::{Element, Encoding, Property, Scalar};
use super::stream::Stream;
use super::{ColorDepth, ColumnInfo, Place, PointBatch, ReadError, Schema, roles};
use rayset_base::geometry::DVec3;

/// Where the value of a property goes.
#[derive(Clone, Copy, Debug)]
enum Target {
    Axis(usize),
    Column(usize),
}

/// The vertices of a PLY file.
pub(super) struct PlyReader {
    body: Body,
    vertex: Element,
    axes: [usize; 3],
    /// The index of the property of each column of the schema.
    properties: Vec<usize>,
    /// The selected properties, and where their values go; a property may have several targets.
    targets: Vec<(usize, Target)>,
    /// The values of a record.
    values: Vec<f64>,
}

impl PlyReader {
    /// Opens a file, reads its header and skips to its vertices.
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be read, is not a PLY file, or has no `vertex` element with
    /// x, y and z.
    pub(super) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        Self::of(Stream::open(path)?)
    }

    /// The vertices of a stream.
    pub(super) fn of(input: Stream) -> Result<FileSource<Self>, ReadError> {
        let path = input.path().to_owned();
        let (header, mut body) = Body::of(input)?;
        let fail = |what: String| ReadError::malformed(&path, Place::Line(header.lines), what);
        let index = header.elements.iter().position(|e| e.name == "vertex");
        let index = index.ok_or_else(|| fail("no `vertex` element".into()))?;
        let vertex = header.elements[index].clone();
        let axes = vertex.axes().map_err(fail)?;

        let mut schema = Schema::new(Vec::new(), ColorDepth::Guess);
        schema.description = header.description;
        // Of nerfstudio and of Brush, which write it differently.
        let comments = schema.description.to_ascii_lowercase();
        let said = |comment: &str| comments.split("; ").any(|known| known == comment);
        let vertical = ["vertical axis: y", "vertical axis: z"].iter().position(|comment| said(comment));
        schema.up = vertical.map(|axis| [DVec3::Y, DVec3::Z][axis]);
        if header.elements.len() == 1 && vertex.has_layout_of_colmap() && !comments.contains(';') {
            schema.description.push_str(", in the layout of COLMAP");
        }
        let (mut properties, mut kinds) = (Vec::new(), Vec::new());
        for (place, property) in vertex.properties.iter().enumerate() {
            if let Property::Scalar { name, kind } = property
                && !axes.contains(&place)
            {
                let column = ColumnInfo::new(name, kind.column_type());
                schema.columns.push(if roles::is_class(name) { column.of_classes() } else { column });
                properties.push(place);
                kinds.push(*kind);
            }
        }
        schema.roles = roles::colors(&schema.columns);
        let colors: Vec<Scalar> =
            ["red", "green", "blue"].iter().filter_map(|name| schema.find(name).map(|c| kinds[c])).collect();
        schema.color_depth = match colors.as_slice() {
            [Scalar::U8, Scalar::U8, Scalar::U8] => ColorDepth::Byte,
            [Scalar::U16, Scalar::U16, Scalar::U16] => ColorDepth::Word,
            _ => ColorDepth::Guess,
        };
        for element in &header.elements[..index] {
            body.skip(element)?;
        }
        let (count, values) = (vertex.count, vec![0.0; vertex.properties.len()]);
        let reader = Self { body, vertex, axes, properties, targets: Vec::new(), values };
        Ok(FileSource::new(&path, schema, Some(count), reader))
    }

    /// Reads binary records without lists.
    fn read_fixed(
        &mut self,
        request: &Request<'_>,
        stride: usize,
        batch: &mut PointBatch,
    ) -> Result<(), ReadError> {
        let big = self.body.encoding() == Encoding::BigEndian;
        let rows = request.most.min((BUFFER_BYTES / stride).max(1));
        let records = self.body.fixed(&self.vertex, request.first, rows, stride)?;
        let first = batch.len();
        batch.position.resize(first + rows, [0.0; 3]);
        for &(place, target) in &self.targets {
            let before = &self.vertex.properties[..place];
            let sizes =
                before.iter().map(|p| if let Property::Scalar { kind, .. } = p { kind.size() } else { 0 });
            let offset: usize = sizes.sum();
            let Property::Scalar { kind, .. } = self.vertex.properties[place] else { continue };
            let values = (0..rows).map(|i| kind.decode(&records[i * stride + offset..], big));
            match target {
                Target::Axis(axis) => set_axis(batch, first, axis, values),
                Target::Column(column) => values.for_each(|v| batch.columns[column].push(v)),
            }
        }
        Ok(())
    }

    /// Reads a record of varying length, or in ASCII.
    fn read_varying(&mut self, index: u64, batch: &mut PointBatch) -> Result<(), ReadError> {
        let values = &mut self.values;
        self.body.record(
            &self.vertex,
            index,
            |_| false,
            |place, part| {
                if let Part::Scalar(value) = part {
                    values[place] = value;
                }
                Ok(())
            },
        )?;
        let mut position = [0.0; 3];
        for &(place, target) in &self.targets {
            match target {
                Target::Axis(axis) => position[axis] = self.values[place],
                Target::Column(column) => batch.columns[column].push(self.values[place]),
            }
        }
        batch.position.push(position);
        Ok(())
    }
}

impl RecordReader for PlyReader {
    fn memory_needed(&self) -> u64 {
        self.body.memory_needed()
    }

    fn select(&mut self, columns: &[usize]) {
        let axes = self.axes.iter().enumerate().map(|(axis, &place)| (place, Target::Axis(axis)));
        let columns =
            columns.iter().enumerate().map(|(to, &from)| (self.properties[from], Target::Column(to)));
        self.targets = axes.chain(columns).collect();
    }

    fn can_skip(&self) -> bool {
        self.body.encoding() != Encoding::Ascii && self.vertex.stride().is_some() && self.body.can_seek()
    }

    fn skip(&mut self, request: &Request<'_>) -> Result<bool, ReadError> {
        let count = request.most as u64;
        match self.vertex.stride() {
            Some(stride) if self.can_skip() => self.body.seek_records(count, stride)?,
            _ => self.body.skip(&Element { count, ..self.vertex.clone() })?,
        }
        Ok(true)
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        match (self.body.encoding(), self.vertex.stride()) {
            (Encoding::LittleEndian | Encoding::BigEndian, Some(stride)) => {
                self.read_fixed(request, stride, batch)
            }
            _ => (0..request.most as u64).try_for_each(|row| self.read_varying(request.first + row, batch)),
        }
    }

    fn finish(&mut self) -> Result<(), ReadError> {
        self.body.check_rest()
    }
}
