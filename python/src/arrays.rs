//! Points in arrays of NumPy, which are read where they lie, whatever their strides.

use numpy::ndarray::{ArrayView1, ArrayView2};
use numpy::{
    Element, PyArrayDyn, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArray,
    PyUntypedArrayMethods,
};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyWeakrefReference;
use rayset::points::{
    ColorDepth, ColumnInfo, ColumnType, PointBatch, PointSource, ReadError, Schema, Values,
};

use crate::errors;

macro_rules! columns {
    ($($kind:ident: $number:ty),*) => {
        /// A column whose array is held.
        pub(crate) enum HeldColumn<'py> {
            $($kind(PyReadonlyArray1<'py, $number>),)*
        }

        /// The numbers of a column.
        #[derive(Clone, Copy)]
        pub(crate) enum ColumnView<'a> {
            $($kind(ArrayView1<'a, $number>),)*
        }

        impl<'py> HeldColumn<'py> {
            /// An array of one axis of one of the column types.
            pub(crate) fn new(name: &str, array: &Bound<'py, PyUntypedArray>) -> PyResult<Self> {
                $(if let Some(held) = held::<$number, _>(array, |a| a.try_readonly().ok()) {
                    return Ok(Self::$kind(held));
                })*
                Err(errors::value(format!(
                    "{name}: an array of {} and {} axes where one of numbers and one axis was expected",
                    array.dtype(),
                    array.ndim()
                )))
            }

            pub(crate) fn view(&self) -> ColumnView<'_> {
                match self { $(Self::$kind(array) => ColumnView::$kind(array.as_array()),)* }
            }
        }

        impl ColumnView<'_> {
            pub(crate) fn kind(&self) -> ColumnType {
                match self { $(Self::$kind(_) => ColumnType::$kind,)* }
            }

            pub(crate) fn len(&self) -> usize {
                match self { $(Self::$kind(view) => view.len(),)* }
            }

            pub(crate) fn append_to(&self, to: &mut Values, from: usize, end: usize) {
                match (self, to) {
                    $((Self::$kind(view), Values::$kind(to)) => match view.as_slice() {
                        Some(slice) => to.extend_from_slice(&slice[from..end]),
                        None => to.extend((from..end).map(|i| view[i])),
                    },)*
                    // The columns of a batch have the types of the schema, which are those of the
                    // arrays.
                    (_, _) => debug_assert!(false, "a column of another type"),
                }
            }
        }
    };
}

columns!(U8: u8, I8: i8, U16: u16, I16: i16, U32: u32, I32: i32, U64: u64, I64: i64, F32: f32, F64: f64);

/// An array whose numbers stay where they are while this exists.
///
/// It is a view of the caller's array, so that no change of shape reaches it. Every array that the
/// numbers belong to has a weak reference: NumPy then refuses to resize it, also with
/// `refcheck=False`, which would give back memory that is being read.
pub(crate) struct Pinned<'py> {
    array: Bound<'py, PyUntypedArray>,
    _owners: Vec<Bound<'py, PyWeakrefReference>>,
}

impl<'py> Pinned<'py> {
    pub(crate) fn new(array: &Bound<'py, PyUntypedArray>) -> PyResult<Self> {
        let py = array.py();
        let view = array.as_any().call_method0("view")?;
        let mut owners = Vec::new();
        let mut base = array.as_any().clone();
        while base.is_instance_of::<PyUntypedArray>() {
            owners.push(PyWeakrefReference::new(&base)?);
            base = base.getattr(intern!(py, "base"))?;
        }
        Ok(Self { array: view.cast_into()?, _owners: owners })
    }

    pub(crate) fn array(&self) -> &Bound<'py, PyUntypedArray> {
        &self.array
    }
}

/// An array as one of a type and one axis, if it is one.
fn held<'py, T: Element, H>(
    array: &Bound<'py, PyUntypedArray>,
    hold: impl FnOnce(&Bound<'py, numpy::PyArray1<T>>) -> Option<H>,
) -> Option<H> {
    let typed = array.cast::<PyArrayDyn<T>>().ok()?;
    let one = typed.as_any().cast::<numpy::PyArray1<T>>().ok()?;
    hold(one)
}

/// Positions whose array is held.
pub(crate) enum HeldPositions<'py> {
    F32(PyReadonlyArray2<'py, f32>),
    F64(PyReadonlyArray2<'py, f64>),
}

/// Positions, a row each.
#[derive(Clone, Copy)]
pub(crate) enum PositionView<'a> {
    F32(ArrayView2<'a, f32>),
    F64(ArrayView2<'a, f64>),
}

impl<'py> HeldPositions<'py> {
    /// An array of rows of three coordinates.
    pub(crate) fn new(array: &Bound<'py, PyUntypedArray>) -> PyResult<Self> {
        let any = array.as_any();
        let single = any.cast::<numpy::PyArray2<f32>>().ok().and_then(|a| a.try_readonly().ok());
        let double = || any.cast::<numpy::PyArray2<f64>>().ok().and_then(|a| a.try_readonly().ok());
        let held = single.map(Self::F32).or_else(|| double().map(Self::F64));
        let fits = |held: &Self| held.view().has_three_columns();
        held.filter(fits).ok_or_else(|| {
            let (shape, kind) = (array.shape(), array.dtype());
            errors::value(format!("positions: expected N rows of three numbers, and got {shape:?} of {kind}"))
        })
    }

    pub(crate) fn view(&self) -> PositionView<'_> {
        match self {
            Self::F32(array) => PositionView::F32(array.as_array()),
            Self::F64(array) => PositionView::F64(array.as_array()),
        }
    }
}

impl PositionView<'_> {
    fn has_three_columns(&self) -> bool {
        match self {
            Self::F32(view) => view.ncols() == 3,
            Self::F64(view) => view.ncols() == 3,
        }
    }

    pub(crate) fn len(&self) -> usize {
        match self {
            Self::F32(view) => view.nrows(),
            Self::F64(view) => view.nrows(),
        }
    }

    pub(crate) fn append_to(&self, to: &mut Vec<[f64; 3]>, from: usize, end: usize) {
        match self {
            Self::F32(view) => append_rows(*view, to, from, end),
            Self::F64(view) => append_rows(*view, to, from, end),
        }
    }
}

fn append_rows<T: Copy + Into<f64>>(
    view: ArrayView2<'_, T>,
    to: &mut Vec<[f64; 3]>,
    from: usize,
    end: usize,
) {
    match view.to_slice() {
        Some(slice) => {
            let rows = slice[3 * from..3 * end].chunks_exact(3);
            to.extend(rows.map(|p| [p[0].into(), p[1].into(), p[2].into()]));
        }
        None => to.extend((from..end).map(|i| [0, 1, 2].map(|axis| view[[i, axis]].into()))),
    }
}

/// What a column is besides its numbers: its name, its unit, whether its numbers are labels of
/// classes.
#[derive(Clone, FromPyObject)]
pub(crate) struct Named {
    #[pyo3(item)]
    pub(crate) name: String,
    #[pyo3(item)]
    pub(crate) unit: String,
    #[pyo3(item)]
    pub(crate) is_class: bool,
}

/// The schema of columns.
pub(crate) fn schema(columns: impl Iterator<Item = (Named, ColumnType)>) -> Schema {
    let mut byte_colors = true;
    let columns: Vec<ColumnInfo> = columns
        .map(|(named, kind)| {
            if named.name == "red" {
                byte_colors = kind == ColumnType::U8;
            }
            let info = ColumnInfo::new(named.name, kind).with_unit(named.unit);
            if named.is_class { info.of_classes() } else { info }
        })
        .collect();
    // Colours come as bytes, or as numbers of 0 to 1.
    Schema::new(columns, if byte_colors { ColorDepth::Byte } else { ColorDepth::Unit })
}

/// Points in arrays.
pub(crate) struct ArraySource<'a> {
    schema: Schema,
    position: PositionView<'a>,
    columns: Vec<ColumnView<'a>>,
    selected: Vec<usize>,
    next: usize,
}

impl<'a> ArraySource<'a> {
    /// Columns are as long as the positions.
    pub(crate) fn new(position: PositionView<'a>, columns: Vec<(Named, ColumnView<'a>)>) -> PyResult<Self> {
        let count = position.len();
        if let Some((named, wrong)) = columns.iter().find(|(_, view)| view.len() != count) {
            let (name, found) = (&named.name, wrong.len());
            return Err(errors::value(format!(
                "{name} has {found} values, where there are {count} positions"
            )));
        }
        let schema = schema(columns.iter().map(|(named, view)| (named.clone(), view.kind())));
        let columns = columns.into_iter().map(|(_, view)| view).collect();
        Ok(Self { schema, position, columns, selected: Vec::new(), next: 0 })
    }
}

impl PointSource for ArraySource<'_> {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        Some(self.position.len() as u64)
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &self.selected);
        let end = self.position.len().min(self.next.saturating_add(limit));
        self.position.append_to(&mut batch.position, self.next, end);
        for (&column, to) in self.selected.iter().zip(&mut batch.columns) {
            self.columns[column].append_to(to, self.next, end);
        }
        self.next = end;
        Ok(())
    }
}
