//! What is up in a cloud, by what its file says, its columns and its shape.

use rayset::Cloud;
use rayset::file::Header;
use rayset::geometry::DVec3;

use super::shape::{is_seen_from_behind, relief, stance};
use super::statistics::{Statistics, range};
use super::view::Orientation;

/// Scans of less than this along every side are of things on a turntable, whose files have y up by
/// custom.
const OBJECT: f64 = 1.0;
/// Things in the unit ball about the origin, as collections of models have them, reach this far.
const UNIT: f64 = 1.01;
/// Rooms and buildings are as large as this, in metres.
const SITE: std::ops::Range<f64> = 2.0..60.0;
/// Rooms are as high as this, in metres.
const ROOM: std::ops::Range<f64> = 2.0..6.0;
/// People stand as high as this, in metres.
const PERSON: std::ops::Range<f64> = 1.2..2.4;
/// Coordinates from here on are those of a map.
const MAP: f64 = 1e4;
/// Distances of places near the surface of the Earth from its middle, in metres: at poles, under
/// the sea, on mountains.
const EARTH: std::ops::Range<f64> = 6.33e6..6.40e6;
/// Of what is larger than this, in metres, the surface of the Earth is bent too much for one
/// direction to be up.
const BENT: f64 = 2e5;

/// Whether points are where a depth camera sees them from the origin, which has x to the right, y
/// down and z ahead: all within its field of view. Of files that may be anything, `is_of_sensor`
/// false, the view is filled to both sides.
fn is_camera_frame(statistics: &Statistics, is_of_sensor: bool) -> bool {
    /// Of depth cameras, at most: the tangent of half their field of view.
    const TANGENT: f64 = 1.2;
    /// What fills a view reaches this far to either side, at least.
    const REACH: f64 = 0.1;
    let points: Vec<DVec3> = statistics.positions().filter(|p| p.is_finite()).collect();
    let is_seen = |p: &DVec3| p.z > 0.0 && p.x.abs().max(p.y.abs()) < TANGENT * p.z;
    let reaches = |tangent: &dyn Fn(&DVec3) -> f64| {
        let (low, high) =
            (points.iter().map(tangent)).fold((0.0_f64, 0.0_f64), |(l, h), t| (l.min(t), h.max(t)));
        low < -REACH && high > REACH
    };
    let is_filled = || reaches(&|p| p.x / p.z) && reaches(&|p| p.y / p.z);
    !points.is_empty() && points.iter().all(is_seen) && (is_of_sensor || is_filled())
}

/// The sides of what most points fill.
struct Extents {
    sides: [f64; 3],
    /// The middles between them.
    middle: [f64; 3],
    thin: usize,
    long: usize,
}

impl Extents {
    fn of(statistics: &Statistics) -> Self {
        let ranges = ["x", "y", "z"].map(|axis| range(&statistics.sorted(axis), 0.005));
        let sides = ranges.map(|(low, high)| high - low);
        let by_side = |&a: &usize, &b: &usize| sides[a].total_cmp(&sides[b]);
        let (thin, long) = ((0..3).min_by(by_side).unwrap_or(2), (0..3).max_by(by_side).unwrap_or(2));
        Self { sides, middle: ranges.map(|(low, high)| 0.5 * (low + high)), thin, long }
    }

    fn others(&self, axis: usize) -> impl Iterator<Item = f64> + '_ {
        (0..3).filter(move |&other| other != axis).map(|other| self.sides[other])
    }

    /// Whether the side along an axis is less than a part of each of the others.
    fn is_thin(&self, axis: usize, part: f64) -> bool {
        self.sides[axis] < part * self.others(axis).fold(f64::INFINITY, f64::min)
    }

    /// What is up of Earth-centred coordinates: the direction from the middle of the Earth; `None`
    /// of others.
    fn away_from_earth(&self) -> Option<DVec3> {
        let middle = DVec3::from_array(self.middle);
        let is_near = EARTH.contains(&middle.length()) && self.sides[self.long] < BENT;
        is_near.then(|| middle.normalize())
    }

    /// Whether points stand along an axis.
    fn is_long(&self, axis: usize) -> bool {
        self.sides[axis] > 1.3 * self.others(axis).fold(0.0, f64::max)
    }

    /// The axis along which a person would stand, by these extents.
    fn person(&self) -> Option<usize> {
        let is_person = PERSON.contains(&self.sides[self.long]) && self.is_long(self.long);
        let is_slab = self.sides[self.thin] < 0.12 * self.sides[self.long];
        (is_person && !is_slab && self.long > 0).then_some(self.long)
    }

    /// Whether points are a thing by their size, and not a site.
    fn is_object(&self) -> bool {
        let reach = (0..3).map(|axis| self.middle[axis].abs() + 0.5 * self.sides[axis]).fold(0.0, f64::max);
        self.sides[self.long] < OBJECT || reach <= UNIT
    }

    /// Whether coordinates are so large that they are those of a map.
    fn is_on_map(&self) -> bool {
        let far = |axis: usize| self.middle[axis].abs() > MAP.max(20.0 * self.sides[self.long]);
        far(0) && far(1)
    }
}

/// The direction against that in which particles fall, y or z; `None` if they have no velocities,
/// or others than that.
fn against_the_fall(statistics: &Statistics) -> Option<DVec3> {
    /// Of the root of the mean square speed, the part that is common to all that falls.
    const COMMON: f64 = 0.8;
    let columns = ["x", "y", "z"].map(|axis| statistics.values(&format!("velocity_{axis}")));
    if columns.iter().any(Vec::is_empty) {
        return None;
    }
    let count = columns[0].len() as f64;
    let mean = columns.each_ref().map(|column| column.iter().sum::<f64>() / count);
    let squares: f64 = columns.iter().flatten().map(|v| v * v).sum();
    let speed = (squares / count).sqrt();
    [1, 2].into_iter().find(|&down| mean[down] < -COMMON * speed).map(axis)
}

/// Whether a cloud has columns that scans of sites have.
fn is_scan(header: &Header) -> bool {
    let names = ["intensity", "reflectance", "label", "classification", "ring", "cosangle"];
    let of_scan = |name: &str| {
        let name = name.to_ascii_lowercase();
        name.starts_with("scalar_") || names.contains(&name.as_str())
    };
    header.has_color || header.attributes.iter().any(|attribute| of_scan(&attribute.name))
}

/// Whether a cloud has columns that LiDARs write.
fn is_of_lidar(header: &Header) -> bool {
    let names = ["intensity", "reflectivity", "ring", "timestamp", "time", "tag", "laser", "offset_time"];
    header.attributes.iter().any(|attribute| names.contains(&&*attribute.name.to_ascii_lowercase()))
}

/// Whether points are a site by the size, shape and columns that it has in its kind of file.
fn is_site(header: &Header, extents: &Extents) -> bool {
    let Extents { sides, thin, long, .. } = *extents;
    let said = |word: &str| header.sources.iter().any(|source| source.contains(word));
    let is_building = SITE.contains(&sides[long]) && !extents.is_long(1);
    if said("PCD") {
        return is_building && !extents.is_thin(1, 0.5) || is_of_lidar(header);
    }
    if is_building && is_scan(header) && thin == 2 {
        return true;
    }
    // Of a building as wide as it is high, the extents say nothing; things in colours are not as
    // large.
    let is_metric = said("PLY") && is_building && is_scan(header) && !extents.is_thin(1, 0.6);
    let is_room = said("PLY") && is_building && extents.is_thin(2, 0.6) && ROOM.contains(&sides[2]);
    is_metric || is_room
}

fn axis(axis: usize) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|i| f64::from(u8::from(i == axis))))
}

/// What is up, and where the front is.
pub(super) fn orientation(cloud: &Cloud, statistics: &Statistics, given: Option<DVec3>) -> Orientation {
    let header = cloud.header();
    let extents = Extents::of(statistics);
    let of_earth = extents.away_from_earth();
    let own = if let Some(up) = of_earth {
        // North is ahead.
        Orientation::with_up(up, "Earth-centred coordinates").toward_front(Some(DVec3::Z))
    } else if let Some(up) = header.up {
        Orientation::with_up(up, "by the kind of file")
    } else {
        found(header, statistics, &extents)
    };
    let mut chosen = match given.map(|up| Orientation::with_up(up, "as asked for")) {
        // Whoever says what would have been found has the same front.
        Some(asked) if asked.up.dot(own.up) > 1.0 - 1e-12 => Orientation { reason: asked.reason, ..own },
        Some(asked) => asked,
        None => own,
    };
    chosen.lies = match of_earth {
        Some(up) => is_thin_along(statistics, up),
        None => extents.is_thin(axis_along(chosen.up), 0.5),
    };
    chosen
}

/// The axis that a direction is nearest to.
fn axis_along(direction: DVec3) -> usize {
    (0..3).max_by(|&a, &b| direction[a].abs().total_cmp(&direction[b].abs())).unwrap_or(2)
}

/// Whether points are thin along a direction that is no axis.
fn is_thin_along(statistics: &Statistics, up: DVec3) -> bool {
    let across = up.any_orthonormal_vector();
    let [thickness, width, length] = [up, across, up.cross(across)].map(|side| {
        let mut along: Vec<f64> =
            statistics.positions().map(|p| p.dot(side)).filter(|v| v.is_finite()).collect();
        along.sort_by(f64::total_cmp);
        let (low, high) = range(&along, 0.005);
        high - low
    });
    thickness < 0.5 * width.min(length)
}

/// What is up of a face or another relief that is thin along an axis, and where its front is.
fn of_relief(statistics: &Statistics, extents: &Extents, of_things: bool) -> Option<Orientation> {
    let thin = extents.thin;
    let toward_eye = extents.is_thin(thin, 0.6).then(|| relief(statistics, axis(thin))).flatten()?;
    let up = match thin {
        2 => DVec3::Y,
        1 => DVec3::Z,
        _ if of_things => DVec3::Y,
        _ => DVec3::Z,
    };
    Some(Orientation::with_up(up, "a relief that faces the reader").toward_front(Some(-toward_eye)))
}

/// A thing of which neither extents nor columns say what is up: the custom of such files, unless it
/// would fall over so and stand well with z up.
fn of_thing(statistics: &Statistics, reason: &'static str) -> Orientation {
    /// What stands well touches the ground with this part of its footprint, at least …
    const WELL: f64 = 0.2;
    /// … and with so many times as much as it would the other way.
    const BETTER: f64 = 3.0;
    let (of_y, of_z) = (stance(statistics, DVec3::Y), stance(statistics, DVec3::Z));
    if of_z > WELL && of_z > BETTER * of_y {
        Orientation::with_up(DVec3::Z, "it stands on its feet")
    } else {
        Orientation::with_up(DVec3::Y, reason)
    }
}

fn found(header: &Header, statistics: &Statistics, extents: &Extents) -> Orientation {
    let Extents { sides, thin, long, .. } = *extents;
    let said = |word: &str| header.sources.iter().any(|source| source.contains(word));
    let is_printed = said("STL");
    let scanned = ["LAS", "E57", "PTX", "PTS"].iter().any(|kind| said(kind)) && sides[long] >= OBJECT;
    // Of people and statues, which are thin from front to back, files have y up.
    let of_things = said("PLY") || said("OBJ");
    // PCD are seen by sensors, and STL lie on the beds of printers.
    let is_flat = extents.is_thin(thin, if said("PCD") || is_printed { 0.5 } else { 0.25 });
    let is_site = (of_things || said("PCD")) && is_site(header, extents);
    let is_thing = of_things && !is_site && !extents.is_on_map();
    let chosen =
        up_of(header, statistics, extents, Kinds { is_printed, scanned, of_things, is_flat, is_site });
    let is_camera = chosen.reason == CAMERA;
    // What lies has no front.
    let lies = extents.is_thin(axis_along(chosen.up), 0.5);
    if is_thing
        && !is_camera
        && !lies
        && header.crs.is_empty()
        && is_seen_from_behind(statistics, chosen.facing)
    {
        return chosen.turned_around();
    }
    chosen
}

/// The reason of those seen by a camera.
const CAMERA: &str = "a camera's own axes";

/// What kind of thing points are.
#[derive(Clone, Copy)]
struct Kinds {
    is_printed: bool,
    scanned: bool,
    of_things: bool,
    is_flat: bool,
    is_site: bool,
}

fn up_of(header: &Header, statistics: &Statistics, extents: &Extents, kinds: Kinds) -> Orientation {
    let Extents { sides, thin, long, .. } = *extents;
    let Kinds { is_printed, scanned, of_things, is_flat, is_site } = kinds;
    let said = |word: &str| header.sources.iter().any(|source| source.contains(word));
    if !header.crs.is_empty() {
        Orientation::with_up(DVec3::Z, "the coordinate reference system")
    } else if scanned {
        Orientation::with_up(DVec3::Z, "the kind of file")
    } else if extents.is_on_map() {
        Orientation::with_up(DVec3::Z, "coordinates of a map")
    } else if !is_printed && is_camera_frame(statistics, said("PCD")) {
        Orientation::with_up(DVec3::NEG_Y, CAMERA).toward_front(Some(DVec3::Z))
    } else if let Some(relief) = of_relief(statistics, extents, of_things).filter(|_| !is_site) {
        relief
    } else if let Some(up) = against_the_fall(statistics) {
        Orientation::with_up(up, "particles that fall")
    } else if said("COLMAP") && !(is_flat && thin == 2) {
        Orientation::with_up(DVec3::NEG_Y, "the cameras of COLMAP")
    } else if let Some(long) = extents.person().filter(|_| !is_printed) {
        Orientation::with_up(axis(long), "the longest extent, of a person's size")
    } else if is_flat && (!of_things || thin == 2 && sides[long] >= OBJECT) {
        Orientation::with_up(axis(thin), "the thinnest extent")
    } else if is_site && thin == 2 {
        Orientation::with_up(DVec3::Z, "the thinnest extent of a site")
    } else if is_site && !extents.is_object() {
        Orientation::with_up(DVec3::Z, "the size of a site")
    } else if extents.is_long(long) && long > 0 {
        Orientation::with_up(axis(long), "the longest extent")
    } else if is_printed {
        Orientation::with_up(DVec3::Z, "the bed of a printer")
    } else if extents.is_object() {
        of_thing(statistics, "the size of an object, not of a site")
    } else if of_things || said("PCD") {
        of_thing(statistics, "the custom of such files")
    } else {
        Orientation::with_up(DVec3::Z, "the custom of such files")
    }
}
