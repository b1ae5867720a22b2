//! Files of VTK in XML: their elements, and the numbers of their arrays, as text, inline or
//! appended, raw or base64, plain or zlib. What volumes and points are made of them is said where
//! these are read.

mod array;
mod base64;
mod blocks;
mod document;
mod fault;

pub(crate) use self::array::{DataArray, Opened};
pub(crate) use self::blocks::Words;
pub(crate) use self::document::{Document, Group, Piece, Tag, read};
pub(crate) use self::fault::Fault;
