//! The file format and the look of pictures do not change unnoticed.
//!
//! `RAYSET_BLESS=1 cargo test golden` writes the files of this folder anew, for a change that is
//! meant.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use rayset::field::Kernel;
use rayset::octree::Cloud;
use rayset::octree::build::{BuildOptions, Precision};
use rayset::points::ArraySource;
use rayset::scene::{ColorMap, ColorRule, MapInput, OpacityRule, Scene};

use crate::common::{build_at, folder, look, mixed_points, plain_picture, scene, scene_of, settings};

const PAGE: u32 = 16384;

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/golden").join(name)
}

/// The text of a golden file, which is written first where that is asked for.
pub(crate) fn expected(name: &str, found: &str) -> String {
    if std::env::var_os("RAYSET_BLESS").is_some() {
        std::fs::write(golden(name), found).expect("the golden file is written");
    }
    std::fs::read_to_string(golden(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// Lines of an offset and sixteen bytes; those of zeros alone are left out, and the first says how
/// long the file is.
fn hex_from_bytes(bytes: &[u8]) -> String {
    let mut text = format!("{} bytes\n", bytes.len());
    for (row, line) in bytes.chunks(16).enumerate().filter(|(_, line)| line.iter().any(|&b| b != 0)) {
        write!(text, "{:06x} ", row * 16).expect("text grows");
        line.iter().for_each(|b| write!(text, " {b:02x}").expect("text grows"));
        text.push('\n');
    }
    text
}

fn bytes_from_hex(text: &str) -> Vec<u8> {
    let mut lines = text.lines();
    let length = lines.next().and_then(|l| l.strip_suffix(" bytes")).expect("a length");
    let mut bytes = vec![0; length.parse().expect("a length")];
    for line in lines {
        let mut words = line.split_whitespace();
        let at = usize::from_str_radix(words.next().expect("an offset"), 16).expect("an offset");
        for (i, word) in words.enumerate() {
            bytes[at + i] = u8::from_str_radix(word, 16).expect("a byte");
        }
    }
    bytes
}

/// Five points with radii, weights and colours.
fn five_points() -> ArraySource {
    let position =
        vec![[0.0, 0.0, 0.0], [1.0, 0.25, 0.5], [0.75, 1.0, 0.125], [0.5, 0.5, 1.0], [-1.0, 0.0625, -0.5]];
    let column = |name, values: [f32; 5]| (name, values.to_vec());
    ArraySource::new(
        position,
        vec![
            column("radius", [0.5, 0.25, 0.5, 1.0, 0.125]),
            column("weight", [1.0, 2.0, 1.0, 0.5, 1.0]),
            column("red", [1.0, 0.0, 0.0, 1.0, 0.5]),
            column("green", [0.0, 1.0, 0.0, 1.0, 0.5]),
            column("blue", [0.0, 0.0, 1.0, 1.0, 0.5]),
        ],
    )
}

#[test]
fn the_same_points_become_the_same_file_as_ever() {
    let folder = folder();
    let path = folder.path().join("five.rset");
    let options =
        BuildOptions { page_bytes: Some(PAGE), precision: Precision::Exact, ..BuildOptions::default() };
    build_at(&path, Box::new(five_points()), &options);
    let found = hex_from_bytes(&std::fs::read(&path).expect("the file reads"));
    assert_eq!(
        found,
        expected("five_points.hex", &found),
        "the format has changed: is its version to go up?"
    );
}

#[test]
fn a_file_written_long_ago_still_opens_and_says_what_its_description_says() {
    let bytes = bytes_from_hex(&std::fs::read_to_string(golden("five_points.hex")).expect("the golden file"));
    // Straight from the tables of docs/format.md, without the library.
    let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    let u64_at = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"));
    let f32_at = |at: usize| f32::from_bits(u32_at(at));
    let f64_at = |at: usize| f64::from_bits(u64_at(at));
    assert_eq!(&bytes[..8], b"RAYSET\r\n");
    assert_eq!((u32_at(8), u64_at(32), u64_at(48), u32_at(56)), (2, 0, bytes.len() as u64, PAGE));
    let section = |letters: &[u8; 4]| {
        let entries = (0..u32_at(60) as usize).map(|i| 64 + 32 * i);
        let at = entries.clone().find(|&at| &bytes[at..at + 4] == letters).expect("the section");
        (u32_at(at + 4), u64_at(at + 8) as usize)
    };
    assert_eq!((section(b"PNTS"), section(b"NODE")), ((1, 4096), (1, 4096 + PAGE as usize)));
    let (_, numbers) = section(b"CLOU");
    assert_eq!((u64_at(numbers), u64_at(numbers + 16)), (5, 1));
    let corners: Vec<f64> = (0..6).map(|i| f64_at(numbers + 80 + 8 * i)).collect();
    assert_eq!(corners, [-1.0, 0.0, -0.5, 1.0, 1.0, 1.0]);
    let (_, columns) = section(b"COLS");
    assert_eq!(u32_at(columns), 3);
    // Radius, weight and colour have no names, so each takes 24 bytes: role, type, flags, smallest
    // and largest value.
    let column = |i: usize| {
        let at = columns + 8 + 24 * i;
        ([bytes[at], bytes[at + 1], bytes[at + 2]], [f64_at(at + 8), f64_at(at + 16)])
    };
    assert_eq!(column(0), ([0, 8, 1], [0.125, 1.0]));
    assert_eq!(column(1), ([1, 8, 1], [0.5, 2.0]));
    assert_eq!(column(2), ([2, 0, 1], [0.0, 255.0]));
    let (points, nodes) = (4096, 4096 + PAGE as usize);
    assert_eq!((u32_at(points), u32_at(points + 8), u32_at(points + 12)), (0x5054_5330, 0, 1));
    assert_eq!((u32_at(nodes), u32_at(nodes + 8), u32_at(nodes + 12)), (0x4e4f_4445, 1, 1));
    // One run of five points in f64, and the columns behind it.
    let shape = u16::from_le_bytes([bytes[points + 32 + 14], bytes[points + 32 + 15]]);
    assert_eq!((shape & 0x7f, shape >> 7 & 3), (4, 2));
    let data = points + 4 * usize::from(u16::from_le_bytes([bytes[points + 48], bytes[points + 49]]));
    let mut x: Vec<f64> = (0..5).map(|i| f64_at(data + 8 * i)).collect();
    x.sort_by(f64::total_cmp);
    assert_eq!(x, [-1.0, 0.0, 0.5, 0.75, 1.0]);
    let radii = data + 3 * 5 * 8;
    let mut radius: Vec<f32> = (0..5).map(|i| f32_at(radii + 4 * i)).collect();
    radius.sort_by(f32::total_cmp);
    assert_eq!(radius, [0.125, 0.25, 0.5, 0.5, 1.0]);
    assert_eq!((u64_at(nodes + 32 + 24), f64_at(nodes + 32 + 32)), (5, 5.5));

    let folder = folder();
    let path = folder.path().join("old.rset");
    std::fs::write(&path, &bytes).expect("the file is written");
    assert_eq!(Cloud::open(&path).expect("the file opens").header().points, 5);
}

#[test]
fn pictures_look_as_they_always_did() {
    /// Linear values are kept to a part of this; 4 parts are the tolerance of one part in 1024.
    const PARTS: f32 = 4095.0;
    const SIDE: u32 = 24;
    let folder = folder();
    let path = folder.path().join("mixed.rset");
    let cloud = build_at(&path, Box::new(mixed_points(300, 3.0, 5)), &BuildOptions::default());
    let lit = scene(&cloud, Kernel::Wyvill, true);
    let mut mapped = look(&cloud, Kernel::CubicSpline);
    let map = ColorMap::named("viridis".parse().expect("a map"), (0.0, 3.0));
    mapped.transfer.color = ColorRule::Map { map, input: MapInput::Density };
    let mapped = scene_of(mapped, false);
    let mut clamped = look(&cloud, Kernel::Gaussian);
    clamped.transfer.opacity = OpacityRule::Clamp;
    let mut clamped = scene_of(clamped, true);
    clamped.background = Some([0.1, 0.2, 0.4]);
    for (name, scene) in [("lit", lit), ("mapped", mapped), ("clamped", clamped)] {
        let pixels = plain_picture(&scene as &Scene, &settings(SIDE, SIDE));
        let parts = |v: f32| (v * PARTS).round().clamp(0.0, PARTS) as i32;
        let mut found = String::new();
        for row in pixels.chunks(SIDE as usize) {
            let words: Vec<String> =
                row.iter().map(|p| p.map(|v| format!("{:03x}", parts(v))).concat()).collect();
            writeln!(found, "{}", words.join(" ")).expect("text grows");
        }
        let text = expected(&format!("{name}.pixels"), &found);
        for (at, (found, expected)) in found.split_whitespace().zip(text.split_whitespace()).enumerate() {
            for channel in 0..4 {
                let value = |word: &str| {
                    i32::from_str_radix(&word[3 * channel..3 * channel + 3], 16).expect("a number")
                };
                let difference = (value(found) - value(expected)).abs();
                assert!(difference <= 4, "{name}: pixel {at} is {found}, was {expected}");
            }
        }
        assert_eq!(found.split_whitespace().count(), text.split_whitespace().count());
    }
}
