//! Promise 4: no wrong pixel from a bad byte.

use std::fs::OpenOptions;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::Arc;

use rayset::container::{
    BLOCK_BYTES, FileHeader, FileKind, PAGE_HEAD_BYTES, PageHead, PageKind, SectionKind, reseal,
};
use rayset::field::Kernel;
use rayset::geometry::DVec3;
use rayset::octree::Cloud;
use rayset::octree::build::BuildOptions;
use rayset::octree::layout::{NODE_BYTES, NodeRef};
use rayset::octree::node::{Node, NodePage, RunRange};
use rayset::octree::verify::Depth;
use rayset::points::ArraySource;
use rayset::trace::ExecSettings;

use crate::common::{build_at, camera, folder, mixed_points, paged, picture, scene, settings};

/// What opening and checking a file comes to, as a message.
fn check(path: &Path) -> Result<(), String> {
    let cloud = Cloud::open(path).map_err(|e| e.to_string())?;
    cloud.verify(Depth::Pages).map(|_| ()).map_err(|e| e.to_string())
}

fn small_cloud(path: &Path) {
    let options = BuildOptions { page_bytes: Some(16 << 10), ..BuildOptions::default() };
    build_at(path, Box::new(mixed_points(90, 2.0, 21)), &options);
}

#[test]
fn every_flipped_byte_is_an_error_that_names_the_file_and_a_place() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    small_cloud(&path);
    assert_eq!(check(&path), Ok(()));
    let mut file = OpenOptions::new().read(true).write(true).open(&path).expect("the file opens");
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).expect("the file reads");
    for at in 0..bytes.len() {
        let mut write = |byte: u8| {
            file.seek(SeekFrom::Start(at as u64)).expect("a seek");
            file.write_all(&[byte]).expect("a write");
        };
        write(bytes[at] ^ (1 << (at % 8)));
        let message = check(&path).expect_err("a flipped byte is noticed");
        assert!(message.contains("c.rset") && message.contains("byte"), "byte {at}: {message}");
        write(bytes[at]);
    }
    assert_eq!(check(&path), Ok(()));
}

#[test]
fn missing_and_extra_bytes_are_errors() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    small_cloud(&path);
    let bytes = std::fs::read(&path).expect("the file reads");
    let lengths = (0..bytes.len()).step_by(509).chain([bytes.len() - 1]);
    for length in lengths {
        std::fs::write(&path, &bytes[..length]).expect("a write");
        assert!(Cloud::open(&path).is_err(), "{length} of {} bytes open", bytes.len());
    }
    std::fs::write(&path, [&bytes[..], &[0]].concat()).expect("a write");
    let message = Cloud::open(&path).expect_err("an extra byte is noticed").to_string();
    assert!(message.contains("appended"), "{message}");
}

#[test]
fn exchanged_pages_are_noticed() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let options = BuildOptions { page_bytes: Some(16 << 10), ..BuildOptions::default() };
    build_at(&path, Box::new(mixed_points(3000, 2.0, 22)), &options);
    let mut bytes = std::fs::read(&path).expect("the file reads");
    let (first, second) = (4096, 4096 + (16 << 10));
    let page = bytes[first..second].to_vec();
    bytes.copy_within(second..second + (16 << 10), first);
    bytes[second..second + (16 << 10)].copy_from_slice(&page);
    std::fs::write(&path, &bytes).expect("a write");
    let message = check(&path).expect_err("exchanged pages are noticed");
    assert!(message.contains("another"), "{message}");
}

#[test]
fn a_render_over_a_damaged_page_fails_and_says_where() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let options = BuildOptions { page_bytes: Some(16 << 10), ..BuildOptions::default() };
    let cloud = build_at(&path, Box::new(mixed_points(3000, 1.0, 23)), &options);
    let expected = {
        let exec = ExecSettings { threads: 2, ..ExecSettings::default() };
        let scene = scene(&cloud, Kernel::Wyvill, false);
        picture(&scene, &camera(), &settings(40, 40), &exec, &paged(&scene, 1 << 30)).expect("a picture")
    };
    let bytes = std::fs::read(&path).expect("the file reads");
    let mut failed = 0;
    for page in 0..cloud.header().pages() {
        let at = cloud.header().page_offset(page) as usize + 100 + 37 * page as usize;
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x40;
        std::fs::write(&path, &damaged).expect("a write");
        let cloud = Arc::new(Cloud::open(&path).expect("the header is whole"));
        let exec = ExecSettings { threads: 2, ..ExecSettings::default() };
        let scene = scene(&cloud, Kernel::Wyvill, false);
        match picture(&scene, &camera(), &settings(40, 40), &exec, &paged(&scene, 1 << 30)) {
            Err(e) => {
                let message = e.to_string();
                assert!(message.contains("c.rset") && message.contains("byte"), "{message}");
                failed += 1;
            }
            Ok(found) => assert!(found == expected, "a damaged page {page} changed the picture"),
        }
    }
    assert!(failed > 0, "no page was needed");
}

#[test]
fn an_octree_that_is_no_tree_is_an_error_in_bounded_time() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let points = ArraySource::new(vec![[0.0; 3], [0.1; 3]], vec![("radius", vec![0.5, 0.5])]);
    let cloud = build_at(&path, Box::new(points), &BuildOptions::default());
    let header = cloud.header().clone();
    let mut bytes = std::fs::read(&path).expect("the file reads");
    // Groups of eight records, each of which has the whole group before it for children: 8^20 ways
    // down.
    let at = header.page_offset(header.point_pages) as usize;
    let page = &mut bytes[at..at + header.page_bytes as usize];
    let leaf = NodePage::trusted(page).get(usize::from(header.root.index)).expect("a root");
    for levels_are_right in [false, true] {
        const LEVELS: u16 = 20;
        // A leaf has no children, and nobody checks where they are.
        let nowhere = NodeRef { page: u32::MAX, index: u16::MAX };
        let level = if levels_are_right { LEVELS as u8 } else { 0 };
        let mut records = vec![Node { level, first_child: nowhere, ..leaf }; 8];
        for group in 0..LEVELS {
            let level = if levels_are_right { (LEVELS - 1 - group) as u8 } else { 0 };
            let first_child = NodeRef { page: 0, index: 8 * group };
            let own = RunRange::default();
            records.extend(vec![Node { own, child_mask: 0xff, first_child, level, ..leaf }; 8]);
        }
        let page = &mut bytes[at..at + header.page_bytes as usize];
        for (i, node) in records.iter().enumerate() {
            node.encode(&mut page[PAGE_HEAD_BYTES + i * NODE_BYTES..][..NODE_BYTES]);
        }
        let used_bytes = (PAGE_HEAD_BYTES + records.len() * NODE_BYTES) as u32;
        let records_head = records.len() as u32;
        PageHead { kind: PageKind::Octree, page: header.point_pages, records: records_head, used_bytes }
            .seal(page, header.identity);
        let numbers = section(&bytes, SectionKind::CLOUD);
        let root = u32::from(records.len() as u16 - 1);
        bytes[numbers + 16..numbers + 24].copy_from_slice(&u64::from(root + 1).to_le_bytes());
        bytes[numbers + 44..numbers + 48].copy_from_slice(&root.to_le_bytes());
        reseal(&mut bytes);
        std::fs::write(&path, &bytes).expect("a write");
        let cloud = Arc::new(Cloud::open(&path).expect("every checksum is right"));
        let scene = scene(&cloud, Kernel::Wyvill, false);
        let exec = ExecSettings { threads: 2, ..ExecSettings::default() };
        let outcome = picture(&scene, &camera(), &settings(8, 8), &exec, &paged(&scene, 1 << 30));
        let message = outcome.expect_err("no tree is walked for ever").to_string();
        assert!(message.contains("octree") && message.contains("c.rset"), "{message}");
        let message = cloud.nearest(DVec3::ZERO, 10.0).expect_err("nor searched").to_string();
        assert!(message.contains("no tree") && message.contains("c.rset"), "{message}");
        let message = cloud.verify(Depth::Deep).expect_err("no tree is checked for ever").to_string();
        assert!(message.contains("node"), "{message}");
    }
}

/// A run of no width would be divided by, and a run that two nodes own would be seen twice.
#[test]
fn records_that_contradict_each_other_under_right_checksums_are_errors() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let cloud = build_at(&path, Box::new(mixed_points(9000, 8.0, 6)), &BuildOptions::default());
    let header = cloud.header().clone();
    let whole = std::fs::read(&path).expect("the file reads");
    let changed = |change: &dyn Fn(&mut [u8])| {
        let mut bytes = whole.clone();
        change(&mut bytes);
        reseal(&mut bytes);
        std::fs::write(&path, &bytes).expect("a write");
        Cloud::open(&path)
            .map_err(|e| e.to_string())
            .and_then(|cloud| cloud.verify(Depth::Deep).map(|_| ()).map_err(|e| e.to_string()))
    };
    assert_eq!(changed(&|_| {}), Ok(()));
    let page_bytes = header.page_bytes as usize;
    let page_of =
        |page: u32| header.page_offset(page) as usize..header.page_offset(page) as usize + page_bytes;
    // The largest radius of a run, the upper half of an f32, 12 bytes into its record.
    for radius in [0_u16, 0x7f80, 0x8000, 0xbf80] {
        let said = changed(&|bytes| {
            let at = page_of(0).start + PAGE_HEAD_BYTES + 12;
            bytes[at..at + 2].copy_from_slice(&radius.to_le_bytes());
        });
        let said = said.expect_err("a radius of nothing");
        assert!(said.contains("largest radius") && said.contains("c.rset"), "{said}");
    }
    // Two nodes with runs of their own: the second is given those of the first.
    let said = changed(&|bytes| {
        let range = page_of(header.point_pages);
        let nodes = NodePage::trusted(&bytes[range.clone()]);
        let with_runs: Vec<(usize, Node)> = (0..nodes.len())
            .filter_map(|i| nodes.get(i).map(|node| (i, node)))
            .filter(|(_, node)| node.own.runs > 0)
            .collect();
        let ((_, first), (at, second)) = (with_runs[0], with_runs[1]);
        let own = RunRange { runs: first.own.runs.min(second.own.runs), ..first.own };
        let record = &mut bytes[range][PAGE_HEAD_BYTES + at * NODE_BYTES..][..NODE_BYTES];
        Node { own, ..second }.encode(record);
    });
    let said = said.expect_err("runs of two nodes");
    assert!(said.contains("its runs are another node's, too"), "{said}");
}

/// Where a section of a file begins.
pub(crate) fn section(bytes: &[u8], kind: SectionKind) -> usize {
    let block = bytes[..BLOCK_BYTES].try_into().expect("a whole block");
    let header = FileHeader::decode(block, FileKind::of(bytes).expect("a file of ours")).expect("a header");
    header.section(kind).expect("the section").offset as usize
}
