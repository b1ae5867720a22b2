//! About how many different records there are, in little memory: enough to tell whether it is worth
//! while to sort all of them and look for copies.
//!
//! HyperLogLog (Flajolet, Fusy, Gandouet, Meunier 2007), which counts few records linearly. The
//! standard error is 0.8 %. The order of records does not matter, nor which part has them.

/// Bits of a hash that choose a register.
const REGISTER_BITS: u32 = 14;
const REGISTERS: usize = 1 << REGISTER_BITS;
/// Correction of the mean of so many registers.
const ALPHA: f64 = 0.7213 / (1.0 + 1.079 / REGISTERS as f64);
/// Copies are many if they are at least one of so many records. A weight is stored with each point
/// then, which a few copies are not worth.
const OF_RECORDS: u64 = 8;
/// Copies may be many if at least one of so many seems to be one.
const SEEM_MANY: f64 = 12.0;

/// Whether so many of the records are copies of others that they are merged.
pub(super) fn are_many(copies: u64, records: u64) -> bool {
    copies > 0 && copies.saturating_mul(OF_RECORDS) >= records
}

/// What is known of the different records that have been included.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Distinct {
    /// For each register, one more than the most zeros with which a hash begins, behind the bits
    /// that choose the register. Empty before the first record.
    registers: Vec<u8>,
}

impl Distinct {
    /// Includes a record, by its hash.
    pub(super) fn include(&mut self, hash: u64) {
        if self.registers.is_empty() {
            self.registers = vec![0; REGISTERS];
        }
        // A bit below those of the hash ends the zeros.
        let zeros = (hash << REGISTER_BITS | 1 << (REGISTER_BITS - 1)).leading_zeros();
        let register = &mut self.registers[(hash >> (u64::BITS - REGISTER_BITS)) as usize];
        *register = (*register).max(zeros as u8 + 1);
    }

    /// Includes other records.
    pub(super) fn merge(&mut self, other: &Self) {
        if self.registers.is_empty() {
            self.registers.clone_from(&other.registers);
        }
        for (own, &other) in self.registers.iter_mut().zip(&other.registers) {
            *own = (*own).max(other);
        }
    }

    /// Whether many of so many records may be copies of others.
    pub(super) fn may_have_many_copies(&self, records: u64) -> bool {
        let copies = records as f64 - self.estimate();
        copies > 0.5 && copies * SEEM_MANY >= records as f64
    }

    /// About the number of different records.
    fn estimate(&self) -> f64 {
        let sum: f64 = self.registers.iter().map(|&register| 2_f64.powi(-i32::from(register))).sum();
        if self.registers.is_empty() {
            return 0.0;
        }
        let (count, unused) = (REGISTERS as f64, self.registers.iter().filter(|&&r| r == 0).count());
        let estimate = ALPHA * count * count / sum;
        if estimate <= 2.5 * count && unused > 0 { count * (count / unused as f64).ln() } else { estimate }
    }

    /// As text: a character for each register.
    #[cfg(feature = "parts")]
    pub(super) fn to_text(&self) -> String {
        self.registers.iter().map(|&register| char::from(b'0' + register)).collect()
    }

    /// From what [`to_text`](Self::to_text) returned, or anything.
    #[cfg(feature = "parts")]
    pub(super) fn from_text(text: &str) -> Self {
        let registers: Vec<u8> = text.bytes().map(|byte| byte.saturating_sub(b'0')).collect();
        Self { registers: if registers.len() == REGISTERS { registers } else { Vec::new() } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayset_store::container::record_hash;

    #[test]
    fn an_eighth_of_copies_is_noticed_and_none_is_not_however_many_records_there_are() {
        for records in [2_u64, 9, 16, 100, 3000, 20_000, 41_000, 60_000, 300_000, 2_000_000] {
            let mut all = Distinct::default();
            (0..records).for_each(|i| all.include(record_hash(&i.to_le_bytes())));
            let error = all.estimate() / records as f64 - 1.0;
            assert!(error.abs() < 0.03, "{records}: {error}");
            assert!(!all.may_have_many_copies(records), "{records}");
            let eighth = records.div_ceil(7);
            assert!(all.may_have_many_copies(records + eighth), "{records} and {eighth} of them again");
            // A single record that comes very often is no other case.
            assert!(all.may_have_many_copies(10 * records));
        }
    }

    #[test]
    fn parts_know_together_what_one_knows_of_all() {
        let (mut all, mut parts) = (Distinct::default(), [Distinct::default(), Distinct::default()]);
        for i in 0_u64..5000 {
            let hash = record_hash(&(i % 3000).to_le_bytes());
            all.include(hash);
            parts[i as usize % 2].include(hash);
        }
        let [mut some, others] = parts;
        some.merge(&others);
        some.merge(&Distinct::default());
        assert_eq!(some, all);
        let mut none = Distinct::default();
        none.merge(&all);
        assert_eq!(none, all);
    }
}
