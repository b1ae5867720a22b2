//! The roles of columns by their names: axes, colours, classes.
//!
//! An exact name takes precedence over an alias: `x` is the axis even if there is an `easting`, and
//! in a file with `red` nothing else is red. If no name matches exactly, case is ignored.

use super::ColumnInfo;

const AXES: [&[&str]; 3] = [
    &[
        "x",
        "position x",
        "easting",
        "points:0",
        "points_0",
        "east",
        "rechtswert",
        "e",
        "longitude",
        "lon",
        "lng",
        "long",
    ],
    &["y", "position y", "northing", "points:1", "points_1", "north", "hochwert", "n", "latitude", "lat"],
    &[
        "z",
        "position z",
        "elevation",
        "height",
        "points:2",
        "points_2",
        "altitude",
        "alt",
        "höhe",
        "hoehe",
        // Höhe in Latin-1, whose bytes are no text here.
        "h\u{fffd}he",
        "hauteur",
        "elev",
        "ele",
        "h",
    ],
];

const COLORS: [&str; 3] = ["red", "green", "blue"];
/// Aliases of the three colours, which are used only if all three are present.
const COLOR_ALIASES: [[&str; 3]; 8] = [
    ["diffuse_red", "diffuse_green", "diffuse_blue"],
    ["r", "g", "b"],
    // Of CloudCompare, as fractions and as scalar fields.
    ["rf", "gf", "bf"],
    ["scalar_r", "scalar_g", "scalar_b"],
    // Of ParaView.
    ["rgb:0", "rgb:1", "rgb:2"],
    ["rgb_0", "rgb_1", "rgb_2"],
    ["colors:0", "colors:1", "colors:2"],
    ["colors_0", "colors_1", "colors_2"],
];

/// Names of the components of a surface normal, which are one only together.
const NORMALS: [[&str; 3]; 8] = [
    ["nx", "ny", "nz"],
    // Of PCD, E57, and vectors by these names.
    ["normal_x", "normal_y", "normal_z"],
    ["normalX", "normalY", "normalZ"],
    ["normals_x", "normals_y", "normals_z"],
    // Of CloudCompare as scalar fields, and of ParaView.
    ["scalar_nx", "scalar_ny", "scalar_nz"],
    ["normals:0", "normals:1", "normals:2"],
    ["normals_0", "normals_1", "normals_2"],
    ["point_normals_x", "point_normals_y", "point_normals_z"],
];

/// The index of the first of `names` that equals `wanted`, exactly or otherwise ignoring case.
fn place(names: &[&str], wanted: &str) -> Option<usize> {
    let exact = names.iter().position(|n| *n == wanted);
    exact.or_else(|| names.iter().position(|n| n.eq_ignore_ascii_case(wanted)))
}

/// Which of `names` are x, y and z.
pub fn axes<S: AsRef<str>>(names: &[S]) -> [Option<usize>; 3] {
    let names: Vec<&str> = names.iter().map(AsRef::as_ref).collect();
    // Behind a name may stand its unit, as in `x (m)` or `Easting [m]`.
    let bare: Vec<&str> =
        names.iter().map(|name| name.split(['(', '[']).next().unwrap_or(name).trim()).collect();
    AXES.map(|aliases| {
        let of = |names: &[&str]| aliases.iter().find_map(|alias| place(names, alias));
        of(&names).or_else(|| of(&bare))
    })
}

/// Whether a coordinate of this name is a longitude in degrees.
pub fn is_longitude(name: &str) -> bool {
    let bare = name.split(['(', '[']).next().unwrap_or(name).trim().to_lowercase();
    ["longitude", "lon", "lng", "long"].contains(&bare.as_str())
}

/// The roles `red`, `green` and `blue`, with the columns that have them under other names. Empty if
/// any column is called `red`, `green` or `blue`.
pub fn colors(columns: &[ColumnInfo]) -> Vec<(String, usize)> {
    let names: Vec<&str> = columns.iter().map(|c| c.name.as_str()).collect();
    let found = color_places(&names);
    found.map_or_else(Vec::new, |found| COLORS.iter().map(|c| (*c).to_owned()).zip(found).collect())
}

/// The places of three colours that have other names than `red`, `green` and `blue`. `None` if any
/// column is called so.
pub fn color_places(names: &[&str]) -> Option<[usize; 3]> {
    let find = |name: &str| place(names, name);
    if COLORS.iter().any(|name| find(name).is_some()) {
        return None;
    }
    COLOR_ALIASES.iter().find_map(|[r, g, b]| Some([find(r)?, find(g)?, find(b)?]))
}

/// The places of the components of a surface normal.
pub fn normals(names: &[&str]) -> Option<[usize; 3]> {
    let find = |name: &str| place(names, name);
    NORMALS.iter().find_map(|[x, y, z]| Some([find(x)?, find(y)?, find(z)?]))
}

/// The column that `name` refers to: the one of that name, otherwise the one with that role,
/// otherwise the one of that name ignoring case.
pub fn find(columns: &[ColumnInfo], roles: &[(String, usize)], name: &str) -> Option<usize> {
    let exact = columns.iter().position(|c| c.name == name);
    exact
        .or_else(|| roles.iter().find(|(role, _)| role == name).map(|(_, column)| *column))
        .or_else(|| columns.iter().position(|c| c.name.eq_ignore_ascii_case(name)))
}

/// Names of positions of three numbers, without case.
pub const POSITIONS: [&str; 22] = [
    "positions",
    "position",
    "xyz",
    "points",
    "pos",
    "coords",
    "coordinates",
    "vertices",
    "location",
    "locations",
    "coord",
    "point",
    "point_cloud",
    "pointcloud",
    "pc",
    "pcd",
    "verts",
    // Centres of Gaussians.
    "means3d",
    "means",
    "centers",
    "centres",
    "centroids",
];
/// Parts of names of three numbers that are no positions.
const OTHER_VECTORS: [&str; 16] = [
    "colo",
    "rgb",
    "normal",
    "scal",
    "quat",
    "rotat",
    "vel",
    "force",
    "accel",
    "grad",
    "cov",
    "size",
    "extent",
    "direction",
    "flow",
    "feature",
];

/// Whether three numbers of this name may be positions, if nothing else is.
pub fn may_be_positions(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    !OTHER_VECTORS.iter().any(|other| name.contains(other))
}

/// Names of colours of three or four numbers.
const VECTORS_OF_COLORS: [&str; 9] =
    ["rgb", "rgba", "color", "colors", "colour", "colours", "point_colors", "rgbs", "vertex_colors"];

/// The columns that `count` numbers with one name become. Positions and colours have names of their
/// own.
pub fn components(name: &str, count: usize) -> Vec<String> {
    let lower = name.to_ascii_lowercase();
    let of = |names: &[&str]| names.iter().take(count).map(|n| (*n).to_owned()).collect();
    match count {
        3 if POSITIONS.contains(&lower.as_str()) => of(&["x", "y", "z"]),
        3 | 4 if VECTORS_OF_COLORS.contains(&lower.as_str()) => of(&["red", "green", "blue", "alpha"]),
        _ => plain_components(name, count),
    }
}

/// The columns that `count` numbers with one name become: `v`, or `v_x`, `v_y` and `v_z`, or `v_0`,
/// `v_1` and so on.
pub fn plain_components(name: &str, count: usize) -> Vec<String> {
    match count {
        1 => vec![name.to_owned()],
        3 => ["x", "y", "z"].map(|axis| format!("{name}_{axis}")).to_vec(),
        _ => (0..count).map(|i| format!("{name}_{i}")).collect(),
    }
}

/// Whether a column of this name holds class labels.
pub fn is_class(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    let name = name.strip_prefix("scalar_").unwrap_or(&name);
    matches!(
        name,
        "class" | "classification" | "label" | "labels" | "segment" | "semantic" | "semantic_label"
    )
}

/// The start of a text from a file, shortened for a message and without control characters.
pub fn excerpt(text: &str) -> String {
    shortened(text, 40)
}

/// The start of a text from a file, of up to `most` characters and without control characters.
pub fn shortened(text: &str, most: usize) -> String {
    let text = text.trim();
    let mut short: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(most).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::ColumnType;

    fn columns(names: &[&str]) -> Vec<ColumnInfo> {
        names.iter().map(|name| ColumnInfo::new(*name, ColumnType::F64)).collect()
    }

    #[test]
    fn a_canonical_name_goes_before_an_alias_and_a_spelling_before_another() {
        assert_eq!(axes(&["height", "x", "y", "z"]), [Some(1), Some(2), Some(3)]);
        assert_eq!(axes(&["Easting", "NORTHING", "height"]), [Some(0), Some(1), Some(2)]);
        assert_eq!(axes(&["height", "elevation", "y", "x"]), [Some(3), Some(2), Some(1)]);
        assert_eq!(axes(&["X", "x", "y", "Z"]), [Some(1), Some(2), Some(3)]);
        assert_eq!(axes(&["x", "y"]), [Some(0), Some(1), None]);
    }

    #[test]
    fn other_names_are_colours_only_together_and_where_no_colour_is() {
        assert_eq!(
            colors(&columns(&["a", "B", "r", "G"])).iter().map(|r| r.1).collect::<Vec<_>>(),
            [2, 3, 1]
        );
        assert!(colors(&columns(&["r", "g"])).is_empty());
        assert!(colors(&columns(&["r", "g", "b", "Green"])).is_empty());
        let both = columns(&["r", "g", "b", "diffuse_red", "diffuse_green", "diffuse_blue"]);
        assert_eq!(colors(&both).iter().map(|r| r.1).collect::<Vec<_>>(), [3, 4, 5]);
    }

    #[test]
    fn a_column_is_found_by_its_own_name_then_its_role_then_in_other_case() {
        let columns = columns(&["r", "g", "b", "B", "Intensity"]);
        let roles = super::colors(&columns);
        let found = |name: &str| super::find(&columns, &roles, name);
        assert_eq!([found("b"), found("B"), found("blue"), found("intensity")], [2, 3, 2, 4].map(Some));
        assert_eq!(found("Blue"), None);
    }
}
