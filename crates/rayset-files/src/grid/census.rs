//! Which values voxels have, counted while they are read.

use super::format::VoxelKind;
use super::labels::{GridLabel, GridLabels, MOST_VALUES, NamedLabels};

/// Of more values than these, they are kept only where they lie side by side.
const MOST_SCATTERED: usize = 256;

/// Counts the values of voxels in the order of the file, as long as they are few and whole.
pub(super) struct Census {
    row_voxels: u64,
    /// Voxels of the row that have been seen.
    in_row: u64,
    /// The value of the latest voxel, by its number in `found`.
    latest: usize,
    /// Stored numbers, ascending by their order in `by_number`.
    found: Vec<Found>,
    /// The numbers in `found`, by stored numbers, ascending.
    by_number: Vec<(f32, usize)>,
    /// Whether they are too many, or not whole.
    given_up: bool,
}

#[derive(Clone, Copy)]
struct Found {
    number: f32,
    voxels: u64,
    runs: u64,
}

impl Census {
    /// The most memory that it takes, in bytes.
    pub(super) const BYTES: u64 = 2 * (MOST_VALUES * (size_of::<Found>() + size_of::<(f32, usize)>())) as u64;

    pub(super) fn new(row_voxels: u64) -> Self {
        Self { row_voxels, in_row: 0, latest: 0, found: Vec::new(), by_number: Vec::new(), given_up: false }
    }

    /// Counts voxels that follow those of before, little-endian.
    pub(super) fn add(&mut self, kind: VoxelKind, voxels: &[u8]) {
        if self.given_up {
            return;
        }
        for voxel in voxels.chunks_exact(kind.bytes()) {
            let number = kind.value(voxel);
            let goes_on = self.in_row > 0 && self.found[self.latest].number == number;
            if !goes_on {
                let Some(latest) = self.find(number) else {
                    self.given_up = true;
                    return;
                };
                self.latest = latest;
                self.found[latest].runs += 1;
            }
            self.found[self.latest].voxels += 1;
            self.in_row = if self.in_row + 1 == self.row_voxels { 0 } else { self.in_row + 1 };
        }
    }

    /// The place of a number in `found`; `None` if it is one too many, or not whole.
    fn find(&mut self, number: f32) -> Option<usize> {
        // Both zeros are one.
        let number = number + 0.0;
        match self.by_number.binary_search_by(|(known, _)| known.total_cmp(&number)) {
            Ok(at) => Some(self.by_number[at].1),
            Err(at) if number.fract() == 0.0 && self.found.len() < MOST_VALUES => {
                self.by_number.insert(at, (number, self.found.len()));
                self.found.push(Found { number, voxels: 0, runs: 0 });
                Some(self.found.len() - 1)
            }
            Err(_) => None,
        }
    }

    /// What voxels have, named; `value` scales stored numbers.
    pub(super) fn labels(&self, value: impl Fn(f64) -> f64, names: &NamedLabels) -> GridLabels {
        let said = names.said;
        if self.given_up {
            return GridLabels::default();
        }
        let values = self.by_number.iter().map(|&(number, at)| {
            let (value, Found { voxels, runs, .. }) = (value(f64::from(number)), self.found[at]);
            let (name, color) = names.names.get(&(value as i64)).cloned().unwrap_or_default();
            GridLabel { value, voxels, runs, name, color }
        });
        let mut labels = GridLabels { said, values: values.collect() };
        labels.values.sort_by(|a, b| a.value.total_cmp(&b.value));
        let whole = labels.values.iter().all(|label| label.value.fract() == 0.0);
        let most = labels.values.iter().max_by_key(|label| label.voxels).map(|label| label.value);
        let few = labels.values.len() <= MOST_SCATTERED;
        if whole && (few || said || labels.mean_run_without(most) >= 2.0) {
            labels
        } else {
            GridLabels::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_end_with_their_rows_wherever_pieces_end() {
        let voxels = [1_u8, 1, 2, 2, 2, 0, 0, 0, 0];
        for piece in 1..=9 {
            let mut census = Census::new(3);
            voxels.chunks(piece).for_each(|voxels| census.add(VoxelKind::U8, voxels));
            let found = census.labels(|v| v, &NamedLabels::default()).values;
            let counts: Vec<_> = found.iter().map(|label| (label.value, label.voxels, label.runs)).collect();
            assert_eq!(counts, [(0.0, 4, 2), (1.0, 2, 1), (2.0, 3, 2)], "{piece}");
        }
    }

    #[test]
    fn values_that_are_many_or_not_whole_are_no_labels() {
        let count = |numbers: &[f32]| {
            let bytes: Vec<u8> = numbers.iter().flat_map(|v| v.to_le_bytes()).collect();
            let mut census = Census::new(numbers.len() as u64);
            census.add(VoxelKind::F32, &bytes);
            census.labels(|v| v, &NamedLabels::default()).values.len()
        };
        let all = |most: u16| (0..most).map(f32::from).collect::<Vec<_>>();
        assert_eq!(count(&all(256)), 256);
        // Of many, each must have neighbours.
        assert_eq!(count(&all(257)), 0);
        let twice = |most| all(most).into_iter().flat_map(|v| [v, v]).collect::<Vec<_>>();
        assert_eq!(count(&twice(2048)), 2048);
        assert_eq!(count(&twice(2049)), 0);
        assert_eq!(count(&[1.0, 2.5]), 0);
        assert_eq!(count(&[0.0, -0.0, -3.0]), 2);
    }
}
