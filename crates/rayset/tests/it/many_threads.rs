//! What threads have in common: shown by counts, which do not depend on how many processors there
//! are.

use std::sync::Arc;
use std::time::Duration;

use rayset::cancel::CancelToken;
use rayset::field::Kernel;
use rayset::trace::predict::NoPredictor;
use rayset::trace::{ExecSettings, FinishedTile, Session, Work};

use crate::common::{camera, folder, paged, scene, settings, workload_cloud};

/// What a render on so many threads does besides tracing.
#[derive(Debug)]
struct Counts {
    requests: u64,
    lock_waits: u64,
    joined: u64,
    woken: u64,
}

const TILES: u64 = 32 * 32;

/// Renders these tiles of a cloud that is in memory.
fn counts(threads: usize) -> Counts {
    let folder = folder();
    let scene = scene(&workload_cloud("sphere-40k", folder.path()), Kernel::Triweight, false);
    let exec = ExecSettings { threads, predictor: Arc::new(NoPredictor), ..ExecSettings::default() };
    let session = Session::over(paged(&scene, 1 << 30), exec).expect("a session");
    let view =
        session.prepare(&scene, &settings(256, 256)).expect("a scene").view(&camera()).expect("a view");
    let work = Work::tiles(view.tiles(&view.region()));
    // Slower than the threads: they leave because tiles wait, and are called back.
    let mut sink = |_: &FinishedTile<'_>| {
        std::thread::sleep(Duration::from_micros(50));
        Ok(())
    };
    let mut render = || view.render(&work, &CancelToken::new(), &mut sink).expect("a picture");
    // The first picture brings the pages into memory.
    render();
    session.reset_statistics();
    let before = session.serial_work();
    render();
    let after = session.serial_work();
    let [lock_waits, joined, woken] = std::array::from_fn(|k| after[k] - before[k]);
    let requests = session.statistics().total(|kind| kind.hits + kind.misses + kind.late);
    Counts { requests, lock_waits, joined, woken }
}

#[test]
fn what_threads_have_in_common_does_not_grow_with_their_number() {
    let alone = counts(1);
    for threads in [2, 16, 64] {
        let many = counts(threads);
        assert_eq!(many.requests, alone.requests, "{threads} threads: requests for pages");
        // All are woken when the render begins, and later no more of them than there is room for
        // tiles. Those that were woken at the end of the first picture may count it when the second
        // has begun.
        let most = threads as u64 + TILES;
        assert!(many.joined <= most && many.woken <= most + threads as u64, "{threads} threads: {many:?}");
        // Three locks a tile and one a request: of all these few are waited for.
        assert!(many.lock_waits <= (many.requests + 3 * TILES) / 50, "{threads} threads: {many:?}");
    }
}
