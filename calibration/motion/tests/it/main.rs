//! Plans the shipped sessions and looks at their motions from outside.

#![expect(clippy::unwrap_used, reason = "a failed test should panic")]

mod documented;
mod first_plan;
mod laws;
mod mimic;
mod plans;

use std::path::{Path, PathBuf};

use palpate_motion::{MotionLimits, Plan};
use palpate_recording::load_station;
use palpate_robot_model::Station;

fn assets() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets")
}

/// A station that comes with Palpate.
fn station(name: &str) -> Station {
    load_station(&assets().join("stations").join(format!("{name}.toml"))).unwrap()
}

/// A plan that comes with Palpate.
fn plan(name: &str) -> Plan {
    Plan::read(&assets().join("plans").join(format!("{name}.toml"))).unwrap()
}

/// Limits for the joints that carry the hand, and for those of the hand.
fn limits(station: &Station, carriers: [f64; 2], limbs: [f64; 2]) -> MotionLimits {
    let of = |what: usize| {
        let limit = |dof| if station.carrier_dofs.contains(&dof) { carriers[what] } else { limbs[what] };
        (0..station.robot.num_dofs()).map(limit).collect()
    };
    MotionLimits::new(station, of(0), of(1))
}
