//! JSON of files from elsewhere: a document takes up to 300 times the memory of its text if it is
//! all brackets and commas, so those that would take too much are refused before they are parsed.

use serde_json::Value;

/// Most bytes of the values of a document.
const MOST_BYTES: usize = 128 << 20;
/// Bytes of an object that is not empty: a node of its tree has room for eleven keys and values.
const OBJECT_BYTES: usize = 640;
/// Bytes of another value, or of a key.
const VALUE_BYTES: usize = 64;

/// Parses a document.
///
/// # Errors
/// What is wrong with it, or how much memory it would take if that is too much.
pub(super) fn parse(text: &[u8]) -> Result<Value, String> {
    // One of these stands before each value, and before each key. Texts may have more of them.
    let bytes = text.iter().map(|byte| match byte {
        b'{' => OBJECT_BYTES,
        b',' | b':' | b'[' => VALUE_BYTES,
        _ => 0,
    });
    let bytes: usize = bytes.sum();
    if bytes > MOST_BYTES {
        return Err(format!(
            "its values take about {} MiB; at most {} are read",
            bytes >> 20,
            MOST_BYTES >> 20
        ));
    }
    serde_json::from_slice(text).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_that_would_take_too_much_memory_are_refused_before_they_are_parsed() {
        let repeated = |value: &str, count: usize| format!("[{}0]", value.repeat(count)).into_bytes();
        assert_eq!(parse(&repeated("[],", 900_000)).unwrap().as_array().unwrap().len(), 900_001);
        let error = parse(&repeated("[],", 1_100_000)).unwrap_err();
        assert_eq!(error, "its values take about 134 MiB; at most 128 are read");
        assert!(parse(&repeated("{\"\":0},", 100_000)).is_ok());
        assert!(parse(&repeated("{\"\":0},", 200_000)).is_err());
        assert!(parse(b"{").is_err());
    }
}
