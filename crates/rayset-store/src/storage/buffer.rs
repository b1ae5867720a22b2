//! Page-sized memory, aligned for direct I/O.

use bytemuck::{Pod, Zeroable};
use memmap2::MmapMut;

/// Alignment of memory that direct I/O requires: a logical sector. Offsets and lengths of pages are
/// multiples of 4096 by the file format.
const ALIGNMENT: usize = 512;

/// Bytes that a page may take besides its own: tables of the operating system and lists of free
/// memory.
pub const OVERHEAD_BYTES: u64 = 256;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(512))]
struct Block([u8; ALIGNMENT]);

/// The memory of one page, aligned to 512 bytes.
///
/// It is mapped by itself, not taken from the allocator's heap. There, pages of different sizes
/// that take each other's place would leave gaps, small allocations would settle in them, and the
/// process would outgrow its budget.
pub struct PageBuffer(Memory);

enum Memory {
    Mapped(MmapMut),
    /// Of pages that could not be mapped: systems limit the number of mappings.
    Allocated(Box<[Block]>),
}

impl PageBuffer {
    /// Zeroed memory of at least `bytes` bytes, rounded up to a multiple of 512.
    #[must_use]
    pub fn new(bytes: usize) -> Self {
        let blocks = bytes.div_ceil(ALIGNMENT);
        if blocks > 0
            && let Ok(mapped) = MmapMut::map_anon(blocks * ALIGNMENT)
        {
            return Self(Memory::Mapped(mapped));
        }
        Self(Memory::Allocated(vec![Block::zeroed(); blocks].into_boxed_slice()))
    }

    /// The bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        match &self.0 {
            Memory::Mapped(mapped) => mapped,
            Memory::Allocated(blocks) => bytemuck::cast_slice(blocks),
        }
    }

    /// The bytes, to be read into.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        match &mut self.0 {
            Memory::Mapped(mapped) => mapped,
            Memory::Allocated(blocks) => bytemuck::cast_slice_mut(blocks),
        }
    }
}

impl std::fmt::Debug for PageBuffer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "PageBuffer({} bytes)", self.bytes().len())
    }
}
