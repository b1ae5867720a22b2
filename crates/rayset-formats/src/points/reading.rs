//! How the columns of a table were read, in one line for the person who reads it.

use super::{Schema, roles};

/// Most columns that are listed.
const MOST: usize = 48;

/// Names of columns as they are understood: coordinates and colours under the names of their roles,
/// `-` for what is skipped. Longitude and latitude keep their names, by which they are made metres.
fn understood(names: &[String], axes: [usize; 3]) -> Vec<String> {
    let mut list: Vec<String> = names
        .iter()
        .map(|name| if name.is_empty() { "-".to_owned() } else { roles::excerpt(name) })
        .collect();
    let shown: Vec<&str> = names.iter().map(String::as_str).collect();
    if !names.get(axes[0]).is_some_and(|name| roles::is_longitude(name)) {
        for (place, name) in axes.into_iter().zip(["x", "y", "z"]) {
            if let Some(column) = list.get_mut(place) {
                name.clone_into(column);
            }
        }
    }
    for (place, name) in roles::color_places(&shown).into_iter().flatten().zip(["red", "green", "blue"]) {
        name.clone_into(&mut list[place]);
    }
    list
}

/// Notes in a schema how its columns were read: `names` are those of the table in their order, of
/// which three are the `axes`, and `by` says what the names come from.
pub(super) fn note(schema: &mut Schema, names: &[String], axes: [usize; 3], by: &str) {
    let mut list = understood(names, axes);
    let more = list.len().saturating_sub(MOST);
    list.truncate(MOST);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    let way = if by == BY_OPTION { "" } else { "; --columns with another such list says otherwise" };
    let said = format!("columns, by {by}: {}{more}", list.join(","));
    let described = if schema.description.is_empty() { "" } else { "; " };
    schema.description = format!("{}{described}{said}", schema.description);
    schema.reading = format!("{said}{way}");
}

/// What names come from that the caller gave.
pub(super) const BY_OPTION: &str = "--columns";
