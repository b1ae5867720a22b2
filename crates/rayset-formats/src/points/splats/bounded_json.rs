//! JSON of files from elsewhere: a document takes up to a hundred times the memory of its text if
//! it is all brackets and commas, so those of too many values are refused before they are parsed.

use serde_json::Value;

/// Most values, and keys of objects. They take at most 64 MiB.
const MOST_VALUES: usize = 1 << 18;

/// Parses a document.
///
/// # Errors
/// What is wrong with it, or how many values it has if these are too many.
pub(super) fn parse(text: &[u8]) -> Result<Value, String> {
    // Behind each value but the last there is one of these; texts may have more of them.
    let values = text.iter().filter(|byte| matches!(byte, b',' | b':' | b'[' | b'{')).count();
    if values > MOST_VALUES {
        return Err(format!("about {values} values; at most {MOST_VALUES} are read"));
    }
    serde_json::from_slice(text).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_of_too_many_values_are_refused_before_they_are_parsed() {
        let lists = |count: usize| format!("[{}[]]", "[],".repeat(count)).into_bytes();
        assert_eq!(parse(&lists(100_000)).unwrap().as_array().unwrap().len(), 100_001);
        let error = parse(&lists(200_000)).unwrap_err();
        assert_eq!(error, "about 400002 values; at most 262144 are read");
        assert!(parse(b"{").is_err());
    }
}
