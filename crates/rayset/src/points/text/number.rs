//! Numbers as tables hold them.

/// The mark between whole numbers and decimals. A file has one: that of the first number that has any.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DecimalMark {
    /// No number had one yet.
    Open,
    Point,
    Comma,
}

/// Why a value is no number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NotANumber {
    Word,
    /// It has the decimal mark that the file does not have, or both.
    OtherMark,
}

impl DecimalMark {
    /// The number that `text`, without blanks around it, stands for.
    ///
    /// What [`str::parse`] reads, with a comma in place of the point (a digit on either side) where the file has
    /// commas, with the exponents of Fortran (`1.0D+05`), and NaN for a missing value: nothing, `NA`, `N/A`, `null`.
    #[inline]
    pub(super) fn parse(&mut self, text: &str) -> Result<f64, NotANumber> {
        match text.parse::<f64>() {
            // Infinities and NaN have no point, and whole numbers leave it open.
            Ok(value) if *self == Self::Point || !text.contains('.') => Ok(value),
            Ok(value) => self.settle(Self::Point).map(|()| value),
            Err(_) => self.parse_unusual(text),
        }
    }

    #[cold]
    fn parse_unusual(&mut self, text: &str) -> Result<f64, NotANumber> {
        if is_missing(text) {
            return Ok(f64::NAN);
        }
        let mut plain = text.replacen(['D', 'd'], "e", 1);
        let comma = plain.find(',');
        if let Some(at) = comma {
            let digit =
                |at: Option<usize>| at.and_then(|i| plain.as_bytes().get(i)).is_some_and(u8::is_ascii_digit);
            if plain.contains('.') {
                return Err(NotANumber::OtherMark);
            }
            if !(digit(at.checked_sub(1)) && digit(Some(at + 1))) {
                return Err(NotANumber::Word);
            }
            plain.replace_range(at..=at, ".");
        }
        let starts = plain.bytes().next().is_some_and(|b| b.is_ascii_digit() || b"+-.".contains(&b));
        let value = plain.parse().ok().filter(|_| starts).ok_or(NotANumber::Word)?;
        if comma.is_some() {
            self.settle(Self::Comma)?;
        } else if plain.contains('.') {
            self.settle(Self::Point)?;
        }
        Ok(value)
    }

    fn settle(&mut self, mark: Self) -> Result<(), NotANumber> {
        if *self == Self::Open {
            *self = mark;
        }
        if *self == mark { Ok(()) } else { Err(NotANumber::OtherMark) }
    }
}

/// Whether a value says that there is none.
fn is_missing(text: &str) -> bool {
    text.is_empty() || ["NA", "N/A", "null"].iter().any(|word| text.eq_ignore_ascii_case(word))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(texts: &[&str]) -> Vec<Result<f64, NotANumber>> {
        let mut mark = DecimalMark::Open;
        texts.iter().map(|text| mark.parse(text)).collect()
    }

    #[test]
    fn points_commas_and_fortran_exponents_are_numbers() {
        assert_eq!(numbers(&["1", "-1.5", ".5", "5.", "1e3"]), [1.0, -1.5, 0.5, 5.0, 1e3].map(Ok));
        assert_eq!(numbers(&["1", "-1,5", "+0,25e2"]), [1.0, -1.5, 25.0].map(Ok));
        assert_eq!(numbers(&["1.0D+05", "2d-3", "1,5D2"])[..2], [Ok(1e5), Ok(2e-3)]);
        assert_eq!(numbers(&["1,5D2"]), [Ok(150.0)]);
        assert_eq!(numbers(&["inf", "-Infinity"]), [Ok(f64::INFINITY), Ok(f64::NEG_INFINITY)]);
    }

    #[test]
    fn a_missing_value_is_nan() {
        for text in ["", "NA", "na", "N/A", "null", "NULL", "nan", "NaN", "-nan"] {
            assert!(numbers(&[text])[0].is_ok_and(f64::is_nan), "{text}");
        }
    }

    #[test]
    fn a_file_has_one_decimal_mark() {
        assert_eq!(numbers(&["1,5", "1.5"]), [Ok(1.5), Err(NotANumber::OtherMark)]);
        assert_eq!(numbers(&["1.5", "1,5"]), [Ok(1.5), Err(NotANumber::OtherMark)]);
        assert_eq!(numbers(&["1.0D0", "1,5"]), [Ok(1.0), Err(NotANumber::OtherMark)]);
        assert_eq!(numbers(&["1,234.5", "1.234,5"]), [Err(NotANumber::OtherMark); 2]);
        for word in ["1,", ",5", "1,2,3", "five", "d", "dnf", "inD", "1D2D3", "0x10", "1 2", "-"] {
            assert_eq!(numbers(&[word]), [Err(NotANumber::Word)], "{word}");
        }
    }
}
