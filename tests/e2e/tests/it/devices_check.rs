//! `palpate devices check` tells an operator what is there, what is missing, and how to mend it.

use std::process::Command;

use e2e::{Bench, Tools, beside_a_station};
use serde_json::Value;

/// Its document, and whether it ended well.
fn check(tools: &Tools, bench: &Bench) -> (Value, Option<i32>) {
    let mut command: Command = tools.palpate();
    command.args(["devices", "check", "--json"]).args(bench.station_args());
    let output = command.output().expect("palpate");
    let text = String::from_utf8_lossy(&output.stdout);
    let document = serde_json::from_str(&text).unwrap_or_else(|err| panic!("{err}: {text}"));
    (document, output.status.code())
}

fn device<'a>(document: &'a Value, id: &str) -> &'a Value {
    let devices = document["devices"].as_array().into_iter().flatten();
    devices.into_iter().find(|device| device["id"] == id).unwrap_or_else(|| panic!("no {id}: {document}"))
}

#[test]
fn devices_that_are_there_are_told_and_so_is_what_is_missing() {
    let Some(tools) = Tools::find() else { return };
    let bench = Bench::start(beside_a_station()).unwrap();
    // Where the machine has much else to do, answers are late: that is warned of.
    let (found, code) = check(&tools, &bench);
    assert_eq!((&found["ok"], code), (&Value::Bool(true), Some(0)), "{found}");
    let station = bench.control.station();
    let devices = found["devices"].as_array().unwrap();
    assert_eq!(devices.len(), station.devices.len());
    let servos = device(&found, "u2d2")["motors"].as_array().unwrap();
    assert_eq!(servos.len(), station.robot.num_dofs() - station.carrier_dofs.len());
    for servo in servos {
        assert!(!servo["identity"].as_str().unwrap().is_empty(), "{servo}");
        assert!((20.0..60.0).contains(&servo["temperature_c"].as_f64().unwrap()), "{servo}");
        assert!((4.5..5.5).contains(&servo["supply_v"].as_f64().unwrap()), "{servo}");
    }
    assert_eq!(device(&found, "xarm")["motors"].as_array().unwrap().len(), station.carrier_dofs.len());
    assert_eq!(devices.iter().filter(|device| device["kind"] == "lines").count(), 5);
    assert!(devices.iter().all(|device| device["rate_hz"].as_f64() > Some(0.0)), "{found}");

    bench.set_faults("[[fault]]\nkind = \"unplug\"\ndevice = \"twintac2\"\n").unwrap();
    let (found, code) = check(&tools, &bench);
    assert_eq!((&found["ok"], code), (&Value::Bool(false), Some(1)), "{found}");
    let missing = device(&found, "twintac2");
    assert_eq!(missing["ok"], Value::Bool(false));
    let advice = missing["problem"].as_str().unwrap();
    assert!(advice.contains("plug") || advice.contains("cable"), "{advice}");
    assert_eq!(device(&found, "twintac1")["ok"], Value::Bool(true), "{found}");
}
