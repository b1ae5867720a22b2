//! What a scene's lengths mean: the unit, and where north is.

use rayset::file::Header;
use rayset::geometry::DAffine3;
use rayset::scene::{Scene, Shape};
use rayset_inputs::units;

/// The space of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Space {
    /// The unit of lengths; `None` if it is unknown.
    pub(crate) unit: Option<&'static str>,
    /// Whether y points north.
    pub(crate) y_is_north: bool,
}

impl Space {
    const UNKNOWN: Self = Self { unit: None, y_is_north: false };

    /// What all clouds and grids of a scene agree on; unknown if any of them is moved.
    pub(crate) fn of(scene: &Scene) -> Self {
        let (mut found, mut moved) = (Vec::new(), false);
        scene.root.for_each(&mut |node| {
            moved |= node.parent_from_local != DAffine3::IDENTITY;
            match &node.shape {
                Shape::Cloud(object) => {
                    let header = object.cloud.header();
                    found.push(
                        of_reference_system(&header.crs)
                            .unwrap_or(Self { unit: of_header(header), ..Self::UNKNOWN }),
                    );
                }
                Shape::Grid(object) => {
                    // Spaces of anatomy are in millimetres.
                    let unit = object.grid.header().facing.map(|_| "mm");
                    found.push(Self { unit, ..Self::UNKNOWN });
                }
                _ => {}
            }
        });
        match found.split_first() {
            Some((first, others)) if !moved && others.iter().all(|other| other == first) => *first,
            _ => Self::UNKNOWN,
        }
    }
}

/// The unit of lengths of a cloud without a known reference system, by what its sources say and
/// where it lies.
pub(crate) fn of_header(header: &Header) -> Option<&'static str> {
    /// Distances from the middle of the Earth of what lies on it, in metres.
    const EARTH: std::ops::Range<f64> = 6.33e6..6.40e6;
    // The standard of E57 says so.
    let is_e57 = header.sources.iter().any(|source| source.contains("E57"));
    if is_e57 || header.points > 0 && EARTH.contains(&header.bounds.center().length()) {
        return Some("m");
    }
    let said = units::of_positions(&header.sources)?;
    LENGTHS.into_iter().find(|known| *known == said)
}

/// Lengths of simulations: comoving ones, and those over the Hubble parameter.
const LENGTHS: [&str; 13] =
    ["pc", "kpc", "Mpc", "cpc", "ckpc", "cMpc", "pc/h", "kpc/h", "Mpc/h", "cpc/h", "ckpc/h", "cMpc/h", "AU"];

/// What the text of a coordinate reference system says; `None` if it is none that is known.
pub(crate) fn of_reference_system(text: &str) -> Option<Space> {
    if let Some(code) = text.strip_prefix("EPSG:") {
        return of_code(code.trim().parse().ok()?);
    }
    let upper = text.to_ascii_uppercase();
    if ["PROJCS[", "PROJCRS[", "PROJECTEDCRS["].iter().any(|word| upper.contains(word)) {
        return Some(Space { unit: unit_of_lengths(&upper), y_is_north: true });
    }
    let geographic = ["GEOGCS[", "GEOGCRS[", "GEODCRS["].iter().any(|word| upper.contains(word));
    // Axes through the middle of the Earth have no north.
    let geocentric = upper.contains("GEOCCS[") || upper.contains("CARTESIAN");
    (geographic && !geocentric).then_some(Space { unit: None, y_is_north: true })
}

/// The unit of the horizontal axes of a projected system: the last in it that is no angle, before
/// the vertical system.
fn unit_of_lengths(upper: &str) -> Option<&'static str> {
    let horizontal = upper.split("VERT_CS[").next()?.split("VERTCRS[").next()?;
    let units = horizontal.match_indices("UNIT[\"").map(|(at, word)| &horizontal[at + word.len()..]);
    units
        .filter_map(|rest| {
            let name = rest.split('"').next()?;
            match name {
                "METRE" | "METER" | "M" => Some("m"),
                "FOOT" | "FT" | "INTERNATIONAL FOOT" => Some("ft"),
                "FOOT_US" | "US SURVEY FOOT" | "US_SURVEY_FOOT" | "U.S. SURVEY FOOT" => Some("ft"),
                "KILOMETRE" | "KILOMETER" | "KM" => Some("km"),
                _ => None,
            }
        })
        .last()
}

/// Systems of the EPSG registry that are common in files: those in metres, and those in degrees.
fn of_code(code: u32) -> Option<Space> {
    let metres = matches!(code,
        32601..=32660 | 32701..=32760 // WGS 84, UTM
        | 25828..=25838 | 3034 | 3035 | 3040..=3051 // ETRS89: UTM, Europe
        | 26901..=26923 | 6328..=6348 | 3717..=3750 // NAD83, UTM
        | 28348..=28358 | 7846..=7859 | 2193 // Australia, New Zealand
        | 31254..=31259 | 31284..=31287 | 31370 | 3812 | 28991 | 28992 | 27700 | 2056 | 21781 | 2154 // national
        | 3942..=3950 | 5513..=5514 | 2176..=2180 | 3067 | 3006 | 31466..=31469 | 4647 | 5554..=5556
        | 3857);
    // Around a pole every direction is one to the south, or to the north.
    let polar = matches!(code, 5041 | 5042 | 3031 | 3413 | 3995);
    let degrees = matches!(code, 4326 | 4258 | 4269 | 4283 | 4617 | 4979 | 4171 | 6318);
    (metres || degrees || polar)
        .then_some(Space { unit: (metres || polar).then_some("m"), y_is_north: !polar })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reference_systems_say_what_the_unit_is_and_whether_there_is_a_north() {
        let wkt = r#"COMPD_CS["x",PROJCS["NAD83 / Oregon",GEOGCS["NAD83",UNIT["degree",0.0174]],PROJECTION["L"],
            UNIT["foot",0.3048],AXIS["X",EAST]],VERT_CS["NAVD88",UNIT["metre",1]]]"#;
        let space = |unit, y_is_north| Some(Space { unit, y_is_north });
        assert_eq!(of_reference_system(wkt), space(Some("ft"), true));
        let wkt =
            r#"PROJCRS["ETRS89",BASEGEOGCRS["E",UNIT["degree",0.01]],CS[Cartesian,2],LENGTHUNIT["metre",1]]"#;
        assert_eq!(of_reference_system(wkt), space(Some("m"), true));
        assert_eq!(of_reference_system("EPSG:32633"), space(Some("m"), true));
        assert_eq!(of_reference_system("EPSG:4326"), space(None, true));
        assert_eq!(of_reference_system("EPSG:4978"), None);
        assert_eq!(of_reference_system(r#"GEOCCS["WGS 84",UNIT["metre",1]]"#), None);
        assert_eq!(of_reference_system("somewhere"), None);
    }
}
