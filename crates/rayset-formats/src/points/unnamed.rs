//! What the columns of a table without names are, by the values in its first rows.
//!
//! A leading column that counts rows, or has times, comes before the positions. Behind these, three
//! numbers of length one are a normal; three bytes, words or numbers up to 1 a colour; a number
//! before a colour an intensity; a small whole number behind colours or normals a label. Four
//! columns are x y z intensity, six without any of these x y z red green blue. Of four columns that
//! are a colour with either end, the end that differs more from the two columns between is the
//! intensity: channels of a colour are alike and vary together. If neither does, the first is.
//! Columns that count returns, from 1 to 7, are no colour; what comes before two of them is an
//! intensity.

/// Rows that are looked at.
pub(super) const ROWS: usize = 256;

/// Values of these are times, not coordinates.
const TIMES: std::ops::Range<f64> = 1e8..1e19;
/// Labels are at most this.
const MOST_LABEL: f64 = 64.0;

/// A pulse of a LiDAR has at most this many returns, of which files have the number of each and
/// that of all.
const MOST_RETURNS: f64 = 7.0;

/// Correlations, of two columns each, that differ by more than this say which column is a channel
/// of a colour.
const LEAST_CORRELATION: f64 = 0.5;

/// Fewer rows than these may have such numbers by chance.
const FEWEST_ROWS: usize = 4;

/// The first rows of a table.
struct Sample<'a>(&'a [Vec<f64>]);

impl Sample<'_> {
    /// The values of a column that are numbers.
    fn column(&self, column: usize) -> impl Iterator<Item = f64> + '_ {
        self.0.iter().filter_map(move |row| row.get(column).copied()).filter(|value| value.is_finite())
    }

    fn all(&self, column: usize, is: impl Fn(f64) -> bool) -> bool {
        let mut values = self.column(column).peekable();
        values.peek().is_some() && values.all(is)
    }

    fn most(&self, column: usize) -> f64 {
        self.column(column).fold(f64::NEG_INFINITY, f64::max)
    }

    fn varies(&self, column: usize) -> bool {
        let first = self.column(column).next();
        self.column(column).any(|value| Some(value) != first)
    }

    /// Whether a column counts rows or has times.
    fn is_lead(&self, column: usize) -> bool {
        let pairs = || self.column(column).zip(self.column(column).skip(1));
        let counts = pairs().all(|(a, b)| b - a == 1.0);
        let times = self.all(column, |value| TIMES.contains(&value)) && pairs().all(|(a, b)| b >= a);
        // Of a lattice, whose first coordinate counts, too, another is the same in many rows.
        pairs().count() > 2
            && (counts || times)
            && (column + 1..column + 4).all(|axis| self.column(axis).next().is_some())
            && (column + 1..column + 3).all(|axis| self.varies(axis))
    }

    fn is_normal(&self, first: usize) -> bool {
        let squares = || {
            let rows = self.0.iter().filter_map(|row| row.get(first..first + 3));
            rows.map(|v| v.iter().map(|value| value * value).sum::<f64>()).filter(|square| square.is_finite())
        };
        squares().any(|square| square > 0.0)
            && squares().all(|square| square == 0.0 || (square - 1.0).abs() < 0.05)
    }

    /// Whether a column counts returns of a pulse, or the like.
    fn counts(&self, column: usize) -> bool {
        let is_number = |v: f64| v.fract() == 0.0 && (1.0..=MOST_RETURNS).contains(&v);
        self.column(column).count() >= FEWEST_ROWS && self.all(column, is_number)
    }

    /// Whether a column is no number of a return, and the next two are.
    fn comes_before_returns(&self, column: usize) -> bool {
        !self.counts(column) && self.counts(column + 1) && self.counts(column + 2)
    }

    /// Whether two of three columns count returns, and the third is something else, or all do.
    fn is_of_returns(&self, first: usize) -> bool {
        let counting = (first..first + 3).filter(|&column| self.counts(column)).count();
        counting == 3 || counting == 2 && (first..first + 3).any(|column| self.most(column) > MOST_RETURNS)
    }

    fn is_color(&self, first: usize) -> bool {
        if self.is_of_returns(first) {
            return false;
        }
        let each = |is: &dyn Fn(usize) -> bool| (first..first + 3).all(is);
        let whole = |column| self.all(column, |v| v.fract() == 0.0 && (0.0..=65535.0).contains(&v));
        let unit = |column| self.all(column, |v| (0.0..=1.0).contains(&v));
        let byte = |column| self.all(column, |v| (0.0..=255.0).contains(&v)) && self.most(column) > 1.0;
        each(&unit) || each(&whole) || each(&byte)
    }

    fn is_label(&self, column: usize) -> bool {
        self.all(column, |v| v.fract() == 0.0 && (-1.0..=MOST_LABEL).contains(&v))
    }

    /// Whether the column behind three numbers belongs to a colour before it, and not the first of
    /// four to one behind it.
    fn goes_on(&self, first: usize) -> bool {
        let last = first + 3;
        let brightest = (first..last).map(|column| self.most(column)).fold(0.0, f64::max);
        let fractions = (first..last).any(|column| !self.all(column, |v| v.fract() == 0.0));
        let opaque = self.all(last, |v| v == 255.0);
        let is_label = self.is_label(last) && (fractions || brightest > MOST_LABEL);
        opaque || is_label || self.belongs_with_next(first, last)
    }

    /// Whether column `first` is a channel of a colour with the next two, rather than column `last`
    /// behind them is.
    fn belongs_with_next(&self, first: usize, last: usize) -> bool {
        let middle = [first + 1, first + 2];
        let shared = |column: usize| middle.iter().map(|&other| self.correlation(column, other)).sum::<f64>();
        let apart = |column: usize| middle.iter().map(|&other| self.difference(column, other)).sum::<f64>();
        let is_bytes = |column: usize| self.all(column, |v| v.fract() == 0.0 && (0.0..=255.0).contains(&v));
        let (of_first, of_last) = (shared(first), shared(last));
        match (is_bytes(first), is_bytes(last)) {
            // Where the others are bytes, a channel is one, too.
            (a, b) if a != b && middle.iter().all(|&column| is_bytes(column)) => a,
            // Of points of one colour, the column that varies is none of it.
            _ if !middle.iter().any(|&column| self.varies(column))
                && self.varies(first) != self.varies(last) =>
            {
                !self.varies(first)
            }
            _ if (of_first - of_last).abs() > LEAST_CORRELATION => of_first > of_last,
            _ => of_first > LEAST_CORRELATION && apart(first) < apart(last),
        }
    }

    /// The coefficient of correlation of two columns; 0 if one of them is constant.
    fn correlation(&self, a: usize, b: usize) -> f64 {
        let pairs = || {
            let pairs = self.0.iter().filter_map(|row| Some((*row.get(a)?, *row.get(b)?)));
            pairs.filter(|(a, b)| a.is_finite() && b.is_finite())
        };
        let count = pairs().count().max(1) as f64;
        let (mean_a, mean_b) = pairs().fold((0.0, 0.0), |sum, (a, b)| (sum.0 + a / count, sum.1 + b / count));
        let [mut aa, mut ab, mut bb] = [0.0; 3];
        for (a, b) in pairs().map(|(a, b)| (a - mean_a, b - mean_b)) {
            (aa, ab, bb) = (aa + a * a, ab + a * b, bb + b * b);
        }
        if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
    }

    /// The mean difference of two columns.
    fn difference(&self, a: usize, b: usize) -> f64 {
        let pairs = self.0.iter().filter_map(|row| Some((row.get(a)? - row.get(b)?).abs()));
        let (count, sum) = pairs.filter(|d| d.is_finite()).fold((0.0, 0.0), |(n, sum), d| (n + 1.0, sum + d));
        sum / f64::max(count, 1.0)
    }
}

/// Names for the columns of a table `width` wide, by its first rows, which may be none. `-` is a
/// column of no interest.
pub(super) fn names(width: usize, rows: &[Vec<f64>]) -> Vec<String> {
    let sample = Sample(rows);
    let mut names = Vec::with_capacity(width);
    let first = if width > 3 && sample.is_lead(0) { 4 } else { 3 };
    if first > 3 {
        names.push("-".to_owned());
    }
    names.extend(["x", "y", "z"].map(String::from));
    let (mut has_color, mut has_normal) = (false, false);
    while names.len() < width {
        let (at, left) = (names.len(), width - names.len());
        let behind = left > 3 && sample.is_color(at + 1);
        let unknown = rows.is_empty();
        if !unknown && sample.column(at).next().is_none() {
            // Words.
            names.push("-".to_owned());
        } else if left > 2 && !has_normal && sample.is_normal(at) {
            names.extend(["nx", "ny", "nz"].map(String::from));
            has_normal = true;
        } else if !has_color
            && (left == 3 && unknown
                || left > 2 && sample.is_color(at) && (!behind || left != 4 || sample.goes_on(at)))
        {
            names.extend(["red", "green", "blue"].map(String::from));
            has_color = true;
        } else if !has_color && !has_normal && (left == 1 && at == first || left == 4 && (behind || unknown))
            || at == first && left > 2 && sample.comes_before_returns(at)
        {
            names.push("intensity".to_owned());
        } else if left == 1 && (has_color || has_normal) && sample.is_label(at) {
            names.push("label".to_owned());
        } else if left == 1 && has_color && !has_normal && at == first + 3 && !unknown {
            names.push("intensity".to_owned());
        } else {
            names.push(format!("column{}", at + 1));
        }
    }
    names.truncate(width);
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The names for eight rows, each made of its number.
    fn of(row: impl Fn(f64) -> Vec<f64>) -> String {
        let rows: Vec<Vec<f64>> = (0..8).map(|i| row(f64::from(i))).collect();
        names(rows[0].len(), &rows).join(" ")
    }

    /// Something else in every row, from 0 to 1.
    fn any(i: f64) -> f64 {
        (0.3 + 0.618 * i).fract()
    }

    #[test]
    fn six_columns_are_colours_or_normals() {
        let position = |i: f64| vec![any(i), any(i + 20.0), any(i + 40.0)];
        let with = |more: &dyn Fn(f64) -> Vec<f64>| of(|i| [position(i), more(i)].concat());
        assert_eq!(with(&|i| vec![10.0 * i, 255.0, 3.0]), "x y z red green blue");
        assert_eq!(with(&|i| vec![any(i), 0.5, 0.2]), "x y z red green blue");
        assert_eq!(with(&|i| vec![any(i).cos(), 0.0, -any(i).sin()]), "x y z nx ny nz");
        assert_eq!(with(&|i| vec![-3.0 * i, 0.0, 1.5]), "x y z column4 column5 column6");
        assert_eq!(names(6, &[]).join(" "), "x y z red green blue");
    }

    #[test]
    fn of_seven_columns_the_first_is_an_intensity_or_the_last_a_label() {
        let with = |four: &dyn Fn(f64) -> [f64; 4]| {
            of(|i| [vec![any(i), any(i + 20.0), any(i + 40.0)], four(i).to_vec()].concat())
        };
        assert_eq!(with(&|i| [-1800.0 + i, 200.0, 90.0, 40.0]), "x y z intensity red green blue");
        assert_eq!(with(&|i| [0.1 * i, 200.0, 90.0, 140.0]), "x y z intensity red green blue");
        assert_eq!(with(&|i| [30.0 + i, 200.0, 90.0, 140.0]), "x y z intensity red green blue");
        assert_eq!(with(&|i| [200.0, 90.0, 40.0, i]), "x y z red green blue label");
        assert_eq!(with(&|i| [any(i), 0.9, 0.4, 3.0]), "x y z red green blue label");
        assert_eq!(with(&|i| [any(i).cos(), 0.0, any(i).sin(), 3.0]), "x y z nx ny nz label");
        assert_eq!(names(7, &[]).join(" "), "x y z intensity red green blue");
    }

    #[test]
    fn of_four_columns_that_are_a_colour_with_either_end_the_one_unlike_the_others_is_the_intensity() {
        let with = |four: &dyn Fn(f64) -> [f64; 4]| {
            of(|i| [vec![any(i), any(i + 20.0), any(i + 40.0)], four(i).to_vec()].concat())
        };
        let (light, byte) =
            (|i: f64| (100.0 * any(i)).round(), |i: f64| (250.0 * any(7.0 * i + 3.0)).round());
        // Points of one colour in light and shade, and of many colours.
        for hue in [[100.0, 80.0, 50.0], [40.0, 120.0, 60.0], [20.0, 25.0, 155.0]] {
            let color = |i: f64| hue.map(|v| v + light(i));
            let last = with(&|i| [color(i)[0], color(i)[1], color(i)[2], byte(i)]);
            assert_eq!(last, "x y z red green blue intensity");
            let first = with(&|i| [byte(i), color(i)[0], color(i)[1], color(i)[2]]);
            assert_eq!(first, "x y z intensity red green blue");
        }
        // More than a byte is no channel among bytes.
        assert_eq!(with(&|i| [200.0, 90.0, 40.0 + i, 300.0 + 7.0 * i]), "x y z red green blue intensity");
        assert_eq!(with(&|i| [200.0, 90.0, 40.0, byte(i)]), "x y z red green blue intensity");
    }

    #[test]
    fn colours_and_normals_come_in_either_order_and_what_is_neither_has_numbers() {
        let position = |i: f64| vec![any(i), any(i + 20.0), any(i + 40.0)];
        let (color, normal) = ([200.0, 30.0, 0.0], [0.0, 0.6, -0.8]);
        assert_eq!(of(|i| [&position(i), &color[..], &normal[..]].concat()), "x y z red green blue nx ny nz");
        assert_eq!(of(|i| [&position(i), &normal[..], &color[..]].concat()), "x y z nx ny nz red green blue");
        assert_eq!(of(|i| [position(i), vec![0.3, i]].concat()), "x y z column4 column5");
        assert_eq!(of(position), "x y z");
        assert_eq!(of(|i| [position(i), vec![any(i)]].concat()), "x y z intensity");
    }

    #[test]
    fn numbers_of_returns_are_no_colours() {
        let with = |more: &dyn Fn(f64) -> Vec<f64>| {
            of(|i| [vec![any(i), any(i + 20.0), any(i + 40.0)], more(i)].concat())
        };
        let (number, of_all) = (|i: f64| 1.0 + i % 2.0, |i: f64| 1.0 + i % 3.0);
        assert_eq!(with(&|i| vec![20.0 * i, number(i), of_all(i)]), "x y z intensity column5 column6");
        assert_eq!(
            with(&|i| vec![20.0 * i, number(i), of_all(i), 2.0]),
            "x y z intensity column5 column6 column7"
        );
        assert_eq!(with(&|i| vec![30.0 + i, 1.0, 1.0]), "x y z intensity column5 column6");
        // A picture of few colours.
        assert_eq!(with(&|i| vec![255.0 * (i % 2.0), 0.0, 3.0]), "x y z red green blue");
    }

    #[test]
    fn a_column_that_counts_or_has_times_comes_before_the_positions() {
        let position = |i: f64| vec![any(i), any(i + 20.0), any(i + 40.0)];
        assert_eq!(of(|i| [vec![1000.0 + i], position(i)].concat()), "- x y z");
        assert_eq!(of(|i| [vec![1.6e9 + 0.1 * i], position(i), vec![7.5]].concat()), "- x y z intensity");
        // A lattice whose x counts.
        assert_eq!(of(|i| vec![i, 0.0, 0.0, any(i)]), "x y z intensity");
    }
}
