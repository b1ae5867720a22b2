//! The types of particles in snapshots of simulations: their names, which of them are read, and
//! what their columns are made of.

use std::path::{Path, PathBuf};

use super::{Place, ReadError};

/// Largest number of types. GADGET has six; later codes have a few more.
pub(super) const MOST_TYPES: usize = 16;

/// Where a column comes from.
#[derive(Clone, PartialEq)]
pub(super) enum Supply {
    /// A component of the block or dataset of this name.
    Stored(String, usize),
    Mass,
    Radius,
    Weight,
    Kind,
}

/// Names of the types of GADGET, in order.
const NAMES: [&str; 6] = ["gas", "dark", "disk", "bulge", "stars", "black-holes"];

/// The name of a type: `gas`, or `PartType7` if it has none.
pub(super) fn name(kind: usize) -> String {
    NAMES.get(kind).map_or_else(|| format!("PartType{kind}"), |name| (*name).to_owned())
}

/// The type that a name denotes.
fn number(name: &str) -> Option<usize> {
    let name = name.trim().to_ascii_lowercase();
    if let Some(digits) = name.strip_prefix("parttype") {
        return digits.parse().ok().filter(|&kind| kind < MOST_TYPES);
    }
    NAMES.iter().position(|known| *known == name)
}

/// The types to be read, in ascending order: those `wanted`; if nothing is, gas if the file has
/// any, otherwise all that it has. `counts` has the number of particles of each type.
pub(super) fn chosen(
    path: &Path,
    wanted: Option<&[String]>,
    counts: &[u64],
) -> Result<Vec<usize>, ReadError> {
    let present: Vec<usize> = (0..counts.len()).filter(|&kind| counts[kind] > 0).collect();
    let Some(wanted) = wanted else {
        return Ok(if present.first() == Some(&0) { vec![0] } else { present });
    };
    let there = || {
        let names: Vec<String> = present.iter().map(|&k| format!("{} ({})", name(k), counts[k])).collect();
        if names.is_empty() {
            "it has no particles".to_owned()
        } else {
            format!("it has {}", names.join(", "))
        }
    };
    let mut types = Vec::new();
    for word in wanted {
        let fail = |what: String| ReadError::malformed(path, Place::Byte(0), what);
        let kind = number(word).ok_or_else(|| {
            fail(format!(
                "`{}` is no type of particle; expected {} or PartType and a number below {MOST_TYPES}; {}",
                super::roles::excerpt(word),
                NAMES.join(", "),
                there()
            ))
        })?;
        if !present.contains(&kind) {
            return Err(fail(format!("there are no particles of the type {}; {}", name(kind), there())));
        }
        types.push(kind);
    }
    types.sort_unstable();
    types.dedup();
    Ok(types)
}

/// How many particles of each of `N` types the files of a snapshot have together.
pub(super) struct Census<const N: usize> {
    pub(super) counts: [u64; N],
    /// The first file with particles of each type, which says what the type has.
    samples: [usize; N],
}

impl<const N: usize> Census<N> {
    /// Counts the particles of all files; `counts_of` are those of one.
    pub(super) fn take(
        files: &[PathBuf],
        counts_of: impl Fn(&Path) -> Result<[u64; N], ReadError>,
    ) -> Result<Self, ReadError> {
        let (mut counts, mut samples) = ([0_u64; N], [0; N]);
        for (index, path) in files.iter().enumerate() {
            for (kind, here) in counts_of(path)?.into_iter().enumerate() {
                if counts[kind] == 0 {
                    samples[kind] = index;
                }
                counts[kind] = counts[kind].saturating_add(here);
            }
        }
        Ok(Self { counts, samples })
    }

    /// The first file with particles of a type.
    pub(super) fn sample<'a>(&self, files: &'a [PathBuf], kind: usize) -> &'a Path {
        &files[self.samples[kind]]
    }

    /// The particles of these types together.
    pub(super) fn total(&self, kinds: &[usize]) -> u64 {
        kinds.iter().fold(0, |all, &kind| all.saturating_add(self.counts[kind]))
    }
}

/// ∫ω dV of the kernel of SPH codes, the M4 cubic spline, over the unit ball if its peak is 1.
const KERNEL_INTEGRAL: f64 = std::f64::consts::PI / 8.0;

/// The weight of a particle with which the sum of cubic splines of peak 1 is the density: its mass
/// divided by the integral of its kernel, π/8 r³.
pub(super) fn weight(mass: f64, radius: f64) -> f64 {
    mass / (KERNEL_INTEGRAL * radius.powi(3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gas_is_read_by_default_and_otherwise_all_there_is() {
        let path = Path::new("snap");
        let chosen = |wanted: &[&str], counts: &[u64]| {
            let wanted: Vec<String> = wanted.iter().map(|w| (*w).to_owned()).collect();
            chosen(path, (!wanted.is_empty()).then_some(&wanted), counts)
        };
        assert_eq!(chosen(&[], &[5, 6, 0, 0, 7]).expect("gas"), [0]);
        assert_eq!(chosen(&[], &[0, 6, 0, 0, 7]).expect("all"), [1, 4]);
        assert_eq!(chosen(&["Stars", "PartType1", "dark"], &[5, 6, 0, 0, 7]).expect("both"), [1, 4]);
        let said = chosen(&["disk"], &[5, 6]).expect_err("none").to_string();
        assert!(said.contains("no particles of the type disk; it has gas (5), dark (6)"), "{said}");
        let said = chosen(&["PartType16"], &[5]).expect_err("none").to_string();
        assert!(said.contains("`PartType16` is no type of particle"), "{said}");
    }
}
