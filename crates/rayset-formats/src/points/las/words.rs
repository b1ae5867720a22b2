//! The textual descriptions in a file: its reference system and its origin.

use super::header::Header;
use super::records::Records;

/// The text of a zero-padded field, without control characters.
pub(super) fn text(field: &[u8]) -> String {
    let field = field.split(|&b| b == 0).next().unwrap_or_default();
    let text: String = String::from_utf8_lossy(field).chars().filter(|c| !c.is_control()).collect();
    text.trim().to_owned()
}

/// The version, the point format, and the names of the system and the program that made the points.
/// It is the same for a file and its compressed form.
pub(super) fn description(header: &Header) -> String {
    let mut words = format!("LAS 1.{}, point format {}", header.minor_version, header.format);
    for field in [&header.system, &header.software] {
        let text = text(field);
        if !text.is_empty() {
            words.push_str(", ");
            words.push_str(&text);
        }
    }
    words
}

/// The coordinate reference system: the WKT of the file, or `EPSG:` and a number. If a file has
/// both, the one that its header indicates.
pub(super) fn reference_system(header: &Header, records: &Records) -> String {
    let wkt = records.wkt.as_deref().map(text).filter(|wkt| !wkt.is_empty());
    let code = records.geo_keys.as_deref().and_then(epsg).map(|code| format!("EPSG:{code}"));
    let in_order = if header.has_wkt { [wkt, code] } else { [code, wkt] };
    in_order.into_iter().flatten().next().unwrap_or_default()
}

/// The EPSG code of the projected reference system, otherwise of the geographic one, in a directory
/// of GeoTIFF keys; `None` if there is none, or only a user-defined one.
fn epsg(directory: &[u8]) -> Option<u16> {
    let numbers: Vec<u16> = directory.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
    // After four numbers, the last of which is the number of keys, each key consists of name,
    // place, count and value.
    let keys = numbers.get(4..)?.chunks_exact(4).take(usize::from(numbers[3]));
    let code = |name: u16| {
        keys.clone().find_map(|key| match *key {
            [key, 0, 1, value @ 1024..=32766] if key == name => Some(value),
            _ => None,
        })
    };
    code(3072).or_else(|| code(2048))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn epsg_codes_come_from_projected_before_geographic_keys_and_never_from_user_defined_ones() {
        let directory = |keys: &[[u16; 4]]| -> Vec<u8> {
            let head = [1, 1, 0, keys.len() as u16];
            head.iter().chain(keys.iter().flatten()).flat_map(|v| v.to_le_bytes()).collect()
        };
        let geographic = [2048, 0, 1, 4326];
        assert_eq!(epsg(&directory(&[[1024, 0, 1, 1], geographic, [3072, 0, 1, 26910]])), Some(26910));
        assert_eq!(epsg(&directory(&[geographic, [3072, 0, 1, 32767]])), Some(4326));
        assert_eq!(epsg(&directory(&[[3072, 34737, 5, 2000]])), None);
        // A directory that claims more keys than it has.
        assert_eq!(epsg(&[1, 0, 1, 0, 0, 0, 255, 255]), None);
        assert_eq!(epsg(&[1, 0, 1]), None);
    }

    #[test]
    fn texts_end_at_the_first_zero_and_carry_no_terminal_escapes() {
        assert_eq!(text(b" PDAL\x1b[31m\0rest"), "PDAL[31m");
        assert_eq!(text(&[0xff, b'a', b'\n']), "\u{fffd}a");
    }
}
