//! The GPS times of compressed points.
//!
//! After LASzip (M. Isenburg, "LASzip: lossless compression of LiDAR data", 2013, and its items
//! GPSTIME11 version 2 and POINT14 versions 3 and 4). The bits of a time are treated as an integer.
//! Up to four sequences of times, for example of several scanners that take turns, are tracked in
//! parallel: the difference to the last time of a sequence is coded as a multiple of the sequence's
//! step and a remainder. If a point belongs to another sequence than the previous point, a symbol
//! says so, and another symbol says how the point continues that sequence.
//!
//! A writer changes the sequence at most once per point. Damaged or malicious data may change it
//! again and again, millions of times in a few bytes, because symbols that are almost certain cost
//! almost nothing. Therefore nothing here recurses, and the number of changes per point is limited.

use std::io::{self, Read};

use laz::decoders::ArithmeticDecoder;
use laz::decompressors::{IntegerDecompressor, IntegerDecompressorBuilder};
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::FieldDecompressor;

/// Largest number of changes of the sequence for one point. Writers need one.
const MOST_CHANGES: u32 = 4;

/// Multiples of the step that have symbols of their own: 0 to 500 first, then -1 to -10. The two
/// extremes also represent all multiples beyond them.
const LARGEST: i32 = 500;
const SMALLEST: i32 = -10;
/// Symbols of a sequence that has a step, after those of the multiples.
const SAME: u32 = (LARGEST - SMALLEST) as u32 + 1;
const NEW: u32 = SAME + 1;
/// Symbols of a sequence that has no step yet. Symbol 0 means that the time is unchanged.
const FIRST_STEP: u32 = 1;
const NEW_WITHOUT_STEP: u32 = 2;
/// Number of symbols, in both cases, after the one for a new sequence: for the next sequence, the
/// one after it, and the previous one.
const CHANGES: u32 = 3;

/// The prediction of a difference, which selects the statistics with which it is coded.
mod context {
    /// No prediction: the sequence has no step.
    pub(super) const FIRST_STEP: u32 = 0;
    /// One step.
    pub(super) const ONE: u32 = 1;
    /// 2 to 9 steps.
    pub(super) const FEW: u32 = 2;
    /// 10 to 499 steps.
    pub(super) const MANY: u32 = 3;
    /// 500 steps, the maximum.
    pub(super) const MOST: u32 = 4;
    /// 1 to 9 steps back.
    pub(super) const BACK: u32 = 5;
    /// 10 steps back, the maximum.
    pub(super) const MOST_BACK: u32 = 6;
    /// No step, in a sequence that has one.
    pub(super) const NONE: u32 = 7;
    /// The upper half of the last time, at the beginning of a sequence.
    pub(super) const UPPER_HALF: u32 = 8;
    pub(super) const COUNT: u32 = 9;
}

/// A sequence of times: its last time, and the step between times.
#[derive(Clone, Copy, Default)]
struct Sequence {
    time: i64,
    /// 0 if there is none yet.
    step: i32,
    /// Differences with a multiple of 0 or at either extreme since the last one of a single step.
    /// After four, the difference becomes the step.
    misses: u8,
}

/// Decodes the times of a chunk, or of one scanner channel of a layered chunk.
pub(super) struct GpsTimes {
    sequences: [Sequence; 4],
    /// The sequence of the last time, and the one that began last, modulo 4.
    current: usize,
    newest: usize,
    /// Added to symbols. In layered chunks there is no symbol for an unchanged time, which another
    /// layer indicates.
    left_out: u32,
    without_step: ArithmeticModel,
    multiple: ArithmeticModel,
    difference: IntegerDecompressor,
}

impl GpsTimes {
    /// For points that are compressed one by one.
    pub(super) fn pointwise() -> Self {
        Self::new(0, 0)
    }

    /// For a layer, which has only the times that differ from the previous one; `first` is the
    /// first time.
    pub(super) fn layered(first: i64) -> Self {
        Self::new(first, 1)
    }

    fn new(first: i64, left_out: u32) -> Self {
        let model = |symbols: u32| ArithmeticModelBuilder::new(symbols - left_out).build();
        let mut sequences = [Sequence::default(); 4];
        sequences[0].time = first;
        Self {
            sequences,
            current: 0,
            newest: 0,
            left_out,
            without_step: model(NEW_WITHOUT_STEP + CHANGES + 1),
            multiple: model(NEW + CHANGES + 1),
            difference: IntegerDecompressorBuilder::new()
                .bits(32)
                .contexts(context::COUNT)
                .build_initialized(),
        }
    }

    /// Decodes the bits of the next time.
    ///
    /// # Errors
    /// [`InvalidData`](io::ErrorKind::InvalidData) if the point changes its sequence more often
    /// than any writer does, and the errors of the decoder.
    pub(super) fn next<R: Read>(&mut self, decoder: &mut ArithmeticDecoder<R>) -> io::Result<i64> {
        for _ in 0..=MOST_CHANGES {
            let change = if self.sequences[self.current & 3].step == 0 {
                self.without_step(decoder)?
            } else {
                self.with_step(decoder)?
            };
            if change == 0 {
                return Ok(self.sequences[self.current & 3].time);
            }
            self.current = self.current.wrapping_add(change as usize) & 3;
        }
        let what = format!("a GPS time changes its sequence more than {MOST_CHANGES} times");
        Err(io::Error::new(io::ErrorKind::InvalidData, what))
    }

    /// Continues a sequence that has no step, or returns by how many sequences to advance to the
    /// one of the time.
    fn without_step<R: Read>(&mut self, decoder: &mut ArithmeticDecoder<R>) -> io::Result<u32> {
        match decoder.decode_symbol(&mut self.without_step)? + self.left_out {
            0 => {}
            FIRST_STEP => {
                let step = self.difference.decompress(decoder, 0, context::FIRST_STEP)?;
                let sequence = &mut self.sequences[self.current & 3];
                *sequence = Sequence { time: sequence.time.wrapping_add(step.into()), step, misses: 0 };
            }
            NEW_WITHOUT_STEP => self.begin(decoder)?,
            symbol => return Ok(symbol - NEW_WITHOUT_STEP),
        }
        Ok(0)
    }

    /// Continues a sequence that has a step, or returns by how many sequences to advance to the one
    /// of the time.
    fn with_step<R: Read>(&mut self, decoder: &mut ArithmeticDecoder<R>) -> io::Result<u32> {
        let symbol = decoder.decode_symbol(&mut self.multiple)?;
        if symbol >= SAME {
            match symbol + self.left_out {
                SAME => {}
                NEW => self.begin(decoder)?,
                symbol => return Ok(symbol - NEW),
            }
            return Ok(0);
        }
        let symbol = symbol as i32;
        let multiple = if symbol <= LARGEST { symbol } else { LARGEST - symbol };
        let context = match multiple {
            0 => context::NONE,
            1 => context::ONE,
            2..10 => context::FEW,
            10..LARGEST => context::MANY,
            LARGEST => context::MOST,
            SMALLEST => context::MOST_BACK,
            _ => context::BACK,
        };
        let sequence = &mut self.sequences[self.current & 3];
        let expected = sequence.step.wrapping_mul(multiple);
        let difference = self.difference.decompress(decoder, expected, context)?;
        sequence.time = sequence.time.wrapping_add(difference.into());
        match multiple {
            1 => sequence.misses = 0,
            0 | LARGEST | SMALLEST => {
                sequence.misses += 1;
                if sequence.misses > 3 {
                    (sequence.step, sequence.misses) = (difference, 0);
                }
            }
            _ => {}
        }
        Ok(0)
    }

    /// Begins a new sequence, which replaces the oldest one.
    fn begin<R: Read>(&mut self, decoder: &mut ArithmeticDecoder<R>) -> io::Result<()> {
        let upper = (self.sequences[self.current & 3].time >> 32) as i32;
        let upper = self.difference.decompress(decoder, upper, context::UPPER_HALF)?;
        let lower = decoder.read_int()?;
        self.newest = (self.newest + 1) & 3;
        self.current = self.newest;
        let time = i64::from(upper) << 32 | i64::from(lower);
        self.sequences[self.newest & 3] = Sequence { time, step: 0, misses: 0 };
        Ok(())
    }
}

impl<R: Read> FieldDecompressor<R> for GpsTimes {
    fn size_of_field(&self) -> usize {
        8
    }

    fn decompress_first(&mut self, source: &mut R, field: &mut [u8]) -> io::Result<()> {
        let mut bytes = [0; 8];
        source.read_exact(&mut bytes)?;
        self.sequences[0].time = i64::from_le_bytes(bytes);
        field.copy_from_slice(&bytes);
        Ok(())
    }

    fn decompress_with(&mut self, decoder: &mut ArithmeticDecoder<R>, field: &mut [u8]) -> io::Result<()> {
        field.copy_from_slice(&self.next(decoder)?.to_le_bytes());
        Ok(())
    }
}
