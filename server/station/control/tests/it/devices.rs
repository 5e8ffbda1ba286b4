//! Devices that go and come back.

use std::{thread, time::Duration};

use palpate_wire::proto::{Disarm, control_request::Request, control_state::Phase, device_status::Link};

use crate::bench::{Bench, Operator, targets};

fn unplug(device: &str) -> String {
    format!("[[fault]]\nkind = \"unplug\"\ndevice = \"{device}\"\n")
}

#[test]
fn every_device_may_be_unplugged_and_comes_back() {
    let bench = Bench::new();
    let mut operator = Operator::watcher(&bench, 1);
    operator.take_control(false);
    let devices: Vec<(usize, String, bool)> = (bench.handle.station().devices.iter().enumerate())
        .map(|(idx, device)| (idx, device.id.clone(), !device.dofs().is_empty()))
        .collect();
    for (idx, id, moves) in devices {
        // An arm that comes back still holds until it is told to let go.
        bench.wait_until("all limp", |now| !now.torque_on.contains(&true));
        operator.arm(&bench);
        bench.set_faults(&unplug(&id));
        let state = bench.wait_for(&format!("{id} lost"), |state| state.devices[idx].link() == Link::Lost);
        let told = &state.devices[idx];
        assert!(!told.problem.is_empty(), "{told:?}");
        if moves {
            // Nobody moves a robot that cannot be seen as a whole.
            let state = bench.wait_for("disarmed", |state| state.phase() == Phase::Disarmed);
            assert!(state.reason.contains(&id) || state.reason.contains("joint"), "{}", state.reason);
            bench.wait_until("the others limp", |now| {
                let other = if id == "xarm" { bench.dof("index_pip") } else { bench.dof("joint1") };
                !now.torque_on[other]
            });
        } else {
            assert!(!state.reason.contains(&id), "{}", state.reason);
            let dof = bench.dof("index_pip");
            let is_there = || (bench.emulated.snapshot().positions[dof] - 0.45).abs() < 0.05;
            while !is_there() {
                // A machine that is too busy makes the station let go meanwhile.
                operator.arm(&bench);
                operator.ask(targets(&[dof], &[0.45]));
                thread::sleep(Duration::from_millis(100));
            }
        }
        bench.set_faults("");
        bench.wait_for(&format!("{id} back"), |state| {
            state.devices[idx].link() == Link::Ready && state.devices[idx].reconnects >= 1
        });
        if !moves {
            operator.accepted(Request::Disarm(Disarm {}));
        }
        bench.wait_for("ready to be armed", |state| {
            state.phase() == Phase::Disarmed && !state.reason.contains("cannot be armed")
        });
    }
    for id in ["u2d2", "xarm", "fsr"] {
        bench.wait_for_audit(&format!("{id} is lost"));
    }
}
