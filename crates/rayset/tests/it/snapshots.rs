//! Snapshots of simulations in HDF5: every column as h5py and numpy see it, radii by each code's
//! convention, several files.

use rayset::points::{self, ColumnType, ReadOptions};

use crate::common::{folder, real_data};
use crate::fixture::{attempt, check_all, damage, fixtures, options, read_all};

#[test]
fn snapshots_of_each_code_are_read_as_h5py_reads_them() {
    check_all("snapshots");
}

#[test]
fn a_snapshot_says_what_it_is_and_how_its_radii_were_made() {
    let describe = |name: &str, particles| {
        let source = points::open(fixtures("snapshots").join(name), &options(particles)).expect("a snapshot");
        source.schema().description.clone()
    };
    let swift = describe("swift.hdf5", None);
    assert!(swift.contains("written by SWIFT") && swift.contains("box size 25"), "{swift}");
    assert!(swift.contains("radius = 2.018932 SmoothingLengths"), "{swift}");
    assert!(swift.contains("Quartic spline (M5); weight = mass / (π/8 radius³)"), "{swift}");
    let arepo = describe("arepo.0.hdf5", None);
    assert!(
        arepo.contains("2 files; 21 particles of type gas, radius = 2.5 (3 mass / 4π Density)^(1/3)"),
        "{arepo}"
    );
    let gadget = describe("gadget.hdf5", Some("dark,gas"));
    assert!(gadget.contains("redshift 0.5") && gadget.contains("h 0.7"), "{gadget}");
    assert!(
        gadget.contains("30 particles of type gas") && gadget.contains("20 particles of type dark"),
        "{gadget}"
    );
}

#[test]
fn numbers_of_half_precision_are_columns_of_single_precision_and_bfloat16_is_none() {
    let source =
        points::open(fixtures("snapshots").join("halves.hdf5"), &ReadOptions::default()).expect("a snapshot");
    let schema = source.schema();
    for name in ["Edges", "Velocities_x"] {
        assert_eq!(schema.columns[schema.find(name).expect(name)].kind, ColumnType::F32, "{name}");
    }
    assert!(schema.find("Brain").is_none(), "{:?}", schema.names().collect::<Vec<_>>());
}

#[test]
fn each_file_of_a_snapshot_reads_all_and_the_missing_one_is_named() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    for name in ["arepo.0.hdf5", "arepo.1.hdf5"] {
        std::fs::copy(fixtures("snapshots").join(name), at(name)).expect("a copy");
    }
    for name in ["arepo.0.hdf5", "arepo.1.hdf5"] {
        let source = points::open(at(name), &ReadOptions::default()).expect("a snapshot");
        assert_eq!(source.count_hint(), Some(21));
        assert_eq!(source.path(), Some(at("arepo.0.hdf5").as_path()), "the first stands for all");
    }
    std::fs::remove_file(at("arepo.0.hdf5")).expect("a removal");
    let said = attempt(&at("arepo.1.hdf5")).expect_err("one is missing");
    assert!(said.contains("arepo.0.hdf5") && said.contains("one of the 2 files"), "{said}");
}

#[test]
fn types_that_are_not_there_are_refused_with_those_that_are() {
    let said = |particles| {
        let read = points::open(fixtures("snapshots").join("gadget.hdf5"), &options(Some(particles)));
        read.err().expect("no such type").to_string()
    };
    assert!(said("bulge").contains("it has gas (30), dark (20), stars (10)"), "{}", said("bulge"));
    assert!(
        said("baryons").contains("`baryons` is no type of particle; expected gas, dark"),
        "{}",
        said("baryons")
    );
}

#[test]
fn an_hdf5_file_that_is_no_snapshot_is_refused_with_its_datasets_and_the_way_out() {
    let said = attempt(&fixtures("snapshots").join("table.h5")).expect_err("no snapshot");
    for part in ["expected a snapshot", "points/xyz (4 × 3)", "time (3)", "numpy.savez"] {
        assert!(said.contains(part), "{said}");
    }
}

#[test]
fn a_snapshot_that_claims_more_than_its_file_can_hold_or_memory_should_is_refused() {
    for (name, part) in [
        ("rows.hdf5", "1000000000 rows are said to follow, more than a file of"),
        (
            "chunks.hdf5",
            "its chunks have 96000000 bytes, and at most 67108864 are read at once; `h5repack -l Coordinates",
        ),
    ] {
        let said = attempt(&fixtures("snapshots").join(name)).expect_err(name);
        assert!(said.contains(part), "{said}");
    }
}

#[test]
fn a_small_snapshot_needs_little_memory() {
    let source =
        points::open(fixtures("snapshots").join("swift.hdf5"), &ReadOptions::default()).expect("a snapshot");
    assert!(source.memory_needed() < 2 << 20, "{}", source.memory_needed());
}

#[test]
fn damaged_snapshots_are_errors_and_never_panics() {
    for (name, step) in [("gadget.hdf5", 151), ("swift.hdf5", 167), ("eagle.hdf5", 53), ("halves.hdf5", 149)]
    {
        let refused = damage(&fixtures("snapshots").join(name), step);
        assert!(refused > 20, "{name}: {refused} of the shortened files were refused");
    }
}

#[test]
fn a_real_snapshot_has_the_numbers_that_h5py_reads() {
    let Some(path) = real_data("particles/lcdm_gas_z0.hdf5") else { return };
    let mut source = points::open(&path, &ReadOptions::default()).expect("a snapshot");
    let all = read_all(&mut *source, 5000).expect("gas");
    assert_eq!(all.len(), 32768);
    let column = |name: &str| &all.columns[source.schema().find(name).expect("a column")];
    assert_eq!(column("mass").get(0), 4.235_076_384_894_417);
    assert_eq!(source.schema().columns[source.schema().find("Density").expect("there")].unit, UNIT);
    let both = points::open(&path, &options(Some("gas,dark"))).expect("two types");
    assert_eq!(both.count_hint(), Some(65536));
    let sum = |name: &str| (0..all.len()).map(|i| column(name).get(i)).sum::<f64>();
    let expected = REAL;
    let found =
        [sum("Density"), sum("InternalEnergy"), sum("radius"), sum("Velocities_z"), sum("ParticleIDs")];
    for (found, expected) in found.iter().zip(expected) {
        assert!((found / expected - 1.0).abs() < 1e-9, "{found}, expected {expected}");
    }
}

const UNIT: &str = "6.769911178294544e-22 cgs a^-3 h^2";
/// Sums in double precision by numpy of Density, InternalEnergy, SmoothingLength, the third of
/// Velocities, ParticleIDs.
const REAL: [f64; 5] = [
    0.002_218_885_669_306_461_3,
    534_171_608.832_321_17,
    81_599_790.426_422_12,
    -26_582.016_959_489_09,
    536_887_296.0,
];
