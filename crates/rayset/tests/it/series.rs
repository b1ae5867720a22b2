//! Series of volumes in one file, and volumes of which a reader makes more than the file says.

use rayset::grid::read::VolumeSource;

use crate::common::folder;
use crate::volume_fixtures::numbers;
use crate::volumes::gzipped;

/// The voxels of a volume of a file, and what is said of it.
fn volume(name: &str, bytes: &[u8], index: Option<u64>) -> Result<(Vec<f32>, String), String> {
    let folder = folder();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("a write");
    let mut source = VolumeSource::open_of_series(&path, index).map_err(|error| error.to_string())?;
    let voxels = numbers(&mut source)?;
    Ok((voxels, source.about.join("\n")))
}

/// Voxel `number` of a volume of a series.
fn voxel(volume: u64, number: u64) -> i16 {
    (100 * volume + number) as i16
}

fn expected(volume: u64) -> Vec<f32> {
    (0..24).map(|number| f32::from(voxel(volume, number))).collect()
}

/// Three volumes of 4 × 3 × 2 voxels, one after another, or voxel by voxel.
fn voxels(is_interleaved: bool) -> Vec<u8> {
    let all = (0..72_u64).map(|i| if is_interleaved { voxel(i % 3, i / 3) } else { voxel(i / 24, i % 24) });
    all.flat_map(i16::to_le_bytes).collect()
}

fn nifti() -> Vec<u8> {
    let mut head = vec![0_u8; 352];
    head[0..4].copy_from_slice(&348_i32.to_le_bytes());
    for (i, n) in [4_i16, 4, 3, 2, 3, 1].into_iter().enumerate() {
        head[40 + 2 * i..42 + 2 * i].copy_from_slice(&n.to_le_bytes());
    }
    head[70..72].copy_from_slice(&4_i16.to_le_bytes());
    head[108..112].copy_from_slice(&352_f32.to_le_bytes());
    head[344..348].copy_from_slice(b"n+1\0");
    head
}

fn nrrd(sizes: &str, more: &str, encoding: &str) -> Vec<u8> {
    let head = "NRRD0004\ntype: short\ndimension: 4\nendian: little\n";
    format!("{head}sizes: {sizes}\n{more}encoding: {encoding}\n\n").into_bytes()
}

#[test]
fn any_volume_of_a_series_is_read_and_which_one_is_said() {
    let (last, first) = ("4 3 2 3", "3 4 3 2");
    let of_list = "kinds: list domain domain domain\n";
    let none_first = "space directions: none (1,0,0) (0,1,0) (0,0,1)\n";
    let none_last = "space directions: (1,0,0) (0,1,0) (0,0,1) none\nspacings: 1 1 1 nan\n";
    let files = [
        ("a.nii", nifti(), false, false),
        ("a.nii.gz", nifti(), false, true),
        ("a.nrrd", nrrd(last, "", "raw"), false, false),
        ("a.nrrd", nrrd(last, none_last, "gzip"), false, true),
        ("a.nrrd", nrrd(first, of_list, "raw"), true, false),
        ("a.nrrd", nrrd(first, none_first, "gzip"), true, true),
    ];
    for (name, head, is_interleaved, is_packed) in files {
        let body = voxels(is_interleaved);
        let bytes = match (name, is_packed) {
            (_, false) => [head.clone(), body].concat(),
            ("a.nii.gz", true) => gzipped(&[head.clone(), body].concat()),
            _ => [head.clone(), gzipped(&body)].concat(),
        };
        let header = String::from_utf8_lossy(&head);
        for index in 0..3 {
            let (found, about) =
                volume(name, &bytes, Some(index)).unwrap_or_else(|e| panic!("{header}: {e}"));
            assert_eq!(found, expected(index), "{header}");
            assert!(about.contains(&format!("volume {index} of a series of 3")), "{about}");
        }
        let (found, about) = volume(name, &bytes, None).expect("the first");
        assert_eq!(found, expected(0));
        assert!(about.contains("--volume-index names another, from 0 to 2"), "{about}");
        let said = volume(name, &bytes, Some(3)).expect_err("there are three");
        assert!(said.contains("--volume-index 3: the file has 3 volumes"), "{said}");
    }
    let said = volume("a.nrrd", &nrrd("4 3 3 2", "kinds: domain domain list domain\n", "raw"), None);
    assert!(said.expect_err("between").contains("only the first or the last is read"));
    let said = volume("a.nrrd", &nrrd("99999999 4 3 2", "kinds: list domain domain domain\n", "raw"), None);
    assert!(said.is_err());
}

#[test]
fn slices_of_slc_that_all_end_one_voxel_early_are_read() {
    let head = b"11111 3 2 2 8 1 1 1 0 0 0 1 0 0 X";
    // Six voxels in a slice, or five.
    let slice = |codes: &[u8]| [format!("{}X", codes.len()).as_bytes(), codes].concat();
    let full = slice(&[3, 7, 0x83, 1, 2, 9, 0]);
    let short = slice(&[3, 7, 0x82, 1, 9, 0]);
    let file = |slices: [&[u8]; 2]| [&head[..], slices[0], slices[1]].concat();
    let (found, about) = volume("a.slc", &file([&full, &full]), None).expect("whole slices");
    assert_eq!((found, about.as_str()), ([7.0, 7.0, 7.0, 1.0, 2.0, 9.0].repeat(2), ""));
    let (found, about) = volume("a.slc", &file([&short, &short]), None).expect("short slices");
    assert_eq!(found, [7.0, 7.0, 7.0, 1.0, 9.0, 9.0].repeat(2));
    assert!(about.contains("every slice ends one voxel early"), "{about}");
    let said = volume("a.slc", &file([&full, &short]), None).expect_err("one slice");
    assert!(said.contains("a slice ends 1 voxels early"), "{said}");
}

#[test]
fn cells_of_vtk_have_their_values_at_their_centres_whatever_ends_the_file() {
    let head = |kind: &str| {
        format!(
            "# vtk DataFile Version 3.0\nx\n{kind}\nDATASET STRUCTURED_POINTS\nDIMENSIONS 3 3 3\nORIGIN 1 2 3\nSPACING 2 2 2\n\
             CELL_DATA 8\nSCALARS s float 1\nLOOKUP_TABLE default\n"
        )
    };
    let values: Vec<f32> = (0..8).map(|i| i as f32 * 1.5).collect();
    let text = values.iter().map(f32::to_string).collect::<Vec<_>>().join(" ");
    let binary = values.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<u8>>();
    for bytes in [
        [head("ASCII").as_bytes(), text.as_bytes()].concat(),
        [head("ASCII").as_bytes(), text.as_bytes(), b"\n"].concat(),
        [head("BINARY").as_bytes(), &binary].concat(),
        [head("BINARY").as_bytes(), &binary, b"\nMETADATA\nINFORMATION 0\n\n"].concat(),
    ] {
        let folder = folder();
        let path = folder.path().join("a.vtk");
        std::fs::write(&path, bytes).expect("a write");
        let mut source = VolumeSource::open(&path).expect("it opens");
        assert_eq!(source.size, [2, 2, 2]);
        assert_eq!(source.space_from_voxel.translation.to_array(), [2.0, 3.0, 4.0]);
        assert_eq!(numbers(&mut source).expect("it reads"), values);
    }
}
