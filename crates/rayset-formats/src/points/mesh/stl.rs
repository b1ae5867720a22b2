//! Meshes in STL files, binary and ASCII. Each triangle has vertices of its own. Normals and
//! colours are not read.

use std::io::{self, BufReader, Read};
use std::path::Path;

use super::triangles::{Description, Sink};
use crate::points::lines::Lines;
use crate::points::{ColorDepth, Place, ReadError, roles};
use rayset_base::geometry::DVec3;
use rayset_store::storage::input_file::InputFile;

const HEADER_BYTES: u64 = 84;
const TRIANGLE_BYTES: usize = 50;
/// Vertices are numbered in 32 bits.
const MOST_TRIANGLES: u64 = u32::MAX as u64 / 3;

/// Reads the triangles of an STL file.
pub(super) fn read(path: &Path, sink: &mut impl Sink) -> Result<Description, ReadError> {
    let fail = |byte: u64, what: String| Err(ReadError::malformed(path, Place::Byte(byte), what));
    let mut file = InputFile::open(path).map_err(ReadError::io(path))?;
    let bytes = file.length().map_err(ReadError::io(path))?;
    let mut header = Vec::new();
    (&mut file).take(HEADER_BYTES).read_to_end(&mut header).map_err(ReadError::io(path))?;
    let is_text = header.trim_ascii_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    let count = header.get(80..84).map(|n| u64::from(u32::from_le_bytes([n[0], n[1], n[2], n[3]])));
    let whole = count.map(|count| HEADER_BYTES + count * TRIANGLE_BYTES as u64);
    match (count, whole) {
        // Headers of binary files may begin with `solid`, too; then the size decides.
        (Some(count), Some(whole)) if whole == bytes || !is_text && whole < bytes => {
            if count > MOST_TRIANGLES {
                return fail(80, format!("{count} triangles; at most {MOST_TRIANGLES} can be read"));
            }
            read_binary(path, file, count, sink)?;
            Ok(description("STL binary", Place::Byte(80)))
        }
        _ if is_text => {
            drop(file);
            read_text(path, sink)?;
            Ok(description("STL ascii", Place::Line(1)))
        }
        (Some(count), Some(whole)) => fail(
            bytes,
            format!("the file ends early: {count} triangles take {whole} bytes, of which it has {bytes}"),
        ),
        _ => fail(0, "not an STL file: it begins with neither `solid` nor a header of 84 bytes".into()),
    }
}

fn description(text: &str, place: Place) -> Description {
    Description { text: text.into(), depth: ColorDepth::Guess, place }
}

fn read_binary(path: &Path, file: InputFile, count: u64, sink: &mut impl Sink) -> Result<(), ReadError> {
    let mut input = BufReader::with_capacity(256 << 10, file);
    let mut record = [0; TRIANGLE_BYTES];
    for index in 0..count {
        sink.check()?;
        input.read_exact(&mut record).map_err(|source| {
            if source.kind() == io::ErrorKind::UnexpectedEof {
                let byte = HEADER_BYTES + index * TRIANGLE_BYTES as u64;
                let what = format!("the file has become shorter: {index} of {count} triangles read");
                return ReadError::malformed(path, Place::Byte(byte), what);
            }
            ReadError::Io { path: path.to_owned(), source }
        })?;
        let coordinate = |at: usize| {
            f64::from(f32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]]))
        };
        // Behind the normal.
        for at in [12, 24, 36] {
            sink.vertex(DVec3::new(coordinate(at), coordinate(at + 4), coordinate(at + 8)), None);
        }
        let first = 3 * index as u32;
        sink.triangle([first, first + 1, first + 2]);
    }
    Ok(())
}

fn read_text(path: &Path, sink: &mut impl Sink) -> Result<(), ReadError> {
    let mut lines = Lines::open(path)?;
    let (mut line, mut triangles, mut corners, mut is_open) = (Vec::new(), 0_u64, 0, false);
    loop {
        sink.check()?;
        line.clear();
        if !lines.append(&mut line)? {
            break;
        }
        let text = String::from_utf8_lossy(&line).to_ascii_lowercase();
        let words: Vec<&str> = text.split_ascii_whitespace().take(5).collect();
        match words.as_slice() {
            [] => {}
            ["solid", ..] => is_open = true,
            ["endsolid", ..] => is_open = false,
            ["facet", ..] if corners == 0 => {}
            ["outer", "loop"] | ["endloop"] => {}
            ["vertex", numbers @ ..] if corners < 3 => {
                sink.vertex(position(numbers).map_err(|what| lines.fail(what))?, None);
                corners += 1;
            }
            ["endfacet"] | ["end", "facet"] if corners == 3 => {
                if triangles == MOST_TRIANGLES {
                    return Err(lines.fail(format!("more than {MOST_TRIANGLES} triangles")));
                }
                let first = 3 * triangles as u32;
                sink.triangle([first, first + 1, first + 2]);
                (triangles, corners) = (triangles + 1, 0);
            }
            ["facet" | "vertex" | "endfacet", ..] => {
                return Err(
                    lines.fail(format!("`{}` after {corners} vertices of a facet, which has 3", words[0]))
                );
            }
            [word, ..] => {
                let word = roles::excerpt(word);
                return Err(lines.fail(format!(
                    "`{word}` where facet, outer loop, vertex, endloop, endfacet or endsolid was expected"
                )));
            }
        }
    }
    if is_open || corners > 0 {
        return Err(lines.fail(format!("the file ends early: no `endsolid` after {triangles} triangles")));
    }
    Ok(())
}

fn position(numbers: &[&str]) -> Result<DVec3, String> {
    let [x, y, z] = numbers else {
        return Err(format!("a vertex of {} numbers; expected three", numbers.len()));
    };
    let number = |word: &str| word.parse().map_err(|_| format!("`{}` is not a number", roles::excerpt(word)));
    Ok(DVec3::new(number(x)?, number(y)?, number(z)?))
}
