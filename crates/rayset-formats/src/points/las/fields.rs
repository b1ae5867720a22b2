//! The columns of each point format, and of extra bytes.

use laz::DecompressionSelection as Layers;

use super::header::Header;
use super::words::text;
use crate::points::{ColumnInfo, ColumnType, Values};

/// Unit of the scan angle of point formats 6 to 10, in degrees.
const SCAN_ANGLE_DEGREES: f64 = 0.006;
/// Size in bytes of a descriptor of extra bytes.
const DESCRIPTOR_BYTES: usize = 192;

/// A column, and how its value is read from a record.
pub(super) struct Field {
    pub(super) info: ColumnInfo,
    /// Bits of the layers of compressed points that contain it.
    pub(super) layers: u32,
    rule: Rule,
}

enum Rule {
    /// A number of the column's type.
    Plain { at: usize },
    /// A bit field within a byte.
    Bits { at: usize, shift: u8, mask: u8 },
    /// A signed 16-bit number of units of [`SCAN_ANGLE_DEGREES`].
    ScanAngle { at: usize },
    /// A number of type `kind`, with scale and offset applied; NaN if it equals `no_data`.
    Scaled { at: usize, kind: ColumnType, no_data: Option<[u8; 8]>, scale: f64, offset: f64 },
}

impl Field {
    fn new(name: &str, layers: u32, kind: ColumnType, rule: Rule) -> Self {
        Self { info: ColumnInfo::new(name, kind), layers, rule }
    }

    fn plain(name: &str, layers: u32, kind: ColumnType, at: usize) -> Self {
        Self::new(name, layers, kind, Rule::Plain { at })
    }

    fn bits(name: &str, layers: u32, at: usize, shift: u8, width: u8) -> Self {
        Self::new(name, layers, ColumnType::U8, Rule::Bits { at, shift, mask: (1 << width) - 1 })
    }

    /// Appends the numbers of records to a column of this field's type.
    pub(super) fn append(&self, records: &[u8], record_bytes: usize, column: &mut Values) {
        let records = records.chunks_exact(record_bytes);
        match self.rule {
            Rule::Plain { at } => match column {
                Values::U8(v) => v.extend(records.map(|r| r[at])),
                Values::U16(v) => v.extend(records.map(|r| u16::from_le_bytes([r[at], r[at + 1]]))),
                _ => records.for_each(|r| column.push_le_bytes(&r[at..])),
            },
            Rule::Bits { at, shift, mask } => {
                records.for_each(|r| column.push_le_bytes(&[r[at] >> shift & mask]));
            }
            Rule::ScanAngle { at } => {
                let steps = |r: &[u8]| f64::from(i16::from_le_bytes([r[at], r[at + 1]]));
                records.for_each(|r| column.push(steps(r) * SCAN_ANGLE_DEGREES));
            }
            Rule::Scaled { at, kind, no_data, scale, offset } => records.for_each(|r| {
                let bytes = &r[at..];
                let missing = no_data.is_some_and(|no_data| is_same(kind, bytes, no_data));
                column.push(if missing { f64::NAN } else { kind.decode(bytes) * scale + offset });
            }),
        }
    }
}

/// Whether a number equals one that a descriptor stores in 8 bytes, as the widest type (unsigned,
/// signed or float) of its kind.
fn is_same(kind: ColumnType, bytes: &[u8], wide: [u8; 8]) -> bool {
    let size = kind.bytes();
    if !kind.is_integer() {
        return kind.decode(bytes) == f64::from_le_bytes(wide);
    }
    let is_signed = matches!(kind, ColumnType::I8 | ColumnType::I16 | ColumnType::I32 | ColumnType::I64);
    let fill = if is_signed && bytes[size - 1] >= 128 { 255 } else { 0 };
    bytes[..size] == wide[..size] && wide[size..].iter().all(|&b| b == fill)
}

/// All columns of a file: the six that every format has, the colours, the other columns of its
/// point format, and those of its extra bytes. Names are unique.
pub(super) fn of_file(header: &Header, extra_bytes: Option<&[u8]>) -> Vec<Field> {
    let mut fields = of_format(header.format);
    let start = header.record_bytes - header.extra_bytes();
    if let Some(descriptors) = extra_bytes {
        for field in of_extra_bytes(descriptors, start, header.record_bytes) {
            let name = field.info.name.clone();
            let is_taken = |name: &str, fields: &[Field]| fields.iter().any(|f| f.info.name == name);
            let mut free = name.clone();
            let mut number = 2;
            while is_taken(&free, &fields) {
                free = format!("{name}_{number}");
                number += 1;
            }
            let info = ColumnInfo { name: free, ..field.info };
            fields.push(Field { info, ..field });
        }
    }
    fields
}

fn of_format(format: u8) -> Vec<Field> {
    use ColumnType::{F32, F64, I8, U8, U16};
    let is_extended = format >= 6;
    let returns = if is_extended { 4 } else { 3 };
    let classification = if is_extended {
        Field::plain("classification", Layers::CLASSIFICATION, U8, 16)
    } else {
        Field::bits("classification", Layers::CLASSIFICATION, 15, 0, 5)
    };
    let mut fields = vec![
        Field::plain("intensity", Layers::INTENSITY, U16, 12),
        Field { info: classification.info.clone().of_classes(), ..classification },
        Field::bits("return_number", 0, 14, 0, returns),
        Field::bits("number_of_returns", 0, 14, returns, returns),
        Field::plain("user_data", Layers::USER_DATA, U8, 17),
        Field::plain("point_source_id", Layers::POINT_SOURCE_ID, U16, if is_extended { 20 } else { 18 }),
    ];
    let colors = match format {
        2 => Some(20),
        3 | 5 => Some(28),
        7 | 8 | 10 => Some(30),
        _ => None,
    };
    if let Some(at) = colors {
        let place = |(i, name)| Field::plain(name, Layers::RGB, U16, at + 2 * i);
        fields.extend(["red", "green", "blue"].into_iter().enumerate().map(place));
    }
    if matches!(format, 8 | 10) {
        fields.push(Field::plain("nir", Layers::NIR, U16, 36));
    }
    let (flags, first) = if is_extended { (15, 0) } else { (15, 5) };
    let layer = if is_extended { Layers::FLAGS } else { Layers::CLASSIFICATION };
    for (bit, name) in ["synthetic", "key_point", "withheld"].into_iter().enumerate() {
        fields.push(Field::bits(name, layer, flags, first + bit as u8, 1));
    }
    let angle = if is_extended {
        fields.push(Field::bits("overlap", Layers::FLAGS, 15, 3, 1));
        fields.push(Field::bits("scanner_channel", 0, 15, 4, 2));
        Field::new("scan_angle", Layers::SCAN_ANGLE, F32, Rule::ScanAngle { at: 18 })
    } else {
        Field::plain("scan_angle_rank", Layers::SCAN_ANGLE, I8, 16)
    };
    fields.push(Field { info: angle.info.clone().with_unit("deg"), ..angle });
    let time = match format {
        0 | 2 => None,
        1 | 3 | 4 | 5 => Some(20),
        _ => Some(22),
    };
    if let Some(at) = time {
        let time = Field::plain("gps_time", Layers::GPS_TIME, F64, at);
        fields.push(Field { info: time.info.clone().with_unit("s"), ..time });
    }
    let (scan, layer) = if is_extended { (15, Layers::FLAGS) } else { (14, 0) };
    fields.push(Field::bits("scan_direction_flag", layer, scan, 6, 1));
    fields.push(Field::bits("edge_of_flight_line", layer, scan, 7, 1));
    fields
}

/// The columns that descriptors of extra bytes define, from byte `at` of a record to byte `end`.
/// Descriptors that exceed the record are ignored, and so are undocumented bytes.
fn of_extra_bytes(descriptors: &[u8], mut at: usize, end: usize) -> Vec<Field> {
    use ColumnType::{F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
    const TYPES: [ColumnType; 10] = [U8, I8, U16, I16, U32, I32, U64, I64, F32, F64];
    let mut fields = Vec::new();
    for (number, descriptor) in descriptors.chunks_exact(DESCRIPTOR_BYTES).enumerate() {
        let (code, options) = (descriptor[2], descriptor[3]);
        let (kind, length) = match code {
            1..=30 => (TYPES[usize::from(code - 1) % 10], usize::from(code - 1) / 10 + 1),
            // Undocumented bytes, whose number is in the options. All other codes are reserved, and
            // their lengths are unknown.
            0 => {
                at += usize::from(options);
                continue;
            }
            _ => break,
        };
        if at + kind.bytes() * length > end {
            break;
        }
        let mut name = text(&descriptor[4..36]);
        if name.is_empty() {
            name = format!("extra_{}", number + 1);
        }
        let unit = unit(&text(&descriptor[160..192]));
        for part in 0..length {
            let wide: [u8; 8] = std::array::from_fn(|i| descriptor[40 + 8 * part + i]);
            let float = |start: usize| {
                let bytes = std::array::from_fn(|i| descriptor[start + 8 * part + i]);
                f64::from_le_bytes(bytes)
            };
            let no_data = (options & 1 != 0).then_some(wide);
            // A scale of zero or a scale that is not finite cannot be intended.
            let scale = Some(float(112)).filter(|s| options & 8 != 0 && s.is_finite() && *s != 0.0);
            let offset = Some(float(136)).filter(|o| options & 16 != 0 && o.is_finite());
            let is_scaled = scale.is_some() || offset.is_some();
            let rule = if is_scaled || (no_data.is_some() && !kind.is_integer()) {
                let (scale, offset) = (scale.unwrap_or(1.0), offset.unwrap_or(0.0));
                Rule::Scaled { at, kind, no_data, scale, offset }
            } else {
                Rule::Plain { at }
            };
            let name = if length > 1 { format!("{name}_{part}") } else { name.clone() };
            let result = if is_scaled { F64 } else { kind };
            let field = Field::new(&name, Layers::ALL_EXTRA_BYTES, result, rule);
            fields.push(Field { info: field.info.clone().with_unit(unit.clone()), ..field });
            at += kind.bytes();
        }
    }
    fields
}

/// The unit in brackets at the end of a description, as in `Echo signal amplitude [dB]`; empty if
/// there is none.
fn unit(description: &str) -> String {
    let inner = description.strip_suffix(']').and_then(|d| d.rsplit_once('['));
    inner.map_or_else(String::new, |(_, unit)| unit.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_what_descriptions_end_with_in_brackets() {
        assert_eq!(unit("Echo signal amplitude [dB]"), "dB");
        assert_eq!(unit("height [m] above ground"), "");
        assert_eq!(unit("]"), "");
    }

    #[test]
    fn missing_data_is_compared_in_the_widest_type_of_its_kind() {
        let signed = (-9999_i64).to_le_bytes();
        assert!(is_same(ColumnType::I16, &(-9999_i16).to_le_bytes(), signed));
        assert!(is_same(ColumnType::I64, &signed, signed));
        assert!(!is_same(ColumnType::U16, &(-9999_i16).to_le_bytes(), signed));
        assert!(!is_same(ColumnType::I16, &9999_i16.to_le_bytes(), signed));
        let float = f64::from(-1.5_f32).to_le_bytes();
        assert!(is_same(ColumnType::F32, &(-1.5_f32).to_le_bytes(), float));
        assert!(is_same(ColumnType::U8, &[255], 255_u64.to_le_bytes()));
    }
}
