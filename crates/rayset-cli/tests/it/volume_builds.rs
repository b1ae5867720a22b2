//! Builds of volumes by the program.

use std::process::Command;

use crate::common::folder;
use crate::vti_text::{blocks, vti};

const ZLIB: &str = " compressor=\"vtkZLibDataCompressor\"";

#[test]
fn a_compressed_block_larger_than_the_budget_is_built_within_it() {
    let folder = folder();
    let side = 400;
    let bytes = vec![7_u8; side * side * side];
    let text = vti("format=\"appended\" offset=\"0\"/>", ZLIB, "raw")
        .replace("0 4 0 3 0 2", &format!("0 {0} 0 {0} 0 {0}", side - 1))
        .replace("Int16", "UInt8");
    let path = folder.path().join("large.vti");
    std::fs::write(&path, [text.as_bytes(), &blocks(&bytes, bytes.len(), 4)].concat()).expect("a write");
    let output = Command::new(env!("CARGO_BIN_EXE_rayset"))
        .args(["build", "--json", "--memory", "32MiB"])
        .arg(&path)
        .arg("-o")
        .arg(folder.path().join("large.rset"))
        .output()
        .expect("the program runs");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let peak = said.split("\"peak_rss_bytes\":").nth(1).expect("the peak is said");
    let peak: u64 = peak
        .trim()
        .split(|c: char| !c.is_ascii_digit())
        .next()
        .and_then(|n| n.parse().ok())
        .expect("a number");
    assert!(peak <= 32 << 20, "{peak} bytes");
}
