//! PLY: ASCII and both binary orders, properties of any type and order; lists are skipped.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use super::ply_header::{Element, Encoding, Header, Property, Scalar};
use super::{ColorDepth, ColumnInfo, Place, PointBatch, PointSource, ReadError, Schema};

const BUFFER_BYTES: usize = 256 << 10;
/// Longest line of an ASCII file, so that a file without line ends costs bounded memory.
const LINE_LIMIT: u64 = 1 << 20;

/// Where a value of a vertex record goes.
#[derive(Clone, Copy, Debug)]
enum Target {
    Axis(usize),
    Column(usize),
    Nothing,
}

/// The vertices of a PLY file.
#[derive(Debug)]
pub struct PlySource {
    path: PathBuf,
    input: BufReader<File>,
    encoding: Encoding,
    vertex: Element,
    /// Schema index of each property of the vertex, axes and lists apart.
    property_columns: Vec<Option<usize>>,
    targets: Vec<Target>,
    schema: Schema,
    selected: Vec<usize>,
    next: u64,
    byte: u64,
    line: u64,
    record: Vec<u8>,
}

impl PlySource {
    /// Opens a file, reads its header and skips to its vertices.
    ///
    /// # Errors
    /// [`ReadError`] where the file cannot be read, is no PLY file, or has no `vertex` element with x, y and z.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let io = |source| ReadError::Io { path: path.to_owned(), source };
        let mut input = BufReader::with_capacity(BUFFER_BYTES, File::open(path).map_err(io)?);
        let header = Header::read(path, &mut input)?;
        let fail = |what: &str| ReadError::malformed(path, Place::Line(header.lines), what);
        let index = header.elements.iter().position(|e| e.name == "vertex");
        let index = index.ok_or_else(|| fail("no `vertex` element"))?;
        let vertex = header.elements[index].clone();

        let mut schema = Schema::new(Vec::new(), ColorDepth::Guess);
        let mut axes = [false; 3];
        let mut property_columns = Vec::new();
        for property in &vertex.properties {
            property_columns.push(match property {
                Property::List { .. } => None,
                Property::Scalar { name, kind } => match axis_of(name) {
                    Some(axis) => {
                        axes[axis] = true;
                        None
                    }
                    None => {
                        let name = canonical(name);
                        if name == "red" {
                            schema.color_depth = match kind {
                                Scalar::U8 => ColorDepth::Byte,
                                Scalar::U16 => ColorDepth::Word,
                                _ => ColorDepth::Guess,
                            };
                        }
                        schema.columns.push(ColumnInfo::new(name, kind.column_type()));
                        Some(schema.columns.len() - 1)
                    }
                },
            });
        }
        if axes != [true; 3] {
            return Err(fail("the `vertex` element lacks x, y or z"));
        }
        let mut source = Self {
            path: path.to_owned(),
            input,
            encoding: header.encoding,
            vertex,
            property_columns,
            targets: Vec::new(),
            schema,
            selected: Vec::new(),
            next: 0,
            byte: header.bytes,
            line: header.lines,
            record: Vec::new(),
        };
        source.select(&[]);
        for element in &header.elements[..index] {
            source.skip_element(element)?;
        }
        Ok(source)
    }

    fn skip_element(&mut self, element: &Element) -> Result<(), ReadError> {
        if let (Some(stride), false) = (element.stride(), self.encoding == Encoding::Ascii) {
            let bytes = element.count.saturating_mul(stride as u64);
            let io = |source| ReadError::Io { path: self.path.clone(), source };
            let skipped =
                std::io::copy(&mut (&mut self.input).take(bytes), &mut std::io::sink()).map_err(io)?;
            self.byte += skipped;
            return if skipped == bytes { Ok(()) } else { Err(self.truncated(&element.name)) };
        }
        for _ in 0..element.count {
            if self.encoding == Encoding::Ascii {
                self.read_line(&element.name)?;
            } else {
                self.read_binary_with_lists(&element.properties, &element.name, |_, _| {})?;
            }
        }
        Ok(())
    }

    fn truncated(&self, element: &str) -> ReadError {
        let place =
            if self.encoding == Encoding::Ascii { Place::Line(self.line) } else { Place::Byte(self.byte) };
        let what = format!(
            "the file ends within element `{element}`: {} of {} vertices read",
            self.next, self.vertex.count
        );
        ReadError::malformed(&self.path, place, what)
    }

    /// Reads one non-empty line into `self.record`.
    fn read_line(&mut self, element: &str) -> Result<(), ReadError> {
        loop {
            self.record.clear();
            let read = (&mut self.input)
                .take(LINE_LIMIT)
                .read_until(b'\n', &mut self.record)
                .map_err(|source| ReadError::Io { path: self.path.clone(), source })?;
            if read == 0 {
                return Err(self.truncated(element));
            }
            self.line += 1;
            if read as u64 == LINE_LIMIT {
                let what = format!("a line of more than {LINE_LIMIT} bytes");
                return Err(ReadError::malformed(&self.path, Place::Line(self.line), what));
            }
            if !self.record.trim_ascii().is_empty() {
                return Ok(());
            }
        }
    }

    fn read_exact(&mut self, bytes: usize, element: &str) -> Result<(), ReadError> {
        self.record.resize(bytes, 0);
        match self.input.read_exact(&mut self.record) {
            Ok(()) => {
                self.byte += bytes as u64;
                Ok(())
            }
            Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => Err(self.truncated(element)),
            Err(source) => Err(ReadError::Io { path: self.path.clone(), source }),
        }
    }

    /// Reads one binary record property by property, calling `value(property index, value)` for its scalars.
    fn read_binary_with_lists(
        &mut self,
        properties: &[Property],
        element: &str,
        mut value: impl FnMut(usize, f64),
    ) -> Result<(), ReadError> {
        let big = self.encoding == Encoding::BigEndian;
        for (index, property) in properties.iter().enumerate() {
            match *property {
                Property::Scalar { kind, .. } => {
                    self.read_exact(kind.size(), element)?;
                    value(index, kind.decode(&self.record, big));
                }
                Property::List { count, item } => {
                    self.read_exact(count.size(), element)?;
                    let items = count.decode(&self.record, big);
                    if !(items >= 0.0 && items <= f64::from(u32::MAX)) {
                        let what = format!("a list of {items} items");
                        return Err(ReadError::malformed(&self.path, Place::Byte(self.byte), what));
                    }
                    let bytes = items as u64 * item.size() as u64;
                    let skipped = std::io::copy(&mut (&mut self.input).take(bytes), &mut std::io::sink())
                        .map_err(|source| ReadError::Io { path: self.path.clone(), source })?;
                    self.byte += skipped;
                    if skipped < bytes {
                        return Err(self.truncated(element));
                    }
                }
            }
        }
        Ok(())
    }

    fn fill_ascii(&mut self, batch: &mut PointBatch, count: usize) -> Result<(), ReadError> {
        for _ in 0..count {
            self.read_line("vertex")?;
            let line = std::mem::take(&mut self.record);
            let fail = |what: String| ReadError::malformed(&self.path, Place::Line(self.line), what);
            let text = std::str::from_utf8(&line).map_err(|_| fail("not text".into()))?;
            let mut words = text.split_ascii_whitespace();
            let mut number = || -> Result<f64, ReadError> {
                let word = words.next().ok_or_else(|| fail("too few values for a vertex".into()))?;
                word.parse().map_err(|_| fail(format!("`{word}` is not a number")))
            };
            let mut position = [0.0; 3];
            for (property, target) in self.vertex.properties.iter().zip(&self.targets) {
                let value = number()?;
                match (property, target) {
                    (Property::List { .. }, _) => {
                        for _ in 0..value.clamp(0.0, 1e9) as u64 {
                            number()?;
                        }
                    }
                    (_, Target::Axis(axis)) => position[*axis] = value,
                    (_, Target::Column(column)) => batch.columns[*column].push(value),
                    (_, Target::Nothing) => {}
                }
            }
            batch.position.push(position);
            self.record = line;
            self.next += 1;
        }
        Ok(())
    }

    fn fill_fixed(&mut self, batch: &mut PointBatch, count: usize, stride: usize) -> Result<(), ReadError> {
        let big = self.encoding == Encoding::BigEndian;
        let mut left = count;
        while left > 0 {
            let chunk = left.min((BUFFER_BYTES / stride.max(1)).max(1));
            self.read_exact(chunk * stride, "vertex")?;
            let mut offset = 0;
            batch.position.resize(batch.position.len() + chunk, [0.0; 3]);
            let first = batch.position.len() - chunk;
            for (property, target) in self.vertex.properties.iter().zip(&self.targets) {
                let Property::Scalar { kind, .. } = *property else { continue };
                let values = (0..chunk).map(|i| kind.decode(&self.record[i * stride + offset..], big));
                match *target {
                    Target::Axis(axis) => {
                        for (p, v) in batch.position[first..].iter_mut().zip(values) {
                            p[axis] = v;
                        }
                    }
                    Target::Column(column) => values.for_each(|v| batch.columns[column].push(v)),
                    Target::Nothing => {}
                }
                offset += kind.size();
            }
            self.next += chunk as u64;
            left -= chunk;
        }
        Ok(())
    }

    fn fill_varying(&mut self, batch: &mut PointBatch, count: usize) -> Result<(), ReadError> {
        let properties = std::mem::take(&mut self.vertex.properties);
        let targets = std::mem::take(&mut self.targets);
        let mut result = Ok(());
        for _ in 0..count {
            let mut position = [0.0; 3];
            result =
                self.read_binary_with_lists(&properties, "vertex", |index, value| match targets[index] {
                    Target::Axis(axis) => position[axis] = value,
                    Target::Column(column) => batch.columns[column].push(value),
                    Target::Nothing => {}
                });
            if result.is_err() {
                break;
            }
            batch.position.push(position);
            self.next += 1;
        }
        (self.vertex.properties, self.targets) = (properties, targets);
        result
    }
}

impl PointSource for PlySource {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        Some(self.vertex.count)
    }

    fn path(&self) -> Option<&Path> {
        Some(&self.path)
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
        self.targets = (self.vertex.properties.iter().zip(&self.property_columns))
            .map(|(property, column)| match (property, column) {
                (Property::Scalar { name, .. }, None) => axis_of(name).map_or(Target::Nothing, Target::Axis),
                (_, Some(c)) => columns.iter().position(|s| s == c).map_or(Target::Nothing, Target::Column),
                _ => Target::Nothing,
            })
            .collect();
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &self.selected);
        let count = (self.vertex.count - self.next).min(limit as u64) as usize;
        match (self.encoding, self.vertex.stride()) {
            (Encoding::Ascii, _) => self.fill_ascii(batch, count),
            (_, Some(stride)) => self.fill_fixed(batch, count, stride),
            (_, None) => self.fill_varying(batch, count),
        }
    }
}

fn axis_of(name: &str) -> Option<usize> {
    ["x", "y", "z"].iter().position(|axis| *axis == name)
}

/// The name under which a property is known here.
fn canonical(name: &str) -> &str {
    match name {
        "r" | "diffuse_red" => "red",
        "g" | "diffuse_green" => "green",
        "b" | "diffuse_blue" => "blue",
        other => other,
    }
}
