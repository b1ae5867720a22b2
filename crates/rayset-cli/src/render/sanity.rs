//! What a finished picture itself says is wrong with it: nothing is seen, all is black or white, or
//! every ray ends where it begins. Each remark names an option that helps.

use rayset::RenderCounts;
use rayset::image::{Band, DisplayTransform};

use rayset_terminal::report::remark;

/// Channels that differ by less than this from the background's are the background.
const SEEN: f32 = 1.0 / 512.0;
/// Displayed values below this are black.
const BLACK: f32 = 0.004;
/// The share of what is seen that has to be white for a remark.
const MOSTLY: f64 = 0.9;
/// Rays that meet this many samples that are not transparent, on average, end at the first of them.
const FIRST_SAMPLE: f64 = 1.05;

/// Counts of a picture's pixels.
pub(crate) struct Census {
    background: [f32; 3],
    /// Factor from linear light to what is displayed.
    exposure: f32,
    pixels: u64,
    seen: u64,
    white: u64,
    brightest: f32,
}

/// What the remarks depend on besides pixels.
pub(super) struct Circumstances {
    /// Points of a cloud; `None` of voxels and of scenes.
    pub(super) points: Option<u64>,
    /// Whether the look was chosen here, so that options of looks apply.
    pub(super) chosen: bool,
    /// Whether all that is seen is solid by intent, as labels are.
    pub(super) is_solid: bool,
    pub(super) cropped: bool,
}

impl Census {
    pub(super) fn new(background: Option<[f32; 3]>, display: DisplayTransform) -> Self {
        Self {
            background: background.unwrap_or_default(),
            exposure: display.exposure.exp2() as f32,
            pixels: 0,
            seen: 0,
            white: 0,
            brightest: 0.0,
        }
    }

    pub(super) fn add(&mut self, band: &Band) {
        self.pixels += band.pixels.len() as u64;
        for &[red, green, blue, opacity] in &band.pixels {
            let light = [red, green, blue];
            let differs = light.iter().zip(self.background).any(|(a, b)| (a - b).abs() > SEEN);
            // A transparent background leaves its mark in the opacity.
            if !differs && (opacity >= 1.0 || opacity <= SEEN) {
                continue;
            }
            self.seen += 1;
            let displayed = light.map(|v| v * self.exposure);
            self.white += u64::from(displayed.iter().all(|&v| v >= 1.0));
            self.brightest = displayed.into_iter().fold(self.brightest, f32::max);
        }
    }

    /// Says what is likely to be wrong.
    pub(super) fn remark(&self, counts: &RenderCounts, of: &Circumstances) {
        if let Some(line) = self.complaint(counts, of) {
            remark(line);
        }
    }

    fn complaint(&self, counts: &RenderCounts, of: &Circumstances) -> Option<String> {
        let or = |option: &str, key: &str| if of.chosen { option.to_owned() } else { key.to_owned() };
        if of.points == Some(0) {
            return Some(
                "the picture is empty: no point of the input is valid; `rayset info` counts what was skipped, \
                 `rayset build --invalid reject` says where the first is"
                    .to_owned(),
            );
        }
        if counts.nonzero_samples == 0 {
            let whole = if of.cropped { "this part of the picture" } else { "the picture" };
            return Some(if counts.samples == 0 {
                format!(
                    "{whole} is empty: no ray meets anything; {} show the whole",
                    or(
                        "--view iso without --position or --look-at will",
                        "a \"camera\" without \"position\" will"
                    )
                )
            } else {
                format!(
                    "{whole} is empty: all that rays meet is transparent, or far smaller than a pixel; try {}",
                    or(
                        // No other look of voxels shows more.
                        if of.points.is_none() {
                            "--opacity extinction:10"
                        } else {
                            "--look density, or --opacity extinction:10"
                        },
                        "more \"opacity\", or a shorter \"unitDistance\""
                    )
                )
            });
        }
        let share = |count: u64| count as f64 / self.seen.max(1) as f64;
        if self.seen == 0 || self.brightest < BLACK {
            let help = or(
                "--exposure 6, --shading none, or --colormap viridis",
                "more \"exposure\" of the \"image\", or lights",
            );
            return Some(format!("all that is seen is as dark as the background, or black; try {help}"));
        }
        if share(self.white) > MOSTLY {
            let help = or("--exposure -3", "\"exposure\": -3 in the \"image\"");
            return Some(format!(
                "{:.0} % of what is seen is brighter than white; try {help}",
                100.0 * share(self.white)
            ));
        }
        let rays = self.seen as f64 * counts.rays as f64 / self.pixels.max(1) as f64;
        if of.chosen
            && !of.is_solid
            && rays > 0.0
            && counts.nonzero_samples as f64 / rays < FIRST_SAMPLE
            && share(self.pixels) < 20.0
        {
            return Some(
                "every ray ends at the first sample that is not transparent: soft matter looks solid; a larger \
                 --unit-distance or --opacity extinction:1 shows more of it"
                    .to_owned(),
            );
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BACKDROP: [f32; 3] = [0.02, 0.02, 0.03];

    fn census(light: [f32; 3], exposure: f64) -> Census {
        let display = DisplayTransform { exposure, ..DisplayTransform::default() };
        let mut census = Census::new(Some(BACKDROP), display);
        let [r, g, b] = light;
        let mut band = Band::new(0, 4, 4, false);
        band.pixels.fill([r, g, b, 1.0]);
        band.pixels[0] = [BACKDROP[0], BACKDROP[1], BACKDROP[2], 1.0];
        census.add(&band);
        census
    }

    fn said(census: &Census, samples: u64, nonzero_samples: u64, chosen: bool) -> Option<String> {
        let mut counts = RenderCounts::default();
        (counts.rays, counts.samples, counts.nonzero_samples) = (census.pixels, samples, nonzero_samples);
        let of = Circumstances { points: Some(9), chosen, is_solid: false, cropped: false };
        census.complaint(&counts, &of)
    }

    #[test]
    fn what_is_wrong_with_a_picture_is_said_with_an_option_that_helps() {
        let grey = census([0.4, 0.4, 0.4], 0.0);
        assert_eq!(said(&grey, 100, 60, true), None);
        assert!(said(&grey, 0, 0, true).expect("a remark").contains("--view"));
        assert!(said(&grey, 100, 0, true).expect("a remark").contains("--opacity"));
        assert!(said(&grey, 100, 0, false).expect("a remark").contains("unitDistance"));
        assert!(said(&grey, 100, 15, true).expect("a remark").contains("--unit-distance"));
        assert_eq!(said(&grey, 100, 15, false), None, "solids of scenes end rays at once");
        assert!(said(&census(BACKDROP, 0.0), 100, 60, true).expect("a remark").contains("--exposure 6"));
        assert!(said(&census([0.0; 3], 0.0), 100, 60, true).expect("a remark").contains("black"));
        assert!(said(&census([0.5; 3], 2.0), 100, 60, true).expect("a remark").contains("white"));
        let of = Circumstances { points: Some(0), chosen: true, is_solid: false, cropped: false };
        let empty = grey.complaint(&RenderCounts::default(), &of).expect("a remark");
        assert!(empty.contains("no point"), "{empty}");
        let mut counts = RenderCounts::default();
        (counts.samples, counts.nonzero_samples) = (100, 0);
        let of_voxels = grey.complaint(&counts, &Circumstances { points: None, ..of }).expect("a remark");
        assert!(of_voxels.contains("--opacity") && !of_voxels.contains("--look"), "{of_voxels}");
    }
}
