//! What a moving picture may cost: as many rays as have been traced in a frame's time lately. Where
//! even the fewest take too long, what is seen from afar is seen in coarser cells.

use std::time::Duration;

/// What a frame of a moving picture may take, in seconds.
const FRAME_SECONDS: f64 = 0.05;
/// A scale is left for a coarser one when a frame is expected to take longer than this many of
/// [`FRAME_SECONDS`].
const TOO_LONG: f64 = 1.25;
/// The next finer scale is taken when its frames are expected to take less than this. In between,
/// the scale stays, so that the picture does not flicker between two.
const SHORT_ENOUGH: f64 = 0.8;
/// From one scale to the next, the number of rays halves.
const COARSEST: u32 = 12;
/// A moving picture never has fewer rays than this, unless it has fewer pixels itself.
const LEAST_RAYS: f64 = 160.0 * 90.0;
/// Cells double in width when a frame of the fewest rays is expected to take longer than this, in
/// seconds. They hide more than coarse pixels do, so slower frames are borne before.
const SLOW_SECONDS: f64 = 0.08;
/// How much sooner frames are expected with cells twice as wide.
const OF_DOUBLED_CELLS: f64 = 0.5;
/// Widths of cells in pixels of a frame, finest first.
const CELLS: [f32; 3] = [4.0, 8.0, 16.0];

/// Chooses the resolution of moving pictures, and how coarse what is far is in them.
#[derive(Clone, Debug)]
pub(crate) struct Pacing {
    /// Seconds a ray, of the frames so far; recent ones count most.
    seconds_per_ray: f64,
    /// How often the number of rays is halved.
    halvings: u32,
    /// The index of the width of cells.
    level: usize,
}

impl Pacing {
    pub(crate) fn new() -> Self {
        // The first frame has the fewest rays: it is there the sooner, and tells how many the next
        // may have.
        Self { seconds_per_ray: 1e-6, halvings: COARSEST, level: 0 }
    }

    /// Takes note of a frame.
    pub(crate) fn traced(&mut self, [width, height]: [u32; 2], time: Duration) {
        let rays = f64::from(width) * f64::from(height);
        let measured = time.as_secs_f64() / rays.max(1.0);
        self.seconds_per_ray += 0.4 * (measured - self.seconds_per_ray);
    }

    /// Takes note of a frame that was given up after some time: it would have taken longer, how
    /// much is not known.
    pub(crate) fn gave_up(&mut self, size: [u32; 2], time: Duration) {
        self.traced(size, 3 * time);
    }

    /// How wide the cells of what is seen from afar are, in pixels of the next frame.
    pub(crate) fn cells(&self) -> f32 {
        CELLS[self.level]
    }

    /// The size of the next frame of a moving picture of a given size.
    pub(crate) fn next_size(&mut self, size: [u32; 2]) -> [u32; 2] {
        self.choose_cells(size);
        let expected = |halvings| self.seconds_per_ray * rays(scaled(size, halvings));
        while self.halvings < COARSEST && expected(self.halvings) > TOO_LONG * FRAME_SECONDS {
            self.halvings += 1;
        }
        if self.halvings > 0 && expected(self.halvings - 1) < SHORT_ENOUGH * FRAME_SECONDS {
            self.halvings -= 1;
        }
        scaled(size, self.halvings)
    }

    /// Cells become finer before there are more rays, and coarser only when there are the fewest.
    fn choose_cells(&mut self, size: [u32; 2]) {
        let seconds = |of: [u32; 2]| self.seconds_per_ray * rays(of);
        if self.level + 1 < CELLS.len() && seconds(scaled(size, COARSEST)) > SLOW_SECONDS {
            self.level += 1;
            self.seconds_per_ray *= OF_DOUBLED_CELLS;
        } else if self.level > 0
            && seconds(scaled(size, self.halvings)) < OF_DOUBLED_CELLS * SHORT_ENOUGH * SLOW_SECONDS
        {
            self.level -= 1;
            self.seconds_per_ray /= OF_DOUBLED_CELLS;
        }
    }
}

fn rays([width, height]: [u32; 2]) -> f64 {
    f64::from(width) * f64::from(height)
}

/// A size with the number of rays halved so many times, in the same proportions.
fn scaled(size: [u32; 2], halvings: u32) -> [u32; 2] {
    let wanted = 0.5_f64.powf(0.5 * f64::from(halvings));
    let least = (LEAST_RAYS / rays(size)).sqrt();
    let scale = wanted.max(least).min(1.0);
    size.map(|edge| ((f64::from(edge) * scale).ceil() as u32).clamp(1, edge))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_moving_picture_has_its_least_size_its_proportions_and_no_more_rays_than_the_picture(
            width in 1_u32..4096, height in 1_u32..4096, micros in 1_u64..10_000_000, frames in 1_usize..40,
        ) {
            let mut pacing = Pacing::new();
            let size = [width, height];
            for _ in 0..frames {
                let frame = pacing.next_size(size);
                prop_assert!((0..2).all(|k| frame[k] <= size[k]), "{:?} of {:?}", frame, size);
                prop_assert!(rays(frame) >= LEAST_RAYS.min(rays(size)), "{:?} of {:?}", frame, size);
                let skew = f64::from(frame[0]) * f64::from(height) - f64::from(frame[1]) * f64::from(width);
                prop_assert!(skew.abs() <= 2.0 * f64::from(width.max(height)), "{:?} of {:?}", frame, size);
                pacing.traced(frame, Duration::from_micros(micros));
            }
        }
    }

    #[test]
    fn cells_widen_where_the_fewest_rays_take_too_long_and_narrow_again() {
        let mut pacing = Pacing::new();
        let size = [1280, 720];
        let mut after = |seconds_per_ray: [f64; 3], frames: usize| {
            let mut seen = Vec::new();
            for _ in 0..frames {
                let next = pacing.next_size(size);
                let level = CELLS.iter().position(|&cells| cells == pacing.cells()).expect("one of them");
                pacing.traced(next, Duration::from_secs_f64(rays(next) * seconds_per_ray[level]));
                seen.push((pacing.cells(), next));
            }
            seen
        };
        let fewest = scaled(size, COARSEST);
        // The fewest rays take 130, 72 and 58 ms: with cells of eight pixels they are soon enough.
        let slow = after([9e-6, 5e-6, 4e-6], 60);
        assert!(slow[20..].iter().all(|&of| of == (8.0, fewest)), "{slow:?}");
        // 430, 290 and 140 ms.
        let slower = after([30e-6, 20e-6, 10e-6], 60);
        assert!(slower[20..].iter().all(|&of| of == (16.0, fewest)), "{slower:?}");
        let fast = after([0.2e-6, 0.15e-6, 0.1e-6], 60);
        assert!(fast[30..].iter().all(|&(cells, size)| cells == 4.0 && size[0] > fewest[0]), "{fast:?}");
    }

    #[test]
    fn the_resolution_settles_where_a_frame_takes_its_time_and_stays() {
        let mut pacing = Pacing::new();
        let size = [1280, 720];
        // A ray takes 0.2 µs.
        let take = |[width, height]: [u32; 2]| Duration::from_secs_f64(f64::from(width * height) * 0.2e-6);
        let mut sizes = Vec::new();
        for frame in 0..60 {
            let next = pacing.next_size(size);
            // A tenth more or less, as machines do.
            pacing.traced(next, take(next).mul_f64(if frame % 2 == 0 { 0.9 } else { 1.1 }));
            sizes.push(next);
        }
        let last = sizes[59];
        assert!(sizes[20..].iter().all(|&size| size == last), "{sizes:?}");
        let seconds = take(last).as_secs_f64();
        assert!(seconds < TOO_LONG * FRAME_SECONDS && seconds > 0.3 * FRAME_SECONDS, "{seconds}");
    }
}
