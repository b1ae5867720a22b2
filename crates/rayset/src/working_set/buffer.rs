//! Page-sized memory, aligned as direct input demands.

use bytemuck::{Pod, Zeroable};

/// Alignment of buffers, offsets and lengths that direct I/O accepts on every file system in use.
pub(super) const ALIGNMENT: usize = 4096;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(4096))]
struct Block([u8; ALIGNMENT]);

/// The memory of one page, aligned to 4096 bytes.
pub struct PageBuffer(Box<[Block]>);

impl PageBuffer {
    /// Zeroed memory of at least `bytes` bytes, rounded up to a multiple of 4096.
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
