//! The HDF5 library as it is used here: nothing is mapped into memory, links into other files are
//! not followed, what a file says about itself allocates no more than the bounds below, and its
//! panics are errors.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use hdf5_reader::error::Error;
use hdf5_reader::group::Group;
use hdf5_reader::{
    Attribute, Dataset, Datatype, FilterRegistry, Hdf5File, OpenOptions, Storage as Bytes, StorageBuffer,
};

use crate::points::{Place, ReadError, lzf, quiet};
use rayset_base::numbers::Stored;
use rayset_store::storage::Storage;
use rayset_store::storage::input_file::InputFile;

/// Largest chunk of a dataset, in bytes. SWIFT's are up to 24 MiB.
pub(super) const MOST_CHUNK_BYTES: usize = 64 << 20;
/// Largest object header, in bytes. Ordinary ones have a few KiB.
const MOST_HEADER_BYTES: usize = 4 << 20;
/// The number that h5py registered for LZF.
const LZF: u16 = 32000;

/// A file that is read in pieces.
struct Pieces {
    file: Arc<dyn Storage>,
    length: u64,
}

impl Bytes for Pieces {
    fn len(&self) -> u64 {
        self.length
    }

    fn read_range(&self, offset: u64, length: usize) -> Result<StorageBuffer, Error> {
        let end = offset.checked_add(length as u64);
        if length > MOST_CHUNK_BYTES + (1 << 20) || end.is_none_or(|end| end > self.length) {
            return Err(Error::InvalidData(format!(
                "{length} bytes at byte {offset} are not in the file, which has {}, or are too many at once",
                self.length
            )));
        }
        let mut bytes = vec![0; length];
        self.file.read_exact_at(&mut bytes, offset)?;
        Ok(StorageBuffer::from_vec(bytes))
    }
}

/// An open file.
pub(super) struct File {
    pub(super) path: PathBuf,
    pub(super) bytes: u64,
    inner: Hdf5File,
}

impl File {
    pub(super) fn open(path: &Path) -> Result<Self, ReadError> {
        let file = InputFile::open(path).map_err(ReadError::io(path))?.into_storage();
        let bytes = file.length().map_err(ReadError::io(path))?;
        let storage: Arc<dyn Bytes> = Arc::new(Pieces { file, length: bytes });
        let mut filters = FilterRegistry::new();
        filters.register(
            LZF,
            Box::new(|_, data, _| {
                let bytes = lzf::decompress(data, MOST_CHUNK_BYTES);
                bytes.ok_or_else(|| Error::DecompressionError("LZF data are damaged".into()))
            }),
        );
        // Blocks of datasets are kept by `Blocks`, whose size is known.
        let options = OpenOptions::default()
            .with_chunk_cache_bytes(0)
            .with_max_chunk_bytes(MOST_CHUNK_BYTES)
            .with_max_read_bytes(MOST_CHUNK_BYTES)
            .with_max_object_header_bytes(MOST_HEADER_BYTES)
            .with_filter_registry(filters);
        let inner = guarded(path, 0, "", || Hdf5File::from_storage_with_options(storage, options))?;
        Ok(Self { path: path.to_owned(), bytes, inner })
    }

    /// An error at an object of the file: its address, and its name with what is wrong.
    pub(super) fn wrong(&self, address: u64, what: impl Into<String>) -> ReadError {
        ReadError::malformed(&self.path, Place::Byte(address), what)
    }

    pub(super) fn root(&self) -> Result<Group, ReadError> {
        self.guarded(0, "/", || self.inner.root_group())
    }

    /// Names of the groups and of the datasets in a group.
    pub(super) fn names(&self, group: &Group) -> Result<(Vec<String>, Vec<String>), ReadError> {
        self.guarded(group.address(), group.name(), || group.member_names())
    }

    /// A group of the root. `None` if there is none of this name.
    pub(super) fn group(&self, name: &str) -> Result<Option<Group>, ReadError> {
        let root = self.root()?;
        if !self.names(&root)?.0.iter().any(|known| known == name) {
            return Ok(None);
        }
        self.guarded(root.address(), name, || root.group(name)).map(Some)
    }

    pub(super) fn attributes(&self, group: &Group) -> Result<Attributes, ReadError> {
        self.guarded(group.address(), group.name(), || group.attributes()).map(Attributes)
    }

    /// Calls the library; its errors are those of the object at `address`.
    pub(super) fn guarded<T>(
        &self,
        address: u64,
        name: &str,
        call: impl FnOnce() -> Result<T, Error>,
    ) -> Result<T, ReadError> {
        guarded(&self.path, address, name, call)
    }
}

fn guarded<T>(
    path: &Path,
    address: u64,
    name: &str,
    call: impl FnOnce() -> Result<T, Error>,
) -> Result<T, ReadError> {
    let what = match quiet::catch(call) {
        Some(Ok(value)) => return Ok(value),
        Some(Err(Error::Io(source))) => return Err(ReadError::Io { path: path.to_owned(), source }),
        Some(Err(error)) => error.to_string(),
        None => "its structure is damaged".to_owned(),
    };
    let what: String = what.chars().map(|c| if c.is_control() { ' ' } else { c }).take(300).collect();
    let what = if name.is_empty() {
        format!("this HDF5 file cannot be read: {what}")
    } else {
        format!("{name}: {what}")
    };
    Err(ReadError::malformed(path, Place::Byte(address), what))
}

/// The attributes of a group or of a dataset.
pub(super) struct Attributes(pub(super) Vec<Attribute>);

impl Attributes {
    fn find(&self, name: &str) -> Option<&Attribute> {
        self.0.iter().find(|attribute| attribute.name == name)
    }

    /// All numbers of an attribute. `None` if there is none of this name that holds numbers.
    pub(super) fn numbers(&self, name: &str) -> Option<Vec<f64>> {
        let attribute = self.find(name)?;
        let width = attribute.raw_data.len() / usize::try_from(attribute.num_elements().ok()?).ok()?.max(1);
        // Each is decoded as an attribute of one number.
        let one = |bytes: &[u8]| Attribute { shape: Vec::new(), raw_data: bytes.to_vec(), ..bare(attribute) };
        if width == 0 {
            return None;
        }
        attribute
            .raw_data
            .chunks_exact(width)
            .map(|bytes| quiet::catch(|| one(bytes).read_as_f64().ok())?)
            .collect()
    }

    /// The first number of an attribute.
    pub(super) fn number(&self, name: &str) -> Option<f64> {
        self.numbers(name)?.first().copied()
    }

    /// A text, shortened and on one line.
    pub(super) fn text(&self, name: &str) -> Option<String> {
        let attribute = self.find(name)?;
        let text = quiet::catch(|| attribute.read_string().ok())??;
        let text: String = text.chars().filter(|c| !c.is_control()).take(80).collect();
        Some(text.trim().to_owned()).filter(|text| !text.is_empty())
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.find(name).is_some()
    }
}

fn bare(attribute: &Attribute) -> Attribute {
    Attribute {
        name: String::new(),
        datatype: attribute.datatype.clone(),
        shape: Vec::new(),
        raw_data: Vec::new(),
        decoded_strings: None,
    }
}

/// The type of the numbers of a dataset. `None` if they are none that columns hold.
pub(super) fn stored(data: &Dataset) -> Result<Option<Stored>, Error> {
    Ok(Some(match *data.dtype() {
        Datatype::FixedPoint { size: 1, signed: false, .. } => Stored::U8,
        Datatype::FixedPoint { size: 1, signed: true, .. } => Stored::I8,
        Datatype::FixedPoint { size: 2, signed: false, .. } => Stored::U16,
        Datatype::FixedPoint { size: 2, signed: true, .. } => Stored::I16,
        Datatype::FixedPoint { size: 4, signed: false, .. } => Stored::U32,
        Datatype::FixedPoint { size: 4, signed: true, .. } => Stored::I32,
        Datatype::FixedPoint { size: 8, signed: false, .. } => Stored::U64,
        Datatype::FixedPoint { size: 8, signed: true, .. } => Stored::I64,
        Datatype::FloatingPoint { size: 2, .. } if is_half(data)? => Stored::F16,
        Datatype::FloatingPoint { size: 4, .. } => Stored::F32,
        Datatype::FloatingPoint { size: 8, .. } => Stored::F64,
        _ => return Ok(None),
    }))
}

/// Places and sizes of the parts of a number of half precision, as the format has them from byte 8
/// of a datatype on: 16 bits from bit 0 on, 5 of exponent from bit 10 on, 10 of fraction from bit 0
/// on, a bias of 15.
const HALF: [u8; 12] = [0, 0, 16, 0, 10, 5, 0, 10, 15, 0, 0, 0];

/// Whether the floating-point numbers of two bytes of a dataset are of half precision; `bfloat16`
/// is not.
fn is_half(data: &Dataset) -> Result<bool, Error> {
    Ok(data.raw_datatype()?.get(8..20) == Some(&HALF[..]))
}
