//! How many rays a moving picture may cost: as many as have been traced in a frame's time lately.

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

/// Chooses the resolution of moving pictures.
#[derive(Clone, Debug)]
pub(crate) struct Pacing {
    /// Seconds a ray, of the frames so far; recent ones count most.
    seconds_per_ray: f64,
    /// How often the number of rays is halved.
    halvings: u32,
}

impl Pacing {
    pub(crate) fn new() -> Self {
        // The first frame has the fewest rays: it is there the sooner, and tells how many the next
        // may have.
        Self { seconds_per_ray: 1e-6, halvings: COARSEST }
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

    /// The size of the next frame of a moving picture of a given size.
    pub(crate) fn next_size(&mut self, size: [u32; 2]) -> [u32; 2] {
        let expected = |halvings| self.seconds_per_ray * rays(scaled(size, halvings));
        while self.halvings < COARSEST && expected(self.halvings) > TOO_LONG * FRAME_SECONDS {
            self.halvings += 1;
        }
        if self.halvings > 0 && expected(self.halvings - 1) < SHORT_ENOUGH * FRAME_SECONDS {
            self.halvings -= 1;
        }
        scaled(size, self.halvings)
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
