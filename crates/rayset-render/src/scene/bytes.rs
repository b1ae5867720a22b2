//! What a scene takes in memory, as it is given.

use std::sync::Arc;

use super::{Lighting, Node, Scene, Shape, Transfer};
use rayset_base::bytes::list_bytes;

impl Scene {
    /// Bytes of the graph, shared nodes once, and of the lights; without the files of its objects.
    pub(crate) fn bytes(&self) -> usize {
        let mut bytes = if let Lighting::Lit(lights) = &self.lighting { list_bytes(lights) } else { 0 };
        self.root.for_each_once(&mut |node| bytes += node.bytes());
        bytes
    }
}

impl Node {
    /// Bytes of the node, without those below.
    fn bytes(&self) -> usize {
        /// What the allocator keeps of the node, its lists and its object besides their contents.
        const BLOCKS: usize = 64;
        let shape = match &self.shape {
            Shape::Procedural(field) => size_of_val(&**field),
            // A list of children is copied where one of them gets a cap.
            Shape::Operator(_, children) => 2 * children.len() * size_of::<Arc<Self>>(),
            Shape::Cloud(object) => object.transfer.bytes(),
            Shape::Grid(object) => object.transfer.bytes(),
        };
        let transfers: usize = self.transfers.iter().map(Transfer::bytes).sum();
        size_of::<Self>() + BLOCKS + shape + list_bytes(&self.transfers) + transfers
    }
}

impl Transfer {
    /// Bytes that it takes besides itself.
    fn bytes(&self) -> usize {
        match self {
            Self::Opacity { curve, .. } => list_bytes(curve),
            Self::Color { map, .. } => map.bytes(),
        }
    }
}
