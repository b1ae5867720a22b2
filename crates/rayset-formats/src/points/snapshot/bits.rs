//! Numbers of datasets as their bits. The library is compiled anew for each type that it reads; it
//! is large, so that it reads bits of four sizes, whatever numbers of this size they are.

use hdf5_reader::error::Error;
use hdf5_reader::{ByteOrder, Datatype, H5Type};

/// The bits of a number, in an unsigned integer of its size.
#[derive(Clone, Copy)]
#[repr(transparent)]
pub(super) struct Bits<Word>(pub(super) Word);

/// The order of bytes in memory.
const NATIVE: ByteOrder =
    if cfg!(target_endian = "little") { ByteOrder::LittleEndian } else { ByteOrder::BigEndian };

/// The size of a datatype of numbers, and the order of its bytes.
fn layout(datatype: &Datatype) -> Option<(usize, ByteOrder)> {
    match *datatype {
        Datatype::FixedPoint { size, byte_order, .. } | Datatype::FloatingPoint { size, byte_order } => {
            Some((size.into(), byte_order))
        }
        _ => None,
    }
}

macro_rules! bits {
    ($($word:ident),*) => {$(
        impl H5Type for Bits<$word> {
            fn hdf5_type() -> Datatype {
                Datatype::FixedPoint { size: size_of::<$word>() as _, signed: false, byte_order: NATIVE }
            }

            #[inline]
            fn from_bytes(bytes: &[u8], datatype: &Datatype) -> Result<Self, Error> {
                match (bytes.first_chunk(), layout(datatype)) {
                    (Some(&bytes), Some((size, order))) if size == size_of::<$word>() => {
                        let word = $word::from_le_bytes(bytes);
                        Ok(Self(if order == ByteOrder::BigEndian { word.swap_bytes() } else { word }))
                    }
                    _ => Err(Error::InvalidData(format!(
                        "{} bytes are no number of type {datatype:?}",
                        bytes.len()
                    ))),
                }
            }

            /// The usual order of bytes, all numbers at once; numbers in the other one by one.
            fn decode_vec(raw: &[u8], datatype: &Datatype, count: usize) -> Option<Result<Vec<Self>, Error>> {
                let (words, _) = raw.as_chunks();
                let usual = layout(datatype) == Some((size_of::<$word>(), ByteOrder::LittleEndian));
                (usual && words.len() == count)
                    .then(|| Ok(words.iter().map(|&bytes| Self($word::from_le_bytes(bytes))).collect()))
            }

            fn element_size(_: &Datatype) -> usize {
                size_of::<$word>()
            }

            fn native_copy_compatible(datatype: &Datatype) -> bool {
                layout(datatype) == Some((size_of::<$word>(), NATIVE))
            }
        }
    )*};
}
bits!(u8, u16, u32, u64);

#[cfg(test)]
mod tests {
    use super::{Bits, ByteOrder, Datatype, H5Type};

    #[test]
    fn bits_are_read_in_both_orders_of_bytes_and_only_in_their_size() {
        let number = |size, byte_order| Datatype::FloatingPoint { size, byte_order };
        let bytes = [0x12, 0x34, 0x56, 0x78];
        let read = |datatype| Bits::<u32>::from_bytes(&bytes, &datatype).ok().map(|Bits(bits)| bits);
        assert_eq!(read(number(4, ByteOrder::LittleEndian)), Some(0x7856_3412));
        assert_eq!(read(number(4, ByteOrder::BigEndian)), Some(0x1234_5678));
        assert_eq!(read(number(2, ByteOrder::LittleEndian)), None);
        let all = |datatype, count| {
            let words = Bits::<u16>::decode_vec(&bytes, &datatype, count)?.ok()?;
            Some(words.into_iter().map(|Bits(bits)| bits).collect::<Vec<_>>())
        };
        assert_eq!(all(number(2, ByteOrder::LittleEndian), 2), Some(vec![0x3412, 0x7856]));
        assert_eq!(all(number(2, ByteOrder::LittleEndian), 3), None);
        assert_eq!(all(number(2, ByteOrder::BigEndian), 2), None);
        assert_eq!(all(number(4, ByteOrder::LittleEndian), 2), None);
        assert!(Bits::<u64>::from_bytes(&bytes, &number(8, ByteOrder::LittleEndian)).is_err());
        assert!(Bits::<u16>::native_copy_compatible(&Bits::<u16>::hdf5_type()));
        assert!(!Bits::<u32>::native_copy_compatible(&Bits::<u16>::hdf5_type()));
    }
}
