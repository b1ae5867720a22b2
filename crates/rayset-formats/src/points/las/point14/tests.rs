use std::io::Cursor;

use laz::las::Point7;
use laz::record::{
    LayeredPointRecordCompressor, LayeredPointRecordDecompressor, RecordCompressor, RecordDecompressor,
};
use laz::{DecompressionSelection, LazItem, LazItemRecordBuilder};
use proptest::prelude::*;

use super::{GROUPS, LAYERS, Median, Point14};

/// A point of format 7: one with colours, whose decoding depends on the channel that this item
/// passes on.
type Record = [u8; 36];

fn items(version: u16) -> Vec<LazItem> {
    if version == 3 {
        LazItemRecordBuilder::version_3_of::<Point7>(0)
    } else {
        LazItemRecordBuilder::version_4_of::<Point7>(0)
    }
}

fn compressed(points: &[Record], version: u16) -> Vec<u8> {
    let mut compressor = LayeredPointRecordCompressor::new(Vec::new());
    compressor.set_fields_from(&items(version)).expect("known items");
    points.iter().for_each(|point| compressor.compress_next(point).expect("it compresses"));
    compressor.done().expect("it ends");
    compressor.into_inner()
}

/// The points of a chunk, as decoded here or by the `laz` crate alone.
fn decoded(chunk: &[u8], count: usize, version: u16, selection: u32, is_ours: bool) -> Vec<Record> {
    let mut decoder = LayeredPointRecordDecompressor::new(Cursor::new(chunk));
    let items = items(version);
    if is_ours {
        decoder.add_field_decompressor(Point14::of_version(version));
        decoder.set_fields_from(&items[1..].to_vec()).expect("known items");
    } else {
        decoder.set_fields_from(&items).expect("known items");
    }
    decoder.set_selection(DecompressionSelection(selection));
    (0..count)
        .map(|_| {
            let mut record = [0; 36];
            decoder.decompress_next(&mut record).expect("it decodes");
            record
        })
        .collect()
}

/// How much points change from one to the next.
#[derive(Clone, Copy, Debug)]
struct Unrest {
    channel: f64,
    field: f64,
    time: f64,
    /// The share of changes to arbitrary rather than to nearby values.
    wild: f64,
    /// Times are arbitrary bits. Otherwise they have one sign: if a sequence has a step,
    /// differences overflow in the compressor of the `laz` crate.
    any_time: bool,
}

/// xorshift64*.
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    fn happens(&mut self, chance: f64) -> bool {
        ((self.bits() >> 11) as f64) < chance * (1_u64 << 53) as f64
    }
}

/// Random points. Each is like the last one of its channel except for what changes.
fn random_points(seed: u64, count: usize, unrest: Unrest) -> Vec<Record> {
    let mut random = Random(seed | 1);
    let mut first: Record = std::array::from_fn(|_| random.bits() as u8);
    first[29] &= 127;
    let mut points = vec![first];
    let mut last = [first; 4];
    let mut channel = usize::from(first[15] >> 4 & 3);
    for _ in 1..count {
        if random.happens(unrest.channel) {
            channel = usize::from(random.happens(0.5)) | usize::from(random.happens(0.5)) << 1;
        }
        let point = &mut last[channel];
        for axis in 0..3 {
            let is_wild = random.happens(unrest.wild);
            let step = if is_wild { random.bits() as i32 } else { (random.bits() % 300) as i32 - 100 };
            let at = 4 * axis..4 * axis + 4;
            let old = i32::from_le_bytes(point[at.clone()].try_into().expect("four bytes"));
            point[at].copy_from_slice(&old.wrapping_add(step).to_le_bytes());
        }
        // Returns, flags, classification, user data, and bytes of the 16-bit fields.
        for at in (12..22).chain(30..36) {
            if random.happens(unrest.field) {
                let is_wild = random.happens(unrest.wild);
                point[at] = if is_wild {
                    random.bits() as u8
                } else {
                    point[at].wrapping_add(random.bits() as u8 % 3)
                };
            }
        }
        point[15] = point[15] & 0xcf | (channel as u8) << 4;
        if random.happens(unrest.time) {
            let old = u64::from_le_bytes(point[22..30].try_into().expect("eight bytes"));
            let other = points[(random.bits() % points.len() as u64) as usize];
            let other = u64::from_le_bytes(other[22..30].try_into().expect("eight bytes"));
            let time = match random.bits() % 16 {
                _ if unrest.any_time => random.bits(),
                0..8 => old.wrapping_add(5000),
                8..10 => old.wrapping_add((random.bits() % 700) * 5000),
                10 => old.wrapping_sub((random.bits() % 15) * 5000 + random.bits() % 50),
                11 => old.wrapping_add(random.bits() % 100_000_000),
                12..15 => other.wrapping_add(5000),
                _ => random.bits(),
            };
            // Zero and minus zero are not distinguished.
            let sign = if unrest.any_time { u64::MAX } else { u64::MAX >> 1 };
            point[22..30].copy_from_slice(&(time & sign).max(1).to_le_bytes());
        }
        points.push(*point);
    }
    points
}

fn unrest() -> impl Strategy<Value = Unrest> {
    let chance = || prop::sample::select(vec![0.0, 0.02, 0.3, 1.0]);
    (chance(), chance(), chance(), chance(), prop::bool::weighted(0.2))
        .prop_map(|(channel, field, time, wild, any_time)| Unrest { channel, field, time, wild, any_time })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn points_in_layers_come_back_to_the_byte_and_selections_as_from_the_laz_crate(
        seed in any::<u64>(),
        count in prop::sample::select(vec![1, 2, 30, 1500]),
        unrest in unrest(),
        version in 3_u16..5,
        selection in any::<u32>(),
    ) {
        let points = random_points(seed, count, unrest);
        let chunk = compressed(&points, version);
        prop_assert!(decoded(&chunk, count, version, u32::MAX, true) == points, "all layers");
        let selected = decoded(&chunk, count, version, selection, true);
        prop_assert!(selected == decoded(&chunk, count, version, selection, false), "some layers");
    }
}

#[test]
fn each_layer_alone_is_read_as_with_all_others() {
    let unrest = Unrest { channel: 0.1, field: 0.2, time: 0.5, wild: 0.1, any_time: false };
    let points = random_points(3, 3000, unrest);
    for version in [3, 4] {
        let chunk = compressed(&points, version);
        let fields = [0..8, 8..12, 16..17, 15..16, 12..14, 18..20, 17..18, 20..22, 22..30];
        for (bit, field) in LAYERS.into_iter().zip(fields) {
            let alone = decoded(&chunk, points.len(), version, bit, true);
            // The fields that can never be skipped.
            assert!(alone.iter().zip(&points).all(|(a, p)| a[..8] == p[..8] && a[14] == p[14]));
            assert!(alone.iter().zip(&points).all(|(a, p)| a[15] & 48 == p[15] & 48));
            let same = alone.iter().zip(&points).all(|(a, p)| a[field.clone()] == p[field.clone()]);
            assert!(same, "version {version}, layer {bit:#x}");
        }
    }
}

#[test]
fn a_chunk_that_is_cut_anywhere_or_has_no_bytes_for_its_second_point_is_an_error() {
    let unrest = Unrest { channel: 0.1, field: 0.2, time: 0.5, wild: 0.1, any_time: false };
    let points = random_points(3, 200, unrest);
    let chunk = compressed(&points, 4);
    let result = |chunk: &[u8]| {
        let mut decoder = LayeredPointRecordDecompressor::new(Cursor::new(chunk));
        decoder.add_field_decompressor(Point14::of_version(4));
        decoder.set_fields_from(&items(4)[1..].to_vec()).expect("known items");
        (0..points.len()).try_for_each(|_| decoder.decompress_next(&mut [0; 36]))
    };
    result(&chunk).expect("the whole is right");
    for end in 0..chunk.len() {
        assert!(result(&chunk[..end]).is_err(), "{end} of {} bytes", chunk.len());
    }
    let mut empty = chunk;
    empty[36 + 4..].fill(0);
    let error = result(&empty).expect_err("no layer has bytes");
    assert_eq!(error.kind(), std::io::ErrorKind::UnexpectedEof);
}

#[test]
fn the_median_of_a_constant_and_of_a_rising_sequence_follows_them() {
    let mut median = Median::ZERO;
    (0..6).for_each(|_| median.add(7));
    assert_eq!(median.get(), 7);
    (8..40).for_each(|n| median.add(n));
    assert!((33..40).contains(&median.get()), "{}", median.get());
}

#[test]
fn groups_are_as_many_as_there_are_medians() {
    assert!(GROUPS.iter().flatten().all(|&group| usize::from(group) < super::GROUP_COUNT));
}
