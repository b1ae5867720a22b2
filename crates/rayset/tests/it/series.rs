//! Series of volumes in one file, and volumes of which a reader makes more than the file says.

use rayset::volumes;

use crate::common::folder;
use crate::other_tables::archive;
use crate::volume_fixtures::numbers;
use crate::volumes::gzipped;
use crate::vti_text::zipped;

/// The voxels of a volume of a file, and what is said of it.
fn volume(name: &str, bytes: &[u8], index: Option<u64>) -> Result<(Vec<f32>, String), String> {
    let folder = folder();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("a write");
    let mut source = volumes::open(&path, index).map_err(|error| error.to_string())?;
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

/// A MetaImage of four dimensions, whose matrix swaps the first two axes of space.
fn meta(file: &str, more: &str) -> Vec<u8> {
    format!(
        "ObjectType = Image\nNDims = 4\nDimSize = 4 3 2 3\nElementType = MET_SHORT\nElementSpacing = 2 3 4 0.5\n\
         Offset = 7 8 9 0\nTransformMatrix = 0 1 0 0 1 0 0 0 0 0 1 0 0 0 0 1\n{more}ElementDataFile = {file}\n"
    )
    .into_bytes()
}

/// An array of 16-bit numbers.
fn npy(shape: &str, fortran: &str, body: &[u8]) -> Vec<u8> {
    let text = format!("{{'descr': '<i2', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
    let length = (text.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\0", &length[..], text.as_bytes(), body].concat()
}

#[test]
fn any_volume_of_a_metaimage_of_four_dimensions_is_read_and_which_one_is_said() {
    let folder = folder();
    let body = voxels(false);
    let packed = zipped(&body);
    std::fs::write(folder.path().join("voxels.raw"), &body).expect("a write");
    for (name, bytes) in [
        ("a.mha", [meta("LOCAL", ""), body.clone()].concat()),
        ("b.mha", [meta("LOCAL", "CompressedData = True\n"), packed].concat()),
        ("c.mha", [meta("LOCAL", "HeaderSize = -1\n"), body].concat()),
        ("d.mhd", meta("voxels.raw", "")),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("a write");
        for index in [None, Some(0), Some(1), Some(2)] {
            let mut source = volumes::open(&path, index).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(numbers(&mut source).expect("voxels"), expected(index.unwrap_or(0)), "{name}");
            let about = source.about.join("\n");
            assert!(about.contains(&format!("volume {} of a series of 3", index.unwrap_or(0))), "{about}");
            let place = source.space_from_voxel.transform_point3([1.0, 1.0, 1.0].into());
            assert_eq!(place.to_array(), [7.0 + 3.0, 8.0 + 2.0, 9.0 + 4.0], "{name}");
        }
        let said = volumes::open(&path, Some(3)).err().expect("there are three").to_string();
        assert!(said.contains("--volume-index 3: the file has 3 volumes"), "{said}");
    }
    // One dimension less or more than the header says.
    for (from, to) in [("Offset = 7 8 9 0", "Offset = 7 8 9"), ("DimSize = 4 3 2 3", "DimSize = 4 3 2 3 1")] {
        let head = String::from_utf8(meta("LOCAL", "")).expect("text").replace(from, to);
        let said = volume("e.mha", &[head.as_bytes(), &voxels(false)].concat(), None);
        assert!(said.clone().is_err_and(|what| what.contains("each of NDims dimensions")), "{said:?}");
    }
    let head = String::from_utf8(meta("LOCAL", "")).expect("text").replace("2 3\nE", "2 99999999999\nE");
    assert!(volume("f.mha", head.as_bytes(), None).is_err());
}

#[test]
fn any_volume_of_an_array_of_more_than_three_axes_is_read_and_which_one_is_said() {
    // Two groups of three volumes of 2 × 3 × 5 voxels; the value of each is its place in the order
    // of the axes.
    let shape = [2_usize, 3, 2, 3, 5];
    let in_order: Vec<i16> = (0..180).collect();
    let mut fortran = vec![0_i16; 180];
    for &value in &in_order {
        let (mut left, mut index) = (value as usize, [0; 5]);
        for axis in (0..5).rev() {
            (index[axis], left) = (left % shape[axis], left / shape[axis]);
        }
        let place = (0..5).rev().fold(0, |place, axis| place * shape[axis] + index[axis]);
        fortran[place] = value;
    }
    let bytes = |values: &[i16]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    for index in 0..6 {
        // Voxels of Fortran's order are read with the first axis fastest.
        let voxel = |i: usize| index as usize * 30 + i;
        let c_order: Vec<f32> = (0..30).map(|i| voxel(i) as f32).collect();
        let f_order: Vec<f32> = (0..30).map(|i| voxel(i % 2 * 15 + i / 2 % 3 * 5 + i / 6) as f32).collect();
        for (order, values, expected) in [("False", &in_order, c_order), ("True", &fortran, f_order)] {
            let array = npy("(2, 3, 2, 3, 5)", order, &bytes(values));
            let archive = archive(&[("four", array.clone())]);
            for (name, file) in [("a.npy", &array), ("a.npz", &archive)] {
                let (found, about) =
                    volume(name, file, Some(index)).unwrap_or_else(|e| panic!("{name}: {e}"));
                assert_eq!(found, expected, "{name}, {index} of order {order}");
                assert!(about.contains(&format!("volume {index} of a series of 6")), "{about}");
                let said = volume(name, file, Some(6)).expect_err("there are six");
                assert!(said.contains("--volume-index 6: the file has 6 volumes"), "{said}");
            }
        }
    }
    // One volume has nothing to choose; of an archive the array of three axes is read.
    let one = npy("(1, 2, 3, 5)", "False", &bytes(&in_order[..30]));
    assert_eq!(volume("a.npy", &one, None).expect("it reads").1, "");
    let many = npy("(6, 2, 3, 5)", "False", &bytes(&in_order));
    let both = archive(&[("series", many.clone()), ("one", one)]);
    assert_eq!(volume("a.npz", &both, None).expect("it reads").0.len(), 30);
    assert!(volume("a.npz", &both, Some(1)).is_err());
    // Films in colours, and points beside arrays of more axes, are no volumes.
    let film = npy("(2, 10, 3, 3)", "False", &bytes(&in_order));
    let points = npy("(60, 3)", "False", &bytes(&in_order));
    let beside = archive(&[("xyz", points), ("series", many)]);
    for (name, bytes) in [("film.npy", film), ("points.npz", beside)] {
        let folder = folder();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("a write");
        assert!(!volumes::is_volume(&path).expect("it reads"), "{name}");
    }
}

/// A rectilinear grid of 3 × 2 × 4 points as one of VTK's legacy files, or in XML, with coordinates
/// of z as given.
fn rectilinear(kind: &str, z: [f32; 4]) -> Vec<u8> {
    let coordinates: [&[f32]; 3] = [&[1.0, 1.5, 2.0], &[3.0, 2.0], &z];
    let values: Vec<f32> = (0..24).map(|i| i as f32 * 0.5).collect();
    let text = |values: &[f32]| values.iter().map(f32::to_string).collect::<Vec<_>>().join("\n") + "\n";
    let body = |values: &[f32]| match kind {
        "BINARY" => [values.iter().flat_map(|v| v.to_be_bytes()).collect(), b"\n".to_vec()].concat(),
        _ => text(values).into_bytes(),
    };
    if kind == "vtr" {
        let array = |values: &[f32]| {
            format!("<DataArray type=\"Float32\" format=\"ascii\">{}</DataArray>\n", text(values))
        };
        return format!(
            "<VTKFile type=\"RectilinearGrid\" byte_order=\"BigEndian\">\n<RectilinearGrid WholeExtent=\"2 4 0 1 0 3\">\n\
             <Piece Extent=\"2 4 0 1 0 3\">\n<PointData>{}</PointData>\n<Coordinates>{}</Coordinates>\n</Piece>\n\
             </RectilinearGrid>\n</VTKFile>\n",
            array(&values),
            coordinates.map(array).concat()
        )
        .into_bytes();
    }
    let mut file =
        format!("# vtk DataFile Version 3.0\nx\n{kind}\nDATASET RECTILINEAR_GRID\nDIMENSIONS 3 2 4\n")
            .into_bytes();
    for (name, values) in ["X", "Y", "Z"].iter().zip(coordinates) {
        file.extend(format!("{name}_COORDINATES {} float\n", values.len()).into_bytes());
        file.extend(body(values));
    }
    file.extend(b"POINT_DATA 24\nSCALARS s float 1\nLOOKUP_TABLE default\n");
    [file, body(&values)].concat()
}

#[test]
fn rectilinear_grids_are_read_if_they_are_evenly_spaced_and_otherwise_the_axis_is_named() {
    let folder = folder();
    for (kind, name) in [("ASCII", "a.vtk"), ("BINARY", "b.vtk"), ("vtr", "c.vtr")] {
        let path = folder.path().join(name);
        // Steps of a tenth, rounded, far from the origin.
        let even = [100.0, 100.1, 100.2, 100.3];
        std::fs::write(&path, rectilinear(kind, even)).expect("a write");
        assert!(volumes::is_volume(&path).expect("it reads"));
        let mut source = volumes::open(&path, None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(source.size, [3, 2, 4], "{name}");
        let last = source.space_from_voxel.transform_point3([2.0, 1.0, 3.0].into());
        let there = [2.0, 2.0, f64::from(100.3_f32)];
        assert!(last.to_array().iter().zip(there).all(|(a, b)| (a - b).abs() < 1e-9), "{name}: {last}");
        let first = source.space_from_voxel.translation.to_array();
        assert_eq!(first, [1.0, 3.0, 100.0], "{name}");
        assert_eq!(numbers(&mut source).expect("it reads")[5], 2.5, "{name}");
        std::fs::write(&path, rectilinear(kind, [0.0, 1.0, 4.0, 9.0])).expect("a write");
        let said = volumes::open(&path, None).err().expect("it is refused").to_string();
        for part in [
            "evenly spaced along z",
            "point 1, counted from 0, is at 1,",
            "put it at 3;",
            "Resample To Image",
        ] {
            assert!(said.contains(part), "{name}: {said}");
        }
        std::fs::write(&path, rectilinear(kind, [0.0, f32::NAN, 4.0, 9.0])).expect("a write");
        assert!(volumes::open(&path, None).is_err(), "{name}");
        let whole = rectilinear(kind, even);
        for length in (0..whole.len()).step_by(7) {
            std::fs::write(&path, &whole[..length]).expect("a write");
            let read =
                volumes::open(&path, None).map_err(|e| e.to_string()).and_then(|mut s| numbers(&mut s));
            assert!(read.is_err() || length + 3 > whole.len(), "{name}: cut off at {length}");
        }
    }
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
        let mut source = volumes::open(&path, None).expect("it opens");
        assert_eq!(source.size, [2, 2, 2]);
        assert_eq!(source.space_from_voxel.translation.to_array(), [2.0, 3.0, 4.0]);
        assert_eq!(numbers(&mut source).expect("it reads"), values);
    }
}
