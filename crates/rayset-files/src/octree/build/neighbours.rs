//! The nearest neighbours of points in Hilbert order: how far away they are, and where.
//!
//! Consecutive points are close to each other, so boxes around short stretches of them serve as a
//! search tree. Points are queried a stretch at a time: the stretches beside it bound the
//! distances, and then only those count whose boxes are nearer than that. Results are exact, so
//! they do not depend on how points were cut into stretches.

use rayset_base::geometry::{Aabb, DVec3};

/// Number of points in a stretch.
pub(super) const STRETCH: usize = 32;
/// The neighbour whose distance is measured; a point is its own neighbour 0.
pub(super) const NEIGHBOUR: usize = 8;
/// Points that are looked for, themselves included, where only that distance counts.
pub(super) const FOR_DISTANCE: usize = NEIGHBOUR + 1;
/// Those where it is also asked where they lie.
pub(super) const FOR_SHAPE: usize = 17;
/// The same of a fluid, which has neighbours on all sides.
pub(super) const FOR_FLUID: usize = 33;

/// The nearest `LEN` points to one that have been found so far, itself included, the nearest first.
/// Of equally near ones those with smaller coordinates come first, if it is asked where they lie:
/// which of them are found must not depend on the order in which they are met.
#[derive(Clone)]
struct Nearest<const LEN: usize> {
    squares: [f64; LEN],
    /// The vectors to them, where these are asked for.
    offsets: [[f32; 3]; LEN],
}

impl<const LEN: usize> Nearest<LEN> {
    const NONE: Self = Self { squares: [f64::INFINITY; LEN], offsets: [[0.0; 3]; LEN] };
    /// Whether offsets are kept.
    const HAS_OFFSETS: bool = LEN > FOR_DISTANCE;

    /// Whether points at this squared distance may be among them.
    fn may_include(&self, square: f64) -> bool {
        let farthest = self.squares[LEN - 1];
        square < farthest || (Self::HAS_OFFSETS && square == farthest)
    }

    fn include(&mut self, square: f64, offset: impl FnOnce() -> [f32; 3]) {
        if !self.may_include(square) {
            return;
        }
        let offset = if Self::HAS_OFFSETS { offset() } else { [0.0; 3] };
        let comes_before = |other: f64, place: [f32; 3]| {
            other > square || (Self::HAS_OFFSETS && other == square && place > offset)
        };
        let mut at = LEN;
        while at > 0 && comes_before(self.squares[at - 1], self.offsets[at - 1]) {
            at -= 1;
        }
        if at == LEN {
            return;
        }
        self.squares.copy_within(at..LEN - 1, at + 1);
        self.squares[at] = square;
        if Self::HAS_OFFSETS {
            self.offsets.copy_within(at..LEN - 1, at + 1);
            self.offsets[at] = offset;
        }
    }
}

/// Points in Hilbert order, no two of which coincide, and boxes around stretches of them.
#[derive(Default)]
pub(super) struct Stretches {
    axes: [Vec<f64>; 3],
    boxes: Vec<Aabb>,
}

impl Stretches {
    pub(super) fn clear(&mut self) {
        self.axes.iter_mut().for_each(Vec::clear);
        self.boxes.clear();
    }

    pub(super) fn push(&mut self, position: [f64; 3]) {
        if self.len().is_multiple_of(STRETCH) {
            self.boxes.push(Aabb::EMPTY);
        }
        if let Some(last) = self.boxes.last_mut() {
            last.include(DVec3::from_array(position));
        }
        self.axes.iter_mut().zip(position).for_each(|(axis, v)| axis.push(v));
    }

    pub(super) fn len(&self) -> usize {
        self.axes[0].len()
    }

    fn points(&self, stretch: usize) -> std::ops::Range<usize> {
        stretch * STRETCH..((stretch + 1) * STRETCH).min(self.len())
    }

    fn point(&self, i: usize) -> DVec3 {
        DVec3::new(self.axes[0][i], self.axes[1][i], self.axes[2][i])
    }

    /// Adds the points of a stretch to the nearest of `point`.
    fn collect<const LEN: usize>(&self, stretch: usize, point: DVec3, nearest: &mut Nearest<LEN>) {
        let range = self.points(stretch);
        let [x, y, z] = &self.axes;
        let (x, y, z) = (&x[range.clone()], &y[range.clone()], &z[range]);
        let mut squares = [f64::INFINITY; STRETCH];
        for (((square, x), y), z) in squares.iter_mut().zip(x).zip(y).zip(z) {
            *square = (x - point.x).powi(2) + (y - point.y).powi(2) + (z - point.z).powi(2);
        }
        for (i, square) in squares.into_iter().enumerate().take(x.len()) {
            nearest.include(square, || [x[i] - point.x, y[i] - point.y, z[i] - point.z].map(|v| v as f32));
        }
    }
}

/// The search for the neighbours of all points of some stretches.
pub(super) struct Search<'a, const LEN: usize> {
    queries: &'a Stretches,
    nearest: Vec<Nearest<LEN>>,
    /// For each stretch, the largest squared distance at which a neighbour of one of its points may
    /// still be found.
    reach: Vec<f64>,
}

impl<'a, const LEN: usize> Search<'a, LEN> {
    /// Bytes for each point.
    pub(super) const POINT_BYTES: usize = size_of::<Nearest<LEN>>();

    /// Whether a squared distance is within another, at which a neighbour may still be found.
    pub(super) fn is_within(square: f64, reach: f64) -> bool {
        square < reach || (Nearest::<LEN>::HAS_OFFSETS && square == reach)
    }

    /// Finds the neighbours among the points themselves. `go_on` is asked before each stretch; once
    /// it says no, the rest is left out.
    pub(super) fn among(queries: &'a Stretches, go_on: impl Fn() -> bool) -> Self {
        let nearest = vec![Nearest::NONE; queries.len()];
        let mut search = Self { queries, nearest, reach: vec![f64::INFINITY; queries.boxes.len()] };
        let mut candidates = Vec::new();
        for stretch in 0..queries.boxes.len() {
            if !go_on() {
                break;
            }
            let beside = stretch.saturating_sub(1)..(stretch + 2).min(queries.boxes.len());
            search.visit(stretch, queries, &[stretch]);
            candidates.clear();
            candidates.extend(beside.clone().filter(|&other| other != stretch));
            search.visit(stretch, queries, &candidates);
            let (bounds, reach) = (queries.boxes[stretch], search.reach[stretch]);
            candidates.clear();
            candidates.extend((0..queries.boxes.len()).filter(|other| {
                let square = square_between(&bounds, &queries.boxes[*other]);
                !beside.contains(other) && Self::is_within(square, reach)
            }));
            search.visit(stretch, queries, &candidates);
        }
        search
    }

    /// Adds stretches of `others` to the neighbours of the points of a stretch, where they are near
    /// enough.
    fn visit(&mut self, stretch: usize, others: &Stretches, candidates: &[usize]) {
        let mut reach = 0.0_f64;
        for i in self.queries.points(stretch) {
            let (point, nearest) = (self.queries.point(i), &mut self.nearest[i]);
            for &other in candidates {
                if nearest.may_include(square_to(&others.boxes[other], point)) {
                    others.collect(other, point, nearest);
                }
            }
            reach = reach.max(nearest.squares[LEN - 1]);
        }
        self.reach[stretch] = reach;
    }

    /// Whether a point in `bounds` could be a neighbour.
    pub(super) fn reaches(&self, bounds: &Aabb) -> bool {
        let stretches = self.queries.boxes.iter().zip(&self.reach);
        stretches.into_iter().any(|(own, &reach)| Self::is_within(square_between(own, bounds), reach))
    }

    /// Adds other points to the neighbours.
    pub(super) fn extend(&mut self, others: &Stretches) {
        let mut candidates = Vec::new();
        for stretch in 0..self.reach.len() {
            let (bounds, reach) = (self.queries.boxes[stretch], self.reach[stretch]);
            candidates.clear();
            candidates.extend(
                (0..others.boxes.len())
                    .filter(|&other| Self::is_within(square_between(&bounds, &others.boxes[other]), reach)),
            );
            if !candidates.is_empty() {
                self.visit(stretch, others, &candidates);
            }
        }
    }

    /// The box of all points, and the largest squared distance at which a neighbour may still be
    /// found.
    pub(super) fn extent(&self) -> (Aabb, f64) {
        let bounds = self.queries.boxes.iter().fold(Aabb::EMPTY, |all, one| all.union(*one));
        (bounds, self.reach.iter().fold(0.0, |a: f64, &b| a.max(b)))
    }

    /// The distance of each point to its neighbour; infinite where there are not so many points.
    pub(super) fn distances(&self) -> impl Iterator<Item = f64> + '_ {
        self.nearest.iter().map(|nearest| nearest.squares[NEIGHBOUR].sqrt())
    }

    /// The vectors from each point to the nearest ones, itself included; `None` where there are not
    /// so many points, or it was not asked where they lie.
    pub(super) fn neighbours(&self) -> impl Iterator<Item = Option<&[[f32; 3]]>> + '_ {
        self.nearest.iter().map(|nearest| {
            let are_known = Nearest::<LEN>::HAS_OFFSETS && nearest.squares[LEN - 1].is_finite();
            are_known.then_some(nearest.offsets.as_slice())
        })
    }
}

/// Squared distance of a point from a box.
fn square_to(bounds: &Aabb, p: DVec3) -> f64 {
    (bounds.min - p).max(p - bounds.max).max(DVec3::ZERO).length_squared()
}

/// Squared distance between two boxes.
pub(super) fn square_between(a: &Aabb, b: &Aabb) -> f64 {
    (a.min - b.max).max(b.min - a.max).max(DVec3::ZERO).length_squared()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a sheet with a dense patch, and nine at one place.
    fn points() -> Vec<[f64; 3]> {
        let mut state = 7_u64;
        let mut unit = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut points: Vec<[f64; 3]> = (0..1500)
            .map(|i| {
                let scale = if i % 3 == 0 { 0.05 } else { 1.0 };
                [scale * unit(), scale * unit(), 0.1 * scale * unit()]
            })
            .collect();
        points.extend([[0.5, 0.5, 0.02]; NEIGHBOUR + 1]);
        // Any order is allowed; this one makes boxes that are of some use.
        points.sort_by(|a, b| {
            ((a[0] * 20.0).floor(), a[1]).partial_cmp(&((b[0] * 20.0).floor(), b[1])).expect("numbers")
        });
        points
    }

    fn brute_force(points: &[[f64; 3]], p: [f64; 3]) -> f64 {
        let mut squares: Vec<f64> =
            points.iter().map(|q| (0..3).map(|a| (p[a] - q[a]).powi(2)).sum()).collect();
        squares.sort_by(f64::total_cmp);
        squares[NEIGHBOUR].sqrt()
    }

    #[test]
    fn neighbours_are_those_of_brute_force_wherever_points_are_cut() {
        let points = points();
        for cut in [32, 512, 960, 1509] {
            let (mut first, mut second) = (Stretches::default(), Stretches::default());
            points[..cut].iter().for_each(|&p| first.push(p));
            points[cut..].iter().for_each(|&p| second.push(p));
            let mut search = Search::<FOR_DISTANCE>::among(&first, || true);
            search.extend(&second);
            for (p, found) in points.iter().zip(search.distances()) {
                assert_eq!(found, brute_force(&points, *p), "{p:?}, cut at {cut}");
            }
        }
    }

    #[test]
    fn where_neighbours_lie_does_not_depend_on_how_points_are_cut_or_ordered() {
        // A lattice, on which many are equally near.
        let mut points: Vec<[f64; 3]> =
            (0..1500).map(|i| [f64::from(i % 40), f64::from(i / 40), 0.0]).collect();
        let mut found = Vec::new();
        for cut in [32, 512, 1500] {
            let (mut first, mut second) = (Stretches::default(), Stretches::default());
            points[..cut].iter().for_each(|&p| first.push(p));
            points[cut..].iter().for_each(|&p| second.push(p));
            let mut search = Search::<FOR_SHAPE>::among(&first, || true);
            search.extend(&second);
            let of_first = points.iter().zip(search.neighbours());
            let place = of_first.filter(|(p, _)| **p == [7.0, 0.0, 0.0] || **p == [20.0, 20.0, 0.0]);
            found.extend(place.map(|(p, offsets)| (p[0] as u32, offsets.unwrap().to_vec())));
            points.reverse();
        }
        found.sort_by_key(|(x, _)| *x);
        found.dedup();
        let [(_, edge), (_, inside)] = &found[..] else { panic!("{} neighbourhoods", found.len()) };
        assert!(edge.len() == 17 && edge.contains(&[0.0; 3]) && inside.contains(&[-2.0, -1.0, 0.0]));
    }

    #[test]
    fn too_few_points_have_no_distance() {
        let mut few = Stretches::default();
        (0..NEIGHBOUR).for_each(|i| few.push([i as f64, 0.0, 0.0]));
        assert!(Search::<FOR_DISTANCE>::among(&few, || true).distances().all(f64::is_infinite));
    }
}
