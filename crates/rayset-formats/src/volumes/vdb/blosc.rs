//! Frames of Blosc 1 (<https://github.com/Blosc/c-blosc/blob/main/README_CHUNK_FORMAT.rst>): 16
//! bytes of header, offsets of blocks, and blocks of one or several compressed streams whose bytes
//! may be shuffled.

use super::zip::inflate;

const HEADER_BYTES: usize = 16;
/// Bits of the flags.
const SHUFFLED: u8 = 1;
const COPIED: u8 = 2;
const BITS_SHUFFLED: u8 = 4;
const WHOLE: u8 = 0x10;
/// A block is split into a stream for each byte of its values if these have at most this many
/// bytes, and each stream at least as many as the other says.
const MOST_STREAMS: usize = 16;
const LEAST_STREAM_BYTES: usize = 128;

/// Compressors, as numbered in the upper three bits of the flags.
#[derive(Clone, Copy)]
enum Codec {
    Lz4,
    Zlib,
}

/// Decompresses a frame of exactly the expected length. An error says what is wrong with it.
pub(super) fn decompress(frame: &[u8], plain: &mut [u8]) -> Result<(), String> {
    let word = |at: usize| {
        let bytes = frame.get(at..at + 4).and_then(|bytes| <[u8; 4]>::try_from(bytes).ok());
        bytes.map(|bytes| u32::from_le_bytes(bytes) as usize).ok_or("a Blosc frame that is cut off")
    };
    let (all, block_bytes) = (word(4)?, word(8)?);
    // There are twelve bytes before.
    let end = word(12)?;
    let (flags, width) = (frame[2], usize::from(frame[3]).max(1));
    if all != plain.len() || end != frame.len() {
        return Err(format!(
            "a Blosc frame of {all} bytes in {end}, where {} in {} were expected",
            plain.len(),
            frame.len()
        ));
    }
    if flags & COPIED != 0 {
        let copy = frame.get(HEADER_BYTES..).filter(|copy| copy.len() == plain.len());
        plain.copy_from_slice(copy.ok_or("a Blosc frame of the wrong length")?);
        return Ok(());
    }
    if flags & BITS_SHUFFLED != 0 {
        return Err(format!("Blosc data with shuffled bits; {ADVICE}"));
    }
    let codec = match flags >> 5 {
        1 => Codec::Lz4,
        3 => Codec::Zlib,
        other => {
            let name =
                ["BloscLZ", "LZ4", "Snappy", "zlib", "Zstandard"].get(usize::from(other)).unwrap_or(&"?");
            return Err(format!("Blosc data compressed by {name}; {ADVICE}"));
        }
    };
    if block_bytes == 0 {
        return Err("a Blosc frame with blocks of 0 bytes".into());
    }
    let mut shuffled = Vec::new();
    for (number, block) in plain.chunks_mut(block_bytes).enumerate() {
        let start = word(HEADER_BYTES + 4 * number)?;
        let splits = flags & WHOLE == 0
            && block.len() == block_bytes
            && width <= MOST_STREAMS
            && block_bytes / width >= LEAST_STREAM_BYTES;
        let streams = if splits { width } else { 1 };
        let from = frame.get(start..).ok_or("a Blosc block beyond its frame")?;
        if flags & SHUFFLED != 0 && width > 1 {
            shuffled.resize(block.len(), 0);
            decode_block(codec, from, streams, &mut shuffled)?;
            unshuffle(&shuffled, width, block);
        } else {
            decode_block(codec, from, streams, block)?;
        }
    }
    Ok(())
}

const ADVICE: &str =
    "write the file again with zip compression: `vdb_tool -read old.vdb -write codec=zip new.vdb`";

fn decode_block(codec: Codec, mut from: &[u8], streams: usize, block: &mut [u8]) -> Result<(), String> {
    let stream_bytes = block.len() / streams;
    if stream_bytes * streams != block.len() {
        return Err("a Blosc block that cannot be divided into its streams".into());
    }
    for stream in block.chunks_mut(stream_bytes.max(1)) {
        let (length, rest) = from.split_first_chunk::<4>().ok_or("a Blosc block that is cut off")?;
        let length = u32::from_le_bytes(*length) as usize;
        let packed = rest.get(..length).ok_or("a Blosc block that is cut off")?;
        from = &rest[length..];
        if length == stream_bytes {
            stream.copy_from_slice(packed);
            continue;
        }
        match codec {
            Codec::Lz4 => {
                let found = lz4_flex::block::decompress_into(packed, stream);
                if found.ok() != Some(stream_bytes) {
                    return Err("LZ4 data that are damaged".into());
                }
            }
            Codec::Zlib => inflate(packed, stream)?,
        }
    }
    Ok(())
}

/// Puts the bytes of values together again: first came the first bytes of all, then the second
/// ones. What is left after the last whole value was not shuffled.
fn unshuffle(shuffled: &[u8], width: usize, block: &mut [u8]) {
    let count = block.len() / width;
    for (number, value) in block.chunks_exact_mut(width).enumerate() {
        for (byte, to) in value.iter_mut().enumerate() {
            *to = shuffled[byte * count + number];
        }
    }
    block[count * width..].copy_from_slice(&shuffled[count * width..]);
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn frame(name: &str) -> Vec<u8> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../rayset/tests/fixtures/blosc");
        std::fs::read(folder.join(name)).expect("a fixture")
    }

    /// What is compressed in all fixtures.
    fn expected() -> Vec<u8> {
        let numbers = (0..5000_u32).flat_map(|k| (k / 3 + (k % 50).pow(3)).to_le_bytes());
        numbers.chain(*b"end").collect()
    }

    #[test]
    fn frames_of_blosc_itself_are_decompressed() {
        let expected = expected();
        for name in
            ["lz4_0", "lz4_8192", "lz4hc_0", "lz4hc_8192", "zlib_0", "zlib_8192", "plain", "wide", "copied"]
        {
            let mut plain = vec![0; expected.len()];
            assert_eq!(decompress(&frame(&format!("{name}.bin")), &mut plain), Ok(()), "{name}");
            assert!(plain == expected, "{name}");
        }
    }

    #[test]
    fn compressors_that_are_not_read_are_named() {
        for (name, said) in [("blosclz_0", "BloscLZ"), ("zstd_8192", "Zstandard"), ("bits", "shuffled bits")]
        {
            let mut plain = vec![0; expected().len()];
            let what = decompress(&frame(&format!("{name}.bin")), &mut plain).expect_err(name);
            assert!(what.contains(said) && what.contains("codec=zip"), "{what}");
        }
    }

    #[test]
    fn frames_that_are_damaged_are_errors_or_other_bytes() {
        let mut plain = vec![0; expected().len()];
        for name in ["lz4_8192.bin", "zlib_0.bin", "copied.bin"] {
            let frame = frame(name);
            for length in 0..frame.len() {
                assert!(decompress(&frame[..length], &mut plain).is_err(), "{name}: {length} bytes");
            }
            for at in 0..frame.len().min(400) {
                let mut flipped = frame.clone();
                flipped[at] ^= 1 << (at % 8);
                let _ = decompress(&flipped, &mut plain);
            }
        }
    }
}
