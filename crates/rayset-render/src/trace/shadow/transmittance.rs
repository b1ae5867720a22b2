//! Transmittance along a ray as a piecewise linear curve (after Lokovic & Veach, *Deep Shadow
//! Maps*, 2000), and the layout of a tile's curves in a page.

/// A knot of a curve: distance and transmittance.
pub(super) type Knot = (f32, f32);

/// Largest error of a curve, unless its tile would not fit into the page.
const TOLERANCE: f32 = 1.0 / 1024.0;
/// Knots of a tile in the making, over all its curves: four times what a page has room for.
const MOST_KNOTS: usize = 8192;

/// The curves of a tile in the making, in memory of a fixed size. Each keeps only the points
/// without which its error would exceed the tolerance; if the knots of all curves are too many, the
/// tolerance is doubled for all of them.
#[derive(Clone, Debug)]
pub(super) struct TransmittanceCurves {
    tolerance: f32,
    curves: Vec<Curve>,
    knots: KnotLists,
    /// Where coarser curves are written, to take the place of `knots`.
    coarser: KnotLists,
}

/// A curve that is being extended: a list of knots, and what follows it.
#[derive(Clone, Copy, Debug, Default)]
struct Curve {
    /// Numbers of the first and the last knot.
    ends: Option<(u16, u16)>,
    count: u16,
    /// The latest point after the last knot, and the range of slopes that fit all points since that
    /// knot.
    pending: Option<(Knot, f32, f32)>,
}

/// Lists of knots in one allocation: each knot has the number of the next.
#[derive(Clone, Debug)]
struct KnotLists(Vec<(Knot, u16)>);

impl KnotLists {
    fn new() -> Self {
        // What a full list needs besides its limit: every curve's pending point when the tile is
        // finished.
        Self(Vec::with_capacity(MOST_KNOTS + MOST_CURVES))
    }

    fn append(&mut self, curve: &mut Curve, knot: Knot) {
        let number = self.0.len() as u16;
        self.0.push((knot, u16::MAX));
        if let Some((_, last)) = curve.ends {
            self.0[usize::from(last)].1 = number;
        }
        curve.ends = Some((curve.ends.map_or(number, |(first, _)| first), number));
        curve.count += 1;
    }

    fn last(&self, curve: &Curve) -> Option<Knot> {
        curve.ends.map(|(_, last)| self.0[usize::from(last)].0)
    }

    fn of(&self, curve: &Curve) -> impl Iterator<Item = Knot> {
        let mut next = curve.ends.map_or(0, |(first, _)| first);
        (0..curve.count).map(move |_| {
            let (knot, following) = self.0[usize::from(next)];
            next = following;
            knot
        })
    }

    /// Adds a point to a curve, farther than all before.
    fn push(&mut self, curve: &mut Curve, point: Knot, tolerance: f32) {
        let Some((x0, y0)) = self.last(curve) else { return self.append(curve, point) };
        let slopes = |x0: f32, y0: f32| {
            let run = (point.0 - x0).max(f32::MIN_POSITIVE);
            let slope = (point.1 - y0) / run;
            (slope, slope - tolerance / run, slope + tolerance / run)
        };
        let (slope, low, high) = slopes(x0, y0);
        match curve.pending {
            Some((_, least, most)) if slope >= least && slope <= most => {
                curve.pending = Some((point, least.max(low), most.min(high)));
            }
            Some((before, ..)) => {
                self.append(curve, before);
                let (_, low, high) = slopes(before.0, before.1);
                curve.pending = Some((point, low, high));
            }
            None => curve.pending = Some((point, low, high)),
        }
    }
}

/// Most curves of a tile.
const MOST_CURVES: usize = 64;

impl TransmittanceCurves {
    /// Bytes of the curves of one tile.
    pub(super) const BYTES: usize =
        2 * (MOST_KNOTS + MOST_CURVES) * size_of::<(Knot, u16)>() + MOST_CURVES * size_of::<Curve>();

    pub(super) fn new() -> Self {
        Self {
            tolerance: TOLERANCE,
            curves: Vec::with_capacity(MOST_CURVES),
            knots: KnotLists::new(),
            coarser: KnotLists::new(),
        }
    }

    /// Forgets everything, and begins `curves` empty curves, at most 64.
    pub(super) fn begin(&mut self, curves: usize) {
        self.tolerance = TOLERANCE;
        self.curves.clear();
        self.curves.resize(curves, Curve::default());
        self.knots.0.clear();
    }

    /// Distance of the last point of a curve.
    pub(super) fn last(&self, curve: usize) -> Option<f32> {
        let curve = &self.curves[curve];
        curve.pending.map(|((x, _), ..)| x).or_else(|| self.knots.last(curve).map(|(x, _)| x))
    }

    /// Adds a point to a curve, which must be farther than all before.
    pub(super) fn push(&mut self, curve: usize, point: Knot) {
        self.knots.push(&mut self.curves[curve], point, self.tolerance);
        if self.knots.0.len() >= MOST_KNOTS {
            self.simplify(MOST_KNOTS / 2);
        }
    }

    /// Doubles the tolerance of all curves until no more than `most` knots are left.
    fn simplify(&mut self, most: usize) {
        while self.knots.0.len() > most {
            self.tolerance *= 2.0;
            self.coarser.0.clear();
            for curve in &mut self.curves {
                let mut simpler = Curve::default();
                let points = self.knots.of(curve).chain(curve.pending.map(|(point, ..)| point));
                points.for_each(|point| self.coarser.push(&mut simpler, point, self.tolerance));
                *curve = simpler;
            }
            std::mem::swap(&mut self.knots, &mut self.coarser);
        }
    }

    /// Completes the curves.
    fn finish(&mut self) {
        for curve in &mut self.curves {
            if let Some((point, ..)) = curve.pending.take() {
                self.knots.append(curve, point);
            }
        }
    }

    /// Completes the curves and writes them into the page of their tile. If they do not fit, all
    /// are simplified with a larger tolerance.
    pub(super) fn encode(&mut self, page: &mut [u8]) {
        let room = (page.len() - self.curves.len() * HEAD_BYTES) / KNOT_BYTES;
        self.finish();
        while self.knots.0.len() > room {
            self.simplify(self.knots.0.len() - 1);
            self.finish();
        }
        let (heads, knots) = page.split_at_mut(self.curves.len() * HEAD_BYTES);
        let mut first = 0;
        for (curve, head) in self.curves.iter().zip(heads.chunks_exact_mut(HEAD_BYTES)) {
            head[..2].copy_from_slice(&(first as u16).to_le_bytes());
            head[2..].copy_from_slice(&curve.count.to_le_bytes());
            for (i, (x, y)) in self.knots.of(curve).enumerate() {
                let at = (first + i) * KNOT_BYTES;
                knots[at..at + 4].copy_from_slice(&x.to_le_bytes());
                knots[at + 4..at + 8].copy_from_slice(&y.to_le_bytes());
            }
            first += usize::from(curve.count);
        }
    }
}

/// Bytes of a ray's head: index of its first knot and number of knots.
const HEAD_BYTES: usize = 4;
const KNOT_BYTES: usize = 8;

/// The curve of one ray of a tile of `rays` rays: its knots, in ascending order of distances.
#[inline(always)]
fn curve(page: &[u8], rays: usize, ray: usize) -> &[[u8; KNOT_BYTES]] {
    let (heads, knots) = page.split_at(rays * HEAD_BYTES);
    let [a, b, c, d] = heads.as_chunks::<HEAD_BYTES>().0[ray];
    let (first, count) = (usize::from(u16::from_le_bytes([a, b])), usize::from(u16::from_le_bytes([c, d])));
    &knots.as_chunks::<KNOT_BYTES>().0[first..first + count]
}

/// Transmittance at a distance on one ray of a tile of `rays` rays.
#[inline(always)]
pub(super) fn transmittance(page: &[u8], rays: usize, ray: usize, distance: f32) -> f32 {
    let knots = curve(page, rays, ray);
    let knot = |[a, b, c, d, e, f, g, h]: [u8; KNOT_BYTES]| {
        (f32::from_le_bytes([a, b, c, d]), f32::from_le_bytes([e, f, g, h]))
    };
    // Most places are in front of all that a ray meets, or behind.
    let (Some(&first), Some(&last)) = (knots.first(), knots.last()) else { return 1.0 };
    let ((nearest, _), (farthest, left)) = (knot(first), knot(last));
    if !(nearest <= distance) {
        return 1.0;
    }
    if farthest <= distance {
        return left;
    }
    let (mut low, mut high) = (1, knots.len() - 1);
    while low < high {
        let middle = (low + high) / 2;
        if knot(knots[middle]).0 <= distance { low = middle + 1 } else { high = middle }
    }
    let ((x0, y0), (x1, y1)) = (knot(knots[low - 1]), knot(knots[low]));
    y0 + (y1 - y0) * (distance - x0) / (x1 - x0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_curve_stays_within_its_tolerance(absorbed in prop::collection::vec(0.0_f32..0.3, 1..200)) {
            let mut curves = TransmittanceCurves::new();
            curves.begin(2);
            let mut left = 1.0;
            let mut points = vec![(0.0, 1.0)];
            for (i, a) in absorbed.iter().enumerate() {
                left *= 1.0 - a * a * a;
                points.push((i as f32 + 1.0, left));
            }
            points.iter().for_each(|&p| curves.push(1, p));
            let mut page = vec![0; 4096];
            curves.encode(&mut page);
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
            let mut curves = TransmittanceCurves::new();
            curves.begin(4);
            curve.iter().for_each(|&p| (0..4).for_each(|i| curves.push(i, p)));
            curves.encode(&mut page);
            for x in [0.0, 77.7, 150.0, 299.0, 1000.0] {
                let found = transmittance(&page, 4, 3, x);
                prop_assert!((0.0..=1.1).contains(&found));
            }
        }
    }
}
