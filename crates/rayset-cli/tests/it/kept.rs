//! The cache: what is used again is what would be built anew, what is not the cache's own is safe
//! from it, and where nothing can be kept everything else goes on.

#![cfg(unix)]

use std::fs::{self, File};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use crate::common::{folder, succeeds};

/// Renders `input` small, with the cache in `kept`.
fn render(folder: &Path, input: &str, more: &[&str]) -> String {
    let plain = ["render", input, "-o", "a.png", "--size", "24x24", "--cache", "kept"];
    succeeds(folder, &[&plain[..], more].concat())
}

fn picture(folder: &Path) -> Vec<u8> {
    fs::read(folder.join("a.png")).expect("a picture")
}

/// A volume in two files, bright where `inside` says so.
fn write_volume(folder: &Path, inside: impl Fn(usize) -> bool) {
    let header = "ObjectType = Image\nNDims = 3\nDimSize = 16 16 16\nElementType = MET_UCHAR\nElementDataFile = v.raw\n";
    fs::write(folder.join("v.mhd"), header).expect("a write");
    fs::write(folder.join("v.raw"), voxels(inside)).expect("a write");
}

fn voxels(inside: impl Fn(usize) -> bool) -> Vec<u8> {
    (0..16 * 16 * 16).map(|i| if inside(i) { 200 } else { (i % 7) as u8 }).collect()
}

/// Points on a slope, `steep` or not, in as many bytes.
fn write_points(path: &Path, steep: u32) {
    let text: String =
        (0..1600).map(|i| format!("{} {} {}\n", i % 40, i / 40, 100 + i % 40 * steep)).collect();
    fs::write(path, text).expect("a write");
}

/// The folders of entries, in no order.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let found = fs::read_dir(folder.join("kept")).expect("the cache").map(|e| e.expect("an entry").path());
    found.filter(|path| path.join("built-from.json").exists()).collect()
}

/// The built file of an entry.
fn data_of(entry: &Path) -> PathBuf {
    let mut files = fs::read_dir(entry).expect("an entry").map(|e| e.expect("a file").path());
    files.find(|path| path.extension().is_some_and(|e| e == "rset")).expect("what was built")
}

#[test]
fn a_file_that_is_replaced_by_one_of_its_size_and_time_is_built_anew() {
    let folder = folder();
    let f = folder.path();
    // Long before 1970 all times were one.
    let times =
        [UNIX_EPOCH + Duration::from_secs(1_000_000_000), UNIX_EPOCH - Duration::from_secs(1_000_000)];
    for time in times {
        let set = |path: &Path| {
            File::options().write(true).open(path).expect("it opens").set_modified(time).expect("a time");
        };
        write_points(&f.join("a.xyz"), 1);
        set(&f.join("a.xyz"));
        render(f, "a.xyz", &[]);
        let first = picture(f);
        assert!(render(f, "a.xyz", &[]).contains("built before"));
        assert!(picture(f) == first);
        write_points(&f.join("b.xyz"), 2);
        set(&f.join("b.xyz"));
        let bytes = |name: &str| fs::metadata(f.join(name)).expect("a file").len();
        assert_eq!(bytes("a.xyz"), bytes("b.xyz"));
        fs::rename(f.join("b.xyz"), f.join("a.xyz")).expect("a move");
        let said = render(f, "a.xyz", &[]);
        assert!(said.contains("used again until") && picture(f) != first, "{time:?}: {said}");
    }
}

#[test]
fn a_file_that_an_input_pulls_in_is_looked_at_too() {
    let folder = folder();
    let f = folder.path();
    write_volume(f, |i| i % 16 < 8);
    render(f, "v.mhd", &[]);
    let first = picture(f);
    assert!(render(f, "v.mhd", &[]).contains("built before"));
    fs::write(f.join("v.raw"), voxels(|i| i / 256 < 8)).expect("a write");
    let said = render(f, "v.mhd", &[]);
    assert!(said.contains("used again until") && picture(f) != first, "{said}");
}

#[test]
fn pruning_removes_nothing_but_entries_and_none_that_is_read() {
    let folder = folder();
    let f = folder.path();
    fs::create_dir(f.join("kept")).expect("a folder");
    // Names as entries have them, and had them.
    let theirs = "kept/scan-0123456789abcdef.rset";
    fs::write(f.join(theirs), [7; 5000]).expect("a write");
    let folder_of_theirs = "kept/scan-0123456789abcdef-0123456789abcdef";
    fs::create_dir(f.join(folder_of_theirs)).expect("a folder");
    fs::write(f.join(folder_of_theirs).join("scan.rset"), [7; 5000]).expect("a write");
    write_points(&f.join("a.xyz"), 1);
    write_points(&f.join("b.xyz"), 2);
    write_points(&f.join("c.xyz"), 3);
    render(f, "a.xyz", &[]);
    let read = entries(f).pop().expect("an entry");
    let note = File::open(read.join("built-from.json")).expect("it opens");
    note.try_lock_shared().expect("as whoever reads it holds it");
    render(f, "b.xyz", &[]);
    let said = render(f, "c.xyz", &["--cache-limit", "1KiB"]);
    assert!(said.contains("removed 1 older"), "{said}");
    assert!(data_of(&read).exists(), "an entry that is read was removed");
    assert!(f.join(theirs).exists() && f.join(folder_of_theirs).join("scan.rset").exists());
    drop(note);
    let said = render(f, "b.xyz", &["--cache-limit", "1KiB"]);
    assert!(said.contains("removed 2 older") && !read.exists(), "{said}");
}

#[test]
fn what_a_killed_build_has_left_in_the_cache_goes_with_the_next() {
    let folder = folder();
    let f = folder.path();
    let left = f.join("kept/a-0123456789abcdef-0123456789abcdef");
    fs::create_dir_all(&left).expect("folders");
    let note = r#"{"rayset-cache": 1, "files": [], "remarks": [], "is_complete": false}"#;
    fs::write(left.join("built-from.json"), note).expect("a write");
    fs::write(left.join(".a.rset.rayset-partial-1-0"), [0; 100]).expect("a write");
    write_points(&f.join("a.xyz"), 1);
    render(f, "a.xyz", &[]);
    assert!(!left.exists());
}

#[test]
fn a_damaged_entry_is_made_again_and_said_to_be() {
    let folder = folder();
    let f = folder.path();
    write_points(&f.join("a.xyz"), 1);
    render(f, "a.xyz", &[]);
    let first = picture(f);
    let path = data_of(&entries(f).pop().expect("an entry"));
    let mut bytes = fs::read(&path).expect("it reads");
    bytes[40] ^= 1;
    fs::write(&path, &bytes).expect("a write");
    let said = render(f, "a.xyz", &[]);
    assert!(said.contains("is damaged and made again") && said.contains("used again until"), "{said}");
    assert!(picture(f) == first && entries(f).len() == 1 && !path.exists());
}

#[test]
fn where_nothing_can_be_kept_the_picture_is_made_and_it_is_said() {
    let folder = folder();
    let f = folder.path();
    write_points(&f.join("a.xyz"), 1);
    succeeds(f, &["render", "a.xyz", "-o", "a.png", "--size", "24x24", "--no-cache"]);
    let first = picture(f);
    // In the place of the folder is a file, as a folder is that cannot be written to.
    fs::write(f.join("kept"), "a file").expect("a write");
    let said = render(f, "a.xyz", &[]);
    assert!(said.contains("nothing is kept: ") && said.contains("--cache names another folder"), "{said}");
    assert!(picture(f) == first);
}

#[test]
fn on_a_full_disk_the_picture_is_made_nothing_is_kept_and_it_is_said() {
    let may_mount = std::process::Command::new("unshare").args(["-rm", "true"]).output();
    if !may_mount.is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: no disk can be mounted here, as `unshare -rm` would");
        return;
    }
    let folder = folder();
    let f = folder.path();
    write_points(&f.join("a.xyz"), 1);
    succeeds(f, &["render", "a.xyz", "-o", "a.png", "--size", "24x24", "--no-cache"]);
    let first = picture(f);
    fs::create_dir(f.join("kept")).expect("a folder");
    let (mut kept, mut not_kept) = (0, 0);
    // It fills up before the first byte, while it is built, and behind its end.
    for pages in [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 1024] {
        let script = format!("mount -t tmpfs -o size={}k tmpfs kept && exec \"$0\" \"$@\"", 4 * pages);
        let mut command = std::process::Command::new("unshare");
        command.args(["-rm", "sh", "-c", &script, env!("CARGO_BIN_EXE_rayset")]);
        command.args(["render", "a.xyz", "-o", "a.png", "--size", "24x24", "--cache", "kept"]);
        let output = command.current_dir(f).output().expect("it runs");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{pages} pages: {said}");
        assert!(picture(f) == first, "{pages} pages");
        let [is_kept, is_not] = ["used again until", "nothing is kept: "].map(|words| said.contains(words));
        assert!(is_kept != is_not, "{pages} pages: {said}");
        assert!(
            is_kept || said.contains("No space left") && said.contains("--cache names another folder"),
            "{said}"
        );
        (kept, not_kept) = (kept + u32::from(is_kept), not_kept + u32::from(is_not));
    }
    assert!(kept > 0 && not_kept > 2, "{kept} of them were kept");
}

#[test]
fn entries_admit_whom_their_inputs_admit_and_folders_their_owner() {
    let folder = folder();
    let f = folder.path();
    let mode = |path: &Path| fs::metadata(path).expect("it is there").permissions().mode() & 0o777;
    write_volume(f, |i| i % 16 < 8);
    fs::set_permissions(f.join("v.raw"), fs::Permissions::from_mode(0o600)).expect("a mode");
    render(f, "v.mhd", &[]);
    let entry = entries(f).pop().expect("an entry");
    assert_eq!(mode(&data_of(&entry)), 0o600, "the voxels are for their owner alone");
    assert_eq!([mode(&entry), mode(&f.join("kept"))], [0o700; 2]);
    assert_eq!(mode(&entry.join("built-from.json")), 0o600);
}

#[test]
fn links_in_the_cache_are_not_followed() {
    let folder = folder();
    let f = folder.path();
    write_points(&f.join("a.xyz"), 1);
    render(f, "a.xyz", &[]);
    let entry = entries(f).pop().expect("an entry");
    // An entry of somebody else's making, behind a link that has the name.
    let elsewhere = f.join("elsewhere");
    fs::rename(&entry, &elsewhere).expect("a move");
    symlink(&elsewhere, &entry).expect("a link");
    let said = render(f, "a.xyz", &["--cache-limit", "1KiB"]);
    assert!(said.contains("used again until"), "{said}");
    assert!(data_of(&elsewhere).exists(), "pruning went through a link");
}
