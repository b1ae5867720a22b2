//! Names and colours of labels in the extensions of a NIfTI file: the label table of Caret and
//! Connectome Workbench (extension code 30), which TotalSegmentator writes, too.
//! `<Label Key="1" Red="0.2" Green="0.4" Blue="1">spleen</Label>`.

use quick_xml::escape::resolve_predefined_entity;
use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};

use rayset_files::grid::labels::{NamedLabels, color_of_shares};

/// The code of an extension with a label table.
const CARET: u32 = 30;
/// Most bytes of all extensions that are looked at.
pub(super) const MOST_BYTES: u64 = 4 << 20;

/// What the extensions, the bytes from 352 up to the voxels, say of labels. Damaged ones say
/// nothing: they are no part of the volume.
pub(super) fn of_extensions(mut extensions: &[u8], big_endian: bool) -> NamedLabels {
    let number = |mut bytes: [u8; 4]| {
        if big_endian {
            bytes.reverse();
        }
        u32::from_le_bytes(bytes)
    };
    let mut labels = NamedLabels::default();
    while let Some((&[size, code], _)) = extensions.as_chunks().0.split_first_chunk::<2>() {
        let Some(data) = extensions.get(8..number(size) as usize) else { break };
        if number(code) == CARET {
            read_table(data, &mut labels);
        }
        extensions = &extensions[8 + data.len()..];
    }
    labels
}

fn read_table(text: &[u8], labels: &mut NamedLabels) {
    let text = String::from_utf8_lossy(text);
    let mut reader = Reader::from_str(text.trim_end_matches('\0'));
    let (mut label, mut name) = (None, String::new());
    // The first thing that is no XML ends the table.
    while let Ok(event) = reader.read_event() {
        match event {
            Event::Start(tag) if tag.local_name().as_ref() == "Label" => {
                (label, name) = (key_and_color(&tag), String::new());
            }
            Event::Text(text) => name.push_str(&text.into_inner()),
            Event::CData(text) => name.push_str(&text.into_inner()),
            Event::GeneralRef(reference) => match reference.resolve_char_ref() {
                Ok(Some(letter)) => name.push(letter),
                _ => name.push_str(resolve_predefined_entity(&reference.into_inner()).unwrap_or_default()),
            },
            Event::End(tag) if tag.local_name().as_ref() == "Label" => {
                if let Some((key, color)) = label.take() {
                    labels.name(key, &name, color);
                }
            }
            Event::Eof => return,
            _ => {}
        }
    }
}

/// The value of a label, and its colour: shares, or bytes if any is above 1.
fn key_and_color(tag: &BytesStart<'_>) -> Option<(i64, Option<[u8; 3]>)> {
    let attribute = |name: &str| {
        let found = tag.try_get_attribute(name).ok()??;
        found.normalized_value(XmlVersion::Explicit1_0).ok().map(|value| value.trim().to_owned())
    };
    let share = |name: &str| attribute(name)?.parse::<f64>().ok();
    let color = [share("Red"), share("Green"), share("Blue")];
    let color = if let [Some(r), Some(g), Some(b)] = color { Some([r, g, b]) } else { None };
    let unit = if color.is_some_and(|shares| shares.iter().any(|share| *share > 1.0)) { 255.0 } else { 1.0 };
    let color = color.and_then(|shares| color_of_shares(shares.map(|share| share / unit)));
    Some((attribute("Key")?.parse().ok()?, color))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn extension(code: u32, text: &str) -> Vec<u8> {
        let padded = (text.len() + 8).next_multiple_of(16);
        let mut bytes = [padded as u32, code].map(u32::to_le_bytes).concat();
        bytes.extend(text.bytes());
        bytes.resize(padded, 0);
        bytes
    }

    #[test]
    fn label_tables_name_labels_and_other_extensions_say_nothing() {
        let table = r#"<?xml version="1.0" encoding="UTF-8"?><CaretExtension><VolumeInformation Index="0"><LabelTable>
            <Label Key="1" Red="0.2" Green="0.4" Blue="1" Alpha="1"><![CDATA[spleen]]></Label>
            <Label Key="-7" Red="255" Green="0" Blue="51">left &amp; right</Label>
            <Label Key="3">bare</Label></LabelTable></VolumeInformation></CaretExtension>"#;
        let mut bytes = extension(6, "a comment");
        bytes.extend(extension(30, table));
        let labels = of_extensions(&bytes, false);
        assert!(labels.said);
        let expected = [
            (-7, "left & right", Some([255, 0, 51])),
            (1, "spleen", Some([51, 102, 255])),
            (3, "bare", None),
        ];
        let found: Vec<_> =
            labels.names.iter().map(|(key, (name, color))| (*key, name.as_str(), *color)).collect();
        assert_eq!(found, expected);
        assert!(!of_extensions(&extension(6, "a comment"), false).said);
        // Damaged ones end the list, whatever their length says.
        for cut in 0..bytes.len() {
            of_extensions(&bytes[..cut], false);
            of_extensions(&bytes[..cut], true);
        }
    }
}
