//! Parsing the numbers of text, whose decimal mark may be a comma.

/// The decimal mark. A file has a single one: that of the first number that has one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DecimalMark {
    /// Not known yet: no number has had one.
    Open,
    Point,
    Comma,
}

/// Why a value is not a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NotANumber {
    Word,
    /// It has another decimal mark than the file, or both.
    OtherMark,
}

impl DecimalMark {
    /// Parses `text`, which has no blanks around it.
    ///
    /// Accepts what [`str::parse`] does, also with a comma between digits as the decimal mark if
    /// the file has commas, and with Fortran exponents (`1.0D+05`). Missing values (an empty text,
    /// `NA`, `N/A`, `null`) become NaN.
    #[inline]
    pub(super) fn parse(&mut self, text: &str) -> Result<f64, NotANumber> {
        match text.parse::<f64>() {
            // Infinities and NaN have no point, and whole numbers leave the mark open.
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

/// Whether texts with a comma show that it is a decimal mark. In groups of thousands, there are
/// three digits behind a comma, at most three before it, and the first is not 0.
pub(super) fn are_decimals<'t>(mut texts: impl Iterator<Item = &'t str>) -> bool {
    texts.any(|text| {
        let Some((whole, fraction)) = text.split_once(',') else { return false };
        let digits = whole.trim_start_matches(['+', '-']);
        let is_number = [digits, fraction]
            .iter()
            .all(|part| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit()));
        is_number && (fraction.len() != 3 || digits.len() > 3 || digits.starts_with('0'))
    })
}

/// Whether a text marks a missing value.
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
