//! The sheet that a picture and its annotations share: the picture has a place of its own on it,
//! and what is drawn lies beside it.

use rayset::Region;

/// Heights of a picture in an em.
const EMS: f32 = 44.0;
/// An em in pixels: smaller is not readable, larger takes memory to no avail.
const EM_RANGE: (f32, f32) = (9.0, 128.0);
/// From the middle of the axes to the end of a name, in ems.
pub(super) const AXES_REACH_EMS: f32 = 4.5;
/// Height of the axes, in ems.
pub(super) const AXES_EMS: f32 = 1.85 * AXES_REACH_EMS;
/// Width of the column beside a picture that has the axes in it, in ems.
pub(super) const COLUMN_EMS: f32 = 2.0 * AXES_REACH_EMS + 2.0;
/// The least part of the sheet's width and height that is left to the picture; on smaller sheets
/// annotations lie over it.
const LEAST: f32 = 0.5;

/// Most pixels along a side.
const MOST_PIXELS: u32 = 1 << 20;

/// An em of a picture of this size, in pixels.
pub(super) fn em_of(size: (u32, u32)) -> f32 {
    (size.1.min(2 * size.0) as f32 / EMS).clamp(EM_RANGE.0, EM_RANGE.1)
}

/// A sheet, and the place of the picture on it, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Sheet {
    /// Width and height of the sheet.
    pub(crate) size: (u32, u32),
    /// Width and height of the picture.
    pub(crate) picture: (u32, u32),
    /// The sheet's pixel that the left upper one of the picture is.
    pub(crate) corner: (u32, u32),
}

impl Sheet {
    /// A sheet of `size` with a caption of so many lines; `None` if it is too small for anything
    /// beside the picture.
    pub(crate) fn new(size: (u32, u32), caption_lines: usize) -> Option<Self> {
        let em = em_of(size);
        let margin = (1.2 * em).round();
        let above = margin + (1.35 * (caption_lines as f32 + 0.2) + 0.3) * em;
        // The scale lies below, the colours and the axes to the right.
        let below = margin + 2.6 * em;
        let right = COLUMN_EMS * em;
        let (width, height) = (size.0 as f32 - right - margin, size.1 as f32 - above - below);
        if width < LEAST * size.0 as f32 || height < LEAST * size.1 as f32 {
            return None;
        }
        Some(Self {
            size,
            picture: (width as u32, height as u32),
            corner: (margin as u32, above.ceil() as u32),
        })
    }

    /// The part of the picture that a part of the sheet shows; `None` if it shows none.
    pub(crate) fn picture_within(&self, shown: &Region) -> Option<Region> {
        let within = |shown: &std::ops::Range<u32>, corner: u32, length: u32| {
            let clamp = |at: u32| at.saturating_sub(corner).min(length);
            clamp(shown.start)..clamp(shown.end)
        };
        let columns = within(&shown.columns, self.corner.0, self.picture.0);
        let rows = within(&shown.rows, self.corner.1, self.picture.1);
        (!columns.is_empty() && !rows.is_empty()).then_some(Region { columns, rows })
    }
}

/// A picture on the part of a sheet that is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Mount {
    /// The part of the sheet: its left upper pixel, and its width and height.
    pub(crate) origin: (u32, u32),
    pub(crate) size: (u32, u32),
    /// The place of the picture's left upper pixel, of those that are rendered, in that part.
    pub(crate) place: (u32, u32),
    /// What is around it: premultiplied, linear light.
    pub(crate) background: [f32; 4],
}

impl Mount {
    /// Of the part `shown` of a sheet, and what of the picture is within it.
    pub(crate) fn new(sheet: &Sheet, shown: &Region, within: &Region, background: Option<[f32; 3]>) -> Self {
        let origin = (shown.columns.start, shown.rows.start);
        Self {
            origin,
            size: (shown.columns.len() as u32, shown.rows.len() as u32),
            place: (
                sheet.corner.0 + within.columns.start - origin.0,
                sheet.corner.1 + within.rows.start - origin.1,
            ),
            background: background.map_or([0.0; 4], |[red, green, blue]| [red, green, blue, 1.0]),
        }
    }

    /// Its numbers as bytes.
    pub(crate) fn encode(&self) -> Vec<u8> {
        let numbers = [self.origin, self.size, self.place].into_iter().flat_map(|(a, b)| [a, b]);
        let numbers = numbers.map(u32::to_le_bytes);
        numbers.chain(self.background.map(f32::to_le_bytes)).flatten().collect()
    }

    /// Takes one from the front of bytes; `None` if none is there.
    pub(crate) fn decode(bytes: &mut &[u8]) -> Option<Self> {
        let mut next = || bytes.split_off(..4)?.try_into().ok();
        let mut number = || next().map(u32::from_le_bytes);
        let origin = (number()?, number()?);
        let size = (number()?, number()?);
        let place = (number()?, number()?);
        let mut background = [0.0; 4];
        for value in &mut background {
            *value = next().map(f32::from_le_bytes)?;
        }
        let fits = |(x, y): (u32, u32)| x.max(y) <= MOST_PIXELS;
        [origin, size, place].into_iter().all(fits).then_some(Self { origin, size, place, background })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_has_its_place_on_the_sheet_and_small_sheets_have_none() {
        let sheet = Sheet::new((960, 640), 2).expect("it is large enough");
        let (right, bottom) = (sheet.corner.0 + sheet.picture.0, sheet.corner.1 + sheet.picture.1);
        assert!(right < 960 && bottom < 640, "{sheet:?}");
        assert!(u64::from(sheet.picture.0) * u64::from(sheet.picture.1) > 960 * 640 / 2, "{sheet:?}");
        let all = Region { columns: 0..960, rows: 0..640 };
        let picture = Region { columns: 0..sheet.picture.0, rows: 0..sheet.picture.1 };
        assert_eq!(sheet.picture_within(&all), Some(picture));
        assert_eq!(sheet.picture_within(&Region { columns: 0..960, rows: 0..sheet.corner.1 }), None);
        for size in [(1, 1), (3, 200), (200, 3), (64, 48)] {
            assert_eq!(Sheet::new(size, 2), None, "{size:?}");
        }
    }

    #[test]
    fn mounts_come_back_from_bytes() {
        let mount = Mount { origin: (1, 2), size: (3, 4), place: (5, 6), background: [0.1, 0.2, 0.3, 1.0] };
        let bytes = mount.encode();
        assert_eq!(Mount::decode(&mut &bytes[..]), Some(mount));
        assert_eq!(Mount::decode(&mut &bytes[..39]), None);
    }
}
