//! Units of simulations in the words of astronomers. Files state factors to CGS units and powers of
//! the scale factor a and of the Hubble parameter h; clouds keep these, exactly, and people are
//! shown what they mean.

/// Factors to CGS units that simulations have, the dimensions that they are of, and their names.
/// The name of a power of a length stands behind the slash, if there is one.
const NAMES: [(f64, &str, i32); 21] = [
    // (factor, name, power of comoving lengths in it)
    (1.495_978_7e13, "AU", 1),
    (3.085_678e18, "pc", 1),
    (3.085_678e21, "kpc", 1),
    (3.085_678e24, "Mpc", 1),
    (1.988_4e33, "M☉", 0),
    (1.988_4e43, "1e10 M☉", 0),
    (1e5, "km/s", 0),
    (1e10, "(km/s)²", 0),
    (6.767_9e-23, "M☉/pc³", -3),
    (6.767_9e-32, "M☉/kpc³", -3),
    (6.767_9e-22, "1e10 M☉/kpc³", -3),
    (6.767_9e-31, "1e10 M☉/Mpc³", -3),
    (3.085_678e16, "kpc s/km", 0),
    (3.085_678e19, "Mpc s/km", 0),
    (3.155_76e13, "Myr", 0),
    (3.155_76e16, "Gyr", 0),
    (3.155_76e7, "yr", 0),
    (6.302e25, "M☉/yr", 0),
    (1.988_4e53, "1e10 M☉ (km/s)²", 0),
    (2.937_999e64, "kpc³", 3),
    (2.937_999e73, "Mpc³", 3),
];

/// Factors that differ by less than this part are the same: codes have constants of their own.
const SAME: f64 = 4e-3;

/// The unit of a column as people say it: `ckpc/h` of `3.085678e21 cgs a h^-1`. What is not known
/// stays as it is.
#[must_use]
pub fn readable(column: &str, unit: &str) -> String {
    let Some((factor, rest)) = unit.split_once(" cgs") else { return unit.to_owned() };
    let Ok(factor) = factor.trim().parse::<f64>() else { return unit.to_owned() };
    let (a, h) = (power_of(rest, "a"), power_of(rest, "h"));
    if factor == 1.0 && column.to_ascii_lowercase().contains("temperature") {
        return "K".to_owned();
    }
    let is_known = |known: f64| (factor / known - 1.0).abs() < SAME;
    let Some((_, name, lengths)) = NAMES.iter().find(|(known, ..)| is_known(*known)) else {
        return unit.to_owned();
    };
    let is_comoving = *lengths != 0 && a == f64::from(*lengths);
    let mut said = if is_comoving {
        match name.rsplit_once('/') {
            Some((mass, length)) => format!("{mass}/c{length}"),
            None => format!("c{name}"),
        }
    } else {
        (*name).to_owned()
    };
    if h == -1.0 {
        said.push_str("/h");
    } else if h != 0.0 {
        said.push_str(&format!(" h^{h}"));
    }
    if a != 0.0 && !is_comoving {
        said.push_str(&format!(" a^{a}"));
    }
    said
}

/// The unit of the positions of a cloud by what its reader says of its file; `None` if nothing is
/// said.
#[must_use]
pub fn of_positions(sources: &[String]) -> Option<String> {
    let said = |source: &String| {
        let (_, unit) = source.split_once("; positions in ")?;
        Some(readable("", unit.split(';').next().unwrap_or(unit).trim()))
    };
    let (first, others) = sources.split_first()?;
    let unit = said(first)?;
    others.iter().all(|other| said(other).as_ref() == Some(&unit)).then_some(unit)
}

/// What signs in units of a simulation mean, for people who have not met them; `None` if none of
/// them occurs.
#[must_use]
pub fn explained<'u>(units: impl IntoIterator<Item = &'u str>) -> Option<String> {
    let (mut comoving, mut hubble, mut powers) = (false, false, false);
    for unit in units {
        let length =
            |prefix: &str| ["pc", "kpc", "Mpc"].iter().any(|name| unit.contains(&format!("{prefix}{name}")));
        comoving |= length("c");
        hubble |= unit.ends_with("/h") || unit.contains("/h ") || unit.contains(" h^");
        powers |= unit.contains(" a^") || unit.contains(" a ");
    }
    let mut words = Vec::new();
    if comoving {
        words.push("ckpc: comoving, times a for lengths of then");
    }
    if comoving || powers {
        words.push("a = 1/(1 + redshift)");
    }
    if hubble {
        words.push("h: the Hubble parameter, 0.7 or as the source says");
    }
    (!words.is_empty()).then(|| words.join("; "))
}

/// The power of a symbol in the rest of a unit: ` a h^-1`, or the expression of SWIFT,
/// `, a^-3 U_M U_L^-3  [ g cm^-3 ]`.
fn power_of(rest: &str, symbol: &str) -> f64 {
    let words = rest.split('[').next().unwrap_or(rest).split([' ', ',']);
    let power = |word: &str| {
        let after = word.strip_prefix(symbol)?;
        if after.is_empty() { Some(1.0) } else { after.strip_prefix('^')?.parse().ok() }
    };
    words.filter_map(power).next().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_simulations_are_those_that_people_say() {
        for (column, unit, said) in [
            ("", "3.085678e21 cgs a h^-1", "ckpc/h"),
            ("", "3.08567758e24 cgs, a U_L  [ cm ]", "cMpc"),
            ("mass", "1.989e43 cgs h^-1", "1e10 M☉/h"),
            ("mass", "1.98848e43 cgs, U_M  [ g ]", "1e10 M☉"),
            ("Density", "6.769911178294544e-22 cgs a^-3 h^2", "1e10 M☉/ckpc³ h^2"),
            ("Velocities", "1e5 cgs a^0.5", "km/s a^0.5"),
            ("InternalEnergy", "1e10 cgs", "(km/s)²"),
            ("Temperature", "1e0 cgs", "K"),
            ("Strange", "7.5e3 cgs a", "7.5e3 cgs a"),
            ("GpsTime", "s", "s"),
        ] {
            assert_eq!(readable(column, unit), said);
        }
        let sources =
            ["snapshot of a simulation; weight = x; positions in 3.085678e21 cgs a h^-1".to_owned()];
        assert_eq!(of_positions(&sources).as_deref(), Some("ckpc/h"));
        assert_eq!(of_positions(&["LAS".to_owned()]), None);
        let said = explained(["ckpc/h", "K"]).expect("two signs");
        assert!(said.contains("comoving") && said.contains("redshift") && said.contains("Hubble"), "{said}");
        assert_eq!(explained(["m", "K", "km/s"]), None);
    }
}
