//! What may be hidden in servo logs.

use super::ServoTruth;

/// What a case is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServoCaseKind {
    /// One effect of the library, at strength 0 (weak), 1 or 2 (strong).
    Single(usize),
    /// Two effects of the library.
    Pair,
    /// Nothing.
    Null,
    /// Something that the library does not hold.
    Outside,
}

/// A servo with a secret.
#[derive(Clone, Debug, PartialEq)]
pub struct ServoCase {
    /// Name for people, e.g. `coulomb_friction, weak`.
    pub label: String,
    /// What it is for.
    pub kind: ServoCaseKind,
    /// Ids of the hidden effects, as the library calls them (for cases outside it: a name of their own).
    pub hidden: Vec<&'static str>,
    /// The servo.
    pub truth: ServoTruth,
}

type Hide = fn(&mut ServoTruth, f64);

/// Id, how it is hidden, and its sizes, the strong one last: weak, medium, strong, or the only one.
const SINGLES: &[(&str, Hide, &[f64])] = &[
    ("viscous_friction", |truth, size| truth.viscous_nm_s_per_rad = size, &[0.004, 0.008, 0.016]),
    ("coulomb_friction", |truth, size| truth.coulomb_nm = size, &[0.01, 0.02, 0.04]),
    ("stribeck_friction", |truth, size| truth.stribeck_nm = size, &[0.012, 0.024, 0.04]),
    ("load_dependent_friction", |truth, size| truth.load_friction = size, &[0.1, 0.2, 0.4]),
    ("command_latency", |truth, size| truth.latency_s = size, &[0.01, 0.02, 0.04]),
    ("gear_backlash", |truth, size| truth.play_rad = size, &[0.02, 0.04, 0.08]),
    ("voltage_sag", |truth, size| truth.supply_resistance_ohm = size, &[0.3, 0.6, 1.2]),
    ("encoder_offset", |truth, size| truth.encoder_offset_rad = size, &[0.03, -0.06, 0.12]),
    ("gravity_load", |truth, size| truth.gravity = size, &[0.1, 0.2, 0.4]),
    ("gain_error", |truth, size| truth.gain = size, &[-0.1, 0.2, 0.4]),
    ("armature_inertia", |truth, size| truth.inertia_kg_m2 = size, &[6e-4, 1.2e-3, 2.4e-3]),
    ("derivative_gain", |truth, size| truth.derivative_s = size, &[0.01, 0.02, 0.04]),
    ("current_limit", |truth, size| truth.current_limit_a = size, &[1.2, 0.9, 0.7]),
    ("constant_torque", |truth, size| truth.constant_torque_nm = size, &[0.025, -0.05, 0.1]),
    ("unstated_load", |truth, size| truth.load_unstated = size > 0.0, &[1.0]),
    ("integer_wrap", |truth, size| truth.wraps = size > 0.0, &[1.0]),
];

const OUTSIDE: &[(&str, Hide, [f64; 2])] = &[
    ("torque_ripple", |truth, size| truth.ripple_nm = size, [0.03, 0.06]),
    ("thermal_drift", |truth, size| truth.thermal = size, [0.25, 0.5]),
    ("friction_spot", |truth, size| truth.spot_nm = size, [0.08, 0.15]),
    ("one_sided_friction", |truth, size| truth.one_sided_nm = size, [0.04, 0.08]),
    ("loose_coupling", |truth, size| truth.coupling_rad_per_nm = size, [0.1, 0.25]),
    ("stuck_encoder_bit", |truth, size| truth.stuck_encoder_bits = size as i64, [4.0, 16.0]),
    ("duty_limit", |truth, size| truth.duty_withheld = size, [0.6, 0.75]),
];

const PAIRS: &[[&str; 2]] = &[
    ["coulomb_friction", "command_latency"],
    ["load_dependent_friction", "armature_inertia"],
    ["viscous_friction", "integer_wrap"],
    ["voltage_sag", "coulomb_friction"],
    ["encoder_offset", "armature_inertia"],
    ["gain_error", "load_dependent_friction"],
    ["derivative_gain", "coulomb_friction"],
    ["unstated_load", "coulomb_friction"],
];

const STRENGTHS: [&str; 3] = ["weak", "medium", "strong"];

/// Every effect at its strengths, pairs at medium strength, effects outside the library at two, and one servo without any
/// secret, to be recorded with many seeds.
pub fn servo_cases() -> Vec<ServoCase> {
    let mut cases = vec![ServoCase {
        label: "nothing".to_owned(),
        kind: ServoCaseKind::Null,
        hidden: Vec::new(),
        truth: ServoTruth::default(),
    }];
    for (id, hide, sizes) in SINGLES {
        for (&size, strength) in sizes.iter().rev().zip((0..STRENGTHS.len()).rev()) {
            let mut truth = ServoTruth::default();
            hide(&mut truth, size);
            cases.push(ServoCase {
                label: format!("{id}, {}", STRENGTHS[strength]),
                kind: ServoCaseKind::Single(strength),
                hidden: vec![id],
                truth,
            });
        }
    }
    for pair in PAIRS {
        let mut truth = ServoTruth::default();
        for (_, hide, sizes) in SINGLES.iter().filter(|(id, ..)| pair.contains(id)) {
            hide(&mut truth, sizes[sizes.len() / 2]);
        }
        cases.push(ServoCase {
            label: pair.join(" and "),
            kind: ServoCaseKind::Pair,
            hidden: pair.to_vec(),
            truth,
        });
    }
    for (id, hide, sizes) in OUTSIDE {
        for (size, strength) in sizes.iter().zip(&STRENGTHS[1..]) {
            let mut truth = ServoTruth::default();
            hide(&mut truth, *size);
            cases.push(ServoCase {
                label: format!("{id} (outside), {strength}"),
                kind: ServoCaseKind::Outside,
                hidden: vec![id],
                truth,
            });
        }
    }
    cases
}
