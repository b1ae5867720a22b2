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
