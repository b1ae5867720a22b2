//! Page-sized memory, aligned for direct I/O.

use bytemuck::{Pod, Zeroable};

/// Alignment of memory that direct I/O requires: a logical sector. Offsets and lengths of pages are multiples of 4096
/// by the file format; memory aligned to that as well would cost every page another 4096 bytes in the allocator.
const ALIGNMENT: usize = 512;

/// Bytes that the allocator may need in addition to a page.
pub const OVERHEAD_BYTES: u64 = 2 * ALIGNMENT as u64;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(512))]
struct Block([u8; ALIGNMENT]);

/// The memory of one page, aligned to 512 bytes.
pub struct PageBuffer(Box<[Block]>);

impl PageBuffer {
    /// Zeroed memory of at least `bytes` bytes, rounded up to a multiple of 512.
    #[must_use]
    pub fn new(bytes: usize) -> Self {
        Self(vec![Block::zeroed(); bytes.div_ceil(ALIGNMENT)].into_boxed_slice())
    }

    /// The bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.0)
    }

    /// The bytes, to be read into.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        bytemuck::cast_slice_mut(&mut self.0)
    }
}

impl std::fmt::Debug for PageBuffer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "PageBuffer({} bytes)", self.bytes().len())
    }
}
