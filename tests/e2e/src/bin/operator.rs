//! An operator in a process of its own, to be killed or stopped by tests: takes control, arms, sends joints somewhere, and
//! sends heartbeats until it ends.
//!
//! Usage: `operator URL DOF=POSITION...`

use std::{thread, time::Duration};

use anyhow::Context as _;
use e2e::{Operator, Watcher, targets};

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let url = args.next().context("expected the address of a studio")?;
    let wanted = args
        .map(|arg| {
            let (dof, position) = arg.split_once('=').context("expected DOF=POSITION")?;
            Ok((dof.parse()?, position.parse()?))
        })
        .collect::<anyhow::Result<Vec<(usize, f64)>>>()?;
    let watcher = Watcher::connect_to(&url)?;
    let mut operator = Operator::connect_to(&url)?;
    operator.take_control("Ada")?;
    operator.arm(&watcher)?;
    operator.must(targets(&wanted))?;
    loop {
        thread::sleep(Duration::from_secs(1));
    }
}
