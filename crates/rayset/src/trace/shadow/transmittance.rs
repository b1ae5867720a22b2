//! Transmittance along a ray as a piecewise linear curve (after Lokovic & Veach, *Deep Shadow Maps*, 2000), and the
//! layout of a tile's curves in a page.

/// A knot of a curve: distance and transmittance.
pub(super) type Knot = (f32, f32);

/// Largest error of a curve, unless its tile would not fit into the page.
const TOLERANCE: f32 = 1.0 / 1024.0;

/// Receives points one by one and keeps those without which the error would exceed the tolerance.
#[derive(Clone, Debug)]
pub(super) struct TransmittanceBuilder {
    tolerance: f32,
    knots: Vec<Knot>,
    /// The latest point after the last knot, and the range of slopes that fit all points since that knot.
    pending: Option<(Knot, f32, f32)>,
}

impl TransmittanceBuilder {
    pub(super) fn new() -> Self {
        Self::with_tolerance(TOLERANCE)
    }

    fn with_tolerance(tolerance: f32) -> Self {
        Self { tolerance, knots: Vec::new(), pending: None }
    }

    /// Distance of the last point.
    pub(super) fn last(&self) -> Option<f32> {
        self.pending.map(|((x, _), ..)| x).or_else(|| self.knots.last().map(|&(x, _)| x))
    }

    /// Adds a point, which must be farther than all before.
    pub(super) fn push(&mut self, point: Knot) {
        let Some(&(x0, y0)) = self.knots.last() else { return self.knots.push(point) };
        let slopes = |x0: f32, y0: f32| {
            let run = (point.0 - x0).max(f32::MIN_POSITIVE);
            let slope = (point.1 - y0) / run;
            (slope, slope - self.tolerance / run, slope + self.tolerance / run)
        };
        let (slope, low, high) = slopes(x0, y0);
        match self.pending {
            Some((_, least, most)) if slope >= least && slope <= most => {
                self.pending = Some((point, least.max(low), most.min(high)));
            }
            Some((before, ..)) => {
                self.knots.push(before);
                let (_, low, high) = slopes(before.0, before.1);
                self.pending = Some((point, low, high));
            }
            None => self.pending = Some((point, low, high)),
        }
    }

    /// Completes the curve.
    pub(super) fn finish(mut self) -> Vec<Knot> {
        self.knots.extend(self.pending.take().map(|(point, ..)| point));
        self.knots
    }
}

/// Bytes of a ray's head: index of its first knot and number of knots.
const HEAD_BYTES: usize = 4;
const KNOT_BYTES: usize = 8;

/// Writes the curves of a tile into its page. If they do not fit, all are simplified with a larger tolerance.
pub(super) fn encode(mut curves: Vec<Vec<Knot>>, page: &mut [u8]) {
    let room = (page.len() - curves.len() * HEAD_BYTES) / KNOT_BYTES;
    let mut tolerance = TOLERANCE;
    while curves.iter().map(Vec::len).sum::<usize>() > room {
        tolerance *= 2.0;
        for curve in &mut curves {
            let mut coarser = TransmittanceBuilder::with_tolerance(tolerance);
            curve.iter().for_each(|&knot| coarser.push(knot));
            *curve = coarser.finish();
        }
    }
    let (heads, knots) = page.split_at_mut(curves.len() * HEAD_BYTES);
    let mut first = 0;
    for (curve, head) in curves.iter().zip(heads.chunks_exact_mut(HEAD_BYTES)) {
        head[..2].copy_from_slice(&(first as u16).to_le_bytes());
        head[2..].copy_from_slice(&(curve.len() as u16).to_le_bytes());
        for (i, &(x, y)) in curve.iter().enumerate() {
            let at = (first + i) * KNOT_BYTES;
            knots[at..at + 4].copy_from_slice(&x.to_le_bytes());
            knots[at + 4..at + 8].copy_from_slice(&y.to_le_bytes());
        }
        first += curve.len();
    }
}

/// Transmittance at a distance on one ray of a tile of `rays` rays.
pub(super) fn transmittance(page: &[u8], rays: usize, ray: usize, distance: f32) -> f32 {
    let u16_at = |at: usize| usize::from(u16::from_le_bytes([page[at], page[at + 1]]));
    let (first, count) = (u16_at(ray * HEAD_BYTES), u16_at(ray * HEAD_BYTES + 2));
    let number = |at: usize| f32::from_le_bytes([page[at], page[at + 1], page[at + 2], page[at + 3]]);
    let knot = |i: usize| {
        let at = rays * HEAD_BYTES + (first + i) * KNOT_BYTES;
        (number(at), number(at + 4))
    };
    let (mut low, mut high) = (0, count);
    while low < high {
        let middle = (low + high) / 2;
        if knot(middle).0 <= distance { low = middle + 1 } else { high = middle }
    }
    match (low.checked_sub(1).map(knot), (low < count).then(|| knot(low))) {
        (Some((x0, y0)), Some((x1, y1))) => y0 + (y1 - y0) * (distance - x0) / (x1 - x0),
        (Some((_, y)), None) => y,
        (None, _) => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_curve_stays_within_its_tolerance(absorbed in prop::collection::vec(0.0_f32..0.3, 1..200)) {
            let mut builder = TransmittanceBuilder::new();
            let mut left = 1.0;
            let mut points = vec![(0.0, 1.0)];
            for (i, a) in absorbed.iter().enumerate() {
                left *= 1.0 - a * a * a;
                points.push((i as f32 + 1.0, left));
            }
            points.iter().for_each(|&p| builder.push(p));
            let mut page = vec![0; 4096];
            encode(vec![vec![], builder.finish()], &mut page);
            for (x, y) in points {
                let found = transmittance(&page, 2, 1, x);
                prop_assert!((found - y).abs() <= TOLERANCE * 1.01 + 1e-6, "{x}: {found}, {y}");
            }
            prop_assert_eq!(transmittance(&page, 2, 0, 5.0), 1.0);
        }

        #[test]
        fn curves_that_do_not_fit_become_coarser_until_they_do(seed in 0_u32..1000) {
            let curve: Vec<Knot> = (0..300)
                .map(|i| (i as f32, 1.0 / (1.0 + 0.02 * (i + seed % 7) as f32) + 0.01 * ((i * 37 + seed) % 5) as f32))
                .collect();
            let mut page = vec![0; 512];
            encode(vec![curve; 4], &mut page);
            for x in [0.0, 77.7, 150.0, 299.0, 1000.0] {
                let found = transmittance(&page, 4, 3, x);
                prop_assert!((0.0..=1.1).contains(&found));
            }
        }
    }
}
