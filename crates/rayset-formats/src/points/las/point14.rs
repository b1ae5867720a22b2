//! Points of formats 6 to 10 (the fields up to the GPS time), compressed in layers.
//!
//! The fields are those of the ASPRS LAS Specification 1.4 R15, and their compression is LASzip's
//! item POINT14, versions 3 and 4 (M. Isenburg, "LASzip: lossless compression of LiDAR data", 2013,
//! which describes its methods: adaptive arithmetic coding with contexts, and integers as residuals
//! of a prediction; and LASzip itself, which extended them to LAS 1.4). A chunk has nine layers,
//! each a separate arithmetic code, so that a reader can skip those that it does not need. The
//! first one gives, for each point, its scanner channel, which fields differ from the last point of
//! that channel, and its x and y. An empty layer is a field that never changes.
//!
//! Each channel has its own statistics, which start at its first point. They also depend on:
//!
//! - *place among returns*: whether a return is the first of its pulse, the last, both or neither;
//!   that of the last point, together with whether its time had changed, for what changes next, and
//!   that of the point itself for classification and intensity;
//! - *group of returns*: six groups of return number and number of returns, by which x and y are
//!   predicted, together with whether the time changed: most points with a new time follow the
//!   scan, and the others follow their pulse;
//! - *depth*: how many returns of the pulse are still to come, by which z is predicted;
//! - *spread*: how many bits the corrections of x and y took, which predicts those of y and z.

use std::io::{self, Cursor, Read, Seek, SeekFrom};

use laz::DecompressionSelection;
use laz::decoders::ArithmeticDecoder;
use laz::decompressors::{IntegerDecompressor, IntegerDecompressorBuilder};
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::LayeredFieldDecompressor;

use super::gps_time::GpsTimes;

/// Size of the fields in bytes.
const BYTES: usize = 30;
/// Bits of the selection that include a layer, in the order of the layers. The first layer cannot
/// be skipped.
const LAYERS: [u32; 9] = [
    DecompressionSelection::ALL,
    DecompressionSelection::Z,
    DecompressionSelection::CLASSIFICATION,
    DecompressionSelection::FLAGS,
    DecompressionSelection::INTENSITY,
    DecompressionSelection::SCAN_ANGLE,
    DecompressionSelection::USER_DATA,
    DecompressionSelection::POINT_SOURCE_ID,
    DecompressionSelection::GPS_TIME,
];

/// Bits for the fields that differ from the last point of the channel. The two lowest are for the
/// return number: unchanged, the next one, the previous one, or another.
const RETURN_NUMBER: u32 = 3;
const RETURNS: u32 = 1 << 2;
const SCAN_ANGLE: u32 = 1 << 3;
const TIME: u32 = 1 << 4;
const POINT_SOURCE: u32 = 1 << 5;
const CHANNEL: u32 = 1 << 6;

/// Group by number of returns and return number. Combinations that no pulse can have are included,
/// because they occur in files.
const GROUPS: [[u8; 16]; 16] = [
    [0, 1, 2, 3, 4, 5, 3, 4, 4, 5, 5, 5, 5, 5, 5, 5],
    [1, 0, 1, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3],
    [2, 1, 2, 4, 4, 4, 4, 4, 4, 4, 4, 3, 3, 3, 3, 3],
    [3, 3, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [3, 3, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 4, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5],
];
const GROUP_COUNT: usize = 6;

/// The fields of a point, except its channel.
#[derive(Clone, Copy)]
struct Point {
    position: [i32; 3],
    intensity: u16,
    return_number: u8,
    returns: u8,
    /// From bit 0 on: the four classification flags, the scan direction and the edge of a flight
    /// line.
    flags: u8,
    classification: u8,
    user_data: u8,
    scan_angle: i16,
    source: u16,
    time: i64,
}

impl Point {
    /// Unpacks a point from its LAS record, and its channel.
    fn unpack(b: &[u8; BYTES]) -> (Self, usize) {
        let axis = |at: usize| i32::from_le_bytes([b[at], b[at + 1], b[at + 2], b[at + 3]]);
        let point = Self {
            position: [axis(0), axis(4), axis(8)],
            intensity: u16::from_le_bytes([b[12], b[13]]),
            return_number: b[14] & 15,
            returns: b[14] >> 4,
            flags: b[15] & 15 | b[15] >> 2 & 48,
            classification: b[16],
            user_data: b[17],
            scan_angle: i16::from_le_bytes([b[18], b[19]]),
            source: u16::from_le_bytes([b[20], b[21]]),
            time: i64::from_le_bytes(std::array::from_fn(|i| b[22 + i])),
        };
        (point, usize::from(b[15] >> 4 & 3))
    }

    fn pack(&self, channel: usize) -> [u8; BYTES] {
        let mut b = [0; BYTES];
        for (axis, bytes) in self.position.iter().zip(b.chunks_exact_mut(4)) {
            bytes.copy_from_slice(&axis.to_le_bytes());
        }
        b[12..14].copy_from_slice(&self.intensity.to_le_bytes());
        b[14] = self.return_number | self.returns << 4;
        b[15] = self.flags & 15 | (channel as u8 & 3) << 4 | (self.flags & 48) << 2;
        b[16] = self.classification;
        b[17] = self.user_data;
        b[18..20].copy_from_slice(&self.scan_angle.to_le_bytes());
        b[20..22].copy_from_slice(&self.source.to_le_bytes());
        b[22..30].copy_from_slice(&self.time.to_le_bytes());
        b
    }

    fn is_first(&self) -> bool {
        self.return_number == 1
    }

    fn is_last(&self) -> bool {
        self.return_number >= self.returns
    }
}

/// Approximates a running median: each new number replaces either the smallest or the largest of
/// five.
#[derive(Clone, Copy)]
struct Median {
    sorted: [i32; 5],
    /// Which of the two is replaced next: the largest until a number is not below the median, then
    /// the smallest until one is not above it.
    drops_greatest: bool,
}

impl Median {
    const ZERO: Self = Self { sorted: [0; 5], drops_greatest: true };

    fn get(&self) -> i32 {
        self.sorted[2]
    }

    fn add(&mut self, number: i32) {
        let [s0, s1, s2, s3, s4] = self.sorted;
        let [a, b, c, d] = if self.drops_greatest { [s0, s1, s2, s3] } else { [s1, s2, s3, s4] };
        self.drops_greatest = if self.drops_greatest { number < s2 } else { number <= s2 };
        self.sorted =
            [a.min(number), b.min(number).max(a), c.min(number).max(b), d.min(number).max(c), d.max(number)];
    }
}

/// Statistics of symbols by context, created when they are first needed: most never are.
struct Models {
    symbols: u32,
    by_context: Vec<Option<ArithmeticModel>>,
}

impl Models {
    fn new(contexts: usize, symbols: u32) -> Self {
        Self { symbols, by_context: vec![None; contexts] }
    }

    fn decode(&mut self, context: usize, layer: &mut Layer) -> io::Result<u32> {
        let model =
            self.by_context[context].get_or_insert_with(|| ArithmeticModelBuilder::new(self.symbols).build());
        layer.code.decode_symbol(model)
    }
}

/// Statistics of integers by context.
fn corrections(bits: u32, contexts: u32) -> IntegerDecompressor {
    IntegerDecompressorBuilder::new().bits(bits).contexts(contexts).build_initialized()
}

/// A layer of a chunk.
struct Layer {
    code: ArithmeticDecoder<Cursor<Vec<u8>>>,
    bytes: usize,
    /// Whether the layer is selected and not empty.
    is_read: bool,
}

impl Layer {
    fn empty() -> Self {
        Self { code: ArithmeticDecoder::new(Cursor::default()), bytes: 0, is_read: false }
    }
}

/// The state of a scanner channel.
struct Channel {
    /// Its last point or, if it has none yet, that of the previous channel.
    last: Point,
    time_changed: bool,
    changes: Models,
    channel: Models,
    returns: Models,
    return_number: Models,
    return_number_of_pulse: Models,
    /// Last steps along x and y by group of returns and whether the time changed.
    steps: [[Median; 2 * GROUP_COUNT]; 2],
    step: [IntegerDecompressor; 2],
    /// Last z by depth.
    z: [i32; 8],
    height: IntegerDecompressor,
    classification: Models,
    flags: Models,
    /// Last intensity by place among returns and whether the time changed.
    intensities: [u16; 8],
    intensity: IntegerDecompressor,
    scan_angle: IntegerDecompressor,
    user_data: Models,
    source: IntegerDecompressor,
    times: GpsTimes,
}

impl Channel {
    fn after(last: Point) -> Self {
        Self {
            last,
            time_changed: false,
            changes: Models::new(8, 128),
            channel: Models::new(1, 3),
            returns: Models::new(16, 16),
            return_number: Models::new(16, 16),
            return_number_of_pulse: Models::new(1, 13),
            steps: [[Median::ZERO; 2 * GROUP_COUNT]; 2],
            step: [corrections(32, 2), corrections(32, 22)],
            z: [last.position[2]; 8],
            height: corrections(32, 20),
            classification: Models::new(64, 256),
            flags: Models::new(64, 64),
            intensities: [last.intensity; 8],
            intensity: corrections(16, 4),
            scan_angle: corrections(16, 2),
            user_data: Models::new(64, 256),
            source: corrections(16, 1),
            times: GpsTimes::layered(last.time),
        }
    }

    /// Decodes which fields differ in the next point.
    fn changes(&mut self, layer: &mut Layer) -> io::Result<u32> {
        let place = usize::from(self.last.is_first()) | usize::from(self.last.is_last()) << 1;
        self.changes.decode(place | usize::from(self.time_changed) << 2, layer)
    }

    /// Decodes the next point of the channel, which becomes the last one.
    fn next(&mut self, changes: u32, layers: &mut [Layer; 9]) -> io::Result<()> {
        let [xy, z, classification, flags, intensity, scan_angle, user_data, source, time] = layers;
        self.time_changed = changes & TIME != 0;
        let time_changed = usize::from(self.time_changed);
        self.next_return(changes, xy)?;
        self.next_place(xy, z)?;
        let last = &mut self.last;
        let place = usize::from(last.is_last()) | usize::from(last.is_first()) << 1;
        if classification.is_read {
            let context = usize::from(last.classification & 31) << 1 | usize::from(place == 3);
            last.classification = self.classification.decode(context, classification)? as u8;
        }
        if flags.is_read {
            last.flags = self.flags.decode(usize::from(last.flags & 63), flags)? as u8;
        }
        if intensity.is_read {
            let expected = &mut self.intensities[place << 1 | time_changed];
            let decoded =
                self.intensity.decompress(&mut intensity.code, i32::from(*expected), place as u32)?;
            last.intensity = decoded as u16;
            *expected = last.intensity;
        }
        if scan_angle.is_read && changes & SCAN_ANGLE != 0 {
            let expected = i32::from(last.scan_angle);
            let decoded = self.scan_angle.decompress(&mut scan_angle.code, expected, time_changed as u32)?;
            last.scan_angle = decoded as i16;
        }
        if user_data.is_read {
            last.user_data = self.user_data.decode(usize::from(last.user_data >> 2), user_data)? as u8;
        }
        if source.is_read && changes & POINT_SOURCE != 0 {
            last.source = self.source.decompress(&mut source.code, i32::from(last.source), 0)? as u16;
        }
        if time.is_read && self.time_changed {
            last.time = self.times.next(&mut time.code)?;
        }
        Ok(())
    }

    fn next_return(&mut self, changes: u32, xy: &mut Layer) -> io::Result<()> {
        let last = &mut self.last;
        if changes & RETURNS != 0 {
            last.returns = self.returns.decode(usize::from(last.returns & 15), xy)? as u8;
        }
        let number = last.return_number & 15;
        let number = match changes & RETURN_NUMBER {
            0 => number,
            1 => number + 1,
            2 => number + 15,
            _ if self.time_changed => self.return_number.decode(usize::from(number), xy)? as u8,
            // Within the same pulse, so it is neither the same number nor an adjacent one.
            _ => number + 2 + self.return_number_of_pulse.decode(0, xy)? as u8,
        };
        last.return_number = number & 15;
        Ok(())
    }

    fn next_place(&mut self, xy: &mut Layer, z: &mut Layer) -> io::Result<()> {
        let Point { return_number, returns, .. } = self.last;
        let group = usize::from(GROUPS[usize::from(returns & 15)][usize::from(return_number & 15)]);
        let is_single = u32::from(returns == 1);
        let mut context = is_single;
        for axis in 0..2 {
            let steps = &mut self.steps[axis][group << 1 | usize::from(self.time_changed)];
            let step = self.step[axis].decompress(&mut xy.code, steps.get(), context)?;
            steps.add(step);
            self.last.position[axis] = self.last.position[axis].wrapping_add(step);
            // For y: the number of bits that x took, rounded down to even.
            context = is_single + (self.step[axis].k() & !1).min(20);
        }
        if z.is_read {
            let spread = (self.step[0].k() + self.step[1].k()) / 2;
            let context = is_single + (spread & !1).min(18);
            let expected = &mut self.z[usize::from(returns.abs_diff(return_number).min(7))];
            *expected = self.height.decompress(&mut z.code, *expected, context)?;
            self.last.position[2] = *expected;
        }
        Ok(())
    }
}

/// Decodes the fields of a chunk's points.
pub(super) struct Point14 {
    selection: u32,
    layers: [Layer; 9],
    /// The channels that have occurred.
    channels: [Option<Box<Channel>>; 4],
    current: usize,
    /// Whether the channel of every point is passed to the later items, as from version 4 on.
    /// Version 3 passes it only if the channel changes, and channel 0 otherwise.
    always_tells_channel: bool,
}

impl Point14 {
    /// For points that were compressed with the given version of the item, 3 or 4.
    pub(super) fn of_version(version: u16) -> Self {
        Self {
            selection: DecompressionSelection::ALL,
            layers: std::array::from_fn(|_| Layer::empty()),
            channels: [const { None }; 4],
            current: 0,
            always_tells_channel: version > 3,
        }
    }
}

impl<R: Read + Seek> LayeredFieldDecompressor<R> for Point14 {
    fn size_of_field(&self) -> usize {
        BYTES
    }

    fn set_selection(&mut self, selection: DecompressionSelection) {
        self.selection = selection.0;
    }

    fn init_first_point(&mut self, source: &mut R, field: &mut [u8], context: &mut usize) -> io::Result<()> {
        let mut bytes = [0; BYTES];
        source.read_exact(&mut bytes)?;
        field.copy_from_slice(&bytes);
        let (point, channel) = Point::unpack(&bytes);
        self.channels = [const { None }; 4];
        self.channels[channel & 3] = Some(Box::new(Channel::after(point)));
        self.current = channel;
        *context = channel;
        Ok(())
    }

    fn decompress_field_with(&mut self, field: &mut [u8], context: &mut usize) -> io::Result<()> {
        let Some(mut channel) = self.channels[self.current & 3].as_deref_mut() else {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "a point comes before the first one"));
        };
        let xy = &mut self.layers[0];
        if !xy.is_read {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        let changes = channel.changes(xy)?;
        if changes & CHANNEL != 0 {
            let further = channel.channel.decode(0, xy)? as usize + 1;
            let last = channel.last;
            self.current = (self.current + further) & 3;
            channel = self.channels[self.current].get_or_insert_with(|| Box::new(Channel::after(last)));
        }
        if self.always_tells_channel || changes & CHANNEL != 0 {
            *context = self.current;
        }
        channel.next(changes, &mut self.layers)?;
        field.copy_from_slice(&channel.last.pack(self.current));
        Ok(())
    }

    fn read_layers_sizes(&mut self, source: &mut R) -> io::Result<()> {
        for layer in &mut self.layers {
            let mut bytes = [0; 4];
            source.read_exact(&mut bytes)?;
            layer.bytes = u32::from_le_bytes(bytes) as usize;
        }
        Ok(())
    }

    /// Allocates by the sizes of the layers, which the caller has checked against the rest of the
    /// chunk.
    fn read_layers(&mut self, source: &mut R) -> io::Result<()> {
        for (layer, bit) in self.layers.iter_mut().zip(LAYERS) {
            layer.is_read = layer.bytes > 0 && self.selection & bit != 0;
            if layer.is_read {
                let mut bytes = vec![0; layer.bytes];
                source.read_exact(&mut bytes)?;
                layer.code = ArithmeticDecoder::new(Cursor::new(bytes));
                layer.code.read_init_bytes()?;
            } else if layer.bytes > 0 {
                source.seek(SeekFrom::Current(layer.bytes as i64))?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
