//! Where the camera stands so that what is seen fills the picture.

use rayset::geometry::DVec3;

/// The part of the picture's shorter side, or of whichever side is reached first, that the object
/// fills.
const FILLED: f64 = 0.9;
/// Of the points, these parts at either side may be strays, which would make everything else small…
const STRAYS: f64 = 0.001;
/// … if they lie farther from the others than this part of the extent of those.
const APART: f64 = 0.2;
/// What four in five of the points span, times this, is the most that is framed: the returns of a
/// LiDAR from far away, and the outskirts of a halo, would make the rest small.
const CORE: f64 = 4.0;
/// Fewer points than these have no core.
const FEW: usize = 500;
/// How far from a point by itself it is seen, as a part of its radius.
const SEEN: f64 = 0.65;
/// Steps until the frame no longer changes.
const ROUNDS: usize = 24;

/// A camera that looks in a direction.
#[derive(Clone, Copy)]
pub(super) struct Frame {
    pub(super) position: DVec3,
    /// Units of the picture: half its height at distance 1, or half its height of an orthographic
    /// one.
    pub(super) half_height: f64,
}

/// The frame of points for a camera that looks along `direction` with `up`, both of length one and
/// at right angles to each other. `tangent` is that of half the vertical field of view; `None` of
/// an orthographic camera. Each point is given with its radius.
pub(super) fn frame(
    points: &[(DVec3, f64)],
    direction: DVec3,
    up: DVec3,
    tangent: Option<f64>,
    aspect: f64,
) -> Frame {
    let right = direction.cross(up);
    let extent = |axis: DVec3| spread_along(points, axis);
    let (across, upward, along) = (extent(right), extent(up), extent(direction));
    let center = right * across.middle() + up * upward.middle() + direction * along.middle();
    let half = (upward.half()).max(across.half() / aspect).max(1e-300);
    let Some(tangent) = tangent else {
        let position = center - direction * (along.half() + 2.0 * half);
        return Frame { position, half_height: half / FILLED };
    };
    // Seen from nearby, what is in front is larger: the camera is moved until what it sees is in
    // the middle and fills the frame.
    let mut position = center - direction * (along.half() + half / tangent);
    for _ in 0..ROUNDS {
        let seen = |axis: DVec3| {
            spread(points.iter().map(|&(p, r)| {
                // A ball is seen around the side that it turns to the eye.
                let depth = ((p - position).dot(direction) - SEEN * r).max(1e-2 * half);
                ((p - position).dot(axis) / depth, SEEN * r / depth)
            }))
        };
        let (x, y) = (seen(right), seen(up));
        let filled = (y.half() / tangent).max(x.half() / (tangent * aspect)) / FILLED;
        let distance = (center - position).dot(direction).max(1e-6 * half);
        position += (right * x.middle() + up * y.middle()) * distance;
        // Half of the way, so that it does not swing.
        position -= direction * (distance * (filled.clamp(0.5, 2.0) - 1.0) * 0.7);
    }
    Frame { position, half_height: tangent }
}

/// The axis about which the cameras of a turntable turn.
#[derive(Clone, Copy)]
pub(super) struct Axis {
    /// A place on it: the middle of what is framed.
    pub(super) center: DVec3,
    /// Its direction, of length one.
    pub(super) up: DVec3,
}

impl Axis {
    /// The axis along `up` through the middle of points.
    pub(super) fn of(points: &[(DVec3, f64)], up: DVec3) -> Self {
        let middle = |axis: DVec3| axis * spread_along(points, axis).middle();
        let across = up.any_orthonormal_vector();
        Self { center: middle(up) + middle(across) + middle(up.cross(across)), up }
    }
}

/// The frame of the first camera of a turntable, from which all of them see all points: as
/// [`frame`], but points count wherever they come to lie while the camera turns about `axis`.
pub(super) fn turning_frame(
    points: &[(DVec3, f64)],
    axis: Axis,
    direction: DVec3,
    up: DVec3,
    tangent: Option<f64>,
    aspect: f64,
) -> Frame {
    /// Turns of the camera that are looked at.
    const TURNS: usize = 48;
    let right = direction.cross(up);
    let across = axis.up.any_orthonormal_vector();
    let sides = [across, axis.up.cross(across), axis.up];
    let spreads = sides.map(|side| spread_along(points, side));
    // All that matters of a point is how far from the axis it is, and how far along it: once round
    // it is everywhere.
    let is_framed = |p: DVec3| sides.iter().zip(spreads).all(|(side, spread)| spread.has(p.dot(*side)));
    let framed = points.iter().filter(|(p, _)| is_framed(*p)).map(|&(p, r)| {
        let offset = p - axis.center;
        let along = offset.dot(axis.up);
        ((offset - axis.up * along).length(), along, SEEN * r)
    });
    let framed: Vec<(f64, f64, f64)> = framed.collect();
    let turns: Vec<DVec3> = (0..TURNS)
        .map(|k| (k as f64 / TURNS as f64 * std::f64::consts::TAU).sin_cos())
        .map(|(sine, cosine)| sides[0] * cosine + sides[1] * sine)
        .collect();
    let half = framed.iter().fold(1e-300_f64, |half, (off, along, r)| half.max(off.hypot(*along) + r));
    // What is seen by a camera at a place, across and upward, from the lowest to the highest;
    // `scale` is what lengths in a depth are divided by.
    let seen = |position: DVec3, scale: &dyn Fn(f64) -> f64| {
        let (mut widest, mut low, mut high) = (0.0_f64, f64::INFINITY, f64::NEG_INFINITY);
        for &(off, along, r) in &framed {
            for turn in &turns {
                let offset = axis.center + *turn * off + axis.up * along - position;
                let scale = scale(offset.dot(direction) - r);
                let (x, y, r) = (offset.dot(right) / scale, offset.dot(up) / scale, r / scale);
                (widest, low, high) = (widest.max(x.abs() + r), low.min(y - r), high.max(y + r));
            }
        }
        if framed.is_empty() { (0.0, Spread { low: 0.0, high: 0.0 }) } else { (widest, Spread { low, high }) }
    };
    let Some(tangent) = tangent else {
        let (widest, upward) = seen(axis.center, &|_| 1.0);
        let half_height = upward.half().max(widest / aspect).max(1e-300) / FILLED;
        let position = axis.center + up * upward.middle() - direction * 3.0 * half;
        return Frame { position, half_height };
    };
    let mut position = axis.center - direction * (half + half / tangent);
    for _ in 0..ROUNDS {
        let (widest, upward) = seen(position, &|depth: f64| depth.max(1e-2 * half));
        let filled = (upward.half() / tangent).max(widest / (tangent * aspect)) / FILLED;
        let distance = (axis.center - position).dot(direction).max(1e-6 * half);
        position += up * upward.middle() * distance;
        position -= direction * (distance * (filled.clamp(0.5, 2.0) - 1.0) * 0.7);
    }
    Frame { position, half_height: tangent }
}

/// What is left of points if those in other places, far away, are left out, and how far the largest
/// of these is away, if it is more than a few strays.
pub(super) fn one_place(mut points: Vec<(DVec3, f64)>) -> (Vec<(DVec3, f64)>, Option<f64>) {
    /// Places are told apart if what is between them is this many times as long as the larger one.
    const EMPTY: f64 = 10.0;
    /// Parts of the points that are worth a word.
    const PART: f64 = 0.005;
    let (all, mut away) = (points.len() as f64, None);
    // Rounds in turn that left nothing out: after one along each axis, no other will.
    let mut idle = 0;
    for round in 0..12 {
        let axis = round % 3;
        if points.len() < FEW || idle == 3 {
            break;
        }
        points.sort_by(|a, b| a.0[axis].total_cmp(&b.0[axis]));
        let gaps = points.windows(2).enumerate().map(|(i, pair)| (i + 1, pair[1].0[axis] - pair[0].0[axis]));
        let Some((at, gap)) = gaps.max_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        let keeps_first = 2 * at >= points.len();
        let kept = if keeps_first { 0..at } else { at..points.len() };
        // Of the whole place: what lies on steps has gaps along one axis.
        let ends = |of: fn(DVec3, DVec3) -> DVec3| points[kept.clone()].iter().map(|(p, _)| *p).reduce(of);
        let (Some(low), Some(high)) = (ends(DVec3::min), ends(DVec3::max)) else { break };
        let length = (high - low).max_element();
        idle += 1;
        if gap > EMPTY * length.max(1e-300) && gap.is_finite() {
            idle = 0;
            if (points.len() - kept.len()) as f64 > PART * all {
                away = Some(away.unwrap_or(0.0_f64).max(gap));
            }
            points = points[kept].to_vec();
        }
    }
    (points, away)
}

/// The least and the largest coordinates of what is framed, whichever side it is seen from. Each
/// point is given with its radius.
pub(super) fn reach(points: &[(DVec3, f64)]) -> [DVec3; 2] {
    let along = |axis: usize| spread(points.iter().map(|&(p, r)| (p[axis], SEEN * r)));
    let spreads = [0, 1, 2].map(along);
    [spreads.map(|s| s.low).into(), spreads.map(|s| s.high).into()]
}

/// The outermost places of the points within a box, each with its radius, in directions that are
/// spread evenly: what frames them frames all.
pub(super) fn outline(points: &[(DVec3, f64)], [low, high]: [DVec3; 2]) -> Vec<DVec3> {
    /// Directions besides the six of the axes.
    const DIRECTIONS: usize = 58;
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let spread = (0..DIRECTIONS).map(|k| {
        let z = 1.0 - (2.0 * k as f64 + 1.0) / DIRECTIONS as f64;
        let (sine, cosine) = (golden * k as f64).sin_cos();
        DVec3::new(cosine, sine, 0.0) * (1.0 - z * z).sqrt() + DVec3::Z * z
    });
    let axes = DVec3::AXES.into_iter().flat_map(|axis| [axis, -axis]);
    let is_within = |p: DVec3| p.cmpge(low).all() && p.cmple(high).all();
    let within: Vec<(DVec3, f64)> = points.iter().copied().filter(|(p, _)| is_within(*p)).collect();
    let outermost = |direction: DVec3| {
        let places = within.iter().map(|&(p, r)| p + direction * (SEEN * r));
        places.max_by(|a, b| a.dot(direction).total_cmp(&b.dot(direction)))
    };
    axes.chain(spread).filter_map(outermost).collect()
}

/// Where most of some intervals lie on an axis.
#[derive(Clone, Copy)]
struct Spread {
    low: f64,
    high: f64,
}

impl Spread {
    fn middle(self) -> f64 {
        0.5 * (self.low + self.high)
    }

    fn half(self) -> f64 {
        0.5 * (self.high - self.low)
    }

    fn has(self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}

/// The spread of points, each with its radius, along an axis.
fn spread_along(points: &[(DVec3, f64)], axis: DVec3) -> Spread {
    spread(points.iter().map(|&(p, r)| (p.dot(axis), SEEN * r)))
}

/// The spread of intervals, each a middle and half a length.
fn spread(intervals: impl Iterator<Item = (f64, f64)>) -> Spread {
    let (mut lows, mut highs): (Vec<f64>, Vec<f64>) = intervals.map(|(m, h)| (m - h, m + h)).unzip();
    let Some(last) = lows.len().checked_sub(1) else { return Spread { low: 0.0, high: 0.0 } };
    // What a place in their order has; much sooner than to sort them.
    let at = |values: &mut [f64], place: usize| *values.select_nth_unstable_by(place, f64::total_cmp).1;
    let left_out = (STRAYS * lows.len() as f64) as usize;
    let (low, high) = (at(&mut lows, left_out), at(&mut highs, last - left_out));
    let apart = APART * (high - low);
    let within = |values: &[f64], least: f64, most: f64| {
        let within = values.iter().copied().filter(move |v| (least..=most).contains(v));
        (within.clone().min_by(f64::total_cmp), within.max_by(f64::total_cmp))
    };
    let lowest = within(&lows, low - apart, f64::INFINITY).0.unwrap_or(low);
    let highest = within(&highs, f64::NEG_INFINITY, high + apart).1.unwrap_or(high);
    if lows.len() < FEW {
        return Spread { low: lowest, high: highest };
    }
    let (from, to) =
        (at(&mut lows, (0.1 * last as f64) as usize), at(&mut highs, (0.9 * last as f64) as usize));
    let (middle, most) = (0.5 * (from + to), 0.5 * CORE * (to - from));
    // The outermost that are within, and not the bounds themselves, between which there may be
    // nothing.
    let least = within(&lows, middle - most, middle + most).0.unwrap_or(from);
    let largest = within(&highs, middle - most, middle + most).1.unwrap_or(to);
    Spread { low: lowest.max(least), high: highest.min(largest) }
}
