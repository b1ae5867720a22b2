//! What voxels look like without a scene, by what their values are.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::common::folder;

/// Voxels along each side.
const SIDE: usize = 32;

/// An array of NumPy of single precision.
fn array(path: &Path, value: impl Fn([f32; 3]) -> f32) {
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({SIDE}, {SIDE}, {SIDE}), }}");
    bytes.extend(format!("{header:117}\n").bytes());
    for i in 0..SIDE * SIDE * SIDE {
        let place = [i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE].map(|v| v as f32 - 15.5);
        bytes.extend(value(place).to_le_bytes());
    }
    fs::write(path, bytes).expect("a write");
}

/// What is said, and how much brighter than the corner the pixels of a small picture are, row by
/// row.
fn render(folder: &Path, more: &[&str]) -> (String, Vec<u8>) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rayset"));
    let arguments = ["render", "v.npy", "-o", "v.png", "--size", "48x48", "--no-cache"];
    let output = command.current_dir(folder).args(arguments).args(more).output().expect("the program runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    let file = std::io::BufReader::new(fs::File::open(folder.join("v.png")).expect("the picture"));
    let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("a picture");
    let pixels: Vec<&[u8]> = bytes[..info.buffer_size()].chunks_exact(info.color_type.samples()).collect();
    let apart = |pixel: &[u8]| (0..3).map(|i| pixel[i].abs_diff(pixels[0][i])).max().unwrap_or(0);
    (said, pixels.iter().map(|pixel| apart(pixel)).collect())
}

fn lit(pixels: &[u8]) -> usize {
    pixels.iter().filter(|&&apart| apart > 24).count()
}

#[test]
fn densities_of_any_magnitude_are_seen_over_their_logarithm() {
    let folder = folder();
    let f = folder.path();
    for magnitude in [1.0, 1e6, 1e-20, 1e-34, 1e32] {
        // A cusp, six orders of magnitude above what is around it.
        array(&f.join("v.npy"), |[x, y, z]| {
            let distance = (x * x + y * y + z * z).sqrt() / 16.0;
            magnitude / (0.01 + distance).powi(4)
        });
        let (said, pixels) = render(f, &[]);
        assert!(said.contains("look: volume (the logarithm of values from "), "{magnitude:e}: {said}");
        assert!(lit(&pixels) * 5 > pixels.len(), "{magnitude:e}: {} pixels are lit", lit(&pixels));
        let scaled = said.contains("values are multiplied by 1e");
        assert_eq!(scaled, !(1e-9..1e10).contains(&magnitude), "{said}");
    }
}

#[test]
fn a_volume_that_is_the_same_everywhere_is_a_box() {
    let folder = folder();
    for value in [1.0, 0.0, -7.5] {
        array(&folder.path().join("v.npy"), |_| value);
        let (said, pixels) = render(folder.path(), &[]);
        assert!(said.contains("every voxel is "), "{said}");
        assert!(lit(&pixels) * 3 > pixels.len(), "{} pixels are lit", lit(&pixels));
    }
}

#[test]
fn waves_about_zero_are_no_tomography_and_are_seen_on_both_sides() {
    let folder = folder();
    let f = folder.path();
    // A ball of waves whose size reaches what Hounsfield units reach.
    array(&f.join("v.npy"), |[x, y, z]| {
        let distance = (x * x + y * y + z * z).sqrt();
        2000.0 * (distance * 1.5 + z * 0.3).sin() * (-distance / 8.0).exp()
    });
    let (said, pixels) = render(f, &[]);
    assert!(said.contains("look: volume (values below -") && said.contains(" and above "), "{said}");
    assert!(lit(&pixels) * 10 > pixels.len(), "{} pixels are lit", lit(&pixels));
    // Air, tissue and bone are.
    array(&f.join("v.npy"), |[x, y, z]| match (x * x + y * y + z * z).sqrt() {
        d if d < 5.0 => 1200.0,
        d if d < 11.0 => 40.0,
        _ => -1000.0,
    });
    let (said, _) = render(f, &[]);
    assert!(said.contains("computed tomography in Hounsfield units"), "{said}");
}
