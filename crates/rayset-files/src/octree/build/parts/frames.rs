//! Pieces of a cloud in a file: what is handed to the assembler, in order, written by one process
//! and replayed by another.
//!
//! A frame is its kind (1 byte), the lengths of its description and of its data (4 bytes each), the
//! CRC-32C of both (4), and both. The description of a piece has its runs, and its nodes or, of an
//! own list, the totals of every run.

use std::io::{self, BufReader, BufWriter, Read, Write};

use super::super::error::BuildError;
use super::super::pieces::Assemble;
use super::super::plan::Cell;
use super::super::subtree::{DraftNode, DraftRun, Piece, Summary};
use crate::octree::layout::{ColumnLayout, RUN_HEAD_BYTES};
use crate::octree::page::RunHead;
use rayset_base::geometry::Aabb;
use rayset_store::container::{Reader, Writer};

const OPEN: u8 = 1;
const OWN: u8 = 2;
const SUBTREE: u8 = 3;
const CLOSE: u8 = 4;
/// The last frame.
const END: u8 = 5;

/// Bytes before the description of a frame.
const FRONT_BYTES: usize = 13;
/// Size of the buffers of reading and writing.
const BUFFER_BYTES: usize = 1 << 20;

/// Writes pieces to a file.
pub(super) struct FrameWriter<W: Write> {
    output: BufWriter<W>,
    /// Makes the error of a write.
    failed: Box<dyn Fn(io::Error) -> BuildError>,
    bytes: u64,
    /// A failed write of an event that cannot report it.
    failure: Option<io::Error>,
}

impl<W: Write> FrameWriter<W> {
    pub(super) fn new(output: W, failed: impl Fn(io::Error) -> BuildError + 'static) -> Self {
        let output = BufWriter::with_capacity(BUFFER_BYTES, output);
        Self { output, failed: Box::new(failed), bytes: 0, failure: None }
    }

    fn frame(&mut self, kind: u8, description: &[u8], data: &[u8]) -> io::Result<()> {
        let mut front = vec![kind];
        front.extend_from_slice(&(description.len() as u32).to_le_bytes());
        front.extend_from_slice(&(data.len() as u32).to_le_bytes());
        let sum = crc32c::crc32c_append(crc32c::crc32c_append(crc32c::crc32c(&front), description), data);
        front.extend_from_slice(&sum.to_le_bytes());
        self.bytes += (front.len() + description.len() + data.len()) as u64;
        [&front, description, data].into_iter().try_for_each(|bytes| self.output.write_all(bytes))
    }

    fn put(&mut self, kind: u8, description: &[u8], data: &[u8]) -> Result<(), BuildError> {
        let written = match self.failure.take() {
            Some(failure) => Err(failure),
            None => self.frame(kind, description, data),
        };
        written.map_err(&self.failed)
    }

    /// Ends the file; returns its size in bytes.
    pub(super) fn finish(mut self) -> Result<u64, BuildError> {
        self.put(END, &[], &[])?;
        self.output.flush().map_err(&self.failed)?;
        Ok(self.bytes)
    }
}

impl<W: Write> Assemble<Piece> for FrameWriter<W> {
    fn open(&mut self, cell: Cell) {
        let mut description = Writer::default();
        put_cell(&mut description, cell);
        if self.failure.is_none() {
            self.failure = self.frame(OPEN, &description.bytes, &[]).err();
        }
    }

    fn own(&mut self, piece: Piece) -> Result<(), BuildError> {
        let mut description = Writer::default();
        put_runs(&mut description, &piece.runs);
        piece.runs.iter().for_each(|run| put_summary(&mut description, &run.summary));
        self.put(OWN, &description.bytes, &piece.data)
    }

    fn subtree(&mut self, cell: Cell, piece: Piece) -> Result<(), BuildError> {
        let mut description = Writer::default();
        put_cell(&mut description, cell);
        put_runs(&mut description, &piece.runs);
        description.u32(piece.nodes.len() as u32);
        piece.nodes.iter().for_each(|node| put_node(&mut description, node));
        self.put(SUBTREE, &description.bytes, &piece.data)
    }

    fn close(&mut self) -> Result<(), BuildError> {
        self.put(CLOSE, &[], &[])
    }
}

fn put_cell(to: &mut Writer, cell: Cell) {
    to.u32(cell.level);
    to.u64(cell.number);
}

fn put_runs(to: &mut Writer, runs: &[DraftRun]) {
    to.u32(runs.len() as u32);
    for run in runs {
        let mut head = [0; RUN_HEAD_BYTES];
        run.head.encode(&mut head);
        to.put(&head);
    }
}

fn put_node(to: &mut Writer, node: &DraftNode) {
    to.u32(node.level);
    to.u32(node.own.start as u32);
    to.u32(node.own.end as u32);
    to.u32(node.children.len() as u32);
    for &(octant, index) in &node.children {
        to.put(&[octant]);
        to.u32(index as u32);
    }
    put_summary(to, &node.summary);
}

fn put_summary(to: &mut Writer, summary: &Summary) {
    to.vec(summary.influence.min);
    to.vec(summary.influence.max);
    to.u64(summary.points);
    to.f64(summary.weight_sum);
    to.f64(summary.radius_sum);
    to.vec(summary.moment);
    to.f64(summary.mass);
    to.u32(summary.detail_min.to_bits());
    to.u32(summary.detail_max.to_bits());
    to.u32(summary.radius_max.to_bits());
    to.f64(summary.position_error);
    to.f64(summary.position_error_radii);
}

fn cell(from: &mut Reader<'_>) -> Option<Cell> {
    Some(Cell { level: from.u32()?, number: from.u64()? })
}

/// Runs with the places of their data, which follow each other and are all of `data_bytes`.
fn runs(from: &mut Reader<'_>, columns: ColumnLayout, data_bytes: usize) -> Option<Vec<DraftRun>> {
    let count = from.u32()? as usize;
    let heads = from.slice(count.checked_mul(RUN_HEAD_BYTES)?)?;
    let mut at = 0;
    let mut run = |head: &[u8]| {
        let head = RunHead::decode(head);
        let data = at..at + head.data_bytes(columns);
        at = data.end;
        DraftRun { head, data, summary: Summary::EMPTY }
    };
    let runs: Vec<DraftRun> = heads.chunks_exact(RUN_HEAD_BYTES).map(&mut run).collect();
    (at == data_bytes).then_some(runs)
}

/// Node number `index` of a piece of `runs` runs.
fn node(from: &mut Reader<'_>, index: usize, runs: usize) -> Option<DraftNode> {
    let level = from.u32()?;
    let own = from.u32()? as usize..from.u32()? as usize;
    let children = from.u32()?;
    if own.start > own.end || own.end > runs || children > 8 {
        return None;
    }
    let child = |from: &mut Reader<'_>| {
        let [octant] = from.take()?;
        let child = from.u32()? as usize;
        (octant < 8 && child < index).then_some((octant, child))
    };
    let children = (0..children).map(|_| child(from)).collect::<Option<Vec<_>>>()?;
    Some(DraftNode { level, own, children, summary: summary(from)? })
}

fn summary(from: &mut Reader<'_>) -> Option<Summary> {
    Some(Summary {
        influence: Aabb { min: from.vec()?, max: from.vec()? },
        points: from.u64()?,
        weight_sum: from.f64()?,
        radius_sum: from.f64()?,
        moment: from.vec()?,
        mass: from.f64()?,
        detail_min: f32::from_bits(from.u32()?),
        detail_max: f32::from_bits(from.u32()?),
        radius_max: f32::from_bits(from.u32()?),
        position_error: from.f64()?,
        position_error_radii: from.f64()?,
    })
}

fn own_piece(description: &[u8], data: Vec<u8>, columns: ColumnLayout) -> Option<Piece> {
    let mut from = Reader::new(description);
    let mut runs = runs(&mut from, columns, data.len())?;
    for run in &mut runs {
        run.summary = summary(&mut from)?;
    }
    Some(Piece { data, runs, nodes: Vec::new() })
}

fn subtree_piece(description: &[u8], data: Vec<u8>, columns: ColumnLayout) -> Option<(Cell, Piece)> {
    let mut from = Reader::new(description);
    let cell = cell(&mut from)?;
    let runs = runs(&mut from, columns, data.len())?;
    let count = from.u32()? as usize;
    let nodes = (0..count).map(|index| node(&mut from, index, runs.len())).collect::<Option<Vec<_>>>()?;
    (!nodes.is_empty()).then_some((cell, Piece { data, runs, nodes }))
}

/// Why frames cannot be replayed.
pub(super) enum FrameError {
    /// They are damaged, at this byte.
    Damaged(u64),
    /// They cannot be read.
    Io(io::Error),
    /// Whoever receives them has failed.
    Receiver(BuildError),
}

/// Hands pieces of a file to `out`. `is_open` says how many nodes are open, before and after.
pub(super) fn replay(
    input: impl Read,
    columns: ColumnLayout,
    is_open: &mut usize,
    out: &mut impl Assemble<Piece>,
    mut between: impl FnMut(u64) -> Result<(), BuildError>,
) -> Result<(), FrameError> {
    let mut input = BufReader::with_capacity(BUFFER_BYTES, input);
    let mut at = 0;
    loop {
        let (kind, description, data) = frame(&mut input, at)?;
        let damaged = || FrameError::Damaged(at);
        let bytes = (FRONT_BYTES + description.len() + data.len()) as u64;
        match kind {
            OPEN => {
                out.open(cell(&mut Reader::new(&description)).ok_or_else(damaged)?);
                *is_open += 1;
            }
            OWN if *is_open > 0 => {
                let piece = own_piece(&description, data, columns).ok_or_else(damaged)?;
                between(piece.runs.iter().map(|run| run.head.len() as u64).sum())
                    .and_then(|()| out.own(piece))
                    .map_err(FrameError::Receiver)?;
            }
            SUBTREE => {
                let (cell, piece) = subtree_piece(&description, data, columns).ok_or_else(damaged)?;
                between(piece.runs.iter().map(|run| run.head.len() as u64).sum())
                    .and_then(|()| out.subtree(cell, piece))
                    .map_err(FrameError::Receiver)?;
            }
            CLOSE if *is_open > 0 => {
                out.close().map_err(FrameError::Receiver)?;
                *is_open -= 1;
            }
            END => return Ok(()),
            _ => return Err(damaged()),
        }
        at += bytes;
    }
}

/// The next frame, which begins at byte `at`: its kind, description and data.
fn frame(input: &mut impl Read, at: u64) -> Result<(u8, Vec<u8>, Vec<u8>), FrameError> {
    let early = |error: io::Error| match error.kind() {
        io::ErrorKind::UnexpectedEof => FrameError::Damaged(at),
        _ => FrameError::Io(error),
    };
    let mut front = [0; FRONT_BYTES];
    input.read_exact(&mut front).map_err(early)?;
    let number = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| front[at + i]));
    let mut read = |bytes: u32| {
        // A length that is wrong must not allocate more than there is.
        let mut read = Vec::new();
        let found = input.by_ref().take(u64::from(bytes)).read_to_end(&mut read).map_err(FrameError::Io)?;
        if found as u64 == u64::from(bytes) { Ok(read) } else { Err(FrameError::Damaged(at)) }
    };
    let (description, data) = (read(number(1))?, read(number(5))?);
    let sum = crc32c::crc32c_append(crc32c::crc32c_append(crc32c::crc32c(&front[..9]), &description), &data);
    if sum == number(9) { Ok((front[0], description, data)) } else { Err(FrameError::Damaged(at)) }
}
