//! Bytes in memory as a storage.

use std::io;
use std::sync::Arc;

use super::transport::{Storage, ends_early};

/// Bytes in memory: a vector, a shared slice, a memory-mapped file.
#[derive(Clone)]
pub struct MemoryStorage(Arc<dyn AsRef<[u8]> + Send + Sync>);

impl MemoryStorage {
    /// Wraps bytes, which must not change during the lifetime of this storage.
    #[must_use]
    pub fn new(bytes: Arc<dyn AsRef<[u8]> + Send + Sync>) -> Self {
        Self(bytes)
    }
}

impl std::fmt::Debug for MemoryStorage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "MemoryStorage({} bytes)", (*self.0).as_ref().len())
    }
}

impl Storage for MemoryStorage {
    fn length(&self) -> io::Result<u64> {
        Ok((*self.0).as_ref().len() as u64)
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let bytes = (*self.0).as_ref();
        let end = offset.saturating_add(buffer.len() as u64);
        let start = usize::try_from(offset).ok();
        let found = start.and_then(|start| bytes.get(start..start.checked_add(buffer.len())?));
        let found = found.ok_or_else(|| ends_early(bytes.len() as u64, end))?;
        buffer.copy_from_slice(found);
        Ok(())
    }

    fn memory(&self) -> Option<Arc<dyn AsRef<[u8]> + Send + Sync>> {
        Some(self.0.clone())
    }
}
