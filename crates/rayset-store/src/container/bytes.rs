//! Little-endian fields, one after another.

use rayset_base::geometry::DVec3;

/// Appends fields.
#[derive(Debug, Default)]
pub struct Writer {
    /// All fields so far.
    pub bytes: Vec<u8>,
}

impl Writer {
    /// Appends bytes.
    pub fn put(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }
    /// Appends a whole number of 32 bits.
    pub fn u32(&mut self, v: u32) {
        self.put(&v.to_le_bytes());
    }
    /// Appends a whole number of 64 bits.
    pub fn u64(&mut self, v: u64) {
        self.put(&v.to_le_bytes());
    }
    /// Appends a number in double precision.
    pub fn f64(&mut self, v: f64) {
        self.put(&v.to_le_bytes());
    }
    /// Appends three numbers in double precision.
    pub fn vec(&mut self, v: DVec3) {
        v.to_array().into_iter().for_each(|x| self.f64(x));
    }
    /// Appends zeros up to the next multiple of `bytes`.
    pub fn pad(&mut self, bytes: usize) {
        self.bytes.resize(self.bytes.len().next_multiple_of(bytes), 0);
    }
}

/// Reads fields; its methods return `None` if the field extends beyond the end.
pub struct Reader<'a> {
    /// All bytes.
    pub bytes: &'a [u8],
    /// Where the next field begins.
    pub at: usize,
}

impl<'a> Reader<'a> {
    /// From the first byte on.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }
    /// The next bytes.
    pub fn slice(&mut self, bytes: usize) -> Option<&'a [u8]> {
        let taken = self.bytes.get(self.at..self.at.checked_add(bytes)?)?;
        self.at += bytes;
        Some(taken)
    }
    /// The next `N` bytes.
    pub fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.slice(N)?.try_into().ok()
    }
    /// The next whole number of 32 bits.
    pub fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }
    /// The next whole number of 64 bits.
    pub fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }
    /// The next number in double precision.
    pub fn f64(&mut self) -> Option<f64> {
        self.take().map(f64::from_le_bytes)
    }
    /// The next three numbers in double precision.
    pub fn vec(&mut self) -> Option<DVec3> {
        Some(DVec3::new(self.f64()?, self.f64()?, self.f64()?))
    }
}
