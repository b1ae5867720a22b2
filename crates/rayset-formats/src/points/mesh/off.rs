//! Meshes in OFF files, as of ModelNet and Geomview, in text; colours of vertices, no normals.

use std::path::Path;

use super::triangles::{Description, Fan, Sink};
use crate::points::lines::Lines;
use crate::points::{ColorDepth, Place, ReadError, roles};
use rayset_base::geometry::DVec3;

/// Whether a file begins as OFF does: `OFF`, or with letters for what vertices have besides.
pub(in crate::points) fn begins(head: &[u8]) -> bool {
    let word = head.split(|byte| !byte.is_ascii_alphabetic()).next().unwrap_or_default();
    word.strip_suffix(b"OFF").is_some_and(|kind| matches!(kind, b"" | b"C" | b"N" | b"CN" | b"ST"))
}

/// Reads the vertices and faces of an OFF file.
pub(super) fn read(path: &Path, sink: &mut impl Sink) -> Result<Description, ReadError> {
    let mut text = Text { lines: Lines::open(path)?, line: Vec::new() };
    if !text.next()? || !begins(&text.line) {
        return Err(text.fail("not an OFF file: it does not begin with `OFF`"));
    }
    // Files of ModelNet have the counts behind the word, even without a blank.
    let word: Vec<u8> = text.line.iter().copied().take_while(u8::is_ascii_alphabetic).collect();
    text.line.drain(..word.len());
    // Behind the position, and behind the normal if there is one.
    let color = word.starts_with(b"C").then_some(if word.starts_with(b"CN") { 6 } else { 3 });
    if text.line.trim_ascii().is_empty() && !text.next()? {
        return Err(text.fail("the file ends before the numbers of its vertices and faces"));
    }
    let counts: Vec<u64> = text.numbers(3, "the numbers of vertices, faces and edges")?;
    let (vertices, faces) = (counts[0], counts[1]);
    if vertices > u64::from(u32::MAX) {
        return Err(text.fail(format!("{vertices} vertices; at most {} can be read", u32::MAX)));
    }
    for done in 0..vertices {
        sink.check()?;
        text.expect(done, vertices, "vertices")?;
        let position: Vec<f64> = text.numbers(3, "x, y and z of a vertex")?;
        let color = color.and_then(|at| text.color(at));
        sink.vertex(DVec3::new(position[0], position[1], position[2]), color);
    }
    for done in 0..faces {
        sink.check()?;
        text.expect(done, faces, "faces")?;
        text.face(vertices, sink)?;
    }
    Ok(Description { text: "OFF".into(), depth: ColorDepth::Guess, place: Place::Line(1) })
}

/// The lines of a file that are neither empty nor remarks.
struct Text {
    lines: Lines,
    line: Vec<u8>,
}

impl Text {
    fn next(&mut self) -> Result<bool, ReadError> {
        loop {
            self.line.clear();
            if !self.lines.append(&mut self.line)? {
                return Ok(false);
            }
            if let Some(remark) = self.line.iter().position(|&byte| byte == b'#') {
                self.line.truncate(remark);
            }
            if !self.line.trim_ascii().is_empty() {
                return Ok(true);
            }
        }
    }

    /// The next line of `of` that there have to be.
    fn expect(&mut self, done: u64, of: u64, what: &str) -> Result<(), ReadError> {
        if self.next()? {
            Ok(())
        } else {
            Err(self.fail(format!("the file ends after {done} of {of} {what}")))
        }
    }

    fn words(&self) -> impl Iterator<Item = &[u8]> {
        self.line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
    }

    /// The first numbers of the line.
    fn numbers<T: std::str::FromStr>(&self, count: usize, what: &str) -> Result<Vec<T>, ReadError> {
        let parsed = self.words().take(count).map(|word| std::str::from_utf8(word).ok()?.parse().ok());
        let found: Option<Vec<T>> = parsed.collect();
        found.filter(|numbers| numbers.len() == count).ok_or_else(|| {
            let line = roles::excerpt(&String::from_utf8_lossy(&self.line));
            self.fail(format!("expected {what}, found `{line}`"))
        })
    }

    /// The colour behind the first numbers of the line, if there is one.
    fn color(&self, behind: usize) -> Option<[f32; 3]> {
        let mut words = self.words().skip(behind).map(|word| std::str::from_utf8(word).ok()?.parse().ok());
        Some([words.next()??, words.next()??, words.next()??])
    }

    /// A face: the number of its corners, these, and perhaps a colour.
    fn face(&self, vertices: u64, sink: &mut impl Sink) -> Result<(), ReadError> {
        let count: u64 = self.numbers(1, "the number of corners of a face")?[0];
        let (mut fan, mut found) = (Fan::default(), 0);
        for word in self.words().skip(1).take(usize::try_from(count).unwrap_or(usize::MAX)) {
            let corner = std::str::from_utf8(word).ok().and_then(|word| word.parse().ok());
            let corner = corner.filter(|&corner: &u32| u64::from(corner) < vertices).ok_or_else(|| {
                let word = roles::excerpt(&String::from_utf8_lossy(word));
                self.fail(format!(
                    "`{word}` is no corner of a face: there are {vertices} vertices, counted from 0"
                ))
            })?;
            fan.corner(corner, sink);
            found += 1;
        }
        if found < count {
            return Err(self.fail(format!("a face of {count} corners, of which {found} are given")));
        }
        Ok(())
    }

    fn fail(&self, what: impl Into<String>) -> ReadError {
        self.lines.fail(what)
    }
}
