//! The columns that the fields of a PCD file make.

use super::header::{Field, Header};
use crate::points::{ColorDepth, ColumnInfo, ColumnType, Schema, Values, roles};

/// Where the numbers of a column or a coordinate are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Origin {
    pub(super) field: usize,
    /// Bytes from the start of the field.
    pub(super) at: usize,
    kind: ColumnType,
    /// The type of the number whose bits are colours, of which this is the byte at `at`.
    packed: Option<ColumnType>,
}

/// The largest whole number that three colours make.
const LARGEST_COLOR: f64 = 16_777_215.0;

/// The bits of colours in a number. Floating-point numbers have them as their own bits, which makes
/// numbers below 1e-37, or, if a program has converted them, as whole numbers.
fn packed_bits(kind: ColumnType, bytes: &[u8]) -> [u8; 4] {
    let number = if kind.is_integer() { 0.0 } else { kind.decode(bytes) };
    if kind.bytes() > 4 || (1.0..=LARGEST_COLOR).contains(&number) && number.fract() == 0.0 {
        return (number as u32).to_le_bytes();
    }
    std::array::from_fn(|i| bytes[i])
}

impl Origin {
    /// Calls `each` with the numbers of `rows` points: the field begins at byte `start` of `bytes`,
    /// and again every `stride` bytes.
    pub(super) fn coordinates(
        self,
        bytes: &[u8],
        start: usize,
        stride: usize,
        rows: usize,
    ) -> impl Iterator<Item = f64> {
        (0..rows).map(move |row| self.kind.decode(&bytes[row * stride + start + self.at..]))
    }

    /// Appends the numbers of `rows` points, as [`coordinates`](Self::coordinates) finds them.
    pub(super) fn append(self, bytes: &[u8], start: usize, stride: usize, rows: usize, column: &mut Values) {
        let fields = (0..rows).map(|row| &bytes[row * stride + start..]);
        match self.packed {
            Some(kind) => fields.for_each(|field| column.push_le_bytes(&packed_bits(kind, field)[self.at..])),
            None => fields.for_each(|field| column.push_le_bytes(&field[self.at..])),
        }
    }
}

/// The schema of a file, where x, y and z are, and where each column is.
pub(super) struct Columns {
    pub(super) schema: Schema,
    pub(super) axes: [Origin; 3],
    pub(super) origins: Vec<Origin>,
}

impl Columns {
    pub(super) fn new(header: &Header) -> Result<Self, String> {
        let names: Vec<&str> =
            header.fields.iter().map(|f| if f.count == 1 { f.name.as_str() } else { "" }).collect();
        let [Some(x), Some(y), Some(z)] = roles::axes(&names) else {
            return Err("no fields called x, y and z, of one number each".into());
        };
        let axes =
            [x, y, z].map(|field| Origin { field, at: 0, kind: header.fields[field].kind, packed: None });
        let mut columns =
            Self { schema: Schema::new(Vec::new(), ColorDepth::Guess), axes, origins: Vec::new() };
        let has_colors =
            ["red", "green", "blue"].iter().any(|c| names.iter().any(|n| n.eq_ignore_ascii_case(c)));
        for (field, info) in header.fields.iter().enumerate() {
            // A field of this name is padding.
            if [x, y, z].contains(&field) || info.name == "_" {
                continue;
            }
            match info.name.as_str() {
                "rgb" | "rgba" if is_packed(info) && !has_colors => {
                    columns.add_packed_color(field, info);
                }
                _ => columns.add_numbers(field, info),
            }
        }
        columns.schema.roles = roles::colors(&columns.schema.columns);
        let is_byte = |name: &&str| {
            let found = columns.schema.find(name);
            found.is_some_and(|column| columns.schema.columns[column].kind == ColumnType::U8)
        };
        if ["red", "green", "blue"].iter().all(is_byte) {
            columns.schema.color_depth = ColorDepth::Byte;
        }
        columns.schema.description = describe(header);
        Ok(columns)
    }

    /// Colours in the bits of a number of any type: alpha, red, green and blue, from the highest
    /// on.
    fn add_packed_color(&mut self, field: usize, info: &Field) {
        let has_alpha = info.name == "rgba";
        // With alpha, the bits of a float may be those of a whole number.
        let packed = (!has_alpha || info.kind == ColumnType::F64).then_some(info.kind);
        for (at, name) in [(2, "red"), (1, "green"), (0, "blue"), (3, "alpha")] {
            if name != "alpha" || has_alpha {
                self.add(Origin { field, at, kind: ColumnType::U8, packed }, name.to_owned());
            }
        }
    }

    fn add_numbers(&mut self, field: usize, info: &Field) {
        for part in 0..info.count {
            let origin = Origin { field, at: part * info.kind.bytes(), kind: info.kind, packed: None };
            let name = info.name.replace(char::is_control, " ");
            self.add(origin, if info.count > 1 { format!("{name}_{part}") } else { name });
        }
    }

    /// Adds a column; a name that is taken gets a number.
    fn add(&mut self, origin: Origin, name: String) {
        let columns = &mut self.schema.columns;
        let is_taken = |name: &str| columns.iter().any(|column| column.name == name);
        let free = if is_taken(&name) {
            (2..).map(|number| format!("{name}_{number}")).find(|name| !is_taken(name)).unwrap_or_default()
        } else {
            name
        };
        let is_class = roles::is_class(&free);
        let info = ColumnInfo::new(free, origin.kind);
        columns.push(if is_class { info.of_classes() } else { info });
        self.origins.push(origin);
    }
}

/// Whether a field is a number of which the bits can be colours. In double precision, it is a whole
/// number.
fn is_packed(info: &Field) -> bool {
    info.count == 1 && (info.kind.bytes() == 4 || info.kind == ColumnType::F64)
}

fn describe(header: &Header) -> String {
    let data = format!("{:?}", header.data).to_lowercase();
    let mut words = format!("PCD {} {data}", header.version);
    if !header.viewpoint.is_empty() {
        words.push_str(", seen from ");
        words.push_str(&header.viewpoint);
    }
    words
}
