//! Data of zlib of a known length.

use std::io::Read;

use flate2::bufread::ZlibDecoder;

/// Decompresses zlib data of exactly the expected length, and verifies their checksum.
pub(super) fn inflate(packed: &[u8], plain: &mut [u8]) -> Result<(), String> {
    let mut decoder = ZlibDecoder::new(packed);
    let damaged = |_| "zip data that are damaged or too short".to_owned();
    decoder.read_exact(plain).map_err(damaged)?;
    match decoder.read(&mut [0]).map_err(damaged)? {
        0 => Ok(()),
        _ => Err("zip data of more values than there are".into()),
    }
}
