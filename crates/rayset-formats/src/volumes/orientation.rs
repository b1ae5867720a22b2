//! Which way is up in the space of a volume, where its format says so.

use rayset_base::geometry::DVec3;

use rayset_files::grid::VolumeSource;

/// Directions in the space of a file. `None` if the format does not say.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Orientation {
    pub(super) up: Option<DVec3>,
    /// Where a viewer looks who sees the front.
    pub(super) facing: Option<DVec3>,
}

impl Orientation {
    /// Of a patient, in a space whose axes point to three sides of the patient, in any order: R or
    /// L (right, left), A or P (anterior, posterior), S or I (superior, inferior). `None` if these
    /// letters do not name a space.
    pub(super) fn of_patient(letters: &str) -> Option<Self> {
        let axes: [char; 3] = letters.chars().collect::<Vec<_>>().try_into().ok()?;
        let along = |one: char, other: char| {
            let axis = axes.iter().position(|letter| *letter == one || *letter == other)?;
            let sign = if axes[axis] == one { 1.0 } else { -1.0 };
            Some(sign * DVec3::AXES[axis])
        };
        along('L', 'R')?;
        // A patient is seen from the front, which is anterior.
        Some(Self { up: Some(along('S', 'I')?), facing: Some(along('P', 'A')?) })
    }

    /// The same volume, of whose space this is known.
    pub(super) fn applied_to(self, mut source: VolumeSource) -> VolumeSource {
        (source.up, source.facing) = (self.up, self.facing);
        source
    }

    /// Of the space of a program, by the name with which it signs its files: in Houdini y is up.
    pub(super) fn of_program(creator: &str) -> Self {
        Self { up: creator.starts_with("Houdini").then_some(DVec3::Y), facing: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn up_is_superior_and_the_front_is_seen_looking_to_the_back() {
        let of = |letters| Orientation::of_patient(letters).map(|o| (o.up, o.facing));
        assert_eq!(of("LPS"), Some((Some(DVec3::Z), Some(DVec3::Y))));
        assert_eq!(of("RAS"), Some((Some(DVec3::Z), Some(-DVec3::Y))));
        assert_eq!(of("LAS"), Some((Some(DVec3::Z), Some(-DVec3::Y))));
        assert_eq!(of("IPR"), Some((Some(-DVec3::X), Some(DVec3::Y))));
        for wrong in ["", "LP", "LPSI", "LRS", "XYZ", "???", "LLL", "APS"] {
            assert_eq!(Orientation::of_patient(wrong), None, "{wrong}");
        }
    }
}
