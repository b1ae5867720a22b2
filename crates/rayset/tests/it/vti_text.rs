//! VTI files as text, for tests.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;

pub(crate) fn zipped(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).expect("a write");
    encoder.finish().expect("it ends")
}

pub(crate) fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for chunk in bytes.chunks(3) {
        let bits = (0..3).fold(0_u32, |bits, i| bits << 8 | u32::from(chunk.get(i).copied().unwrap_or(0)));
        for i in 0..4 {
            let letter = LETTERS[(bits >> (18 - 6 * i)) as usize & 63];
            text.push(if i <= chunk.len() { letter as char } else { '=' });
        }
    }
    text
}

/// A file of 5 × 4 × 3 voxels of 16 bits with spacings of 1, 2 and 3. `array` ends the start of its
/// array, and holds its text and end if it has any; `file` is more that the file says of itself.
/// With an encoding the appended data follow.
pub(crate) fn vti(array: &str, file: &str, encoding: &str) -> String {
    let head = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\"{file}>\n\
         <ImageData WholeExtent=\"0 4 0 3 0 2\" Origin=\"0 0 0\" Spacing=\"1 2 3\">\n<Piece Extent=\"0 4 0 3 0 2\">\n\
         <PointData Scalars=\"v\">\n<DataArray type=\"Int16\" Name=\"v\" {array}\n</PointData>\n</Piece>\n</ImageData>\n"
    );
    if encoding.is_empty() {
        head + "</VTKFile>\n"
    } else {
        head + &format!("<AppendedData encoding=\"{encoding}\">\n _")
    }
}

/// Lengths as words of 4 or 8 bytes.
pub(crate) fn words(all: &[u64], width: usize) -> Vec<u8> {
    all.iter().flat_map(|n| n.to_le_bytes()[..width].to_vec()).collect()
}

/// Data in compressed blocks, with the table before them.
pub(crate) fn blocks(bytes: &[u8], block: usize, width: usize) -> Vec<u8> {
    let zipped: Vec<Vec<u8>> = bytes.chunks(block).map(zipped).collect();
    let mut head = vec![zipped.len() as u64, block as u64, (bytes.len() % block) as u64];
    head.extend(zipped.iter().map(|b| b.len() as u64));
    [words(&head, width), zipped.concat()].concat()
}
