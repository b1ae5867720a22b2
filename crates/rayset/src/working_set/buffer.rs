//! Page-sized memory, aligned as direct input demands.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

/// Alignment of memory that direct I/O asks for: a logical sector. Offsets and lengths of pages are multiples of 4096 by
/// the file format; memory aligned to that as well would cost every page another 4096 bytes in the allocator.
const ALIGNMENT: usize = 512;

/// What the allocator may take beside a page.
pub const OVERHEAD_BYTES: u64 = 2 * ALIGNMENT as u64;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(512))]
struct Block([u8; ALIGNMENT]);

/// The memory of one page: its own, aligned to 512 bytes, or a part of somebody else's.
pub struct PageBuffer(Memory);

enum Memory {
    Own(Box<[Block]>),
    Shared(Arc<dyn AsRef<[u8]> + Send + Sync>, Range<usize>),
}

impl PageBuffer {
    /// Zeroed memory of at least `bytes` bytes, rounded up to a multiple of 512.
    #[must_use]
    pub fn new(bytes: usize) -> Self {
        Self(Memory::Own(vec![Block::zeroed(); bytes.div_ceil(ALIGNMENT)].into_boxed_slice()))
    }

    /// A part of memory that somebody has already, such as a map of a file, so that a page need not be copied. Nothing where
    /// it has no such part.
    #[must_use]
    pub fn shared(memory: Arc<dyn AsRef<[u8]> + Send + Sync>, part: Range<usize>) -> Option<Self> {
        (*memory).as_ref().get(part.clone())?;
        Some(Self(Memory::Shared(memory, part)))
    }

    /// The bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        match &self.0 {
            Memory::Own(blocks) => bytemuck::cast_slice(blocks),
            // Memory that changes its length behind our back has no such part any more.
            Memory::Shared(memory, part) => (**memory).as_ref().get(part.clone()).unwrap_or(&[]),
        }
    }

    /// The bytes, to be read into. Shared memory is copied first.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        if let Memory::Shared(..) = self.0 {
            let mut own = Self::new(self.bytes().len());
            let bytes = self.bytes();
            own.bytes_mut()[..bytes.len()].copy_from_slice(bytes);
            *self = own;
        }
        match &mut self.0 {
            Memory::Own(blocks) => bytemuck::cast_slice_mut(blocks),
            Memory::Shared(..) => &mut [],
        }
    }
}

impl std::fmt::Debug for PageBuffer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "PageBuffer({} bytes)", self.bytes().len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shared_memory_is_read_where_it_is_and_copied_before_it_is_written() {
        let memory: Arc<Vec<u8>> = Arc::new((0..200).collect());
        let mut buffer = PageBuffer::shared(memory.clone(), 10..50).expect("a part");
        assert_eq!(buffer.bytes().as_ptr(), memory[10..].as_ptr());
        buffer.bytes_mut()[0] = 99;
        assert_eq!((buffer.bytes()[0], buffer.bytes()[39], memory[10]), (99, 49, 10));
        assert!(PageBuffer::shared(memory, 100..201).is_none());
    }
}
