//! LZF, the compression of h5py's filter `lzf`: literals, and references to at most 8 KiB back.

/// Decompresses into at most `limit` bytes. `None` if the data are damaged or longer.
pub(super) fn decompress(mut data: &[u8], limit: usize) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(limit.min(data.len().saturating_mul(4)));
    let byte = |data: &mut &[u8]| {
        let (&first, rest) = data.split_first()?;
        *data = rest;
        Some(usize::from(first))
    };
    while let Some(control) = byte(&mut data) {
        if control < 32 {
            let literals = data.get(..control + 1)?;
            out.extend_from_slice(literals);
            data = &data[control + 1..];
        } else {
            let mut length = control >> 5;
            if length == 7 {
                length += byte(&mut data)?;
            }
            let distance = ((control & 31) << 8) + byte(&mut data)? + 1;
            let start = out.len().checked_sub(distance)?;
            // The copy may reach into what it appends.
            for i in start..start + length + 2 {
                out.push(out[i]);
            }
        }
        if out.len() > limit {
            return None;
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::decompress;

    #[test]
    fn literals_and_references_are_read_and_damage_is_none() {
        // "ab", then 3 + 2 bytes from 2 back; then a long reference of 7 + 1 + 2 bytes from 1 back.
        let data = [1, b'a', b'b', 3 << 5, 1, 7 << 5, 1, 0];
        assert_eq!(decompress(&data, 64).as_deref(), Some(&b"abababaaaaaaaaaaa"[..]));
        assert_eq!(decompress(&data, 10), None, "longer than the limit");
        assert_eq!(decompress(&data[..7], 64), None, "cut off");
        assert_eq!(decompress(&[1 << 5, 0], 64), None, "before the beginning");
    }
}
