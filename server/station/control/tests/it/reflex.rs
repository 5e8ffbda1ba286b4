//! A reflex under whoever has control.

use std::path::Path;

use palpate_wire::proto::{ControlState, Reflex, Release, control_request::Request};

use crate::bench::{Bench, Operator, targets};

fn shipped() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/grasp/reflex/xarm6_leap.toml");
    let text = std::fs::read_to_string(path).expect("the shipped reflex");
    // A short test meets fewer hiccups of a busy machine, which disarm the station.
    text.replace("return_rad_per_s = 0.1", "return_rad_per_s = 2.0")
}

fn switch(on: bool, config_toml: &str) -> Request {
    Request::Reflex(Reflex { on, config_toml: config_toml.to_owned() })
}

#[test]
fn a_finger_that_is_stopped_yields_and_goes_where_it_is_told_when_it_can() {
    let bench = Bench::patient();
    let operator = Operator::armed(&bench, 1);
    assert!(
        bench.frame().and_then(|frame| frame.control).is_some_and(|state| state.reflex.is_none()),
        "off by default"
    );
    let watcher = Operator::watcher(&bench, 2);
    assert!(watcher.refused(switch(true, &shipped())).contains("watch only"));
    assert!(operator.refused(switch(true, "gains = 1")).contains("the reflex's configuration"));
    operator.accepted(switch(true, &shipped()));
    let state = bench.wait_for("on", |state| state.reflex.is_some());
    let digits = state.reflex.expect("it was looked at").digits;
    assert!(digits.iter().all(|digit| digit.phase == "free" && digit.offset_rad == 0.0), "{digits:?}");
    assert_eq!(bench.wait_for_audit("switched the reflex on").who, "operator 1");

    // A digit is told all its joints, as policies do it.
    let dofs = ["index_mcp_forward", "index_pip", "index_dip"].map(|joint| bench.dof(joint));
    bench.set_faults("[[fault]]\nkind = \"stuck\"\njoint = \"index_pip\"\n");
    let at = dofs.map(|dof| bench.emulated.snapshot().positions[dof]);
    let told = at.map(|at| at + 0.6);
    operator.accepted(targets(&dofs, &told));
    let index = |state: &ControlState| {
        let mut digits = state.reflex.iter().flat_map(|reflex| &reflex.digits);
        digits.find(|digit| digit.digit == "index").cloned().unwrap_or_default()
    };
    // The offset is 0.3 rad at most, of which half is this joint's.
    bench.wait_for("yielding", |state| {
        let commanded = state.commanded.get(dofs[1]).copied().map_or(f64::NAN, f64::from);
        index(state).phase == "yielding"
            && index(state).offset_rad < -0.29
            && (commanded - (told[1] - 0.15)).abs() < 0.02
    });
    bench.set_faults("");
    bench.wait_for("back", |state| {
        let commanded = state.commanded.get(dofs[1]).copied().map_or(f64::NAN, f64::from);
        index(state).offset_rad == 0.0 && (commanded - told[1]).abs() < 1e-3
    });

    operator.accepted(switch(false, ""));
    bench.wait_for("off", |state| state.reflex.is_none());
    operator.accepted(switch(true, &shipped()));
    bench.wait_for("on again", |state| state.reflex.is_some());
    operator.accepted(Request::Release(Release {}));
    bench.wait_for("off with the lease", |state| state.reflex.is_none());
    bench.wait_for_audit("has not got control any more");
}
