//! The measured logs of a Dynamixel XL330, where they are at hand.

use std::path::PathBuf;

use palpate_recording::{RegisterUnits, ServoLog};
use palpate_reports::Verdict;
use palpate_sim::job::{Cancel, NoProgress};
use palpate_truth::actuator::{ServoTruth, record_servo, servo_cases};

use super::*;

/// The measured logs; `None`, with a message, where the folder is absent.
fn measured() -> Option<Vec<ServoLog>> {
    let folder =
        std::env::var_os("PALPATE_DATA").map_or_else(|| PathBuf::from("../../../shared/data"), PathBuf::from);
    let folder = folder.join("bam_xl330/raw");
    if !folder.is_dir() {
        eprintln!(
            "skipped: no measured logs in {folder:?}; PALPATE_DATA names the folder that holds bam_xl330"
        );
        return None;
    }
    Some(ServoLog::read_folder(&folder).expect("the measured logs"))
}

fn holding_out(value: &str) -> ActuatorConfig {
    ActuatorConfig {
        hold_out: LogHoldOut::Field { field: "kp".to_owned(), value: value.to_owned() },
        ..ActuatorConfig::default()
    }
}

#[test]
fn measured_servo_stores_pwm_unsigned_its_gear_loses_torque_and_its_rotor_is_heavy() {
    let Some(logs) = measured() else { return };
    for gain in ["100", "200", "400"] {
        let outcome =
            diagnose_actuator(&holding_out(gain), &logs, &NoProgress, &Cancel::default(), &|| 0.0).unwrap();
        let mut report = outcome.report;
        report.effects.sort_by(|a, b| a.id.cmp(&b.id));
        let [inertia, wrap, friction] = &report.effects[..] else {
            panic!("with kp={gain} held out: {}", report.sentence)
        };
        let ids = [&inertia.id, &wrap.id, &friction.id];
        assert_eq!(ids, ["armature_inertia", "integer_wrap", "load_dependent_friction"], "kp={gain}");
        assert!((1e-3..2e-3).contains(&inertia.parameters["inertia_kg_m2"]), "kp={gain}");
        assert!(wrap.parameters["wrapped"] > 0.95, "kp={gain}");
        assert!((0.3..0.6).contains(&friction.parameters["load_friction"]), "kp={gain}");
        let held_out = &report.held_out;
        assert!(held_out.diagnosed < 0.5 * held_out.calibrated, "kp={gain}: {held_out:?}");
        assert!(report.takes["confirm"].len() == 4 && report.takes["fit"].len() == 8);
    }
}

#[test]
fn hold_out_that_leaves_nothing_is_refused() {
    let log = |gain: f64| ServoLog {
        fields: [("kp".to_owned(), gain.to_string())].into(),
        position_gain_register: Some(gain),
        ..ServoLog::default()
    };
    let logs = [log(100.0), log(200.0)];
    let field = |value: &str| LogHoldOut::Field { field: "kp".to_owned(), value: value.to_owned() };
    assert_eq!(held_out(&field("200.0"), &logs).unwrap(), [1]);
    let message = held_out(&field("300"), &logs).expect_err("there is no such gain").to_string();
    assert!(message.contains("choose among: kp=100, kp=200"), "{message}");
    assert!("kp".parse::<LogHoldOut>().is_err());
    assert_eq!("kp=200".parse::<LogHoldOut>().unwrap(), field("200"));
}

fn blind(label: &str, without: &[&str]) -> ActuatorOutcome {
    let cases = servo_cases();
    let case = cases.iter().find(|case| case.label == label).expect("a case of that label");
    diagnosed(&case.truth, without)
}

fn diagnosed(truth: &ServoTruth, without: &[&str]) -> ActuatorOutcome {
    let config = ActuatorConfig {
        starts: 2,
        resamples: 50,
        without: without.iter().map(|id| (*id).to_owned()).collect(),
        ..ActuatorConfig::default()
    };
    let logs = record_servo(truth, 1);
    diagnose_actuator(&config, &logs, &NoProgress, &Cancel::default(), &|| 0.0).expect("a diagnosis")
}

fn ids(outcome: &ActuatorOutcome) -> Vec<&str> {
    outcome.report.effects.iter().map(|effect| effect.id.as_str()).collect()
}

#[test]
fn hidden_effects_are_named_and_the_held_out_gap_closes() {
    // Other constants of the motor move the joint as a wrong gain does: only the PWM tells it.
    let shares =
        [("coulomb_friction, medium", 0.3), ("gain_error, weak", 1.0), ("armature_inertia, medium", 0.3)];
    for (label, share) in shares {
        let outcome = blind(label, &[]);
        assert_eq!(ids(&outcome), [label.split(',').next().expect("an id")], "{label}");
        assert_eq!(outcome.report.verdict, Verdict::Explained, "{label}");
        let gap = &outcome.report.held_out;
        assert!(gap.diagnosed < share * gap.calibrated, "{label}: {gap:?}");
    }
    let mut both = blind("viscous_friction and integer_wrap", &[]);
    both.report.effects.sort_by(|a, b| a.id.cmp(&b.id));
    assert_eq!(ids(&both), ["integer_wrap", "viscous_friction"]);
}

#[test]
fn a_heavier_rotor_and_a_lighter_load_are_one_class_that_no_motion_tells_apart() {
    let rotor = ServoTruth { inertia_kg_m2: 1.2e-3, ..ServoTruth::default() };
    let load = ServoTruth { gravity: -0.2, ..ServoTruth::default() };
    for truth in [rotor, load] {
        let mut report = diagnosed(&truth, &[]).report;
        assert_eq!(report.effects.len(), 1, "{truth:?}");
        assert_eq!(report.effects[0].id, "armature_inertia", "what was weighed is believed: {truth:?}");
        report.effects[0].class.sort();
        assert_eq!(report.effects[0].class, ["armature_inertia", "gravity_load"], "{truth:?}");
        let next = report.next_experiment.expect("another load, which a rotor is not");
        assert!(next.sentence.contains("with a load of"), "{}", next.sentence);
        assert!(
            report.notes.iter().any(|note| note.contains("no recorded motion tells")),
            "{:?}",
            report.notes
        );
    }
}

#[test]
fn nothing_hidden_is_nothing_named_and_what_no_effect_explains_is_said_so() {
    let nothing = blind("nothing", &[]);
    assert_eq!((ids(&nothing), nothing.report.verdict), (Vec::new(), Verdict::NoDiscrepancy));
    let spot = blind("friction_spot (outside), strong", &[]);
    assert_eq!((ids(&spot), spot.report.verdict), (Vec::new(), Verdict::Unexplained));
}

#[test]
fn friction_of_another_law_is_named_and_what_its_formula_misses_is_said_to_be_left() {
    let outcome = blind("load_dependent_friction, medium", &[]);
    assert_eq!(ids(&outcome), ["load_dependent_friction"]);
    assert_eq!(outcome.report.verdict, Verdict::PartlyExplained);
}

#[test]
fn a_neighbour_that_explains_a_part_is_taken_back() {
    let outcome = blind("coulomb_friction, strong", &["coulomb_friction"]);
    assert_eq!((ids(&outcome), outcome.report.verdict), (Vec::new(), Verdict::Unexplained));
    let withheld = &outcome.report.in_doubt;
    let neighbour = withheld.iter().find(|name| name.id == "load_dependent_friction").unwrap();
    assert!(neighbour.doubt[0].measured > neighbour.doubt[0].limit, "{withheld:?}");
}

#[test]
fn friction_that_no_kind_accounts_for_is_said_to_be_missing_and_is_in_the_model() {
    let report = blind("coulomb_friction, strong", &["coulomb_friction"]).report;
    assert!(report.sentence.starts_with("Friction is missing from the model"), "{}", report.sentence);
    assert!(report.held_out.diagnosed < 0.1 * report.held_out.calibrated, "{:?}", report.held_out);
    // What is no friction is not called so.
    let spot = blind("torque_ripple (outside), strong", &[]).report;
    assert!(!spot.sentence.contains("Friction"), "{}", spot.sentence);
}

/// Logs of a servo with friction that grows with its load, of one motion at one gain.
fn one_motion(motion: &str, gain: &str) -> Vec<ServoLog> {
    let mut logs = record_servo(&ServoTruth { load_friction: 0.2, ..ServoTruth::default() }, 7);
    logs.retain(|log| log.fields["trajectory"] == motion && log.fields["kp"] == gain);
    logs
}

#[test]
fn kinds_of_friction_that_one_motion_does_not_tell_apart_ask_for_another_gain_or_load() {
    let logs = one_motion("square", "400");
    let config = ActuatorConfig { hold_out: LogHoldOut::None, starts: 2, ..ActuatorConfig::default() };
    let report = diagnose_actuator(&config, &logs, &NoProgress, &Cancel::default(), &|| 0.0).unwrap().report;
    assert!(report.sentence.contains("Friction is missing"), "{}", report.sentence);
    assert!(report.sentence.contains("on the fitted logs"), "nothing is held out: {}", report.sentence);
    let next = report.next_experiment.expect("an experiment");
    let mut separates = next.separates.clone();
    separates.sort();
    assert_eq!(separates, ["coulomb_friction", "load_dependent_friction"]);
    assert!(next.sentence.contains("at position gain 800"), "{}", next.sentence);
}

#[test]
fn a_servo_of_another_make_is_diagnosed_in_its_own_units() {
    let units = RegisterUnits { counts_per_turn: 1024.0, full_pwm: 1000.0, unit_gain: 64.0 };
    let truth = |coulomb_nm| ServoTruth { units, coulomb_nm, ..ServoTruth::default() };
    let nothing = diagnosed(&truth(0.0), &[]);
    assert_eq!((ids(&nothing), nothing.report.verdict), (Vec::new(), Verdict::NoDiscrepancy));
    let friction = diagnosed(&truth(0.02), &[]);
    assert_eq!((ids(&friction), friction.report.verdict), (vec!["coulomb_friction"], Verdict::Explained));

    let mut logs = record_servo(&truth(0.0), 1);
    logs[3].torque_constant_nm_per_a = Some(1.1);
    let refused = ActuatorDomain::new(&logs).err().expect("logs that disagree").to_string();
    assert!(refused.contains(&logs[3].id) && refused.contains("torque_constant"), "{refused}");
}

#[test]
fn a_load_that_nobody_weighed_is_found_beside_friction() {
    let truth = ServoTruth { load_unstated: true, coulomb_nm: 0.02, ..ServoTruth::default() };
    let outcome = diagnosed(&truth, &[]);
    assert_eq!(ids(&outcome), ["unstated_load", "coulomb_friction"]);
    assert_eq!(outcome.report.verdict, Verdict::Explained);
    let load = &outcome.report.effects[0].parameters;
    // As well as the motor is known: its resistance is the datasheet's to 15 % here.
    assert!((0.4..0.56).contains(&load["sine_nm"]), "m g l is 0.48 N m: {load:?}");
    assert!((0.004..0.006).contains(&load["inertia_kg_m2"]), "m l^2 is 0.0049 kg m^2: {load:?}");
    assert!(load["cosine_nm"].abs() < 0.01, "{load:?}");
}

#[test]
fn a_sag_keeps_the_size_that_the_voltage_shows() {
    let truth = ServoTruth { supply_resistance_ohm: 0.6, ..ServoTruth::default() };
    let outcome = diagnosed(&truth, &[]);
    let sag = outcome.model.effects.iter().find(|effect| effect.id == "voltage_sag").expect("a sag");
    assert!((0.45..0.75).contains(&sag.parameter("supply_resistance_ohm")), "{sag:?}");
}
