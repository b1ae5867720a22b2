//! Decoded runs of few points, packed: what is seen of a run from afar is mostly a few Gaussians,
//! which take as long to make as its points take to decode.

use std::collections::{HashMap, HashSet, VecDeque};

use super::columns::{CHUNK_POINTS, CHUNKS, MAP_COLUMNS};
use super::plates::Plate;
use super::run::{DecodedRun, is_wide};
use super::run_key::RunKey;
use rayset_base::geometry::DVec3;
use rayset_files::octree::layout::RUN_POINTS;

/// Fewest runs for which there is memory.
const LEAST_RUNS: usize = 4;
/// The part of memory for runs without points, one in so many, and the most bytes of one in a table
/// of up to 16/7 places for each.
const OF_EMPTY: usize = 16;
const EMPTY_BYTES: usize = 16 * (size_of::<RunKey>() + 1) / 7;
/// The part of memory for the table and the list of other runs, one in so many, and the most bytes
/// of one in both: places that runs have left may double a table once, and the smaller one is there
/// until then.
const OF_TABLES: usize = 8;
const TABLE_BYTES: usize = 3 * 16 * (size_of::<(RunKey, u64)>() + 1) / 7 + size_of::<Kept>();

/// Packed runs in a part of memory. The oldest goes first; one that has been used meanwhile becomes
/// the youngest instead.
#[derive(Debug, Default)]
pub(super) struct PackedRuns {
    /// The most bytes of the numbers of runs, and how many there are.
    room: usize,
    bytes: usize,
    /// Most runs, and most of those without points: there is memory for so many in tables.
    most_runs: usize,
    most_empty: usize,
    /// Those without points: mostly as many as others.
    empty: HashSet<RunKey>,
    /// The numbers of others.
    number_of: HashMap<RunKey, u64>,
    /// In the order of their numbers, from the oldest on.
    kept: VecDeque<Kept>,
    oldest: u64,
}

#[derive(Debug)]
struct Kept {
    key: RunKey,
    is_used: bool,
    packed: PackedRun,
}

/// A run in single precision, with as much of its columns as it has points.
#[derive(Debug, Default)]
struct PackedRun {
    len: u8,
    center: DVec3,
    reach: [f32; 3],
    reach_length: f32,
    size: (f64, f64),
    least_length: f64,
    radius_min: f32,
    is_widened: bool,
    /// Of ellipsoids, with a column for each number of their maps.
    plate: Option<Plate>,
    has_map: bool,
    /// Numbers of columns.
    attributes: u8,
    labels: u8,
    values: Vec<f32>,
}

impl PackedRuns {
    /// Gives it so many bytes of memory, or none; it forgets all runs.
    pub(super) fn set_room(&mut self, bytes: usize) {
        let most_empty = bytes / OF_EMPTY / EMPTY_BYTES;
        let most_runs = bytes / OF_TABLES / TABLE_BYTES;
        // At once: tables that grow are there twice, and those that have grown stay.
        *self = Self {
            room: bytes - bytes / OF_EMPTY - bytes / OF_TABLES,
            bytes: 0,
            most_runs,
            most_empty,
            empty: HashSet::with_capacity(most_empty),
            number_of: HashMap::with_capacity(most_runs),
            kept: VecDeque::with_capacity(most_runs),
            oldest: 0,
        };
    }

    /// Forgets all runs.
    pub(super) fn clear(&mut self) {
        self.empty.clear();
        self.number_of.clear();
        self.kept.clear();
        (self.bytes, self.oldest) = (0, 0);
    }

    /// Whether a run is known to have no points.
    pub(super) fn is_empty_run(&self, key: RunKey) -> bool {
        self.empty.contains(&key)
    }

    /// Whether a run is kept as samples that are at least `step` apart need it: `run` becomes it.
    pub(super) fn find(&mut self, key: RunKey, step: f64, run: &mut DecodedRun) -> bool {
        let Some(number) = self.number_of.get(&key) else { return false };
        let Some(kept) = self.kept.get_mut((number - self.oldest) as usize) else { return false };
        let is_right = !is_wide(kept.packed.size, kept.packed.least_length, step);
        if is_right {
            kept.is_used = true;
            kept.packed.unpack(run);
        }
        is_right
    }

    /// Keeps a run, if it is not kept already and is in single precision.
    pub(super) fn keep(&mut self, key: RunKey, run: &mut DecodedRun) {
        if run.len == 0 {
            self.keep_empty(key);
            return;
        }
        let needed = PackedRun::bytes_of(run.packed_numbers());
        if run.wide.is_some() || needed > self.room / LEAST_RUNS || self.number_of.contains_key(&key) {
            return;
        }
        // The memory of one that goes is for it.
        let mut packed = PackedRun::default();
        while (self.bytes + needed.max(packed.bytes()) > self.room || self.kept.len() >= self.most_runs)
            && let Some(oldest) = self.take_oldest()
        {
            packed = oldest;
        }
        packed.pack(run);
        self.bytes += packed.bytes();
        self.push(Kept { key, is_used: false, packed });
    }

    fn keep_empty(&mut self, key: RunKey) {
        if self.empty.len() >= self.most_empty {
            self.empty.clear();
        }
        if self.most_empty > 0 {
            self.empty.insert(key);
        }
    }

    fn push(&mut self, kept: Kept) {
        self.number_of.insert(kept.key, self.oldest + self.kept.len() as u64);
        self.kept.push_back(kept);
    }

    /// Takes out the oldest that has not been used.
    fn take_oldest(&mut self) -> Option<PackedRun> {
        loop {
            let kept = self.kept.pop_front()?;
            self.oldest += 1;
            if kept.is_used {
                self.push(Kept { is_used: false, ..kept });
                continue;
            }
            self.number_of.remove(&kept.key);
            self.bytes -= kept.packed.bytes();
            return Some(kept.packed);
        }
    }
}

impl PackedRun {
    /// Becomes a run.
    fn pack(&mut self, run: &mut DecodedRun) {
        let mut values = std::mem::take(&mut self.values);
        values.clear();
        let needed = run.packed_numbers();
        // Much larger memory would be lost to others.
        if values.capacity() < needed || values.capacity() > 2 * needed {
            values = Vec::with_capacity(needed);
        }
        run.each_column(|column| values.extend_from_slice(column));
        *self = Self {
            len: run.len as u8,
            center: run.center,
            reach: run.reach,
            reach_length: run.reach_length,
            size: run.size,
            least_length: run.least_length,
            radius_min: run.radius_min,
            is_widened: run.is_widened,
            plate: run.has_plates.then_some(run.plates.of_run),
            has_map: !run.points.map.is_empty(),
            attributes: run.attribute.len() as u8,
            labels: run.label.len() as u8,
            values,
        };
    }

    fn unpack(&self, run: &mut DecodedRun) {
        run.len = self.len.into();
        run.wide = None;
        (run.size, run.least_length) = (self.size, self.least_length);
        (run.center, run.reach, run.reach_length) = (self.center, self.reach, self.reach_length);
        run.radius_min = self.radius_min;
        (run.may_be_wide, run.are_splats, run.is_widened) = (false, false, self.is_widened);
        run.has_plates = self.plate.is_some();
        run.plates.of_run = self.plate.unwrap_or_default();
        const NONE: [f32; RUN_POINTS] = [0.0; RUN_POINTS];
        run.points.map.resize(if self.has_map { MAP_COLUMNS } else { 0 }, NONE);
        run.attribute.resize(self.attributes.into(), NONE);
        run.label.resize(self.labels.into(), NONE);
        let mut rest = &*self.values;
        if run.len > 0 {
            run.each_column(|column| {
                let (values, others) = rest.split_at(column.len().min(rest.len()));
                column[..values.len()].copy_from_slice(values);
                rest = others;
            });
            run.chunk_reach_squared[run.len.div_ceil(CHUNK_POINTS)..].fill(-1.0);
        }
    }

    fn bytes(&self) -> usize {
        Self::bytes_of(self.values.capacity())
    }

    fn bytes_of(numbers: usize) -> usize {
        numbers * size_of::<f32>()
    }
}

impl DecodedRun {
    /// How many numbers there are in its columns.
    fn packed_numbers(&mut self) -> usize {
        let mut numbers = 0;
        if self.len > 0 {
            self.each_column(|column| numbers += column.len());
        }
        numbers
    }

    /// Calls `visit` with each of its columns in single precision, as far as it has points, and
    /// with each of those by chunks.
    fn each_column(&mut self, mut visit: impl FnMut(&mut [f32])) {
        let padded = self.len.next_multiple_of(CHUNK_POINTS).min(RUN_POINTS);
        let chunks = self.len.div_ceil(CHUNK_POINTS).min(CHUNKS);
        let points = &mut self.points;
        let single = [
            &mut points.radius,
            &mut points.inverse_radius,
            &mut points.inverse_radius_squared,
            &mut points.weight,
        ];
        let columns = points.position.iter_mut().chain(single).chain(&mut points.map);
        let columns = columns.chain(&mut self.attribute).chain(&mut self.label);
        columns.for_each(|column| visit(&mut column[..padded]));
        let by_chunks = self.chunk_center.iter_mut().chain([&mut self.chunk_reach_squared]);
        by_chunks.for_each(|column| visit(&mut column[..chunks]));
        if self.has_plates {
            self.plates.by_chunks().for_each(|column| visit(&mut column[..chunks]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::run_key::RunPart;
    use super::*;

    /// A run whose numbers all differ.
    fn run(len: usize, has_map: bool, attributes: usize, labels: usize) -> DecodedRun {
        const NONE: [f32; RUN_POINTS] = [0.0; RUN_POINTS];
        let mut run = DecodedRun { len, has_plates: has_map, least_length: 0.5, ..DecodedRun::default() };
        run.points.map = vec![NONE; if has_map { MAP_COLUMNS } else { 0 }];
        (run.attribute, run.label) = (vec![NONE; attributes], vec![NONE; labels]);
        let mut next = len as f32;
        run.each_column(|column| {
            column.iter_mut().for_each(|v| {
                *v = next;
                next += 1.0;
            });
        });
        run.chunk_reach_squared[len.div_ceil(CHUNK_POINTS)..].fill(-1.0);
        run.plates.of_run.high = next;
        (run.center, run.reach, run.reach_length) = (DVec3::splat(f64::from(next)), [next; 3], 3.0 * next);
        (run.radius_min, run.size) = (0.25, (0.5, 0.75));
        run
    }

    fn columns(run: &mut DecodedRun) -> Vec<Vec<f32>> {
        let mut columns = Vec::new();
        run.each_column(|column| columns.push(column.to_vec()));
        columns
    }

    fn key(page: u32, number: u16) -> RunKey {
        RunKey { cloud: 1, page, number, what: RunPart::Spread(0), sight: 0 }
    }

    #[test]
    fn what_is_found_is_what_was_kept_whatever_the_run_was_before() {
        let kinds =
            [(128, true, 11, 1), (13, true, 0, 0), (8, false, 3, 2), (1, false, 0, 1), (0, true, 4, 0)];
        let mut packed = PackedRuns::default();
        packed.set_room(1 << 20);
        for (number, &(len, has_map, attributes, labels)) in kinds.iter().enumerate() {
            packed.keep(key(3, number as u16), &mut run(len, has_map, attributes, labels));
        }
        for (number, &(len, has_map, attributes, labels)) in kinds.iter().enumerate() {
            if len == 0 {
                assert!(packed.is_empty_run(key(3, number as u16)));
                continue;
            }
            for before in kinds {
                let mut found = run(before.0, before.1, before.2, before.3);
                found.may_be_wide = true;
                assert!(packed.find(key(3, number as u16), 1.0, &mut found));
                let mut was = run(len, has_map, attributes, labels);
                assert_eq!(found.len, len);
                assert_eq!((found.attribute.len(), found.label.len()), (attributes, labels));
                assert_eq!(found.points.map.is_empty(), !has_map);
                assert_eq!((found.center, found.reach, found.size), (was.center, was.reach, was.size));
                assert_eq!(found.plates.of_run.high, if has_map { was.plates.of_run.high } else { 0.0 });
                assert!(found.has_plates == has_map && !found.may_be_wide && found.radius_min == 0.25);
                assert_eq!(found.chunk_reach_squared, was.chunk_reach_squared);
                assert_eq!(columns(&mut found), columns(&mut was));
            }
        }
        let mut found = run(1, false, 0, 0);
        assert!(!packed.find(key(4, 0), 1.0, &mut found), "it was never kept");
        // Samples that are nearer need more than single precision.
        assert!(!packed.find(key(3, 1), 1e-9, &mut found) && found.len == 1);
        packed.set_room(0);
        assert!(!packed.find(key(3, 1), 1.0, &mut found));
        packed.keep(key(3, 1), &mut found);
    }

    #[test]
    fn no_more_is_kept_than_there_is_room_for_and_what_is_used_stays() {
        const ROOM: usize = 64 << 10;
        let (mut packed, mut found) = (PackedRuns::default(), run(1, false, 0, 0));
        packed.set_room(ROOM);
        for page in 0..100 {
            packed.keep(key(page, 0), &mut run(1 + page as usize, page % 2 == 0, 6, 0));
            let bytes: usize = packed.kept.iter().map(|kept| kept.packed.bytes()).sum();
            assert!(packed.bytes == bytes && bytes <= ROOM, "{bytes}");
            assert_eq!(packed.number_of.len(), packed.kept.len());
            assert!(packed.find(key(0, 0), 1.0, &mut found) && found.len == 1, "{page}");
        }
        assert!(packed.find(key(99, 0), 1.0, &mut found) && found.len == 100);
        assert!(!packed.find(key(1, 0), 1.0, &mut found), "it was used once");
        assert!(packed.kept.len() > 4);
        for kept in &packed.kept {
            assert_eq!(usize::from(kept.packed.len), 1 + kept.key.page as usize);
        }
    }

    #[test]
    fn a_run_without_points_is_known_as_such() {
        let mut packed = PackedRuns::default();
        packed.set_room(1 << 20);
        packed.keep(key(1, 0), &mut run(0, true, 4, 0));
        packed.keep(key(1, 1), &mut run(3, true, 4, 0));
        assert_eq!([0, 1, 2].map(|number| packed.is_empty_run(key(1, number))), [true, false, false]);
    }
}
