//! What a snapshot says about itself, by the conventions of the codes that write them.

use super::hdf5::File;
use crate::points::ReadError;
use crate::points::particles::MOST_TYPES;

/// The header of a file of a snapshot.
#[derive(Default)]
pub(super) struct Header {
    /// The program that wrote it, where it says so.
    code: String,
    /// Number of files of the snapshot.
    pub(super) files: u64,
    /// Whether the data are in other files.
    pub(super) is_virtual: bool,
    /// Mass of each type whose particles all have the same; 0 for others.
    masses: Vec<f64>,
    /// H/h, the radius of compact support in smoothing lengths of SWIFT, and the kernel whose it
    /// is. `None` if it was not written by SWIFT.
    pub(super) gamma: Option<(f64, String)>,
    redshift: Option<f64>,
    time: Option<f64>,
    box_size: Option<f64>,
    hubble: Option<f64>,
}

/// Radius of compact support in smoothing lengths of the kernels of SWIFT in three dimensions, by
/// the beginnings of their names (Dehnen and Aly 2012, table 1).
const GAMMAS: [(&str, f64); 6] = [
    ("Cubic spline", 1.825_742),
    ("Quartic spline", 2.018_932),
    ("Quintic spline", 2.195_775),
    ("Wendland C2", 1.936_492),
    ("Wendland C4", 2.207_940),
    ("Wendland C6", 2.449_490),
];

impl Header {
    pub(super) fn read(file: &File) -> Result<Self, ReadError> {
        let mut header = Self { files: 1, ..Self::default() };
        if let Some(group) = file.group("Header")? {
            let attributes = file.attributes(&group)?;
            let number = |name| attributes.number(name);
            header.files = number("NumFilesPerSnapshot").map_or(1, |count| count as u64);
            header.is_virtual = number("Virtual") == Some(1.0);
            header.masses = attributes.numbers("MassTable").unwrap_or_default();
            header.redshift = number("Redshift");
            header.time = number("Time");
            header.box_size = number("BoxSize");
            header.hubble = number("HubbleParam");
            header.code = attributes.text("Code").unwrap_or_default();
        }
        if header.hubble.is_none()
            && let Some(group) = file.group("Parameters")?
        {
            header.hubble = file.attributes(&group)?.number("HubbleParam");
        }
        if header.code.is_empty()
            && let Some(group) = file.group("Code")?
        {
            header.code = file.attributes(&group)?.text("Code").unwrap_or_default();
        }
        if header.code == "SWIFT" {
            header.gamma = Some(gamma(file)?);
        }
        Ok(header)
    }

    /// The mass of each particle of a type. `None` if they differ, or are not stated.
    pub(super) fn mass(&self, kind: usize) -> Option<f64> {
        debug_assert!(kind < MOST_TYPES);
        self.masses.get(kind).copied().filter(|&mass| mass > 0.0)
    }

    /// "snapshot of a simulation in HDF5, written by SWIFT, redshift 0, box 50000".
    pub(super) fn description(&self) -> String {
        let mut words = "snapshot of a simulation in HDF5".to_owned();
        if !self.code.is_empty() {
            words.push_str(&format!(", written by {}", self.code));
        }
        let numbers = [
            ("redshift", self.redshift),
            ("time", self.time),
            ("box size", self.box_size),
            ("h", self.hubble),
        ];
        for (name, number) in numbers {
            if let Some(number) = number {
                words.push_str(&format!(", {name} {number}"));
            }
        }
        if self.files > 1 {
            words.push_str(&format!(", {} files", self.files));
        }
        words
    }
}

/// The kernel of a snapshot of SWIFT, and its radius of compact support in smoothing lengths.
fn gamma(file: &File) -> Result<(f64, String), ReadError> {
    let Some(group) = file.group("HydroScheme")? else {
        return Ok((GAMMAS[0].1, "Cubic spline, as no other is stated".into()));
    };
    let Some(name) = file.attributes(&group)?.text("Kernel function") else {
        return Ok((GAMMAS[0].1, "Cubic spline, as no other is stated".into()));
    };
    match GAMMAS.iter().find(|(known, _)| name.starts_with(known)) {
        Some((_, gamma)) => Ok((*gamma, name)),
        None => {
            let known: Vec<&str> = GAMMAS.iter().map(|(name, _)| *name).collect();
            let what = format!(
                "HydroScheme, Kernel function: `{name}` is unknown, so that smoothing lengths are; expected {}",
                known.join(", ")
            );
            Err(file.wrong(group.address(), what))
        }
    }
}
