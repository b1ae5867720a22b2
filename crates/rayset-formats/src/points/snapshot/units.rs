//! Units of datasets, by the attributes that each code gives them.

use super::hdf5::Attributes;

/// Exponents of the scale factor and of the Hubble parameter, and the factor to CGS units, in the
/// names of each code.
struct Names {
    factor: &'static str,
    /// In which the expression for physical units stands, if the code writes one.
    expression: &'static str,
    a: &'static str,
    h: &'static str,
}

const CODES: [Names; 3] = [
    // EAGLE, and GADGET-3 before it.
    Names { factor: "CGSConversionFactor", expression: "", a: "aexp-scale-exponent", h: "h-scale-exponent" },
    // AREPO, IllustrisTNG, GADGET-4.
    Names { factor: "to_cgs", expression: "", a: "a_scaling", h: "h_scaling" },
    Names {
        factor: "Conversion factor to CGS (not including cosmological corrections)",
        expression: "Expression for physical CGS units",
        a: "a-scale exponent",
        h: "h-scale exponent",
    },
];

/// The unit of masses of a whole snapshot, by the attributes of a group about its units or the
/// parameters of its run. Empty if they state none.
pub(super) fn of_masses(attributes: &Attributes) -> String {
    // GADGET and its kin have masses over the Hubble parameter, SWIFT has not.
    let names = [("UnitMass_in_g", " h^-1"), ("Unit mass in cgs (U_M)", "")];
    let stated = names.iter().find_map(|(name, over)| Some((attributes.number(name)?, over)));
    stated
        .filter(|(factor, _)| *factor > 0.0)
        .map_or_else(String::new, |(factor, over)| format!("{factor:e} cgs{over}"))
}

/// The unit of a dataset as text, such as `3.085678e21 cgs a h^-1`: the factor to CGS units, and
/// the powers of the scale factor a and of the Hubble parameter h by which a number is multiplied
/// as well. Empty if none is stated.
pub(super) fn of(attributes: &Attributes) -> String {
    for code in &CODES {
        let Some(factor) = attributes.number(code.factor) else { continue };
        if let Some(expression) = attributes.text(code.expression) {
            return format!("{factor:e} cgs, {expression}");
        }
        // AREPO writes a factor of 0 where a number has no unit.
        if factor == 0.0 {
            return String::new();
        }
        let mut unit = format!("{factor:e} cgs");
        for (symbol, exponent) in [("a", code.a), ("h", code.h)] {
            match attributes.number(exponent) {
                None | Some(0.0) => {}
                Some(1.0) => unit.push_str(&format!(" {symbol}")),
                Some(power) => unit.push_str(&format!(" {symbol}^{power}")),
            }
        }
        return unit;
    }
    String::new()
}
