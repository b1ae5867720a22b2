//! What sorted records become: pieces, made in parallel and received in file order.

use super::error::BuildError;
use super::plan::{Cell, Event};
use super::sorted::Sorted;

/// Converts sorted records to pieces of output, in parallel.
pub(super) trait Pack: Sync {
    type Piece: Send;
    /// Converts a node with everything below it.
    fn subtree(&self, cell: Cell, records: Sorted<'_>) -> Self::Piece;
    /// Converts part of a node's own list: a multiple of 128 points, or the rest of it.
    fn own(&self, records: Sorted<'_>) -> Self::Piece;
}

/// Passes records on as they are.
pub(super) struct Copy;

impl Copy {
    fn bytes(records: Sorted<'_>) -> Vec<u8> {
        let stride = if records.len() > 0 { records.record(0).len() } else { 0 };
        let mut bytes = Vec::with_capacity(records.len() * stride);
        (0..records.len()).for_each(|i| bytes.extend_from_slice(records.record(i)));
        bytes
    }
}

impl Pack for Copy {
    type Piece = Vec<u8>;

    fn subtree(&self, _: Cell, records: Sorted<'_>) -> Vec<u8> {
        Self::bytes(records)
    }

    fn own(&self, records: Sorted<'_>) -> Vec<u8> {
        Self::bytes(records)
    }
}

/// Receives the pieces, in file order.
pub(super) trait Assemble<P> {
    fn open(&mut self, cell: Cell);
    /// Part of the own list of the open node.
    fn own(&mut self, piece: P) -> Result<(), BuildError>;
    fn subtree(&mut self, cell: Cell, piece: P) -> Result<(), BuildError>;
    fn close(&mut self) -> Result<(), BuildError>;
}

/// Opens and closes nodes; ignores stretches of points.
pub(super) fn structure<P>(event: &Event, out: &mut impl Assemble<P>) -> Result<(), BuildError> {
    match event {
        Event::Open(cell) => {
            out.open(*cell);
            Ok(())
        }
        Event::Close => out.close(),
        Event::Own { .. } | Event::Subtree { .. } => Ok(()),
    }
}
