//! GPS times of LAZ files: whatever they are, they come back to the bit, and data that would have a
//! decoder recurse without end are an error.

use std::io::{self, Write};
use std::path::Path;

use laz::encoders::ArithmeticEncoder;
use laz::las::v2::LasPoint0Compressor;
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::{FieldCompressor, RecordCompressor, SequentialPointRecordCompressor};
use proptest::prelude::*;
use rayset::points::{PointBatch, PointSource, open_las};

use crate::common::{folder, program};
use crate::las_writer::{Chunks, LasFile, points_start};

/// Symbols that a point's time changes its sequence by, where no sequence has a step.
const CHANGES: usize = 2_000_000;

/// Says of the second time that it belongs to the next sequence, and of the next one the same.
struct EndlessChanges(ArithmeticModel);

impl<W: Write> FieldCompressor<W> for EndlessChanges {
    fn size_of_field(&self) -> usize {
        8
    }

    fn compress_first(&mut self, to: &mut W, field: &[u8]) -> io::Result<()> {
        to.write_all(field)
    }

    fn compress_with(&mut self, encoder: &mut ArithmeticEncoder<W>, _: &[u8]) -> io::Result<()> {
        (0..CHANGES).try_for_each(|_| encoder.encode_symbol(&mut self.0, 3))
    }
}

/// A file of two points, the second of which changes the sequence of its time over and over.
fn hostile_pointwise() -> Vec<u8> {
    let file = LasFile::random(1, 2, 0, 5);
    let mut points = SequentialPointRecordCompressor::new(Vec::new());
    points.add_field_compressor(LasPoint0Compressor::default());
    points.add_field_compressor(EndlessChanges(ArithmeticModelBuilder::new(6).build()));
    file.points.iter().for_each(|point| points.compress_next(point).expect("it compresses"));
    points.done().expect("it ends");
    let mut bytes = file.laz(Chunks::One);
    bytes.truncate(points_start(&bytes));
    bytes.extend(points.into_inner());
    bytes
}

/// The same in layers: of a chunk of a good file, the last layer is replaced, which is that of the
/// times.
fn hostile_layered() -> Vec<u8> {
    let mut bytes = LasFile::random(6, 2, 0, 5).laz(Chunks::NoTable(2));
    let mut layer = ArithmeticEncoder::new(Vec::new());
    let mut model = ArithmeticModelBuilder::new(5).build();
    (0..CHANGES).try_for_each(|_| layer.encode_symbol(&mut model, 2)).expect("it compresses");
    layer.done().expect("it ends");
    let layer = layer.into_inner();
    // Behind the place of the table: a point, how many there are, and the sizes of nine layers.
    let size = points_start(&bytes) + 8 + 30 + 4 + 8 * 4..points_start(&bytes) + 8 + 30 + 4 + 9 * 4;
    let old = u32::from_le_bytes(bytes[size.clone()].try_into().expect("four bytes"));
    assert!(old > 4, "the times differ");
    bytes[size].copy_from_slice(&(layer.len() as u32).to_le_bytes());
    bytes.truncate(bytes.len() - old as usize);
    bytes.extend(layer);
    bytes
}

/// A program of its own reads the file: where a stack overflows, the whole process dies.
fn is_refused(bytes: &[u8]) {
    assert!(bytes.len() < 4000, "{} bytes hold {CHANGES} changes", bytes.len());
    let folder = folder();
    std::fs::write(folder.path().join("hostile.laz"), bytes).expect("a write");
    let output = program()
        .current_dir(folder.path())
        .args(["build", "hostile.laz", "--radius", "1", "--attributes", "gps_time", "-o", "out.rset"])
        .output()
        .expect("the program runs");
    let words = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{:?}: {words}", output.status);
    assert!(words.contains("hostile.laz, byte "), "{words}");
    assert!(words.contains("a GPS time changes its sequence more than 4 times"), "{words}");
}

#[test]
fn a_time_that_changes_its_sequence_without_end_is_an_error_and_overflows_no_stack() {
    is_refused(&hostile_pointwise());
}

#[test]
fn a_layer_of_times_that_change_their_sequence_without_end_is_an_error_and_overflows_no_stack() {
    is_refused(&hostile_layered());
}

/// The bits of a file's times.
fn times(path: &Path) -> Vec<u64> {
    let mut source = open_las(path).expect("it opens");
    let column = source.schema().find("gps_time").expect("it has times");
    source.select(&[column]);
    let (mut times, mut batch) = (Vec::new(), PointBatch::default());
    loop {
        source.fill(&mut batch, 500).expect("it reads");
        if batch.is_empty() {
            return times;
        }
        times.extend((0..batch.columns[0].len()).map(|i| batch.columns[0].get(i).to_bits()));
    }
}

/// How a time follows from those before it, as numbers of their bits.
#[derive(Clone, Debug)]
enum Next {
    Same,
    /// So many of the last steps further, and a little.
    Steps(i64, i64),
    Step(i64),
    /// A time of long ago goes on.
    Resume(usize, i64),
    Bits(u64),
}

fn next() -> impl Strategy<Value = Next> {
    prop_oneof![
        3 => Just(Next::Same),
        6 => Just(Next::Steps(1, 0)),
        6 => (-14_i64..14, -3_i64..4).prop_map(|(n, rest)| Next::Steps(n, rest)),
        3 => (-600_i64..1200, -90_i64..90).prop_map(|(n, rest)| Next::Steps(n, rest)),
        2 => (-5000_i64..5000).prop_map(Next::Step),
        1 => any::<i32>().prop_map(|step| Next::Step(step.into())),
        4 => (1_usize..40, -2000_i64..2000).prop_map(|(back, step)| Next::Resume(back, step)),
        1 => any::<u64>().prop_map(Next::Bits),
        1 => prop::sample::select(vec![0, 1, 1 << 31, 1 << 32, u64::MAX >> 1, 0x7ff0 << 48, 0x7ff8 << 48])
            .prop_map(Next::Bits),
    ]
}

/// Times of one sign: of others, the compressor of the `laz` crate has differences that overflow.
fn times_of(changes: &[Next], is_negative: bool) -> Vec<u64> {
    let mut times = vec![0x4119_0000_0000_0000_i64];
    let mut step = 1000_i64;
    for change in changes {
        let last = times[times.len() - 1];
        let time = match *change {
            Next::Same => last,
            Next::Steps(n, rest) => last.wrapping_add(n.wrapping_mul(step)).wrapping_add(rest),
            Next::Step(new) => {
                step = new;
                last.wrapping_add(new)
            }
            Next::Resume(back, step) => times[times.len().saturating_sub(back + 1)].wrapping_add(step),
            Next::Bits(bits) => bits as i64,
        };
        times.push(time & i64::MAX);
    }
    times.iter().map(|&time| time as u64 | u64::from(is_negative) << 63).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn times_of_points_compressed_one_by_one_come_back_to_the_bit(
        changes in prop::collection::vec(next(), 1..1500),
        is_negative in any::<bool>(),
    ) {
        let expected = times_of(&changes, is_negative);
        let mut file = LasFile::random(1, expected.len(), 0, 5);
        for (point, time) in file.points.iter_mut().zip(&expected) {
            point[20..28].copy_from_slice(&time.to_le_bytes());
        }
        let folder = folder();
        let path = folder.path().join("a.laz");
        std::fs::write(&path, file.laz(Chunks::Fixed(700))).expect("a write");
        prop_assert_eq!(times(&path), expected);
    }
}
