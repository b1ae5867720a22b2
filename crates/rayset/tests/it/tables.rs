//! Tables of points as text: what is read of every dialect, and what is refused, with its line.

use std::path::{Path, PathBuf};

use proptest::prelude::*;
use rayset::octree::build::{BuildOptions, Rule};
use rayset::points::{self, PointBatch, ReadError, ReadOptions};

use crate::common::{build_at, folder, real_data};

/// Positions, and every column with its name.
pub(crate) type Table = (Vec<[f64; 3]>, Vec<(String, Vec<f64>)>);

/// All that a file holds.
pub(crate) fn table(path: &Path, names: Option<&str>) -> Result<Table, ReadError> {
    let text_columns = names.map(|names| names.split(',').map(str::to_owned).collect());
    let mut source = points::open(path, &ReadOptions::default().with_text_columns(text_columns))?;
    let mut columns: Vec<(String, Vec<f64>)> =
        source.schema().names().map(|name| (name.to_owned(), Vec::new())).collect();
    source.select(&(0..columns.len()).collect::<Vec<_>>());
    let (mut position, mut batch) = (Vec::new(), PointBatch::default());
    loop {
        source.fill(&mut batch, 100)?;
        if batch.is_empty() {
            return Ok((position, columns));
        }
        position.extend_from_slice(&batch.position);
        for (column, values) in columns.iter_mut().zip(&batch.columns) {
            assert_eq!(values.len(), batch.len());
            column.1.extend((0..values.len()).map(|i| values.get(i)));
        }
    }
}

fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a write");
    path
}

fn read_as(name: &str, text: impl AsRef<[u8]>) -> Table {
    let folder = folder();
    let text = text.as_ref();
    table(&write(folder.path(), name, text), None)
        .unwrap_or_else(|e| panic!("{}: {e}", String::from_utf8_lossy(text)))
}

/// The message of what is refused, without the name of the file.
fn refusal_as(name: &str, text: impl AsRef<[u8]>) -> String {
    let folder = folder();
    let text = text.as_ref();
    let read = table(&write(folder.path(), name, text), None);
    let Err(error) = read else { panic!("{:?} was read", String::from_utf8_lossy(text)) };
    let message = error.to_string();
    let (file, what) = message.split_once(", ").expect("a place");
    assert!(file.ends_with(name), "{message}");
    what.to_owned()
}

fn read(text: &str) -> Table {
    read_as("a.csv", text)
}

fn refusal(text: &str) -> String {
    refusal_as("a.csv", text)
}

fn names(table: &Table) -> Vec<&str> {
    table.1.iter().map(|(name, _)| name.as_str()).collect()
}

/// Equal bit by bit, but for the bits of NaN.
fn same(a: &Table, b: &Table) -> bool {
    let text = |t: &Table| format!("{t:?}");
    text(a) == text(b)
}

const TWO: [[f64; 3]; 2] = [[1.0, 2.0, 3.0], [-4.5, 5e3, 0.25]];

#[test]
fn a_column_called_height_is_an_attribute_where_there_is_a_z() {
    let (position, columns) = read("x,y,z,height\n1,2,3,9\n-4.5,5e3,.25,8\n");
    assert_eq!(position, TWO);
    assert_eq!(columns, [("height".to_owned(), vec![9.0, 8.0])]);
    let (position, columns) = read("height,elevation,y,x\n9,3,2,1\n8,.25,5e3,-4.5\n");
    assert_eq!((position.as_slice(), columns[0].0.as_str()), (TWO.as_slice(), "height"));
}

#[test]
fn other_names_of_axes_are_axes_where_no_column_has_their_own() {
    for header in [
        "easting,northing,elevation",
        "Easting,Northing,Height",
        "X,Y,Z",
        "x,y,height",
        "\"Points:0\",\"Points:1\",\"Points:2\"",
    ] {
        let (position, columns) = read(&format!("{header}\n1,2,3\n-4.5,5e3,.25\n"));
        assert_eq!(position, TWO, "{header}");
        assert!(columns.is_empty(), "{header}");
    }
}

#[test]
fn names_keep_their_spelling_and_are_found_in_any() {
    let folder = folder();
    let path = write(folder.path(), "a.csv", b"X,Y,Z,Intensity,GpsTime\n1,2,3,4,5\n");
    let source = points::open(&path, &ReadOptions::default()).expect("it opens");
    let schema = source.schema();
    assert_eq!(schema.names().collect::<Vec<_>>(), ["Intensity", "GpsTime"]);
    assert_eq!(
        [schema.find("intensity"), schema.find("GpsTime"), schema.find("gps")],
        [Some(0), Some(1), None]
    );
}

#[test]
fn columns_called_b_and_r_are_addressed_by_their_own_names_and_are_colours_too() {
    let folder = folder();
    let header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                  property float r\nproperty float g\nproperty float b\nend_header\n";
    let rows = "0 0 0 1 2 3\n1 0 0 2 3 4\n0 1 0 3 4 5\n";
    let files = [
        write(folder.path(), "a.csv", format!("x,y,z,r,g,b\n{}", rows.replace(' ', ",")).as_bytes()),
        write(folder.path(), "a.ply", format!("{header}{rows}").as_bytes()),
    ];
    for path in files {
        let open = || points::open(&path, &ReadOptions::default()).expect("it opens");
        let source = open();
        let schema = source.schema();
        assert_eq!(schema.names().collect::<Vec<_>>(), ["r", "g", "b"]);
        assert_eq!(["red", "green", "blue"].map(|name| schema.find(name)), [Some(0), Some(1), Some(2)]);
        assert_eq!(["r", "g", "b"].map(|name| schema.find(name)), [Some(0), Some(1), Some(2)]);
        // One column may serve several ends at once.
        let mut source = open();
        source.select(&[2, 0, 2]);
        let mut batch = PointBatch::default();
        source.fill(&mut batch, 10).expect("it reads");
        let column = |i: usize| (0..3).map(|k| batch.columns[i].get(k)).collect::<Vec<_>>();
        assert_eq!([column(0), column(1), column(2)], [[3.0, 4.0, 5.0], [1.0, 2.0, 3.0], [3.0, 4.0, 5.0]]);
        let options = BuildOptions {
            attributes: vec!["b".into()],
            radius: Some(Rule::Attribute("r".into())),
            ..BuildOptions::default()
        };
        build_at(&folder.path().join("a.rset"), open(), &options);
    }
}

#[test]
fn other_names_of_colours_count_together_and_where_no_colour_is_named() {
    let folder = folder();
    let found = |header: &str| {
        let row = vec!["1"; header.split(',').count()].join(",");
        let path = write(folder.path(), "a.csv", format!("{header}\n{row}\n").as_bytes());
        let source = points::open(&path, &ReadOptions::default()).expect("it opens");
        ["red", "green", "blue"].map(|name| source.schema().find(name))
    };
    assert_eq!(found("x,y,z,R,G,B"), [Some(0), Some(1), Some(2)]);
    assert_eq!(found("x,y,z,r,g"), [None; 3]);
    assert_eq!(found("x,y,z,r,g,b,red"), [Some(3), None, None]);
}

#[test]
fn rows_wider_or_narrower_than_the_header_are_errors_that_name_the_line() {
    let wide = refusal("x,y,z,a\n\n1,2,3,4,5\n");
    assert!(wide.starts_with("line 3: 5 values where the header on line 1 names 4"), "{wide}");
    let narrow = refusal("x,y,z,a\n1,2,3\n");
    assert!(narrow.starts_with("line 2: 3 values where the header on line 1 names 4"), "{narrow}");
    let comment = refusal_as("a.xyz", "# x y z a\n1 2 3\n");
    assert!(comment.starts_with("line 2: 3 values where the header on line 1 names 4"), "{comment}");
    // A comment that is a sentence is no header.
    assert_eq!(read_as("a.xyz", "# points with x y z and all\n1 2 3\n-4.5 5e3 .25\n").0, TWO);
}

#[test]
fn a_row_with_another_number_of_values_is_an_error_in_every_text_format() {
    for name in ["a.xyz", "a.txt", "a.csv", "a.asc", "a.pts"] {
        for separator in [" ", "\t", ",", ";"] {
            for row in ["1 2 3 4 5", "1 2 3"] {
                let rows = format!("1 2 3 4\n\n{row}\n").replace(' ', separator);
                let count = if name == "a.pts" { "2\n" } else { "" };
                let what = refusal_as(name, format!("{count}{rows}"));
                let (first, line) = (1 + count.len() / 2, 3 + count.len() / 2);
                let values = row.split(' ').count();
                let expected =
                    format!("line {line}: {values} values where 4 were expected, as on line {first}");
                assert_eq!(what, expected, "{name} {separator:?}");
            }
        }
    }
    let folder = folder();
    let path = write(folder.path(), "a.csv", b"1,2,3,4\n");
    let what = table(&path, Some("x,y,z")).expect_err("a value without a name").to_string();
    assert!(what.contains("line 1: 4 values where --columns names 3"), "{what}");
}

#[test]
fn quoted_values_separators_and_line_breaks_are_read() {
    let text = "\"name\",\"x\",\"y\",\"z\",\"Height\n(m)\"\r\n\"Tree, \"\"old\"\"\",\"1\",2,\"3\",9\r\n\
                \"two\nlines\n\n# of it\",\"-4.5\",\"5e3\", \".25\",\"8\"\r\n";
    let folder = folder();
    let path = write(folder.path(), "a.csv", text.as_bytes());
    let mut source = points::open(&path, &ReadOptions::default()).expect("it opens");
    // A column of words is passed over.
    assert_eq!(source.schema().names().collect::<Vec<_>>(), ["Height (m)"]);
    source.select(&[0]);
    let mut batch = PointBatch::default();
    source.fill(&mut batch, 10).expect("it reads");
    assert_eq!(batch.position, TWO);
    assert_eq!([batch.columns[0].get(0), batch.columns[0].get(1)], [9.0, 8.0]);
    // Words are no numbers, if somebody wants them; the line is that on which the record begins.
    let said = table(&path, Some("name,x,y,z,height")).expect_err("words").to_string();
    assert!(said.contains("line 3: `Tree, \"old\"` is not a number"), "{said}");
    assert_eq!(read_as("a.xyz", "\"x\" \"y\" \"z\"\n\"1\" \"2\" \"3\"\n-4.5 5e3 .25\n").0, TWO);
    let open = refusal("x,y,z\n1,2,3\n\"4,5,6\n7,8,9\n");
    assert_eq!(open, "line 3: a quote that is not closed");
}

#[test]
fn byte_order_marks_are_passed_over_or_named() {
    assert_eq!(read("\u{feff}x,y,z\n1,2,3\n-4.5,5e3,.25\n").0, TWO);
    assert_eq!(read("\u{feff}\"x\",\"y\",\"z\"\n1,2,3\n-4.5,5e3,.25\n").0, TWO);
    assert_eq!(read("\u{feff}1,2,3\n-4.5,5e3,.25\n").0, TWO);
    let little: Vec<u8> = "\u{feff}x,y,z\n1,2,3\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    let what = refusal_as("a.csv", little);
    assert!(what.contains("UTF-16") && what.contains("UTF-8"), "{what}");
}

#[test]
fn decimal_commas_are_read_where_no_comma_separates() {
    let expected = [[1.5, 2.0, 3.25], [-4.5, 5e3, 0.25]];
    for separator in [";", "\t", " ", "   ", " \t"] {
        for header in ["", "x;y;z\n", "# x;y;z\n"] {
            let text = format!("{header}1,5;2;3,25\n-4,5;5,0e3;0,25\n").replace(';', separator);
            assert_eq!(read_as("a.txt", &text).0, expected, "{text:?}");
        }
    }
    // The header may be separated otherwise, and whole numbers settle nothing.
    assert_eq!(read("x,y,z\n1;2;3\n1,5;2;3,25\n").0[1], expected[0]);
    // Where both could be, commas separate.
    assert_eq!(read("1,5,2,5,3,5\n"), read("1;5;2;5;3;5\n"));
    assert_eq!(read("1, 5, 2\n").0, [[1.0, 5.0, 2.0]]);
}

#[test]
fn a_file_has_one_decimal_mark() {
    assert!(
        refusal("1,5;2;3\n1.5;2;3\n").starts_with("line 2: `1.5` has two decimal marks, or another than")
    );
    assert!(
        refusal("1.5;2;3\n2,5;2;3\n").starts_with("line 2: `2,5` has two decimal marks, or another than")
    );
    assert!(refusal("x;y;z\n1;2;3\n1.234,5;2;3\n").starts_with("line 3: `1.234,5` has two decimal marks"));
    let thousands = refusal("x,y,z\n1,2,3\n\"1,234\",2,3\n");
    assert!(thousands.starts_with("line 3: `1,234`: where commas separate values"), "{thousands}");
    // What the first row settles holds.
    assert!(refusal("1 2 3\n1,2,3\n").starts_with("line 2: 1 values where 3 were expected"));
    assert!(refusal("1,2,3\n1;2;3\n").starts_with("line 2: 1 values where 3 were expected"));
}

#[test]
fn the_count_of_a_pts_file_is_compared_with_its_points() {
    let few = refusal_as("a.pts", "1000\n1 2 3\n4 5 6\n");
    assert!(few.starts_with("line 1: the count claims 1000 points and 2 follow, up to line 3"), "{few}");
    let many = refusal_as("a.pts", "1\n1 2 3\n4 5 6\n");
    assert!(many.starts_with("line 3: a point beyond the 1 that the count on line 1 claims"), "{many}");
    let second = refusal_as("a.pts", "1\n1 2 3\n3\n4 5 6\n");
    assert!(second.starts_with("line 3: the count claims 3 points and 1 follow, up to line 4"), "{second}");
    let early = refusal_as("a.pts", "2\n1 2 3\n1\n4 5 6\n");
    assert!(early.starts_with("line 1: the count claims 2 points and 1 follow"), "{early}");
    let none = refusal_as("a.pts", "7\n");
    assert!(none.contains("no line of numbers found after the count of 7 points"), "{none}");
}

#[test]
fn several_scans_in_a_pts_file_are_one_cloud() {
    let text = "1\r\n1 2 3 -9 1 2 3\r\n0\r\n\r\n1\r\n-4.5 5e3 .25 8 1 2 3\r\n";
    let found = read_as("a.pts", text);
    assert_eq!(found.0, TWO);
    assert_eq!(names(&found), ["intensity", "red", "green", "blue"]);
    assert_eq!(read_as("a.txt", "//X Y Z\n2\n1 2 3\n-4.5 5e3 .25\n").0, TWO);
}

#[test]
fn missing_values_are_nan_and_fortran_exponents_are_numbers() {
    let (position, columns) = read("x,y,z,a\n1.0D+00,2d0,3,\n-4.5,5.0D3,2.5d-1,NA\nnan,NaN,n/a,null\n");
    assert_eq!(position[..2], TWO);
    assert!(position[2].iter().chain(&columns[0].1).all(|v| v.is_nan()));
    assert!(refusal("x,y,z\n1,2,3\n1,2,three\n").starts_with("line 3: `three` is not a number"));
}

#[test]
fn comments_empty_lines_line_ends_and_trailing_separators_change_nothing() {
    let expected = read("x,y,z,a\n1,2,3,4\n5,6,7,\n");
    for text in [
        "x,y,z,a\r\n1,2,3,4\r\n5,6,7,\r\n",
        "\n# a comment\nx,y,z,a\n\n1,2,3,4\n// another, with a \" in it\n5,6,7,\n\n",
        "x,y,z,a,\n1,2,3,4,\n5,6,7,,\n",
        "x,y,z,a\n1,2,3,4,\n5,6,7,,",
        "#x,y,z,a\n1,2,3,4\n  # and\n5,6,7,",
        "\"x\",y,z,a\n 1 , 2 ,3, 4 \n5,6,7,NaN",
        "x\ty\tz\ta\n1\t2\t3\t4\n5\t6\t7\t\n",
        "# caf\u{e9}\nx;y;z;a\n1;2;3;4\n5;6;7;\n",
    ] {
        assert!(same(&read(text), &expected), "{text:?}: {:?}", read(text));
    }
    // Comments in another encoding than UTF-8 are still comments.
    let latin = [b"# caf\xe9\n".as_slice(), b"x,y,z,a\n1,2,3,4\n5,6,7,\n"].concat();
    assert!(same(&read_as("a.csv", latin), &expected));
    // Without any line feed, carriage returns are line ends.
    assert_eq!(read("1,2,3\r-4.5,5e3,0.25\r").0, TWO);
    assert!(refusal("x,y,z\n1,2,3\n1,2,3\r4,5,6\n").contains("line 3: a carriage return within a line"));
    assert!(refusal_as("a.xyz", "1 2 3\n1 2 3\r4 5 6\n").contains("line 2: a carriage return within a line"));
}

#[test]
fn records_without_an_end_cost_bounded_memory() {
    let long = format!("x,y,z\n1,2,{}\n", "3".repeat(70_000));
    assert!(refusal(&long).starts_with("line 2: a line of more than 65536 bytes"));
    // A quote that is never closed takes all lines that follow.
    let open = format!("x,y,z\n1,2,3\n1,2,\"3\n{}", "4,5,6\n".repeat(50_000));
    let what = refusal(&open);
    assert!(what.contains("65536 bytes") && what.contains("quote"), "{what}");
    let first = format!("x,y,z\n1,2,\"3\n{}", "4,5,6\n".repeat(50_000));
    assert!(refusal(&first).contains("65536 bytes"));
    // As long as a record may be.
    let spaces = " ".repeat(65_536 - "-4.5,5e3,.25".len());
    assert_eq!(read(&format!("1,2,3\n-4.5,5e3,{spaces}.25\r\n")).0, TWO);
}

#[test]
fn what_is_no_table_is_refused_with_what_to_do() {
    assert!(refusal("x,y,a\n1,2,3\n").starts_with("line 1: expected numbers or a header with x, y and z"));
    assert!(
        refusal("x,y,z\na,b,c\n")
            .starts_with("line 2: expected numbers under x, y and z of the header on line 1")
    );
    assert!(refusal("x,y,z,a,a\n1,2,3,4,5\n").starts_with("line 1: two columns are called `a`"));
    assert!(refusal("x,y,z\n").contains("no line of numbers found"));
    let folder = folder();
    let path = write(folder.path(), "a.csv", b"lon,lat,alt,name\n1,2,3,oak\n-4.5,5e3,.25,elm\n");
    assert_eq!(table(&path, Some("x,y,z,-")).expect("named").0, TWO);
    let what = table(&path, Some("x,y,height_above,-")).expect_err("no z").to_string();
    assert!(what.contains("no column called z"), "{what}");
}

#[test]
fn columns_of_classes_are_known_and_the_source_describes_itself() {
    let folder = folder();
    let path = write(folder.path(), "a.csv", b"x,y,z,Classification,class,label,classes\n1,2,3,4,5,6,7\n");
    let source = points::open(&path, &ReadOptions::default()).expect("it opens");
    let classes: Vec<bool> = source.schema().columns.iter().map(|c| c.is_class).collect();
    assert_eq!(classes, [true, true, true, false]);
    assert!(source.schema().description.starts_with("CSV with header; columns, by"));
    let path = write(folder.path(), "a.xyz", b"1 2 3\n");
    let source = points::open(&path, &ReadOptions::default()).expect("it opens");
    assert!(source.schema().description.starts_with("text separated by blanks without header; columns, by"));
}

#[test]
fn real_pts_files_are_read_to_their_last_point() {
    let Some(folder) = real_data("ptsptx") else {
        eprintln!("skipped: no PTS files here");
        return;
    };
    for (name, points, columns) in [("autzen.pts", 10, 4), ("bunnyData.pts", 30_571, 0), ("test.pts", 19, 4)]
    {
        let found = table(&folder.join(name), None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((found.0.len(), found.1.len()), (points, columns), "{name}");
    }
}

/// A way to write tables.
#[derive(Clone, Copy, Debug)]
struct Dialect {
    delimiter: u8,
    decimal_comma: bool,
    quotes: csv::QuoteStyle,
    has_header: bool,
    crlf: bool,
    byte_order_mark: bool,
}

fn dialects() -> impl Strategy<Value = Dialect> {
    let quotes = prop::sample::select(vec![
        csv::QuoteStyle::Always,
        csv::QuoteStyle::Necessary,
        csv::QuoteStyle::NonNumeric,
    ]);
    (prop::sample::select(b",;\t ".to_vec()), any::<[bool; 4]>(), quotes).prop_map(
        |(delimiter, flags, quotes)| {
            let [decimal_comma, has_header, crlf, byte_order_mark] = flags;
            let decimal_comma = decimal_comma && delimiter != b',';
            Dialect { delimiter, decimal_comma, quotes, has_header, crlf, byte_order_mark }
        },
    )
}

fn numbers() -> impl Strategy<Value = f64> {
    prop_oneof![any::<f64>(), -1e7..1e7, (-1000_i32..1000).prop_map(f64::from)]
        .prop_map(|v| if v.is_nan() { f64::NAN } else { v })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn tables_in_any_dialect_read_back_the_same(
        dialect in dialects(),
        rows in prop::collection::vec(prop::collection::vec(numbers(), 5), 1..6),
        order in Just(vec!["x", "y", "z", "a;b, \"c\" d", "Class"]).prop_shuffle(),
        scientific: bool,
    ) {
        let terminator = if dialect.crlf { csv::Terminator::CRLF } else { csv::Terminator::Any(b'\n') };
        let mut writer = csv::WriterBuilder::new()
            .delimiter(dialect.delimiter)
            .quote_style(dialect.quotes)
            .terminator(terminator)
            .from_writer(if dialect.byte_order_mark { b"\xef\xbb\xbf".to_vec() } else { Vec::new() });
        // Doubled quotes are no business of blanks.
        let order = order.iter().map(|n| if dialect.delimiter == b' ' { n.replace('"', "") } else { (*n).to_owned() });
        let order: Vec<String> = order.collect();
        let names: Vec<String> =
            if dialect.has_header { order } else { ["x", "y", "z", "column4", "column5"].map(str::to_owned).to_vec() };
        if dialect.has_header {
            writer.write_record(&names).expect("memory");
        }
        for row in &rows {
            writer.write_record(row.iter().map(|v| {
                let text = if scientific { format!("{v:e}") } else { v.to_string() };
                if dialect.decimal_comma { text.replace('.', ",") } else { text }
            })).expect("memory");
        }
        let text = writer.into_inner().expect("memory");
        let place = |name: &str| names.iter().position(|n| n == name).expect("a column");
        let axes = ["x", "y", "z"].map(place);
        let expected: Table = (
            rows.iter().map(|row| axes.map(|axis| row[axis])).collect(),
            (names.iter().enumerate().filter(|(i, _)| !axes.contains(i)))
                .map(|(i, name)| (name.clone(), rows.iter().map(|row| row[i]).collect()))
                .collect(),
        );
        let folder = folder();
        let found = table(&write(folder.path(), "a.csv", &text), None);
        prop_assert!(
            matches!(&found, Ok(found) if same(found, &expected)),
            "{:?}\n{found:?}\n{expected:?}", String::from_utf8_lossy(&text)
        );
    }

    #[test]
    fn scrambled_tables_are_values_or_errors_with_a_line(
        edits in prop::collection::vec((0_usize..80, prop::sample::select(b"\"\",;\t \r\n#.1eD\xff\0x".to_vec())), 1..6),
        which in 0_usize..4,
    ) {
        let text = "x,y,z,\"a,b\"\n1.5,2,3,4\n# c\n5,6,7,\"8\"\n9,10,11,12\n";
        let mut bytes = match which {
            0 => text.to_owned(),
            1 => text.replace(',', ";").replace('.', ","),
            2 => text.replace(',', "\t"),
            _ => format!("2\n{}", "1 2 3 4\n".repeat(4)),
        }.into_bytes();
        for (at, byte) in edits {
            let at = at % bytes.len();
            bytes[at] = byte;
        }
        let folder = folder();
        if let Err(error) = table(&write(folder.path(), "a.csv", &bytes), None) {
            let text = error.to_string();
            // What looks like another kind of file, a molecule's, is refused as a whole.
            prop_assert!(text.contains(", line ") || text.contains("which is not read"), "{text}");
        }
    }
}
