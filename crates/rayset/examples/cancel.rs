//! Cancels a render at various moments and prints how long the calls took to return, which is next
//! to nothing; then renders again in the same session: `cargo run --release --example cancel`.
#![allow(clippy::print_stdout, reason = "an example says what it did")]

use std::thread;
use std::time::{Duration, Instant};

use rayset::scene::RenderSettings;
use rayset::{CancelToken, FinishedTile, RenderError, Session, SinkError, Work};

mod common;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scene = common::knot_under_a_lamp()?;
    let settings = RenderSettings::default().with_size(320, 240);
    let session = Session::builder().build()?;
    let view = session.prepare(&scene, &settings)?.view(&common::camera(&scene, 0.0))?;
    let expected = view.picture()?;
    let work = Work::tiles(view.tiles(&view.region()));
    let mut sink = |_: &FinishedTile<'_>| -> Result<(), SinkError> { Ok(()) };

    let started = Instant::now();
    view.render(&work, &CancelToken::new(), &mut sink)?;
    let whole = started.elapsed();

    let mut late: Vec<Duration> = Vec::new();
    for turn in 0..200_u32 {
        let cancel = CancelToken::new();
        // At moments spread over the whole render.
        let moment = whole.mul_f64(f64::from(turn * 73 % 200) / 200.0);
        let canceller = {
            let cancel = cancel.clone();
            thread::spawn(move || {
                thread::sleep(moment);
                cancel.cancel();
                Instant::now()
            })
        };
        let outcome = view.render(&work, &cancel, &mut sink);
        let returned = Instant::now();
        assert!(matches!(outcome, Ok(_) | Err(RenderError::Cancelled)));
        let cancelled = canceller.join().map_err(|_| "the canceller panicked")?;
        late.push(returned.saturating_duration_since(cancelled));
    }
    late.sort_unstable();
    println!(
        "a render of {whole:.0?}, cancelled 200 times: returned within {:.1?} (median), {:.1?} (99 of 100), {:.1?} (all)",
        late[100], late[197], late[199]
    );
    assert!(view.picture()? == expected, "the session renders on, to the same bits");
    Ok(())
}
