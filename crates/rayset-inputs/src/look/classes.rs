//! Names of classes of points.

/// The classes of the LAS specification (ASPRS, LAS 1.4 R15, table 17).
const LAS: [&str; 23] = [
    "never classified",
    "unclassified",
    "ground",
    "low vegetation",
    "medium vegetation",
    "high vegetation",
    "building",
    "low noise",
    "key point",
    "water",
    "rail",
    "road",
    "overlap",
    "wire, guard",
    "wire, conductor",
    "transmission tower",
    "wire connector",
    "bridge deck",
    "high noise",
    "overhead structure",
    "ignored ground",
    "snow",
    "temporal exclusion",
];

/// The first class that the specification leaves to users.
const FIRST_OF_USERS: usize = 64;

/// The name of a class of a column; a number, if the column's classes are not those of LAS files.
pub fn class_name(class: f64, column: &str) -> String {
    if !column.eq_ignore_ascii_case("classification") || class < 0.0 {
        return format!("{class}");
    }
    match class as usize {
        number if number >= FIRST_OF_USERS => format!("user class {number}"),
        number => LAS.get(number).map_or_else(|| format!("reserved {number}"), |name| (*name).to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_beyond_the_specification_are_those_of_users() {
        let name = |class| class_name(class, "Classification");
        assert_eq!(name(2.0), "ground");
        assert_eq!(name(22.0), "temporal exclusion");
        assert_eq!(name(40.0), "reserved 40");
        assert_eq!(name(64.0), "user class 64");
        assert_eq!(name(255.0), "user class 255");
        assert_eq!(class_name(64.0, "segment"), "64");
    }
}
