//! Distinguishes the pages of one file from those of another: a hash of the input and the options
//! from which the file was built.

use std::fmt;

use xxhash_rust::xxh3::{Xxh3, xxh3_128};

/// Part of every identity, so that a later builder with another page layout gives the same input
/// another identity.
const LAYOUT_REVISION: u32 = 1;

/// The identity of a file: equal for equal content, regardless of the order of the inputs and of
/// the threads and memory of the build.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Identity(pub [u8; 16]);

impl Identity {
    /// The CRC-32C of the identity, with which the checksum of every page starts.
    #[must_use]
    pub fn seed(&self) -> u32 {
        crc32c::crc32c(&self.0)
    }
}

impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// A hash of a record; sums of it do not depend on the order of records, and that of all records is
/// the lowest of [`RecordSum::to_words`].
pub fn record_hash(record: &[u8]) -> u64 {
    xxh3_128(record) as u64
}

/// The sum of the hashes of records, which does not depend on their order.
#[derive(Clone, Copy, Debug, Default)]
pub struct RecordSum {
    sum: u128,
    count: u64,
}

impl RecordSum {
    /// Adds a record. Returns a hash of it.
    pub fn include(&mut self, record: &[u8]) -> u64 {
        let hash = xxh3_128(record);
        self.sum = self.sum.wrapping_add(hash);
        self.count += 1;
        hash as u64
    }

    /// The sum and the count as numbers of 64 bits, lower half first.
    pub fn to_words(self) -> [u64; 3] {
        [self.sum as u64, (self.sum >> 64) as u64, self.count]
    }

    /// From what [`to_words`](Self::to_words) returned.
    #[must_use]
    pub fn from_words([low, high, count]: [u64; 3]) -> Self {
        Self { sum: u128::from(high) << 64 | u128::from(low), count }
    }

    /// Includes the records of another sum.
    pub fn merge(&mut self, other: Self) {
        self.sum = self.sum.wrapping_add(other.sum);
        self.count += other.count;
    }

    /// The identity of a file made from these records and from `options`, which state everything
    /// else that its pages depend on.
    pub fn identity(self, options: &str) -> Identity {
        let mut hash = StreamHash::new(options);
        hash.update(&self.sum.to_le_bytes());
        hash.update(&self.count.to_le_bytes());
        hash.identity()
    }
}

/// A hash of a sequence of bytes.
#[derive(Clone)]
pub struct StreamHash(Xxh3);

impl StreamHash {
    /// A hash that begins with `options`.
    #[must_use]
    pub fn new(options: &str) -> Self {
        let mut hash = Xxh3::new();
        hash.update(&LAYOUT_REVISION.to_le_bytes());
        hash.update(&(options.len() as u64).to_le_bytes());
        hash.update(options.as_bytes());
        Self(hash)
    }

    /// Appends bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The identity of a file that is made of the bytes so far.
    #[must_use]
    pub fn identity(&self) -> Identity {
        Identity(self.0.digest128().to_le_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_order_of_records_makes_no_other_identity_and_everything_else_does() {
        let of = |records: &[&[u8]], options: &str| {
            let mut sum = RecordSum::default();
            records.iter().for_each(|r| _ = sum.include(r));
            sum.identity(options)
        };
        let identity = of(&[b"a", b"b", b"b"], "radius 1");
        assert_eq!(identity, of(&[b"b", b"a", b"b"], "radius 1"));
        assert_ne!(identity, of(&[b"a", b"b"], "radius 1"));
        assert_ne!(identity, of(&[b"a", b"a", b"b"], "radius 1"));
        assert_ne!(identity, of(&[b"a", b"b", b"b"], "radius 2"));
        assert_eq!(identity.to_string().len(), 32);
    }
}
