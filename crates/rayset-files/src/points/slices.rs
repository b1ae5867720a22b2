//! Points in slices in the caller's memory, which are read in place.

use std::ops::Range;

use super::{ColorDepth, ColumnInfo, ColumnType, PointBatch, PointSource, ReadError, Schema, Values};

macro_rules! column_slice {
    ($($kind:ident: $number:ty),*) => {
        /// The numbers of a column, as a slice of one of the column types.
        #[derive(Clone, Copy, Debug)]
        pub enum ColumnSlice<'a> {
            $(
                #[doc = concat!("Of type `", stringify!($number), "`.")]
                $kind(&'a [$number]),
            )*
        }

        impl ColumnSlice<'_> {
            /// The type.
            #[must_use]
            pub fn kind(&self) -> ColumnType {
                match self { $(Self::$kind(_) => ColumnType::$kind,)* }
            }

            fn len(&self) -> usize {
                match self { $(Self::$kind(slice) => slice.len(),)* }
            }

            fn append_to(&self, to: &mut Values, range: Range<usize>) {
                match (self, to) {
                    $((Self::$kind(from), Values::$kind(to)) => to.extend_from_slice(&from[range]),)*
                    // The columns of a batch have the types of the schema, which are those of the
                    // slices.
                    (from, to) => debug_assert_eq!(from.kind(), to.kind()),
                }
            }
        }

        $(
            impl<'a> From<&'a [$number]> for ColumnSlice<'a> {
                fn from(slice: &'a [$number]) -> Self {
                    Self::$kind(slice)
                }
            }

            impl<'a> From<&'a Vec<$number>> for ColumnSlice<'a> {
                fn from(numbers: &'a Vec<$number>) -> Self {
                    Self::$kind(numbers)
                }
            }
        )*
    };
}

column_slice!(U8: u8, I8: i8, U16: u16, I16: i16, U32: u32, I32: i32, U64: u64, I64: i64, F32: f32, F64: f64);

/// Positions in a slice, in single or double precision.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub enum PositionSlice<'a> {
    /// Single precision.
    F32(&'a [[f32; 3]]),
    /// Double precision.
    F64(&'a [[f64; 3]]),
}

impl PositionSlice<'_> {
    fn len(&self) -> usize {
        match self {
            Self::F32(positions) => positions.len(),
            Self::F64(positions) => positions.len(),
        }
    }

    fn append_to(&self, to: &mut Vec<[f64; 3]>, range: Range<usize>) {
        match self {
            Self::F32(positions) => to.extend(positions[range].iter().map(|p| p.map(f64::from))),
            Self::F64(positions) => to.extend_from_slice(&positions[range]),
        }
    }
}

impl<'a> From<&'a [[f32; 3]]> for PositionSlice<'a> {
    fn from(positions: &'a [[f32; 3]]) -> Self {
        Self::F32(positions)
    }
}

impl<'a> From<&'a [[f64; 3]]> for PositionSlice<'a> {
    fn from(positions: &'a [[f64; 3]]) -> Self {
        Self::F64(positions)
    }
}

impl<'a> From<&'a Vec<[f32; 3]>> for PositionSlice<'a> {
    fn from(positions: &'a Vec<[f32; 3]>) -> Self {
        Self::F32(positions)
    }
}

impl<'a> From<&'a Vec<[f64; 3]>> for PositionSlice<'a> {
    fn from(positions: &'a Vec<[f64; 3]>) -> Self {
        Self::F64(positions)
    }
}

/// A column does not have as many values as there are positions.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("column `{name}` has {found} values, where there are {expected} positions")]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct ColumnLengthError {
    /// The column.
    pub name: String,
    /// Its length.
    pub found: usize,
    /// The number of positions.
    pub expected: usize,
}

/// Points in slices: positions, and columns of any type and name. The slices are borrowed and read
/// in place.
///
/// ```
/// # extern crate rayset_files as rayset;
/// use rayset::points::SliceSource;
///
/// let positions = vec![[0.0_f64, 0.0, 0.0], [1.0, 0.0, 0.0]];
/// let temperature = vec![280_i16, 295];
/// let radius = vec![0.5_f32, 0.6];
/// let source = SliceSource::new(&positions).radius(&radius)?.attribute("T", &temperature)?;
/// # Ok::<(), rayset::points::ColumnLengthError>(())
/// ```
#[derive(Clone, Debug)]
pub struct SliceSource<'a> {
    schema: Schema,
    position: PositionSlice<'a>,
    columns: Vec<ColumnSlice<'a>>,
    colors: Option<&'a [[f32; 3]]>,
    selected: Vec<usize>,
    next: usize,
}

impl<'a> SliceSource<'a> {
    /// Points without columns, at positions with any finite coordinates.
    #[must_use]
    pub fn new(position: impl Into<PositionSlice<'a>>) -> Self {
        Self {
            schema: Schema::new(Vec::new(), ColorDepth::Unit),
            position: position.into(),
            columns: Vec::new(),
            colors: None,
            selected: Vec::new(),
            next: 0,
        }
    }

    /// Adds a radius of influence for each point, which a build uses by default.
    ///
    /// # Errors
    /// [`ColumnLengthError`].
    pub fn radius(self, radius: impl Into<ColumnSlice<'a>>) -> Result<Self, ColumnLengthError> {
        self.attribute("radius", radius)
    }

    /// Adds a weight for each point, which a build uses by default.
    ///
    /// # Errors
    /// [`ColumnLengthError`].
    pub fn weight(self, weight: impl Into<ColumnSlice<'a>>) -> Result<Self, ColumnLengthError> {
        self.attribute("weight", weight)
    }

    /// Adds a colour for each point: display-encoded (sRGB) red, green and blue, from 0 to 1.
    ///
    /// # Errors
    /// [`ColumnLengthError`].
    pub fn color(mut self, color: &'a [[f32; 3]]) -> Result<Self, ColumnLengthError> {
        self.check("color", color.len())?;
        self.colors = Some(color);
        let first = self.columns.len();
        let channels = ["red", "green", "blue"].map(|name| ColumnInfo::new(name, ColumnType::F32));
        self.schema.columns.splice(first..self.schema.columns.len(), channels);
        Ok(self)
    }

    /// Adds a further column, which
    /// [`BuildOptions::attributes`](crate::octree::build::BuildOptions::attributes) can keep under
    /// its name.
    ///
    /// # Errors
    /// [`ColumnLengthError`].
    pub fn attribute(
        mut self,
        name: &str,
        values: impl Into<ColumnSlice<'a>>,
    ) -> Result<Self, ColumnLengthError> {
        let values = values.into();
        self.check(name, values.len())?;
        // Colours come after all other columns.
        self.schema.columns.insert(self.columns.len(), ColumnInfo::new(name, values.kind()));
        self.columns.push(values);
        Ok(self)
    }

    fn check(&self, name: &str, found: usize) -> Result<(), ColumnLengthError> {
        let expected = self.position.len();
        if found == expected {
            return Ok(());
        }
        Err(ColumnLengthError { name: name.to_owned(), found, expected })
    }
}

impl PointSource for SliceSource<'_> {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        Some(self.position.len() as u64)
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
    }

    fn can_skip(&self) -> bool {
        true
    }

    fn skip(&mut self, count: u64) -> Result<(), ReadError> {
        let left = self.position.len() - self.next;
        self.next += usize::try_from(count).unwrap_or(left).min(left);
        Ok(())
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &self.selected);
        let range = self.next..self.position.len().min(self.next.saturating_add(limit));
        self.position.append_to(&mut batch.position, range.clone());
        for (to, &index) in batch.columns.iter_mut().zip(&self.selected) {
            match (self.columns.get(index), self.colors) {
                (Some(column), _) => column.append_to(to, range.clone()),
                (None, Some(colors)) => {
                    let channel = index - self.columns.len();
                    colors[range.clone()].iter().for_each(|color| to.push(f64::from(color[channel])));
                }
                (None, None) => {}
            }
        }
        self.next = range.end;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_come_in_their_types_whatever_order_they_are_given_in() {
        let positions: Vec<[f32; 3]> = (0..10).map(|i| [i as f32, 0.0, -1.5]).collect();
        let (ids, colors) =
            ((0..10_u64).map(|i| i + (1 << 60)).collect::<Vec<_>>(), vec![[0.25, 0.5, 1.0]; 10]);
        let radius = vec![0.5_f64; 10];
        let mut source = SliceSource::new(&positions)
            .color(&colors)
            .and_then(|source| source.attribute("id", &ids))
            .and_then(|source| source.radius(&radius))
            .expect("lengths agree");
        assert_eq!(source.schema().names().collect::<Vec<_>>(), ["id", "radius", "red", "green", "blue"]);
        let find = |name: &str| source.schema().find(name).expect("it is there");
        let selected = [find("green"), find("id"), find("radius")];
        source.select(&selected);
        let mut batch = PointBatch::default();
        let mut seen = 0;
        loop {
            source.fill(&mut batch, 4).expect("points");
            if batch.is_empty() {
                break;
            }
            for i in 0..batch.len() {
                assert_eq!(batch.position[i], [(seen + i) as f64, 0.0, -1.5]);
                assert_eq!((batch.columns[0].get(i), batch.columns[2].get(i)), (0.5, 0.5));
            }
            let Values::U64(found) = &batch.columns[1] else { panic!("another type") };
            assert_eq!(*found, ids[seen..seen + batch.len()]);
            seen += batch.len();
        }
        assert_eq!(seen, 10);
        let short = SliceSource::new(&positions).weight(&vec![1.0_f32; 9]).expect_err("one is missing");
        assert_eq!(short.to_string(), "column `weight` has 9 values, where there are 10 positions");
    }
}
