//! The smallest caches that run, by height and number of point sets: the paper's O(n·h).

use std::cell::RefCell;
use std::rc::Rc;

use anyhow::Result;
use rayset::points::Workload;
use rayset::scene::CloudObject;
use rayset::trace::reference::PointField;

use super::{BATCH, Setting, Subject, differing, same_picture_note};
use crate::cache::CacheError;
use crate::engine::{self, EngineError, IndexField, Picture, all_pixels};
use crate::index::{Index, Limits};
use crate::predict::Variant;
use crate::record::{NODE_BYTES, POINT_BYTES};
use crate::records::{Budget, OutOfCore};
use crate::report::{Series, Table, plot};
use crate::simulated::{Clock, SimulatedDisk};

pub(super) fn run(setting: &Setting) -> Result<()> {
    let (points, side) = setting.pick((1_500, 8), (20_000, 24));
    let mut table = Table::new(
        "Minimum memory",
        &["height h", "smallest node cache that runs", "of it, a path", "bytes for n = 1", "n = 2", "n = 10"],
    );
    let mut line = Series { name: "nodes".into(), points: Vec::new() };
    let mut worst: f64 = 0.0;
    for height in setting.pick(2..5, 2..8) {
        let folder = setting.work.join(format!("minimum-{height}"));
        std::fs::create_dir_all(&folder)?;
        let workload: Workload = format!("sphere-{points}").parse()?;
        let subject = Subject::build(workload.source(), Some(0.1), side, &folder.join("c.rset"))?;
        let index = subject.index(&folder, Limits { height, leaf_points: 1 })?;
        let mut smallest = 1;
        let picture = loop {
            if let Some(picture) = picture_with(&subject, &index, smallest)? {
                break picture;
            }
            smallest += 1;
        };
        worst = worst.max(differing(&picture, &subject.shipping()?.0));
        // With the one secondary record and the one point.
        let bytes = ((smallest + 1) * NODE_BYTES + POINT_BYTES) as u64;
        line.points.push((f64::from(height), smallest as f64));
        table.row([
            height.to_string(),
            smallest.to_string(),
            (index.summary.height + 1).to_string(),
            bytes.to_string(),
            (2 * bytes).to_string(),
            (10 * bytes).to_string(),
        ]);
        std::fs::remove_dir_all(&folder)?;
    }
    table.note(format!(
        "{points} points; one secondary record and one point in core besides; predictor `line`. A run fails where a node has no place because \
         all are retained. Each of n point sets has caches of its own, so the bytes are n times those of one. The engine \
         that ships needs {} pages for one thread, whatever the height and however many the clouds.",
        rayset::trace::memory::least_pages(1)
    ));
    table.note(same_picture_note(worst));
    table.write(&setting.out, "minimum")?;
    plot(&setting.out.join("minimum.svg"), "Smallest node cache by height", ("height", "records"), &[line])
}

/// The picture with so many nodes and a single point in core, where they are enough.
fn picture_with(subject: &Subject, index: &Index, nodes: usize) -> Result<Option<Picture>> {
    let clock = Clock::default();
    let disk = SimulatedDisk::open(&index.files(), clock.clone())?;
    // A node cache of OutOfCore gives a part to secondary records: here it is `nodes` without that.
    let mut records =
        OutOfCore::new(Box::new(disk), Budget { nodes: 4, points: 1 }, BATCH, true, Some(clock));
    records.set_capacities(nodes, 1, 1);
    let records = Rc::new(RefCell::new(records));
    let failure = Rc::new(RefCell::new(None));
    let field = IndexField::new(&subject.object(), true, Variant::Line, records, failure.clone());
    let given = |_: &CloudObject| &field as &dyn PointField;
    let view = (&subject.camera, &subject.settings, subject.step);
    let outcome = engine::render(&subject.scene, view, &failure, given, all_pixels(&subject.settings));
    match outcome {
        Ok(picture) => Ok(Some(picture)),
        Err(EngineError::Cache(CacheError::Full { .. })) => Ok(None),
        Err(error) => Err(error.into()),
    }
}
