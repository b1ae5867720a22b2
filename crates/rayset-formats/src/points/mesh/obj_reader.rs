//! The statements of a Wavefront OBJ file that make points: vertices, with colours if they have
//! any, and faces. All others (normals, texture coordinates, groups, materials, curves) are passed
//! over.

use std::path::Path;

use crate::points::lines::Lines;
use crate::points::{ReadError, roles};

/// Most statements that are passed over at a time.
const OTHERS: usize = 1024;

/// A statement.
pub(super) enum Statement<'a> {
    Vertex {
        position: [f64; 3],
        color: Option<[f32; 3]>,
    },
    /// The vertices at the corners, counted from 0. They may be defined later.
    Face(&'a [u64]),
    /// Some others, none of which makes points.
    Others,
}

#[derive(Debug)]
pub(super) struct ObjReader {
    lines: Lines,
    line: Vec<u8>,
    /// Vertices so far.
    vertices: u64,
    corners: Vec<u64>,
    /// The largest vertex of a face, and the line where it is used.
    farthest: Option<(u64, u64)>,
}

impl ObjReader {
    pub(super) fn open(path: &Path) -> Result<Self, ReadError> {
        let lines = Lines::open(path)?;
        Ok(Self { lines, line: Vec::new(), vertices: 0, corners: Vec::new(), farthest: None })
    }

    /// The next vertex or face, or others, if there are many before it; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Statement<'_>>, ReadError> {
        for _ in 0..OTHERS {
            if !self.read_line()? {
                self.check_corners()?;
                return Ok(None);
            }
            let words = self.line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
            // The rest of a line is a remark.
            let mut words = words.take_while(|word| !word.starts_with(b"#"));
            match words.next() {
                Some(b"v") => {
                    let (position, color) = vertex(words).map_err(|what| self.lines.fail(what))?;
                    self.vertices += 1;
                    return Ok(Some(Statement::Vertex { position, color }));
                }
                Some(b"f") => {
                    self.corners.clear();
                    for word in words {
                        let corner = corner(word, self.vertices).map_err(|what| self.lines.fail(what))?;
                        self.corners.push(corner);
                    }
                    let farthest = self.corners.iter().max().map(|&corner| (corner, self.lines.number()));
                    self.farthest = self.farthest.max(farthest);
                    return Ok(Some(Statement::Face(&self.corners)));
                }
                _ => {}
            }
        }
        Ok(Some(Statement::Others))
    }

    /// Reads a line, and those that a backslash at its end continues it with. Returns false at the
    /// end of the file.
    fn read_line(&mut self) -> Result<bool, ReadError> {
        self.line.clear();
        let found = self.lines.append(&mut self.line)?;
        while self.line.last() == Some(&b'\\') {
            self.line.pop();
            self.line.push(b' ');
            if !self.lines.append(&mut self.line)? {
                break;
            }
        }
        Ok(found)
    }

    /// Checks that all corners are vertices, once these are known.
    fn check_corners(&self) -> Result<(), ReadError> {
        match self.farthest {
            Some((corner, line)) if corner >= self.vertices => {
                let what = format!(
                    "a corner is vertex {}, which is not there: there are {}, counted from 1",
                    corner + 1,
                    self.vertices
                );
                Err(self.lines.fail_at(line, what))
            }
            _ => Ok(()),
        }
    }
}

fn shown(word: &[u8]) -> String {
    roles::excerpt(&String::from_utf8_lossy(word))
}

/// Position, and colour where six numbers or more are given. A fourth number alone is the weight of
/// rational curves.
fn vertex<'a>(words: impl Iterator<Item = &'a [u8]>) -> Result<([f64; 3], Option<[f32; 3]>), String> {
    let (mut numbers, mut count) = ([0.0; 6], 0);
    for word in words.take(6) {
        let number = std::str::from_utf8(word).ok().and_then(|text| text.parse().ok());
        numbers[count] = number.ok_or_else(|| format!("`{}` is not a number", shown(word)))?;
        count += 1;
    }
    if count < 3 {
        return Err(format!("a vertex of {count} numbers; expected x, y and z"));
    }
    let [x, y, z, red, green, blue] = numbers;
    Ok(([x, y, z], (count == 6).then(|| [red, green, blue].map(|v: f64| v as f32))))
}

/// The vertex of a corner like `7`, `7/1/2` or `-1`, the last vertex so far.
fn corner(word: &[u8], vertices: u64) -> Result<u64, String> {
    let index = word.split(|&byte| byte == b'/').next().unwrap_or_default();
    let index: Option<i64> = std::str::from_utf8(index).ok().and_then(|text| text.parse().ok());
    let place = match index {
        Some(index @ 1..) => Some(index as u64 - 1),
        Some(index @ ..=-1) => vertices.checked_sub(index.unsigned_abs()),
        _ => None,
    };
    place.ok_or_else(|| {
        format!(
            "`{}` is no corner of a face; expected the number of a vertex from 1 on, or from -1 back to -{vertices}",
            shown(word)
        )
    })
}
