//! Estimates of pictures whose costs are known.

use super::*;

/// A picture of 800×600 pixels, of which those of some columns cost fifty times as much, and half
/// of which are traced again, at four times the cost.
struct Made {
    costly: Range<u32>,
    traces_again: bool,
    /// What probes cost, in costs of the same tile in the picture.
    cold: f32,
    warm: f32,
}

impl Made {
    fn seconds(&self, tile: &Tile) -> f32 {
        if self.costly.contains(&tile.x) { 5e-3 } else { 1e-4 }
    }

    fn varying(&self, tile: &Tile) -> u64 {
        if self.costly.contains(&tile.x) { 40 } else { 2 }
    }

    /// Column after column, so that what costs comes early or late.
    fn tiles() -> Vec<Tile> {
        let columns = (0..100).flat_map(|i| (0..75).map(move |j| (i, j)));
        columns.map(|(i, j)| Tile { x: 8 * i, y: 8 * j, width: 8, height: 8 }).collect()
    }

    /// The error of the estimate of all time, after so many shares of it, as a factor.
    fn worst(&self, from: f64) -> f64 {
        let whole = Region { columns: 0..800, rows: 0..600 };
        let mut costs =
            Costs::of(&whole, [whole.clone()].into_iter(), self.traces_again, Some(Duration::ZERO));
        let again = |tile: &Tile| self.seconds(tile) * 4.0 * self.varying(tile) as f32 / 64.0;
        let passes = if self.traces_again { 2 } else { 1 };
        let total: f64 = Self::tiles()
            .iter()
            .map(|tile| {
                f64::from(self.seconds(tile)) + if passes == 2 { f64::from(again(tile)) } else { 0.0 }
            })
            .sum();
        let (mut spent, mut worst) = (0.0, 1.0_f64);
        let mut judge = |costs: &mut Costs, spent: f64| {
            if spent > from * total && spent < 0.99 * total {
                let estimate = spent * 480_000.0 / costs.done().max(1) as f64;
                worst = worst.max(estimate / total).max(total / estimate);
            }
        };
        for pass in 0..passes {
            for tile in Self::tiles() {
                if pass == 0 && spent > 0.02 * total && matches!(costs.probes, Probes::Later(_)) {
                    for region in costs.begin_probes().concat() {
                        let (x, y) = (region.columns.start, region.rows.start);
                        let tile = Tile { x, y, width: 8, height: 8 };
                        for (is_warm, times) in [(false, self.cold), (true, self.warm)] {
                            costs.probe(is_warm);
                            costs.finished(&tile, 64, 0, times * self.seconds(&tile), true);
                            if passes == 2 {
                                costs.decided(&tile, self.varying(&tile));
                                let seconds = times * again(&tile);
                                costs.finished(&tile, self.varying(&tile), 1, seconds, true);
                            }
                        }
                    }
                    costs.end_probes();
                }
                let (pixels, seconds) = match pass {
                    0 => (64, self.seconds(&tile)),
                    _ => (self.varying(&tile), again(&tile)),
                };
                costs.finished(&tile, pixels, pass, seconds, true);
                spent += f64::from(seconds);
                judge(&mut costs, spent);
            }
            if passes == 2 && pass == 0 {
                Self::tiles().iter().for_each(|tile| costs.decided(tile, self.varying(tile)));
            }
        }
        assert_eq!(costs.done(), 480_000, "all pixels are told of in the end");
        worst
    }
}

#[test]
fn the_rest_of_a_picture_that_costs_most_somewhere_is_known_after_a_tenth() {
    // What is a tile wide is met by few probes.
    let pictures = [(700..800, 1.5), (0..100, 1.5), (380..420, 1.5), (0..0, 1.5), (96..104, 2.0)];
    for (costly, most) in pictures {
        // Half of what a tile costs may be what warm probes find done.
        for (cold, warm, most) in [(1.0, 1.0, most), (3.0, 0.9, most), (1.5, 0.5, 2.0)] {
            for traces_again in [false, true] {
                let made = Made { costly: costly.clone(), traces_again, cold, warm };
                let worst = made.worst(0.1);
                let of = format!("{costly:?}, {traces_again}, {cold} to {warm}");
                assert!(worst < most, "{of}: {worst:.2} times");
            }
        }
    }
}

#[test]
fn what_is_finished_is_never_less_than_before() {
    let whole = Region { columns: 3..100, rows: 5..90 };
    let mut costs = Costs::of(&whole, [whole.clone()].into_iter(), false, None);
    let mut before = 0;
    for (number, x) in (0..100).step_by(8).enumerate() {
        for y in (0..90).step_by(8) {
            let (left, top) = (whole.columns.start.max(x), whole.rows.start.max(y));
            let (width, height) = ((x + 8).min(100) - left, (y + 8).min(90) - top);
            let tile = Tile { x: left, y: top, width, height };
            let seconds = if number % 3 == 0 { 1.0 } else { 0.01 };
            costs.finished(&tile, tile.pixels() as u64, 0, seconds, true);
            let done = costs.done();
            assert!(done >= before && done <= whole.pixels(), "{done} after {before}");
            before = done;
        }
    }
    assert_eq!(before, whole.pixels());
    assert!(!costs.are_due(), "nothing is left");
}
