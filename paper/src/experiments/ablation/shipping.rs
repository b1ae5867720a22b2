//! The engine that ships with one thing changed at a time, on this machine's disk.

use std::sync::Arc;

use anyhow::{Result, ensure};
use rayset::octree::build::{self, BuildControl, BuildOptions, Rule};
use rayset::points::Workload;
use rayset::trace::predict::{LinePredictor, NoPredictor, PacketPredictor, Predictor};
use rayset::working_set::read::{self, BackendKind};

use super::super::{Setting, Subject, median};
use crate::report::{Table, bars, number};

/// Memory is this part of the file.
const MEMORY_PART: u64 = 8;
/// What pages have where nothing else is said.
const PAGE_BYTES: u32 = 32 << 10;

pub(super) fn run(setting: &Setting) -> Result<()> {
    let side = setting.pick(32, 256);
    let repeats = setting.pick(1, 5);
    let workload: Workload = setting.pick("sphere-50k", "sphere-5m").parse()?;
    let folder = setting.work.join("ablation-shipping");
    std::fs::create_dir_all(&folder)?;
    let mut table = Table::new(
        "Ablation: the engine that ships",
        &["what is varied", "", "s", "stalled", "reads", "MB read", "of it once", "misses", "hinted in time"],
    );
    let mut shown = Vec::new();
    let sizes: &[u32] =
        setting.pick(&[16 << 10][..], &[16 << 10, 32 << 10, 64 << 10, 128 << 10, 256 << 10][..]);
    let standard = setting.pick(16 << 10, PAGE_BYTES);
    for &page_bytes in sizes {
        let cloud = folder.join("c.rset");
        let radius = workload.radius().map(Rule::Number);
        let options = BuildOptions { radius, page_bytes: Some(page_bytes), ..BuildOptions::default() };
        build::run(vec![workload.source()], &cloud, &options, &BuildControl::default())?;
        let mut subject = Subject::open(&cloud, side)?;
        subject.make_translucent();
        let memory = (subject.cloud.header().file_bytes / MEMORY_PART).max(8 * u64::from(page_bytes));
        let rows = if page_bytes == standard { changes(setting) } else { Vec::new() };
        // Positions are rounded by pages: only of one size must pictures be the same.
        let mut first_picture = None;
        let of_size = Change {
            what: "bytes a page",
            value: page_bytes.to_string(),
            predictor: Arc::new(PacketPredictor::default()),
            backend: BackendKind::Auto,
        };
        for Change { what, value, predictor, backend } in std::iter::once(of_size).chain(rows) {
            let (mut times, mut stalls, mut last) = (Vec::new(), Vec::new(), None);
            for _ in 0..repeats {
                let (picture, seconds, statistics) =
                    subject.shipping_by(memory, read::backend(backend)?, predictor.clone())?;
                let stalled: u64 = statistics.total(|kind| kind.stall_nanoseconds);
                let first = first_picture.get_or_insert_with(|| picture.clone());
                ensure!(*first == picture, "{what} {value}: another picture");
                times.push(seconds);
                stalls.push(stalled as f64 * 1e-9 / seconds);
                last = Some(statistics);
            }
            let sum = |of: fn(&rayset::working_set::KindStatistics) -> u64| {
                last.iter().map(|s| s.total(of)).sum::<u64>()
            };
            let seconds = median(&mut times);
            table.row([
                what.to_owned(),
                value.clone(),
                number(seconds),
                format!("{:.0} %", 100.0 * median(&mut stalls)),
                sum(|k| k.reads).to_string(),
                number(sum(|k| k.bytes_read) as f64 / 1e6),
                number(sum(|k| k.bytes_unique) as f64 / 1e6),
                sum(|k| k.misses).to_string(),
                sum(|k| k.hinted_in_time).to_string(),
            ]);
            shown.push((format!("{what}: {value}"), seconds));
        }
    }
    std::fs::remove_dir_all(&folder)?;
    table.note(format!(
        "{workload}, translucent, {side}×{side} rays, one thread, memory for pages an eighth of the file, direct reads from \
         this machine's disk, medians of {repeats}. One thing is changed at a time; the usual is `packet` with 16 blocks of \
         32×32 pixels ahead and two slabs on a miss, pages of {} KiB.",
        standard >> 10
    ));
    table.write(&setting.out, "ablation-shipping")?;
    bars(&setting.out.join("ablation-shipping.svg"), "Ablation: the engine that ships", "seconds", &shown)
}

struct Change {
    what: &'static str,
    value: String,
    predictor: Arc<dyn Predictor>,
    backend: BackendKind,
}

/// What is varied at the usual size of pages.
fn changes(setting: &Setting) -> Vec<Change> {
    let backend = BackendKind::Auto;
    let change = |what, value: String, predictor| Change { what, value, predictor, backend };
    let mut all = vec![
        change("predictor", "none".into(), Arc::new(NoPredictor) as Arc<dyn Predictor>),
        change("predictor", "line".into(), Arc::new(LinePredictor)),
    ];
    let usual = PacketPredictor::default();
    for tiles_ahead in setting.pick(&[1][..], &[0, 1, 4, 64][..]) {
        let predictor = PacketPredictor { tiles_ahead: *tiles_ahead, ..usual };
        all.push(change("blocks ahead", tiles_ahead.to_string(), Arc::new(predictor)));
    }
    for slabs_on_a_miss in setting.pick(&[1][..], &[0, 1, 4, 8][..]) {
        let predictor = PacketPredictor { slabs_on_a_miss: *slabs_on_a_miss, ..usual };
        all.push(change("slabs on a miss", slabs_on_a_miss.to_string(), Arc::new(predictor)));
    }
    for (name, backend) in [("io_uring", BackendKind::Uring), ("threads", BackendKind::Pool)] {
        // Not every system has the first.
        if read::backend(backend).is_ok() {
            all.push(Change { what: "I/O backend", value: name.into(), predictor: Arc::new(usual), backend });
        }
    }
    all
}
