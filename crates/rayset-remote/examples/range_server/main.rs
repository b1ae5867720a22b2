//! Serves the files of a folder by ranges, as far away and as faulty as is wanted:
//!
//!     range_server FOLDER PORT [latency_ms=50] [jitter=0.2] [failing=0.01] [slow=0.05]
//!                              [slow_ms=2000] [cut=0.01] [rate=5500]

#[allow(dead_code, reason = "tests use more of it")]
mod server;

use std::collections::HashMap;
use std::time::Duration;

use server::{Behaviour, RangeServer};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [folder, port, settings @ ..] = words.as_slice() else {
        return Err("expected FOLDER PORT [NAME=NUMBER …]".into());
    };
    let mut known: HashMap<&str, f64> =
        ["latency_ms", "jitter", "failing", "slow", "slow_ms", "cut", "rate"].map(|name| (name, 0.0)).into();
    for setting in settings {
        let (name, number) = setting.split_once('=').ok_or("expected NAME=NUMBER")?;
        *known.get_mut(name).ok_or("no such setting")? = number.parse()?;
    }
    let behaviour = Behaviour {
        latency: Duration::from_secs_f64(known["latency_ms"] / 1000.0),
        jitter: known["jitter"],
        failing: known["failing"],
        slow: (known["slow"], Duration::from_secs_f64(known["slow_ms"] / 1000.0)),
        cut: known["cut"],
        rate: known["rate"],
        ..Behaviour::default()
    };
    let server = RangeServer::start(Some(folder.into()), port.parse()?, behaviour)?;
    let mut out = std::io::stdout();
    std::io::Write::write_all(&mut out, format!("{}\n", server.address_of("")).as_bytes())?;
    // Until standard input ends.
    std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
    let counted = |count: &std::sync::atomic::AtomicU64| count.load(std::sync::atomic::Ordering::Relaxed);
    let (reads, bytes) = (counted(&server.objects.reads), counted(&server.objects.bytes));
    std::io::Write::write_all(&mut out, format!("{reads} reads, {bytes} bytes\n").as_bytes())?;
    Ok(())
}
