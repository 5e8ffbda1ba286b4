//! Takes open in readers that nobody here wrote.

use std::process::Command;

use e2e::{Tools, demo_session, run_json, together};

#[test]
fn take_opens_in_stock_mcap_reader() {
    let Some(tools) = Tools::find() else { return };
    let _turn = together();
    let data = demo_session(&tools).unwrap();
    let script = e2e::root().join("tests/e2e/python/read_take.py");
    let take = data.join("sessions/demo/take-01.mcap");
    let seen = run_json(Command::new(&tools.python).arg(script).arg(take)).unwrap();
    let text = seen.to_string();
    for expected in
        ["foxglove.JointStates", "palpate.TactileSample", "/joint_states", "/tactile/twintac", "/tactile/fsr"]
    {
        assert!(text.contains(expected), "{expected} is missing in {text}");
    }
}
