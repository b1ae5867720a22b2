//! Columns of numbers in the types that files use, so that times, classes and identifiers are kept
//! exactly.

use rayset_base::bytes_of;
use rayset_base::numbers::Stored;
use rayset_base::text_numbers::TextNumber;

/// The type of the numbers of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ColumnType {
    /// 8 bits, unsigned.
    U8,
    /// 8 bits, signed.
    I8,
    /// 16 bits, unsigned.
    U16,
    /// 16 bits, signed.
    I16,
    /// 32 bits, unsigned.
    U32,
    /// 32 bits, signed.
    I32,
    /// 64 bits, unsigned.
    U64,
    /// 64 bits, signed.
    I64,
    /// IEEE 754 single precision.
    F32,
    /// IEEE 754 double precision.
    F64,
}

impl ColumnType {
    /// All types, each at the index of its [`code`](Self::code).
    pub const ALL: &[Self] = &[
        Self::U8,
        Self::I8,
        Self::U16,
        Self::I16,
        Self::U32,
        Self::I32,
        Self::U64,
        Self::I64,
        Self::F32,
        Self::F64,
    ];

    /// The type of a column of numbers of a file: that of the numbers, but single precision for
    /// half precision.
    #[doc(hidden)]
    pub fn of(stored: Stored) -> Self {
        match stored {
            Stored::I8 => Self::I8,
            Stored::U8 => Self::U8,
            Stored::I16 => Self::I16,
            Stored::U16 => Self::U16,
            Stored::I32 => Self::I32,
            Stored::U32 => Self::U32,
            Stored::I64 => Self::I64,
            Stored::U64 => Self::U64,
            Stored::F16 | Stored::F32 => Self::F32,
            Stored::F64 => Self::F64,
        }
    }

    /// The number that denotes the type in a cloud file.
    #[must_use]
    pub fn code(self) -> u8 {
        self as u8
    }

    /// Size of a value in bytes: 1, 2, 4 or 8.
    #[must_use]
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// The name, as in `u8` or `f64`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::I32 => "i32",
            Self::U64 => "u64",
            Self::I64 => "i64",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    /// Whether the type holds whole numbers only.
    #[must_use]
    pub fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    fn is_signed(self) -> bool {
        matches!(self, Self::I8 | Self::I16 | Self::I32 | Self::I64)
    }

    /// The smallest type that holds every value of both exactly. If there is none (for 64-bit
    /// integers with floats, and for [`U64`](Self::U64) with signed integers), [`F64`](Self::F64),
    /// which is exact for integers up to 2⁵³.
    #[must_use]
    pub fn common(self, other: Self) -> Self {
        if self == other {
            return self;
        }
        match (self.is_integer(), other.is_integer()) {
            (true, true) if self.is_signed() == other.is_signed() => {
                if self.bytes() > other.bytes() {
                    self
                } else {
                    other
                }
            }
            (true, true) => {
                let (signed, unsigned) = if self.is_signed() { (self, other) } else { (other, self) };
                match signed.bytes().max(2 * unsigned.bytes()) {
                    2 => Self::I16,
                    4 => Self::I32,
                    8 => Self::I64,
                    _ => Self::F64,
                }
            }
            (false, false) => Self::F64,
            (true, false) | (false, true) => {
                let (integer, float) = if self.is_integer() { (self, other) } else { (other, self) };
                if float == Self::F32 && integer.bytes() <= 2 { Self::F32 } else { Self::F64 }
            }
        }
    }

    /// Decodes a value from the first [`bytes`](Self::bytes) of `bytes`, in little-endian order.
    /// 64-bit integers beyond 2⁵³ are rounded.
    ///
    /// Panics if `bytes` is shorter.
    #[must_use]
    #[inline]
    pub fn decode(self, bytes: &[u8]) -> f64 {
        macro_rules! number {
            ($t:ty) => {{
                let mut b = [0; size_of::<$t>()];
                b.copy_from_slice(&bytes[..size_of::<$t>()]);
                <$t>::from_le_bytes(b) as f64
            }};
        }
        match self {
            Self::U8 => f64::from(bytes[0]),
            Self::I8 => f64::from(bytes[0] as i8),
            Self::U16 => number!(u16),
            Self::I16 => number!(i16),
            Self::U32 => number!(u32),
            Self::I32 => number!(i32),
            Self::U64 => number!(u64),
            Self::I64 => number!(i64),
            Self::F32 => number!(f32),
            Self::F64 => number!(f64),
        }
    }
}

impl TextNumber for ColumnType {
    fn parse(&self, text: &str) -> Option<([u8; 8], usize)> {
        match self {
            Self::U8 => bytes_of!(text, u8),
            Self::I8 => bytes_of!(text, i8),
            Self::U16 => bytes_of!(text, u16),
            Self::I16 => bytes_of!(text, i16),
            Self::U32 => bytes_of!(text, u32),
            Self::I32 => bytes_of!(text, i32),
            Self::U64 => bytes_of!(text, u64),
            Self::I64 => bytes_of!(text, i64),
            Self::F32 => bytes_of!(text, f32),
            Self::F64 => bytes_of!(text, f64),
        }
    }

    fn type_name(&self) -> String {
        self.name().to_owned()
    }
}

impl std::fmt::Display for ColumnType {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// The description of a column of a source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnInfo {
    /// Name. Colours are `red`, `green` and `blue`.
    pub name: String,
    /// Type of the numbers.
    pub kind: ColumnType,
    /// Unit as named by the file; empty if it names none.
    pub unit: String,
    /// Whether the numbers are class labels, which must not be interpolated.
    pub is_class: bool,
}

impl ColumnInfo {
    /// A column of quantities, without a unit.
    #[must_use]
    pub fn new(name: impl Into<String>, kind: ColumnType) -> Self {
        Self { name: name.into(), kind, unit: String::new(), is_class: false }
    }

    /// The same column, marked as class labels.
    #[must_use]
    pub fn of_classes(self) -> Self {
        Self { is_class: true, ..self }
    }

    /// The same column with a unit.
    #[must_use]
    pub fn with_unit(self, unit: impl Into<String>) -> Self {
        Self { unit: unit.into(), ..self }
    }
}

/// The numbers of a column, each in the column's own type.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Values {
    /// See [`ColumnType::U8`].
    U8(Vec<u8>),
    /// See [`ColumnType::I8`].
    I8(Vec<i8>),
    /// See [`ColumnType::U16`].
    U16(Vec<u16>),
    /// See [`ColumnType::I16`].
    I16(Vec<i16>),
    /// See [`ColumnType::U32`].
    U32(Vec<u32>),
    /// See [`ColumnType::I32`].
    I32(Vec<i32>),
    /// See [`ColumnType::U64`].
    U64(Vec<u64>),
    /// See [`ColumnType::I64`].
    I64(Vec<i64>),
    /// See [`ColumnType::F32`].
    F32(Vec<f32>),
    /// See [`ColumnType::F64`].
    F64(Vec<f64>),
}

/// Evaluates the same expression for the vector of any type.
macro_rules! each {
    ($values:expr, $v:ident => $what:expr) => {
        match $values {
            Values::U8($v) => $what,
            Values::I8($v) => $what,
            Values::U16($v) => $what,
            Values::I16($v) => $what,
            Values::U32($v) => $what,
            Values::I32($v) => $what,
            Values::U64($v) => $what,
            Values::I64($v) => $what,
            Values::F32($v) => $what,
            Values::F64($v) => $what,
        }
    };
}

impl Values {
    /// An empty column of the given type.
    #[must_use]
    pub fn empty(kind: ColumnType) -> Self {
        match kind {
            ColumnType::U8 => Self::U8(Vec::new()),
            ColumnType::I8 => Self::I8(Vec::new()),
            ColumnType::U16 => Self::U16(Vec::new()),
            ColumnType::I16 => Self::I16(Vec::new()),
            ColumnType::U32 => Self::U32(Vec::new()),
            ColumnType::I32 => Self::I32(Vec::new()),
            ColumnType::U64 => Self::U64(Vec::new()),
            ColumnType::I64 => Self::I64(Vec::new()),
            ColumnType::F32 => Self::F32(Vec::new()),
            ColumnType::F64 => Self::F64(Vec::new()),
        }
    }

    /// The type.
    #[must_use]
    pub fn kind(&self) -> ColumnType {
        match self {
            Self::U8(_) => ColumnType::U8,
            Self::I8(_) => ColumnType::I8,
            Self::U16(_) => ColumnType::U16,
            Self::I16(_) => ColumnType::I16,
            Self::U32(_) => ColumnType::U32,
            Self::I32(_) => ColumnType::I32,
            Self::U64(_) => ColumnType::U64,
            Self::I64(_) => ColumnType::I64,
            Self::F32(_) => ColumnType::F32,
            Self::F64(_) => ColumnType::F64,
        }
    }

    /// Number of values.
    #[must_use]
    pub fn len(&self) -> usize {
        each!(self, v => v.len())
    }

    /// Whether there are no values.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Removes all numbers but keeps the allocated memory.
    pub fn clear(&mut self) {
        each!(self, v => v.clear());
    }

    /// Number `index` as `f64`; 64-bit integers beyond 2⁵³ are rounded. Panics if `index` is out of
    /// range.
    #[must_use]
    #[inline]
    pub fn get(&self, index: usize) -> f64 {
        #[allow(clippy::unnecessary_cast, reason = "one of the types is f64")]
        {
            each!(self, v => v[index] as f64)
        }
    }

    /// Appends a number, converted as by `as`: for integers, it is truncated and clamped to the
    /// range of the type, and NaN becomes 0.
    #[inline]
    pub fn push(&mut self, value: f64) {
        each!(self, v => v.push(value as _));
    }

    /// Multiplies every number by `factor`, converted as by [`push`](Self::push).
    pub fn scale(&mut self, factor: f64) {
        #[allow(clippy::unnecessary_cast, reason = "one of the types is f64")]
        {
            each!(self, v => v.iter_mut().for_each(|x| *x = (*x as f64 * factor) as _));
        }
    }

    /// Appends the number at the start of `bytes`, in little-endian order; exact for every type.
    ///
    /// Panics if there are fewer bytes than the type has.
    #[inline]
    pub fn push_le_bytes(&mut self, bytes: &[u8]) {
        macro_rules! put {
            ($v:ident: $t:ty) => {{
                let mut b = [0; size_of::<$t>()];
                b.copy_from_slice(&bytes[..size_of::<$t>()]);
                $v.push(<$t>::from_le_bytes(b));
            }};
        }
        match self {
            Self::U8(v) => v.push(bytes[0]),
            Self::I8(v) => v.push(bytes[0] as i8),
            Self::U16(v) => put!(v: u16),
            Self::I16(v) => put!(v: i16),
            Self::U32(v) => put!(v: u32),
            Self::I32(v) => put!(v: i32),
            Self::U64(v) => put!(v: u64),
            Self::I64(v) => put!(v: i64),
            Self::F32(v) => put!(v: f32),
            Self::F64(v) => put!(v: f64),
        }
    }

    /// Appends a range of the numbers of another column.
    ///
    /// Panics if the types differ or the range extends beyond the end.
    pub fn extend_from(&mut self, other: &Self, range: std::ops::Range<usize>) {
        macro_rules! same {
            ($($kind:ident),*) => {
                match (self, other) {
                    $((Self::$kind(to), Self::$kind(from)) => to.extend_from_slice(&from[range]),)*
                    (to, from) => panic!("{} where {} was expected", from.kind(), to.kind()),
                }
            };
        }
        same!(U8, I8, U16, I16, U32, I32, U64, I64, F32, F64);
    }

    /// Appends number `index`, as a value of type `kind`, to `out` in little-endian order. The
    /// conversion is as exact as [`common`](ColumnType::common) states if `kind` is the common type
    /// of this type and others.
    #[inline]
    pub fn write_as(&self, index: usize, kind: ColumnType, out: &mut Vec<u8>) {
        if kind == self.kind() {
            each!(self, v => out.extend_from_slice(&v[index].to_le_bytes()));
            return;
        }
        macro_rules! convert {
            ($t:ty) => {
                each!(self, v => out.extend_from_slice(&(v[index] as $t).to_le_bytes()))
            };
        }
        match kind {
            ColumnType::U8 => convert!(u8),
            ColumnType::I8 => convert!(i8),
            ColumnType::U16 => convert!(u16),
            ColumnType::I16 => convert!(i16),
            ColumnType::U32 => convert!(u32),
            ColumnType::I32 => convert!(i32),
            ColumnType::U64 => convert!(u64),
            ColumnType::I64 => convert!(i64),
            ColumnType::F32 => convert!(f32),
            ColumnType::F64 => convert!(f64),
        }
    }
}

macro_rules! from_vectors {
    ($($variant:ident: $number:ty),+) => {$(
        impl From<Vec<$number>> for Values {
            fn from(values: Vec<$number>) -> Self {
                Self::$variant(values)
            }
        }
    )+};
}

from_vectors!(F32: f32, F64: f64, U8: u8, U16: u16, I32: i32, U64: u64, I64: i64);

#[cfg(test)]
mod tests {
    use super::*;

    /// Smallest and largest value, for integers.
    fn ends(kind: ColumnType) -> Option<(i128, i128)> {
        Some(match kind {
            ColumnType::U8 => (0, u8::MAX.into()),
            ColumnType::I8 => (i8::MIN.into(), i8::MAX.into()),
            ColumnType::U16 => (0, u16::MAX.into()),
            ColumnType::I16 => (i16::MIN.into(), i16::MAX.into()),
            ColumnType::U32 => (0, u32::MAX.into()),
            ColumnType::I32 => (i32::MIN.into(), i32::MAX.into()),
            ColumnType::U64 => (0, u64::MAX.into()),
            ColumnType::I64 => (i64::MIN.into(), i64::MAX.into()),
            ColumnType::F32 | ColumnType::F64 => return None,
        })
    }

    #[test]
    fn the_common_type_holds_both_and_does_not_depend_on_their_order() {
        for &a in ColumnType::ALL {
            assert_eq!(ColumnType::ALL[usize::from(a.code())], a);
            for &b in ColumnType::ALL {
                let common = a.common(b);
                assert_eq!(common, b.common(a));
                if let (Some(a), Some(b), Some(both)) = (ends(a), ends(b), ends(common)) {
                    assert!(both.0 <= a.0.min(b.0) && both.1 >= a.1.max(b.1), "{common}");
                }
            }
        }
        assert_eq!(ColumnType::U16.common(ColumnType::F32), ColumnType::F32);
        assert_eq!(ColumnType::U32.common(ColumnType::F32), ColumnType::F64);
        assert_eq!(ColumnType::U32.common(ColumnType::I8), ColumnType::I64);
        assert_eq!(ColumnType::U64.common(ColumnType::I8), ColumnType::F64);
    }

    #[test]
    fn sixty_four_bits_pass_through_bytes_unchanged() {
        let numbers = [u64::MAX, u64::MAX - 1, 1 << 53, (1 << 53) + 1];
        let (column, mut bytes) = (Values::from(numbers.to_vec()), Vec::new());
        (0..numbers.len()).for_each(|i| column.write_as(i, ColumnType::U64, &mut bytes));
        let mut back = Values::empty(ColumnType::U64);
        bytes.chunks_exact(8).for_each(|b| back.push_le_bytes(b));
        assert_eq!(back, column);
    }
}
