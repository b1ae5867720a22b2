//! The GPS times of compressed points.
//!
//! After LASzip (M. Isenburg, "LASzip: lossless compression of LiDAR data", 2013, and its items GPSTIME11 version 2 and
//! POINT14 versions 3 and 4). A time is taken as the integer that its bits are. Up to four sequences of times, as those
//! of several scanners that take turns, are continued side by side: the difference to the last time of a sequence is
//! coded as a multiple of the sequence's step and what is left over. A symbol says that the point belongs to another
//! sequence than the last one did, and another symbol says how it continues that.
//!
//! A writer changes to the sequence that the time continues, once for a point. Data may say that it changes again and
//! again, millions of times in a few bytes, for symbols that are certain cost next to nothing. So nothing here
//! recurses, and the changes of a point are counted.

use std::io::{self, Read};

use laz::decoders::ArithmeticDecoder;
use laz::decompressors::{IntegerDecompressor, IntegerDecompressorBuilder};
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::FieldDecompressor;

/// Changes of the sequence for one point that are followed. Writers need one.
const MOST_CHANGES: u32 = 4;

/// Multiples of the step that have symbols of their own: 0 to 500 first, then -1 to -10. The two ends also stand for all
/// that is beyond them.
const LARGEST: i32 = 500;
const SMALLEST: i32 = -10;
/// Symbols of a sequence that has a step, behind those of its multiples.
const SAME: u32 = (LARGEST - SMALLEST) as u32 + 1;
const NEW: u32 = SAME + 1;
/// Symbols of a sequence that has no step yet. The one that is 0 says that the time is the same.
const FIRST_STEP: u32 = 1;
const NEW_WITHOUT_STEP: u32 = 2;
/// Symbols of either kind behind the one for a new sequence: the next one, the one after it, and the one before it.
const CHANGES: u32 = 3;

/// What a difference is compared with, which decides by what statistics it is coded.
mod context {
    /// Nothing: the sequence has no step.
    pub(super) const FIRST_STEP: u32 = 0;
    /// The step.
    pub(super) const ONE: u32 = 1;
    /// 2 to 9 steps.
    pub(super) const FEW: u32 = 2;
    /// 10 to 499 steps.
    pub(super) const MANY: u32 = 3;
    /// 500 steps, the most.
    pub(super) const MOST: u32 = 4;
    /// 1 to 9 steps back.
    pub(super) const BACK: u32 = 5;
    /// 10 steps back, the most.
    pub(super) const MOST_BACK: u32 = 6;
    /// No step, in a sequence that has one.
    pub(super) const NONE: u32 = 7;
    /// The upper half of the last time, where a sequence begins.
    pub(super) const UPPER_HALF: u32 = 8;
    pub(super) const COUNT: u32 = 9;
}

/// Times in sequence, each with the step between them.
#[derive(Clone, Copy, Default)]
struct Sequence {
    time: i64,
    /// 0 where there is none yet.
    step: i32,
    /// Differences since the last one of a single step that no multiple between the ends came near. After four, the
    /// difference is the step.
    misses: u8,
}

/// Decodes the times of a chunk, or those of one scanner channel where points are layered.
pub(super) struct GpsTimes {
    sequences: [Sequence; 4],
    /// Sequence of the last time, and the one that began last, modulo 4.
    current: usize,
    newest: usize,
    /// Added to symbols. Where points are layered, another layer says which times are the same, and no symbol does.
    left_out: u32,
    without_step: ArithmeticModel,
    multiple: ArithmeticModel,
    difference: IntegerDecompressor,
}

impl GpsTimes {
    /// Times of points that are compressed one by one.
    pub(super) fn pointwise() -> Self {
        Self::new(0, 0)
    }

    /// Times that differ from the one before, after a first one, as a layer has them.
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

    /// The bits of the next time.
    ///
    /// # Errors
    /// [`InvalidData`](io::ErrorKind::InvalidData) where the point changes its sequence more often than any writer has
    /// it do, and what the decoder cannot read.
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

    /// Continues a sequence that has no step, or returns how many sequences further the time belongs.
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

    /// Continues a sequence that has a step, or returns how many sequences further the time belongs.
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

    /// Begins a sequence in place of the oldest one.
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
