//! The types of numbers of E57: floats, whole numbers of a range, and such as are scaled.

use e57::{RecordDataType, RecordValue};

use crate::points::{ColumnType, Values};

/// How the numbers of a field are stored.
#[derive(Clone, Copy, Debug)]
pub(super) enum Number {
    Single,
    Double,
    /// A whole number from `min` to `max`, stored as what it exceeds `min` by.
    Integer {
        min: i64,
        max: i64,
    },
    /// The same, to be scaled.
    Scaled {
        min: i64,
        max: i64,
        scale: f64,
        offset: f64,
    },
}

impl Number {
    pub(super) fn new(kind: &RecordDataType) -> Self {
        match *kind {
            RecordDataType::Single { .. } => Self::Single,
            RecordDataType::Double { .. } => Self::Double,
            RecordDataType::Integer { min, max } => Self::Integer { min, max },
            // Scaled by nothing, they stay whole.
            RecordDataType::ScaledInteger { min, max, scale, offset } if (scale, offset) == (1.0, 0.0) => {
                Self::Integer { min, max }
            }
            RecordDataType::ScaledInteger { min, max, scale, offset } => {
                Self::Scaled { min, max, scale, offset }
            }
        }
    }

    /// Size in bits, 0 to 64: none if there is only one number.
    pub(super) fn bits(self) -> usize {
        match self {
            Self::Single => 32,
            Self::Double => 64,
            Self::Integer { min, max } | Self::Scaled { min, max, .. } => {
                64 - max.wrapping_sub(min).cast_unsigned().leading_zeros() as usize
            }
        }
    }

    /// The smallest type of column that holds every number exactly.
    pub(super) fn column_type(self) -> ColumnType {
        const INTEGERS: [(ColumnType, i64, i64); 7] = [
            (ColumnType::U8, 0, u8::MAX as i64),
            (ColumnType::I8, i8::MIN as i64, i8::MAX as i64),
            (ColumnType::U16, 0, u16::MAX as i64),
            (ColumnType::I16, i16::MIN as i64, i16::MAX as i64),
            (ColumnType::U32, 0, u32::MAX as i64),
            (ColumnType::I32, i32::MIN as i64, i32::MAX as i64),
            (ColumnType::I64, i64::MIN, i64::MAX),
        ];
        match self {
            Self::Single => ColumnType::F32,
            Self::Double | Self::Scaled { .. } => ColumnType::F64,
            Self::Integer { min, max } => INTEGERS
                .iter()
                .find(|(_, least, most)| (*least..=*most).contains(&min) && (*least..=*most).contains(&max))
                .map_or(ColumnType::I64, |(kind, ..)| *kind),
        }
    }

    /// The number that `raw` bits stand for.
    pub(super) fn value(self, raw: u64) -> f64 {
        match self {
            Self::Single => f32::from_bits(raw as u32).into(),
            Self::Double => f64::from_bits(raw),
            Self::Integer { min, .. } => min.wrapping_add_unsigned(raw) as f64,
            Self::Scaled { min, scale, offset, .. } => min.wrapping_add_unsigned(raw) as f64 * scale + offset,
        }
    }

    /// Appends the number that `raw` bits stand for; exact for integers in columns of integers.
    pub(super) fn push(self, raw: u64, column: &mut Values) {
        match self {
            Self::Integer { min, .. } if column.kind().is_integer() => {
                column.push_le_bytes(&min.wrapping_add_unsigned(raw).to_le_bytes());
            }
            _ => column.push(self.value(raw)),
        }
    }

    /// The range of what can be stored; `None` for floats.
    pub(super) fn range(self) -> Option<(f64, f64)> {
        match self {
            Self::Single | Self::Double => None,
            Self::Integer { min, max } => Some((min as f64, max as f64)),
            Self::Scaled { min, max, scale, offset } => {
                let ends = [min, max].map(|end| end as f64 * scale + offset);
                Some((ends[0].min(ends[1]), ends[0].max(ends[1])))
            }
        }
    }

    /// A limit of a field of this type.
    pub(super) fn limit(self, limit: &RecordValue) -> f64 {
        match (limit, self) {
            (RecordValue::Single(value), _) => (*value).into(),
            (RecordValue::Double(value), _) => *value,
            (RecordValue::ScaledInteger(value), Self::Scaled { scale, offset, .. }) => {
                *value as f64 * scale + offset
            }
            (RecordValue::ScaledInteger(value) | RecordValue::Integer(value), _) => *value as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_takes_the_bits_of_its_range_and_the_smallest_column() {
        let whole = |min, max| {
            let number = Number::Integer { min, max };
            (number.bits(), number.column_type())
        };
        assert_eq!(whole(5, 5), (0, ColumnType::U8));
        assert_eq!(whole(0, 1), (1, ColumnType::U8));
        assert_eq!(whole(-1, 254), (8, ColumnType::I16));
        assert_eq!(whole(0, 2047), (11, ColumnType::U16));
        assert_eq!(whole(-2048, 2047), (12, ColumnType::I16));
        assert_eq!(whole(i64::MIN, i64::MAX), (64, ColumnType::I64));
        assert_eq!(Number::Integer { min: i64::MIN, max: i64::MAX }.value(u64::MAX), i64::MAX as f64);
    }
}
