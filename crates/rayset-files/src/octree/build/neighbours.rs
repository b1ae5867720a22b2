//! The nearest neighbours of points in Hilbert order: how far away they are, and where.
//!
//! Consecutive points are close to each other, so boxes around short stretches of them serve as a
//! search tree, and boxes around groups of these. Points are queried a stretch at a time: of the
//! stretches beside it, those points come first that are next along the curve, because most of them
//! are near. Then only stretches count whose boxes are nearer than what was found. Results are
//! exact, so they do not depend on how points were cut into stretches.

use std::ops::Range;

use rayset_base::geometry::{Aabb, DVec3};

/// Number of points in a stretch.
pub(super) const STRETCH: usize = 32;
/// Number of points whose distances are compared at once.
const FEW: usize = 4;
/// Number of stretches that have a box together.
const GROUP: usize = 32;
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

    /// The nearest of some points at these squared distances; `offset` gives the vector to one of
    /// them. Those of `likely`, at most `LEN`, are taken first: if they are near, most others need
    /// no place.
    fn of(squares: &[f64], likely: Range<usize>, offset: impl Fn(usize) -> [f32; 3]) -> Self {
        let mut nearest = Self::NONE;
        for (at, i) in likely.clone().enumerate() {
            nearest.squares[at] = squares[i];
            if Self::HAS_OFFSETS {
                nearest.offsets[at] = offset(i);
            }
            nearest.sink(at);
        }
        nearest.include_all(&squares[..likely.start], &offset);
        nearest.include_all(&squares[likely.end..], |i| offset(likely.end + i));
        nearest
    }

    fn farthest(&self) -> f64 {
        self.squares[LEN - 1]
    }

    /// Whether points at this squared distance may be among them.
    fn may_include(&self, square: f64) -> bool {
        square < self.farthest() || (Self::HAS_OFFSETS && square == self.farthest())
    }

    /// Includes a point instead of the last one, if it comes before that.
    fn include(&mut self, square: f64, offset: impl FnOnce() -> [f32; 3]) {
        if !self.may_include(square) {
            return;
        }
        let offset = if Self::HAS_OFFSETS { offset() } else { [0.0; 3] };
        if square == self.farthest() && offset >= self.offsets[LEN - 1] {
            return;
        }
        (self.squares[LEN - 1], self.offsets[LEN - 1]) = (square, offset);
        self.sink(LEN - 1);
    }

    /// Includes points at these squared distances.
    fn include_all(&mut self, squares: &[f64], offset: impl Fn(usize) -> [f32; 3]) {
        for (few, squares) in squares.chunks(FEW).enumerate() {
            // Of most few, none is near enough: one comparison for all of them.
            let least = squares.iter().fold(f64::INFINITY, |a, &b| if b < a { b } else { a });
            if self.may_include(least) {
                (few * FEW..).zip(squares).for_each(|(i, &square)| self.include(square, || offset(i)));
            }
        }
    }

    /// Brings what stands at a place before those that it comes before.
    fn sink(&mut self, from: usize) {
        let (square, offset) = (self.squares[from], self.offsets[from]);
        let mut at = from;
        while at > 0 {
            let before = self.squares[at - 1];
            if before < square || (before == square && self.offsets[at - 1] <= offset) {
                break;
            }
            self.squares[at] = before;
            if Self::HAS_OFFSETS {
                self.offsets[at] = self.offsets[at - 1];
            }
            at -= 1;
        }
        self.squares[at] = square;
        if Self::HAS_OFFSETS {
            self.offsets[at] = offset;
        }
    }
}

/// Points in Hilbert order, no two of which coincide, and boxes around stretches of them.
#[derive(Default)]
pub(super) struct Stretches {
    axes: [Vec<f64>; 3],
    boxes: Vec<Aabb>,
    /// A box around every [`GROUP`] boxes that follow each other.
    boxes_of_boxes: Vec<Aabb>,
}

impl Stretches {
    pub(super) fn clear(&mut self) {
        self.axes.iter_mut().for_each(Vec::clear);
        self.boxes.clear();
        self.boxes_of_boxes.clear();
    }

    pub(super) fn push(&mut self, position: [f64; 3]) {
        if self.len().is_multiple_of(STRETCH) {
            if self.boxes.len().is_multiple_of(GROUP) {
                self.boxes_of_boxes.push(Aabb::EMPTY);
            }
            self.boxes.push(Aabb::EMPTY);
        }
        for last in self.boxes.last_mut().into_iter().chain(self.boxes_of_boxes.last_mut()) {
            last.include(DVec3::from_array(position));
        }
        self.axes.iter_mut().zip(position).for_each(|(axis, v)| axis.push(v));
    }

    pub(super) fn len(&self) -> usize {
        self.axes[0].len()
    }

    fn points(&self, stretch: usize) -> Range<usize> {
        stretch * STRETCH..((stretch + 1) * STRETCH).min(self.len())
    }

    fn point(&self, i: usize) -> DVec3 {
        DVec3::new(self.axes[0][i], self.axes[1][i], self.axes[2][i])
    }

    /// The squared distances of some points from `point`, and a function to the vectors from it.
    fn around<'a>(
        &'a self,
        range: Range<usize>,
        point: DVec3,
        squares: &mut [f64],
    ) -> impl Fn(usize) -> [f32; 3] + 'a {
        let [x, y, z] = &self.axes;
        let (x, y, z) = (&x[range.clone()], &y[range.clone()], &z[range]);
        for (((square, x), y), z) in squares.iter_mut().zip(x).zip(y).zip(z) {
            *square = (x - point.x).powi(2) + (y - point.y).powi(2) + (z - point.z).powi(2);
        }
        move |i| [x[i] - point.x, y[i] - point.y, z[i] - point.z].map(|v| v as f32)
    }

    /// Adds the points of a stretch to the nearest of `point`.
    fn collect<const LEN: usize>(&self, stretch: usize, point: DVec3, nearest: &mut Nearest<LEN>) {
        let mut squares = [0.0; STRETCH];
        let range = self.points(stretch);
        let squares = &mut squares[..range.len()];
        let offset = self.around(range, point, squares);
        nearest.include_all(squares, offset);
    }

    /// Numbers of the stretches that may have a neighbour of a point in `bounds`, at a squared
    /// distance of at most `reach`.
    fn within<const LEN: usize>(&self, bounds: &Aabb, reach: f64) -> impl Iterator<Item = usize> + '_ {
        let bounds = *bounds;
        let is_near = move |other: &Aabb| Search::<LEN>::is_within(square_between(&bounds, other), reach);
        let groups = self.boxes_of_boxes.iter().enumerate().filter(move |(_, group)| is_near(group));
        let boxes = groups.flat_map(|(number, _)| {
            let first = number * GROUP;
            first..(first + GROUP).min(self.boxes.len())
        });
        boxes.filter(move |&number| is_near(&self.boxes[number]))
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
            search.begin(stretch, &(queries.points(beside.start).start..queries.points(beside.end - 1).end));
            let near = queries.within::<LEN>(&queries.boxes[stretch], search.reach[stretch]);
            candidates.clear();
            candidates.extend(near.filter(|other| !beside.contains(other)));
            search.visit(stretch, queries, &candidates);
        }
        search
    }

    /// Looks among the points of a stretch, and of those beside it, for the neighbours of its own.
    /// Those before and behind a point in Hilbert order are mostly among the nearest.
    fn begin(&mut self, stretch: usize, about: &Range<usize>) {
        let mut squares = [0.0; 3 * STRETCH];
        let squares = &mut squares[..about.len()];
        for i in self.queries.points(stretch) {
            let offset = self.queries.around(about.clone(), self.queries.point(i), squares);
            let first = (i - about.start).saturating_sub(LEN / 2);
            self.nearest[i] = Nearest::of(squares, first..(first + LEN).min(about.len()), offset);
        }
        self.note_reach(stretch);
    }

    fn note_reach(&mut self, stretch: usize) {
        let nearest = &self.nearest[self.queries.points(stretch)];
        self.reach[stretch] = nearest.iter().fold(0.0, |reach, nearest| nearest.farthest().max(reach));
    }

    /// Adds stretches of `others` to the neighbours of the points of a stretch, where they are near
    /// enough.
    fn visit(&mut self, stretch: usize, others: &Stretches, candidates: &[usize]) {
        for i in self.queries.points(stretch) {
            let (point, nearest) = (self.queries.point(i), &mut self.nearest[i]);
            for &other in candidates {
                if nearest.may_include(square_to(&others.boxes[other], point)) {
                    others.collect(other, point, nearest);
                }
            }
        }
        self.note_reach(stretch);
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
            candidates.extend(others.within::<LEN>(&bounds, reach));
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

    /// What was found of each point: the distance to its neighbour, infinite where there are not so
    /// many points; and the vectors to the nearest ones, itself included, the nearest first. These
    /// are `None` where there are not so many points, or it was not asked where they lie.
    pub(super) fn found(&self) -> impl Iterator<Item = (f64, Option<&[[f32; 3]]>)> + '_ {
        self.nearest.iter().map(|nearest| {
            let are_known = Nearest::<LEN>::HAS_OFFSETS && nearest.farthest().is_finite();
            let offsets = are_known.then_some(nearest.offsets.as_slice());
            (nearest.squares[NEIGHBOUR].sqrt(), offsets)
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
            for (p, (found, _)) in points.iter().zip(search.found()) {
                assert_eq!(found, brute_force(&points, *p), "{p:?}, cut at {cut}");
            }
        }
    }

    /// Compares what is found among points, in any order, with a sort of all of them.
    fn check_offsets<const LEN: usize>(points: &[[f64; 3]]) {
        let (mut first, mut second) = (Stretches::default(), Stretches::default());
        let (own, others) = points.split_at(points.len() - points.len() / 3);
        own.iter().for_each(|&p| first.push(p));
        others.iter().for_each(|&p| second.push(p));
        let mut search = Search::<LEN>::among(&first, || true);
        search.extend(&second);
        let mut checked = 0;
        for (p, (distance, offsets)) in own.iter().zip(search.found()) {
            let mut all: Vec<(f64, [f32; 3])> = (points.iter())
                .map(|q| [q[0] - p[0], q[1] - p[1], q[2] - p[2]])
                .map(|v| (v.iter().map(|v| v * v).sum(), v.map(|v| v as f32)))
                .collect();
            all.sort_by(|a, b| a.partial_cmp(b).expect("numbers"));
            let what = format!("{p:?} of {}, {LEN} neighbours", points.len());
            let expected = all.get(NEIGHBOUR).map_or(f64::INFINITY, |found| found.0.sqrt());
            assert!(distance == expected, "{what}");
            let nearest = all.get(..LEN).map(|nearest| nearest.iter().map(|found| found.1).collect());
            let nearest: Option<Vec<_>> = nearest.filter(|_| LEN > FOR_DISTANCE);
            assert_eq!(offsets.map(<[_]>::to_vec), nearest, "{what}");
            checked += 1;
        }
        assert_eq!(checked, own.len());
    }

    #[test]
    fn neighbours_are_those_of_a_sort_however_many_there_are_and_are_asked_for() {
        for count in [0, 1, 5, 9, 17, 31, 32, 33, 64, 65, 97, 130, 3000] {
            // A lattice of two layers, on which many are equally near.
            let lattice: Vec<[f64; 3]> =
                (0..count).map(|i| [f64::from(i / 2 % 40), f64::from(i / 80), f64::from(i % 2)]).collect();
            let scattered: Vec<[f64; 3]> = points().into_iter().take(count.min(1500) as usize).collect();
            for points in [lattice, scattered] {
                check_offsets::<FOR_DISTANCE>(&points);
                check_offsets::<FOR_SHAPE>(&points);
                check_offsets::<FOR_FLUID>(&points);
            }
        }
    }

    #[test]
    fn where_neighbours_lie_does_not_depend_on_how_points_are_cut_or_ordered() {
        // A lattice, on which many are equally near.
        let mut points: Vec<[f64; 3]> =
            (0..1500).map(|i| [f64::from(i % 40), f64::from(i / 40), 0.0]).collect();
        let mut found = Vec::new();
        let mut state = 1_u64;
        for cut in [32, 512, 1500, 900, 700] {
            let (mut first, mut second) = (Stretches::default(), Stretches::default());
            points[..cut].iter().for_each(|&p| first.push(p));
            points[cut..].iter().for_each(|&p| second.push(p));
            let mut search = Search::<FOR_SHAPE>::among(&first, || true);
            search.extend(&second);
            let of_first = points.iter().zip(search.found());
            let place = of_first.filter(|(p, _)| **p == [7.0, 0.0, 0.0] || **p == [20.0, 20.0, 0.0]);
            found.extend(place.map(|(p, (_, offsets))| (p[0] as u32, offsets.unwrap().to_vec())));
            for end in (1..points.len()).rev() {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                points.swap(end, (state >> 33) as usize % (end + 1));
            }
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
        assert!(Search::<FOR_DISTANCE>::among(&few, || true).found().all(|(d, _)| d.is_infinite()));
    }
}
