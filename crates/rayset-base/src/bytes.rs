//! What values take in memory besides themselves.

/// Bytes of the memory that a list has.
#[must_use]
pub fn list_bytes<T>(list: &Vec<T>) -> usize {
    list.capacity() * size_of::<T>()
}
