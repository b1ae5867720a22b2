//! LAS and LAZ: every format and method gives the same numbers, claims of damaged files cost
//! nothing, and memory does not grow with what is around the points.

use std::path::{Path, PathBuf};
use std::process::Command;

use rayset::points::{self, ColumnType, PointBatch, PointSource, ReadError, ReadOptions, Values, open_las};

use crate::common::{Random, folder, real_data};
use crate::las_writer::{Chunks, EXTENDED_AT, LasFile, descriptor, place_of_table, points_start};

fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a write");
    path
}

/// Positions and the columns of a selection.
fn read(path: &Path, selection: Option<&[usize]>) -> Result<(Vec<[f64; 3]>, Vec<Values>), ReadError> {
    let mut source = open_las(path)?;
    let all: Vec<usize> = (0..source.schema().columns.len()).collect();
    let selection = selection.unwrap_or(&all);
    source.select(selection);
    let kinds = selection.iter().map(|&i| source.schema().columns[i].kind);
    let mut columns: Vec<Values> = kinds.map(Values::empty).collect();
    let (mut position, mut batch) = (Vec::new(), PointBatch::default());
    loop {
        source.fill(&mut batch, 777)?;
        if batch.is_empty() {
            return Ok((position, columns));
        }
        position.extend_from_slice(&batch.position);
        for (all, part) in columns.iter_mut().zip(&batch.columns) {
            all.extend_from(part, 0..part.len());
        }
    }
}

/// What opening and reading the whole file fails with.
fn complaint(path: &Path) -> String {
    read(path, None).expect_err("the file is broken").to_string()
}

/// Every number of a file against those of the `las` crate, an implementation of its own.
fn agrees_with_the_las_crate(path: &Path) {
    let (position, columns) = read(path, None).unwrap_or_else(|e| panic!("{e}"));
    let source = open_las(path).expect("it opens");
    let schema = source.schema();
    let mut oracle = las::Reader::from_path(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let format = *oracle.header().point_format();
    let count = oracle.header().number_of_points();
    assert_eq!((position.len() as u64, source.count_hint()), (count, Some(count)), "{}", path.display());
    let points = oracle.read_all().unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    assert_eq!(points.len() as u64, count);
    let column = |name: &str| {
        let index = schema.find(name).unwrap_or_else(|| panic!("{}: no {name}", path.display()));
        &columns[index]
    };
    let same = |name: &str, expected: Vec<f64>| {
        let found = column(name);
        assert_eq!(found.len(), expected.len());
        for (i, e) in expected.iter().enumerate() {
            let f = found.get(i);
            assert!(f.to_bits() == e.to_bits() || f == *e, "{}, {name} of {i}: {f} {e}", path.display());
        }
    };
    let xyz = points.x().zip(points.y()).zip(points.z()).map(|((x, y), z)| [x, y, z]);
    assert!(xyz.eq(position.iter().copied()), "positions of {}", path.display());
    same("intensity", points.intensity().map(f64::from).collect());
    same("classification", points.classification().map(f64::from).collect());
    same("return_number", points.return_number().map(f64::from).collect());
    same("number_of_returns", points.number_of_returns().map(f64::from).collect());
    same("user_data", points.user_data().map(f64::from).collect());
    same("point_source_id", points.point_source_id().map(f64::from).collect());
    assert_eq!(schema.find("red").is_some(), format.has_color);
    if let Some(rgb) = points.rgb() {
        let rgb: Vec<(u16, u16, u16)> = rgb.collect();
        same("red", rgb.iter().map(|c| c.0.into()).collect());
        same("green", rgb.iter().map(|c| c.1.into()).collect());
        same("blue", rgb.iter().map(|c| c.2.into()).collect());
    }
    assert_eq!(schema.find("gps_time").is_some(), format.has_gps_time);
    if let Some(times) = points.gps_time() {
        same("gps_time", times.collect());
    }
    if let Some(nir) = points.nir() {
        same("nir", nir.map(f64::from).collect());
    }
    // What the crate has for whole points only, some of which it refuses.
    let whole: Vec<las::Point> = points.points().map_while(Result::ok).collect();
    if whole.len() as u64 == count {
        let flag = |of: fn(&las::Point) -> bool| whole.iter().map(|p| f64::from(u8::from(of(p)))).collect();
        same("synthetic", flag(|p| p.is_synthetic));
        same("key_point", flag(|p| p.is_key_point));
        same("withheld", flag(|p| p.is_withheld));
        if format.is_extended {
            same("overlap", flag(|p| p.is_overlap));
            same("scanner_channel", whole.iter().map(|p| p.scanner_channel.into()).collect());
        }
        let angle = column(if format.is_extended { "scan_angle" } else { "scan_angle_rank" });
        let worst = (0..angle.len()).map(|i| (angle.get(i) - f64::from(whole[i].scan_angle)).abs());
        assert!(worst.fold(0.0, f64::max) < 1e-4, "{}: scan angles", path.display());
    }
}

#[test]
fn every_point_format_reads_as_the_las_crate_reads_it_plain_and_compressed() {
    let folder = folder();
    for format in 0..=10 {
        for extra in [0, 5] {
            let file = LasFile::random(format, 2500, extra, 40 + u64::from(format));
            let plain = write(folder.path(), "a.las", &file.las());
            let compressed = write(folder.path(), "a.laz", &file.laz(Chunks::Fixed(1000)));
            agrees_with_the_las_crate(&plain);
            agrees_with_the_las_crate(&compressed);
            assert_eq!(read(&plain, None).expect("it reads"), read(&compressed, None).expect("it reads"));
        }
    }
}

#[test]
fn real_files_read_as_the_las_crate_reads_them() {
    let Some(folder) = real_data("lidar") else {
        eprintln!("skipped: no LAS files here");
        return;
    };
    let mut compared = 0;
    for entry in std::fs::read_dir(folder).expect("the folder lists") {
        let path = entry.expect("an entry").path();
        if std::fs::metadata(&path).expect("a file").len() < 4_000_000 {
            agrees_with_the_las_crate(&path);
            compared += 1;
        }
    }
    assert!(compared > 30, "only {compared} files");
}

#[test]
fn chunks_of_every_kind_with_and_without_their_table_decode_alike() {
    let folder = folder();
    for format in [3, 7] {
        let file = LasFile::random(format, 3000, 3, 9);
        let expected = read(&write(folder.path(), "a.las", &file.las()), None).expect("it reads");
        let mut kinds = vec![
            Chunks::Fixed(3000),
            Chunks::Fixed(2999),
            Chunks::Fixed(7000),
            Chunks::Variable(&[1, 700, 13]),
            Chunks::NoTable(700),
            Chunks::Streamed(700),
        ];
        if format == 3 {
            kinds.push(Chunks::One);
        }
        for (i, chunks) in kinds.into_iter().enumerate() {
            let path = write(folder.path(), "a.laz", &file.laz(chunks));
            let found = read(&path, None).unwrap_or_else(|e| panic!("format {format}, kind {i}: {e}"));
            assert!(found == expected, "format {format}, kind {i}");
        }
        let none = LasFile { points: Vec::new(), ..file };
        let path = write(folder.path(), "a.laz", &none.laz(Chunks::Fixed(10)));
        assert!(read(&path, None).expect("an empty file").0.is_empty());
    }
}

#[test]
fn a_selection_of_columns_reads_what_the_whole_holds_and_may_change_within_a_chunk() {
    let folder = folder();
    for format in [1, 10] {
        let file = LasFile::random(format, 1500, 4, 21)
            .with_extra(&[descriptor(5, "tag", "", NONE)], |i| (i as u32).to_le_bytes().to_vec());
        let path = write(folder.path(), "a.laz", &file.laz(Chunks::Fixed(1000)));
        let (position, columns) = read(&path, None).expect("it reads");
        for (i, column) in columns.iter().enumerate() {
            let one = read(&path, Some(&[i])).expect("it reads");
            assert!(one.0 == position && one.1 == [column.clone()], "column {i} alone");
        }
        let mut source = open_las(&path).expect("it opens");
        let mut batch = PointBatch::default();
        let mut at = 0;
        for i in 0..columns.len() {
            source.select(&[i]);
            source.fill(&mut batch, 60).expect("points");
            for (j, p) in batch.position.iter().enumerate() {
                assert_eq!(
                    (*p, batch.columns[0].get(j)),
                    (position[at + j], columns[i].get(at + j)),
                    "column {i}"
                );
            }
            at += 60;
        }
    }
}

const NONE: (Option<[u8; 8]>, Option<f64>, Option<f64>) = (None, None, None);

#[test]
fn extra_bytes_are_columns_of_their_types_scaled_where_the_file_says_so() {
    let missing = Some((-9999_i64).to_le_bytes());
    let descriptors = [
        descriptor(4, "height", "above ground [m]", (missing, Some(0.01), Some(100.0))),
        descriptor(7, "pulse", "", NONE),
        vec![0; 192],
        descriptor(9, "intensity", "", (Some(f64::from(-1.5_f32).to_le_bytes()), None, None)),
        descriptor(13, "normal", "", NONE),
        descriptor(8, "", "", NONE),
        descriptor(10, "beyond the record", "", NONE),
    ];
    let mut descriptors = descriptors.to_vec();
    descriptors[2][3] = 2;
    let extra = |i: usize| -> Vec<u8> {
        let height = if i == 3 { -9999 } else { i as i16 * 10 };
        let float = if i == 4 { -1.5 } else { i as f32 };
        let pulse = u64::MAX - i as u64;
        [
            height.to_le_bytes().to_vec(),
            pulse.to_le_bytes().to_vec(),
            vec![7, 7],
            float.to_le_bytes().to_vec(),
            [(i as u16).to_le_bytes(), 500_u16.to_le_bytes()].concat(),
            (i64::MIN + i as i64).to_le_bytes().to_vec(),
        ]
        .concat()
    };
    let file = LasFile::random(6, 6, 0, 3).with_extra(&descriptors, extra);
    let folder = folder();
    let path = write(folder.path(), "a.las", &file.las());
    let (_, columns) = read(&path, None).expect("it reads");
    let source = open_las(&path).expect("it opens");
    let schema = source.schema();
    let column = |name: &str| {
        let index = schema.find(name).unwrap_or_else(|| panic!("{name} of {:?}", schema.columns));
        (&columns[index], &schema.columns[index])
    };
    let (height, info) = column("height");
    assert_eq!((info.kind, info.unit.as_str()), (ColumnType::F64, "m"));
    assert_eq!((height.get(2), height.get(5)), (20.0 * 0.01 + 100.0, 50.0 * 0.01 + 100.0));
    assert!(height.get(3).is_nan(), "missing data");
    assert_eq!(column("pulse").0, &Values::from((0..6).map(|i| u64::MAX - i).collect::<Vec<_>>()));
    // The name of a column that every format has.
    let (float, info) = column("intensity_2");
    assert_eq!((info.kind, float.get(5)), (ColumnType::F32, 5.0));
    assert!(float.get(4).is_nan());
    assert_eq!((column("normal_0").0.get(4), column("normal_1").0.get(4)), (4.0, 500.0));
    assert_eq!(column("extra_6").0, &Values::from((0..6).map(|i| i64::MIN + i).collect::<Vec<_>>()));
    assert!(schema.find("beyond the record").is_none());
    assert!(column("classification").1.is_class && !column("point_source_id").1.is_class);
    assert_eq!(column("gps_time").1.unit, "s");
}

#[test]
fn the_reference_system_and_the_origin_are_in_the_schema_without_control_characters() {
    let folder = folder();
    let keys: Vec<u8> =
        [1_u16, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 26910].iter().flat_map(|v| v.to_le_bytes()).collect();
    let mut file = LasFile::random(3, 3, 0, 3);
    file.records.push(("LASF_Projection", 34735, keys));
    let open = |file: &LasFile| {
        let path = write(folder.path(), "a.las", &file.las());
        open_las(&path).expect("it opens").schema().clone()
    };
    let schema = open(&file);
    assert_eq!(schema.crs, "EPSG:26910");
    assert_eq!(schema.description, "LAS 1.3, point format 3, test system, rayset tests");
    // WKT in an extended record, behind one that nobody needs; the header says which of both
    // counts.
    let wkt = "PROJCS[\"here\"]";
    (file.minor, file.global_encoding) = (4, 16);
    file.extended =
        vec![("someone", 7, vec![9; 300_000]), ("LASF_Projection", 2112, format!("{wkt}\0\0").into_bytes())];
    assert_eq!(open(&file).crs, wkt);
    file.global_encoding = 0;
    assert_eq!(open(&file).crs, "EPSG:26910");
    file.records.clear();
    assert_eq!(open(&file).crs, wkt);
}

#[test]
fn counts_follow_the_specification_and_claims_beyond_the_file_are_refused_at_once() {
    let folder = folder();
    let mut file = LasFile::random(1, 100, 0, 3);
    file.minor = 4;
    let bytes = file.las();
    let count = |bytes: &[u8]| read(&write(folder.path(), "a.las", bytes), None).map(|r| r.0.len());
    // Both counts; only the 64-bit one; only the legacy one; and both, of which the legacy one goes
    // first.
    for (legacy, wide, expected) in [(100, 100, 100), (0, 100, 100), (100, 0, 100), (50, 100, 50), (0, 0, 0)]
    {
        let mut changed = bytes.clone();
        changed[107..111].copy_from_slice(&u32::to_le_bytes(legacy));
        changed[247..255].copy_from_slice(&u64::to_le_bytes(wide));
        assert_eq!(count(&changed).expect("it reads"), expected, "{legacy} {wide}");
    }
    let mut changed = bytes.clone();
    changed[107..111].copy_from_slice(&101_u32.to_le_bytes());
    let complaint = count(&changed).expect_err("too many").to_string();
    assert!(complaint.contains("101 points of 28 bytes") && complaint.contains("at most 100"), "{complaint}");
    let cut = &bytes[..bytes.len() - 1];
    let complaint = count(cut).expect_err("cut off").to_string();
    assert!(
        complaint.contains(&format!("byte {}", cut.len())) && complaint.contains("at most 99"),
        "{complaint}"
    );
}

#[test]
fn a_truncated_laz_file_says_the_byte_and_how_many_points_were_read() {
    let folder = folder();
    for format in [3, 7] {
        let file = LasFile::random(format, 3000, 0, 9);
        let whole = file.laz(Chunks::NoTable(1000));
        let start = points_start(&whole);
        let cut = &whole[..start + (whole.len() - start) * 2 / 3];
        let complaint = complaint(&write(folder.path(), "a.laz", cut));
        assert!(complaint.contains("byte ") && complaint.contains("cut off"), "{complaint}");
        // Layered chunks are measured when the file is opened, the others are decoded to where they
        // end.
        if format == 3 {
            let words: Vec<&str> = complaint.split([' ', ';']).collect();
            let of = words.windows(3).find(|w| w[1] == "of" && w[2] == "3000").expect("how many of how many");
            assert!((1500..2500).contains(&of[0].parse::<u32>().expect("a number")), "{complaint}");
        }
        let whole = file.laz(Chunks::Fixed(1000));
        let complaint = self::complaint(&write(folder.path(), "a.laz", &whole[..place_of_table(&whole)]));
        assert!(complaint.contains("table of chunks") && complaint.contains("cut off"), "{complaint}");
    }
}

/// The claims of lengths that ended the process, or took gigabytes, where they were believed.
fn hostile_files() -> Vec<(&'static str, Vec<u8>)> {
    let file = LasFile::random(7, 2000, 0, 5);
    let extended = LasFile { extended: vec![("someone", 7, vec![0; 10])], ..file.clone() };
    let laz = file.laz(Chunks::Fixed(500));
    let (start, table) = (points_start(&laz), place_of_table(&laz));
    let put = |bytes: &[u8], at: usize, value: &[u8]| {
        let mut bytes = bytes.to_vec();
        bytes[at..at + value.len()].copy_from_slice(value);
        bytes
    };
    let plain = extended.las();
    let contents = plain.len() - 70;
    vec![
        ("chunks.laz", put(&laz, table + 4, &u32::MAX.to_le_bytes())),
        ("many.laz", put(&laz, table + 4, &4_000_000_000_u32.to_le_bytes())),
        // The size of the first layer of the first chunk, behind a point and the number of points.
        ("layer.laz", put(&laz, start + 8 + 36 + 4, &u32::MAX.to_le_bytes())),
        ("extended.las", put(&plain, contents + 20, &(1_u64 << 40).to_le_bytes())),
        ("extended.laz", put(&extended.laz(Chunks::Fixed(500)), EXTENDED_AT + 8, &u32::MAX.to_le_bytes())),
        ("records.las", put(&plain, 100, &u32::MAX.to_le_bytes())),
        ("count.las", put(&plain, 247, &(1_u64 << 60).to_le_bytes())),
        ("place.laz", put(&laz, start, &i64::MAX.to_le_bytes())),
    ]
}

#[test]
#[cfg(target_os = "linux")]
fn hostile_lengths_are_one_line_errors_within_little_memory() {
    let folder = folder();
    for (name, bytes) in hostile_files() {
        write(folder.path(), name, &bytes);
        // A kilobyte of claims may not take a gigabyte of addresses.
        let script = format!("ulimit -v 1000000; exec \"$0\" build {name} -o out.rset --threads 1");
        let output = Command::new("sh")
            .current_dir(folder.path())
            .args(["-c", &script, env!("CARGO_BIN_EXE_rayset")])
            .output()
            .expect("the program runs");
        let words = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{name}: {words}");
        assert!(
            words.contains(name) && words.contains("byte ") && !words.contains("panicked"),
            "{name}: {words}"
        );
    }
}

#[test]
#[cfg(target_os = "linux")]
fn hundreds_of_megabytes_of_extended_records_and_chunks_of_a_million_points_stay_within_the_budget() {
    let folder = folder();
    let mut file = LasFile::random(0, 1000, 0, 5);
    file.points = file.points.iter().cycle().take(1_200_000).cloned().collect();
    // One chunk of all points, which is decoded as it is read.
    std::fs::write(folder.path().join("a.laz"), file.laz(Chunks::Fixed(1_500_000))).expect("a write");
    let small = LasFile { extended: vec![("someone", 7, Vec::new())], ..LasFile::random(6, 2000, 0, 5) };
    let bytes = small.las();
    let length_at = bytes.len() - 60 + 20;
    let mut bytes = bytes;
    bytes[length_at..length_at + 8].copy_from_slice(&300_000_000_u64.to_le_bytes());
    let path = write(folder.path(), "b.las", &bytes);
    let hole = std::fs::File::options().append(true).open(path).expect("it opens");
    hole.set_len(bytes.len() as u64 + 300_000_000).expect("a hole");
    for name in ["a.laz", "b.las"] {
        let arguments =
            ["build", name, "-o", "c.rset", "--radius", "1", "--memory", "32MiB", "--threads", "2", "--json"];
        let output = Command::new(env!("CARGO_BIN_EXE_rayset"))
            .current_dir(folder.path())
            .args(arguments)
            .output()
            .expect("the program runs");
        assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
        let built: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let peak = built["peak_rss_bytes"].as_f64().expect("a number");
        assert!(peak <= 32.0 * 1_048_576.0, "{name}: {peak} bytes resident");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_chunk_in_layers_that_is_larger_than_the_budget_is_an_error_that_names_the_memory_it_needs() {
    let folder = folder();
    let mut file = LasFile::random(6, 1000, 0, 5);
    file.points = file.points.iter().cycle().take(600_000).cloned().collect();
    std::fs::write(folder.path().join("a.laz"), file.laz(Chunks::Fixed(600_000))).expect("a write");
    let build = |memory: &str| {
        Command::new(env!("CARGO_BIN_EXE_rayset"))
            .current_dir(folder.path())
            .args(["build", "a.laz", "-o", "c.rset", "--radius", "1", "--threads", "1", "--json"])
            .args(["--attributes", "none"])
            .args(["--memory", memory])
            .output()
            .expect("the program runs")
    };
    let output = build("6MiB");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    let bytes = said.split_whitespace().find_map(|word| word.parse::<u64>().ok());
    let bytes = bytes.unwrap_or_else(|| panic!("no number of bytes in: {said}"));
    assert!(bytes > 10 << 20, "{said}");
    let output = build(&bytes.to_string());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let built: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let peak = built["peak_rss_bytes"].as_u64().expect("a number");
    assert!(peak <= bytes, "{peak} bytes resident where {bytes} were allowed");
}

#[test]
fn a_source_says_what_it_holds_of_layered_chunks_and_of_long_points() {
    let folder = folder();
    let needed = |bytes: &[u8]| {
        let path = write(folder.path(), "a.laz", bytes);
        points::open(&path, &ReadOptions::default()).expect("it opens").memory_needed()
    };
    let layered = LasFile::random(6, 60_000, 0, 5);
    let [large, small] = [Chunks::Fixed(60_000), Chunks::Fixed(1000)].map(|chunks| layered.laz(chunks));
    let chunk = (place_of_table(&large) - points_start(&large)) as u64;
    assert!(chunk > 300_000, "a chunk of {chunk} bytes");
    assert!(needed(&large) >= chunk && needed(&large) - needed(&small) > chunk * 9 / 10);
    // Without a table of chunks, the chunks themselves are measured.
    assert_eq!(needed(&layered.laz(Chunks::NoTable(60_000))), needed(&large));
    let sequential = LasFile::random(0, 60_000, 0, 5);
    let [large, small] = [Chunks::Fixed(60_000), Chunks::Fixed(1000)].map(|chunks| sequential.laz(chunks));
    assert_eq!(needed(&large), needed(&small));
    // A model for each extra byte, and for four channels where points are layered.
    let long = |format| needed(&LasFile::random(format, 3, 10_000, 5).laz(Chunks::Fixed(10)));
    assert!(long(0) > 20 << 20 && long(6) > 80 << 20, "{} {}", long(0), long(6));
}

#[test]
fn damaged_points_are_errors_and_panics_of_the_decompressor_print_nothing() {
    let folder = folder();
    let mut random = Random(12);
    let mut panics = Vec::new();
    for format in [3, 7] {
        let good = LasFile::random(format, 600, 2, 8).laz(Chunks::Fixed(200));
        let (start, table) = (points_start(&good) + 8, place_of_table(&good));
        for i in 0..150 {
            let mut bytes = good.clone();
            for _ in 0..4 {
                let at = start + (random.unit() * (table - start) as f64) as usize;
                bytes[at] = (random.unit() * 256.0) as u8;
            }
            let name = format!("{format}-{i}.laz");
            let path = write(folder.path(), &name, &bytes);
            match read(&path, None) {
                Ok((position, _)) => assert_eq!(position.len(), 600),
                Err(e) => {
                    let words = e.to_string();
                    assert!(words.contains("byte ") && words.contains("of 600 points"), "{words}");
                    if words.contains("begins here are damaged") {
                        panics.push(name);
                    }
                }
            }
        }
    }
    assert!(!panics.is_empty(), "none of the files made the decompressor panic");
    for name in panics.iter().take(5) {
        let output = Command::new(env!("CARGO_BIN_EXE_rayset"))
            .current_dir(folder.path())
            .args(["build", name, "-o", "out.rset"])
            .output()
            .expect("the program runs");
        let words = String::from_utf8_lossy(&output.stderr);
        assert!(!words.contains("panicked") && !words.contains("index out of"), "{name}: {words}");
    }
}

#[test]
fn mutated_headers_records_and_tables_are_values_or_errors_with_a_place() {
    let folder = folder();
    let mut random = Random(99);
    let mut below = move |n: usize| (random.unit() * n as f64) as usize;
    let records = vec![("LASF_Projection", 2112, b"PROJCS[]".to_vec())];
    let extended = vec![("someone", 7, vec![1; 40]), ("LASF_Projection", 2112, vec![65; 20])];
    let mut files = Vec::new();
    for format in [1, 3, 7] {
        let file = LasFile { records: records.clone(), ..LasFile::random(format, 400, 0, 77) };
        let file = file.with_extra(&[descriptor(3, "a", "", NONE)], |i| (i as u16).to_le_bytes().to_vec());
        let file = LasFile { minor: 4, extended: extended.clone(), ..file };
        files.extend([file.las(), file.laz(Chunks::Fixed(90)), file.laz(Chunks::Variable(&[50, 77]))]);
    }
    for round in 0..200 {
        for (number, good) in files.iter().enumerate() {
            let mut bytes = good.clone();
            let places =
                [0..points_start(good) + 60, points_start(good)..good.len(), good.len() - 250..good.len()];
            let place = places[round % 3].clone();
            for _ in 0..1 + below(3) {
                let at = place.start + below(place.len() - 8);
                match below(4) {
                    0 => bytes[at] ^= 1 << below(8),
                    1 => bytes[at] = below(256) as u8,
                    2 => bytes[at..at + 4].fill(255),
                    _ => bytes[at..at + 8].fill([0, 127, 255][below(3)]),
                }
            }
            if below(4) == 0 {
                bytes.truncate(below(good.len()));
            }
            let path = write(folder.path(), "a.laz", &bytes);
            if let Err(e) = read(&path, None) {
                let words = e.to_string();
                assert!(words.contains("a.laz, byte "), "file {number}, round {round}: {words}");
            }
        }
    }
}
