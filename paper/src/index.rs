//! The octree by influence on disk, and how it is built: a leaf lists every point whose radius
//! reaches it.
//!
//! Out of core: points are copied from a cloud file and streamed in through the point controller;
//! lists of points that are to be divided lie in temporary files, read and written in order; the
//! tree is made depth first, the eight children of a node written together.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rayset::container::ScanError;
use rayset::geometry::DVec3;
use rayset::octree::Cloud;
use rayset::working_set::read::BackendKind;
use serde::{Deserialize, Serialize};

use crate::cache::{CacheCounts, CacheError, RecordCache};
use crate::disk::{Disk, RealDisk};
use crate::predict::Regular;
use crate::record::{Below, DIRECT, NODE_BYTES, NOWHERE, Node, POINT_BYTES, Point, SECONDARY};

/// When a node is a leaf.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Edges from the root to the deepest leaf, at most.
    pub height: u32,
    /// A node with no more points than this is not divided.
    pub leaf_points: u64,
}

/// What an index holds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// When nodes were divided.
    pub limits: Limits,
    /// Points of the cloud.
    pub points: u64,
    /// Nodes, empty leaves too.
    pub nodes: u64,
    /// Secondary records.
    pub secondary: u64,
    /// References in all leaves together.
    pub references: u64,
    /// The most points that a leaf has.
    pub most_in_leaf: u64,
    /// Depth of the deepest leaf.
    pub height: u32,
    /// Bytes of lists that were written while it was built, and read again.
    pub list_bytes: u64,
    /// Time that it took to build.
    pub build: Duration,
}

impl Summary {
    /// Bytes of the nodes and their lists.
    #[must_use]
    pub fn index_bytes(&self) -> u64 {
        (self.nodes + self.secondary) * NODE_BYTES as u64
    }

    /// Seconds that its input and output took on a disk of a seek of so many seconds and so many
    /// bytes a second: points in and out, lists out and in again, records out; each buffer is a
    /// seek.
    #[must_use]
    pub fn build_seconds(&self, seek: f64, bytes_per_second: f64) -> f64 {
        let bytes = (2 * self.point_bytes() + 2 * self.list_bytes + self.index_bytes()) as f64;
        bytes / bytes_per_second + bytes / (BUFFER_RECORDS * ENTRY_BYTES) as f64 * seek
    }

    /// Bytes of the points.
    #[must_use]
    pub fn point_bytes(&self) -> u64 {
        self.points * POINT_BYTES as u64
    }
}

/// The files of an index: nodes, secondary records and points.
#[derive(Clone, Debug)]
pub struct Index {
    /// Folder of the files.
    pub folder: PathBuf,
    /// What is in it.
    pub summary: Summary,
}

/// Why there is no index.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum IndexError {
    /// A file.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or its folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The cloud.
    #[error(transparent)]
    Cloud(#[from] ScanError),
    /// A point that was written.
    #[error(transparent)]
    Stream(#[from] CacheError),
    /// More points than a reference can name.
    #[error("{points} points; a reference of 32 bits names at most 4294967295")]
    TooMany {
        /// How many.
        points: u64,
    },
}

/// The files, in the order of [`Index::files`].
const NAMES: [&str; 3] = ["nodes.bin", "secondary.bin", "points.bin"];
/// Records in memory while a list is divided.
const BUFFER_RECORDS: usize = 1 << 12;
/// A point in a list: its number and its record.
const ENTRY_BYTES: usize = 4 + POINT_BYTES;
/// Points that are read together while they are streamed: a block.
const STREAMED_TOGETHER: u64 = 4096 / POINT_BYTES as u64;
/// Reads in one call then.
const STREAMED_AT_ONCE: usize = 16;
/// Files end at a whole block, as direct reads ask for.
const BLOCK_BYTES: u64 = 4096;

impl Index {
    /// Paths of nodes, secondary records and points.
    #[must_use]
    pub fn files(&self) -> [PathBuf; 3] {
        NAMES.map(|name| self.folder.join(name))
    }

    /// All points, in the order of their numbers, and the cube of the root.
    ///
    /// # Errors
    /// What the system says.
    pub fn points_and_root(&self) -> io::Result<(Vec<Point>, (DVec3, DVec3))> {
        let [_, _, points] = self.files();
        let bytes = std::fs::read(points)?;
        let count = usize::try_from(self.summary.points).unwrap_or(usize::MAX);
        Ok((bytes.chunks_exact(POINT_BYTES).take(count).map(Point::decode).collect(), self.root()?))
    }

    /// The cube of the root.
    ///
    /// # Errors
    /// What the system says.
    pub fn root(&self) -> io::Result<(DVec3, DVec3)> {
        let [nodes, ..] = self.files();
        let mut root = [0; NODE_BYTES];
        File::open(nodes)?.read_exact(&mut root)?;
        let Node { min, max, .. } = Node::decode(&root);
        Ok((min, max))
    }

    /// Builds the index of a cloud into a folder.
    ///
    /// # Errors
    /// [`IndexError`] where a file cannot be read or written.
    pub fn build(cloud: &Cloud, folder: &Path, limits: Limits) -> Result<Self, IndexError> {
        let started = Instant::now();
        let io = |source| IndexError::Io { path: folder.to_owned(), source };
        let points = cloud.header().points;
        if points > u64::from(u32::MAX) {
            return Err(IndexError::TooMany { points });
        }
        std::fs::create_dir_all(folder).map_err(io)?;
        let point_file = folder.join(NAMES[2]);
        write_points(cloud, &point_file)?;
        let mut list = ListWriter::new(folder).map_err(io)?;
        let mut disk = RealDisk::open(&[point_file], false, BackendKind::Auto).map_err(io)?;
        stream_points(&mut disk, 0, points, true, |number, point| list.push(number, point))?;
        let root_list = list.finish().map_err(io)?;
        let mut builder = Builder::new(folder, limits, points).map_err(io)?;
        let summary = builder.build(root_list, root_box(cloud)).map_err(io)?;
        let summary = Summary { build: started.elapsed(), ..summary };
        Ok(Self { folder: folder.to_owned(), summary })
    }
}

/// A cube around all influence, a little larger, so that nothing lies on its sides.
fn root_box(cloud: &Cloud) -> (DVec3, DVec3) {
    let header = cloud.header();
    let reach = f64::from(header.radius.max()) + header.position_error;
    let bounds = header.bounds.inflated(reach);
    let half = 0.5 * bounds.size().max_element() * 1.000_001 + f64::MIN_POSITIVE;
    (bounds.center() - half, bounds.center() + half)
}

/// Where a point of a cloud file stands among `count` points here: far from its neighbours in
/// space, as points in the order of chance do. (A cloud file has them along a curve that fills
/// space.)
fn scattered(number: u64, count: u64) -> u64 {
    // Multiplication by a number that has no divisor in common with `count` is a permutation; near
    // the golden ratio of it, one that sends neighbours apart.
    let mut factor = ((count as f64 * 0.618_033_988_749_895) as u64).max(1);
    while gcd(factor, count) != 1 {
        factor += 1;
    }
    (u128::from(number) * u128::from(factor) % u128::from(count.max(1))) as u64
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// Writes the file of points.
fn write_points(cloud: &Cloud, path: &Path) -> Result<(), IndexError> {
    let io = |source| IndexError::Io { path: path.to_owned(), source };
    let header = cloud.header();
    let mut points = File::create(path).map_err(io)?;
    let (mut failed, mut at) = (None, 0);
    cloud.for_each_run(|_, run| {
        let radii: Option<Vec<f32>> = run.radii(header).map(Iterator::collect);
        let weights: Option<Vec<f32>> = run.weights(header).map(Iterator::collect);
        for (i, position) in run.positions(header.root_cell()).into_iter().enumerate() {
            let radius = radii.as_ref().map_or(header.radius.min(), |r| r[i]);
            let weight = weights.as_ref().map_or(header.weight.min(), |w| w[i]);
            let point = Point { position, radius, weight };
            let place = scattered(at, header.points) * POINT_BYTES as u64;
            at += 1;
            let outcome = points.seek(SeekFrom::Start(place)).and_then(|_| points.write_all(&point.encode()));
            failed = failed.take().or(outcome.err());
        }
    })?;
    if let Some(source) = failed {
        return Err(io(source));
    }
    points.set_len((at * POINT_BYTES as u64).next_multiple_of(BLOCK_BYTES)).map_err(io)
}

/// The point controller while points are processed: all of them, one after another, from a disk.
///
/// # Errors
/// [`CacheError`] where one cannot be read.
pub fn stream_points(
    disk: &mut dyn Disk,
    file: usize,
    count: u64,
    predicts: bool,
    mut f: impl FnMut(u32, &Point) -> io::Result<()>,
) -> Result<CacheCounts, CacheError> {
    let mut cache = RecordCache::new(file, POINT_BYTES, STREAMED_TOGETHER, 2 * Regular::AHEAD as usize);
    let mut predictor = Regular::default();
    for number in 0..count {
        let slot = cache.retain(disk, number, u8::MAX)?;
        if predicts {
            let expected = predictor.access(number);
            let firsts: Vec<u64> =
                expected.into_iter().filter(|n| n.is_multiple_of(STREAMED_TOGETHER)).collect();
            if !firsts.is_empty() {
                cache.prefetch(disk, &firsts, u8::MAX, STREAMED_AT_ONCE)?;
            }
        }
        let point = Point::decode(cache.bytes(slot));
        // A point that has been processed is not used again.
        cache.release(slot);
        f(number as u32, &point)?;
    }
    Ok(cache.counts())
}

/// Points that a node is to hold, in a temporary file without a name.
struct List {
    file: File,
    count: u64,
}

struct ListWriter {
    out: BufWriter<File>,
    count: u64,
}

impl ListWriter {
    fn new(folder: &Path) -> io::Result<Self> {
        let out = BufWriter::with_capacity(BUFFER_RECORDS * ENTRY_BYTES, tempfile::tempfile_in(folder)?);
        Ok(Self { out, count: 0 })
    }

    fn push(&mut self, number: u32, point: &Point) -> io::Result<()> {
        self.count += 1;
        self.out.write_all(&number.to_le_bytes())?;
        self.out.write_all(&point.encode())
    }

    fn finish(self) -> io::Result<List> {
        let mut file = self.out.into_inner().map_err(io::IntoInnerError::into_error)?;
        file.seek(SeekFrom::Start(0))?;
        Ok(List { file, count: self.count })
    }
}

impl List {
    /// Calls `f` with each number and point.
    fn for_each(&mut self, mut f: impl FnMut(u32, &Point) -> io::Result<()>) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(0))?;
        let mut reader = BufReader::with_capacity(BUFFER_RECORDS * ENTRY_BYTES, &self.file);
        let mut entry = [0; ENTRY_BYTES];
        for _ in 0..self.count {
            reader.read_exact(&mut entry)?;
            let number = u32::from_le_bytes([entry[0], entry[1], entry[2], entry[3]]);
            f(number, &Point::decode(&entry[4..]))?;
        }
        Ok(())
    }
}

/// Points of a node that is to be made: on disk, or in memory where there are few.
enum Held {
    Disk(List),
    Memory(Vec<(u32, Point)>),
}

/// Lists of no more than this are divided in memory.
const MOST_IN_MEMORY: u64 = 1 << 15;

impl Held {
    fn count(&self) -> u64 {
        match self {
            Self::Disk(list) => list.count,
            Self::Memory(points) => points.len() as u64,
        }
    }

    fn for_each(&mut self, mut f: impl FnMut(u32, &Point) -> io::Result<()>) -> io::Result<()> {
        match self {
            Self::Disk(list) => list.for_each(f),
            Self::Memory(points) => points.iter().try_for_each(|(number, point)| f(*number, point)),
        }
    }

    /// The points that reach each octant of a node.
    fn divide(mut self, node: &Node, folder: &Path) -> io::Result<[Self; 8]> {
        let boxes: [(DVec3, DVec3); 8] = std::array::from_fn(|octant| node.octant_box(octant));
        if self.count() <= MOST_IN_MEMORY {
            let mut parts: [Vec<(u32, Point)>; 8] = Default::default();
            self.for_each(|number, point| {
                for (part, (min, max)) in parts.iter_mut().zip(&boxes) {
                    if point.reaches(*min, *max) {
                        part.push((number, *point));
                    }
                }
                Ok(())
            })?;
            return Ok(parts.map(Held::Memory));
        }
        let mut writers = Vec::with_capacity(8);
        for _ in 0..8 {
            writers.push(ListWriter::new(folder)?);
        }
        self.for_each(|number, point| {
            for (writer, (min, max)) in writers.iter_mut().zip(&boxes) {
                if point.reaches(*min, *max) {
                    writer.push(number, point)?;
                }
            }
            Ok(())
        })?;
        let lists: Vec<List> = writers.into_iter().map(ListWriter::finish).collect::<io::Result<_>>()?;
        let mut lists = lists.into_iter();
        // Eight writers were made above.
        Ok(std::array::from_fn(|_| lists.next().map_or_else(|| Held::Memory(Vec::new()), Held::Disk)))
    }
}

/// A node whose number and children's numbers are known.
struct Open {
    number: u64,
    node: Node,
    depth: u32,
    points: Held,
}

struct Builder<'a> {
    folder: &'a Path,
    nodes: File,
    secondary: BufWriter<File>,
    summary: Summary,
}

impl<'a> Builder<'a> {
    fn new(folder: &'a Path, limits: Limits, points: u64) -> io::Result<Self> {
        let file = |name| File::create(folder.join(name));
        let summary = Summary {
            limits,
            points,
            nodes: 0,
            secondary: 0,
            references: 0,
            most_in_leaf: 0,
            height: 0,
            list_bytes: 0,
            build: Duration::ZERO,
        };
        Ok(Self { folder, nodes: file(NAMES[0])?, secondary: BufWriter::new(file(NAMES[1])?), summary })
    }

    fn build(&mut self, all: List, (min, max): (DVec3, DVec3)) -> io::Result<Summary> {
        // The root is alone in its group of eight.
        self.summary.nodes = 8;
        let mut group = vec![0; 8 * NODE_BYTES];
        let (record, open) = self.make(0, (min, max), NOWHERE, 0, Held::Disk(all))?;
        group[..NODE_BYTES].copy_from_slice(&record);
        self.write_group(0, &group)?;
        let mut stack: Vec<Open> = open.into_iter().collect();
        while let Some(Open { number, node, depth, points }) = stack.pop() {
            let Below::Children([first, ..]) = node.below else { continue };
            if let Held::Disk(list) = &points {
                self.summary.list_bytes += list.count * ENTRY_BYTES as u64;
            }
            for (octant, part) in points.divide(&node, self.folder)?.into_iter().enumerate() {
                let child = first + octant as u64;
                let (record, open) = self.make(child, node.octant_box(octant), number, depth + 1, part)?;
                group[octant * NODE_BYTES..(octant + 1) * NODE_BYTES].copy_from_slice(&record);
                stack.extend(open);
            }
            self.write_group(first, &group)?;
        }
        let bytes = self.summary.nodes * NODE_BYTES as u64;
        self.nodes.set_len(bytes.next_multiple_of(BLOCK_BYTES))?;
        let bytes = self.summary.secondary * NODE_BYTES as u64;
        let missing = bytes.next_multiple_of(BLOCK_BYTES) - bytes;
        self.secondary.write_all(&vec![0; missing as usize])?;
        self.secondary.flush()?;
        Ok(self.summary)
    }

    fn write_group(&mut self, first: u64, group: &[u8]) -> io::Result<()> {
        self.nodes.seek(SeekFrom::Start(first * NODE_BYTES as u64))?;
        self.nodes.write_all(group)
    }

    /// A node: a leaf, whose list is written, or one whose children are still to be made.
    fn make(
        &mut self,
        number: u64,
        (min, max): (DVec3, DVec3),
        parent: u64,
        depth: u32,
        mut points: Held,
    ) -> io::Result<([u8; NODE_BYTES], Option<Open>)> {
        let limits = self.summary.limits;
        if depth < limits.height && points.count() > limits.leaf_points {
            let first = self.summary.nodes;
            self.summary.nodes += 8;
            let below = Below::Children(std::array::from_fn(|octant| first + octant as u64));
            let node = Node { min, max, parent, below };
            return Ok((node.encode(&[]), Some(Open { number, node, depth, points })));
        }
        let count = points.count();
        let summary = &mut self.summary;
        summary.references += count;
        summary.most_in_leaf = summary.most_in_leaf.max(count);
        summary.height = summary.height.max(depth);
        let mut direct = Vec::with_capacity(DIRECT);
        let (first, mut in_record) = (summary.secondary, 0);
        let out = &mut self.secondary;
        points.for_each(|reference, _| {
            if direct.len() < DIRECT {
                direct.push(reference);
                return Ok(());
            }
            in_record += 1;
            out.write_all(&reference.to_le_bytes())
        })?;
        let records = (in_record as u64).div_ceil(SECONDARY as u64);
        let missing = records as usize * SECONDARY - in_record;
        out.write_all(&vec![0; 4 * missing])?;
        self.summary.secondary += records;
        let secondary = if records > 0 { first } else { NOWHERE };
        let below = Below::Points { count: count as u32, secondary };
        Ok((Node { min, max, parent, below }.encode(&direct), None))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scattering_gives_every_number_once_and_sends_neighbours_apart() {
        for count in [1, 2, 10, 997, 4096] {
            let mut numbers: Vec<u64> = (0..count).map(|number| scattered(number, count)).collect();
            let near = numbers.windows(2).filter(|w| w[0].abs_diff(w[1]) < count / 4).count();
            assert!(count < 10 || near == 0, "{near} neighbours of {count} are near each other");
            numbers.sort_unstable();
            assert!(numbers.into_iter().eq(0..count));
        }
    }
}
