//! A small bench: one strong effect, one outside the library, and nothing at all. The seeds are of sessions that are
//! answered rightly: what these tests guard is that they stay so, the whole bench says how often it is.

#![expect(clippy::unwrap_used, reason = "a bench that cannot be run is a failed test")]

use std::collections::BTreeMap;
use std::path::Path;

use palpate_blind::{BlindConfig, BlindError, BlindReport, World, actuator, tactile};
use palpate_diagnosis::{DiagnosisConfig, diagnose, reference};
use palpate_recording::{SpanKind, Take};
use palpate_reports::{Purpose, Verdict};
use palpate_sim::{
    SensorModel,
    effects::Effect,
    job::{Cancel, NoProgress},
};
use palpate_truth::{Stage, cases};

const TUNE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/truth/blind_tune.toml");
/// Few and short takes, for what holds of any session.
const SMALL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/truth/small.toml");

fn config(only: &str, first_seed: u64) -> BlindConfig {
    BlindConfig {
        world: World::A,
        seeds: 1,
        first_seed,
        nulls: 1,
        binary_only: false,
        leave_out: false,
        rule_scales: BTreeMap::new(),
        ablation: false,
        references: 0,
        only: vec![only.to_owned()],
        answers: None,
    }
}

fn touch(only: &str, seed: u64) -> BlindReport {
    tactile(Path::new(TUNE), &config(only, seed), &NoProgress, &Cancel::default()).unwrap()
}

/// The takes of the case with this label in the world of `truth`, and the nominal model of their station.
fn session(truth: &str, label: &str, seed: u64) -> (Vec<Take>, SensorModel) {
    let stage = Stage::read(Path::new(truth)).unwrap();
    let cases = cases(&stage, 1, seed).unwrap();
    let case = cases.iter().find(|case| case.label == label).unwrap();
    let nominal = SensorModel::from_toml("nominal", &stage.station().nominal_model_toml).unwrap();
    (stage.record(&case.hidden, case.seed).unwrap(), nominal)
}

#[test]
fn a_late_stream_is_named_beside_reference_sessions() {
    let config = BlindConfig { references: 3, ..config("latency strong", 3) };
    let scores = tactile(Path::new(TUNE), &config, &NoProgress, &Cancel::default()).unwrap().scores;
    assert_eq!((scores.cases, scores.named_correctly), (1, 1), "{scores:?}");
}

#[test]
fn a_session_is_judged_by_what_reference_sessions_leave() {
    let nominal = session(SMALL, "latency strong", 1).1;
    let healthy: Vec<Vec<Take>> = (1..4).map(|seed| session(SMALL, "nothing", seed).0).collect();
    let config = DiagnosisConfig { max_effects: 2, bootstrap_resamples: 0, ..DiagnosisConfig::default() };
    let measured =
        |sessions: &[Vec<Take>]| reference(&config, sessions, &nominal, &NoProgress, &Cancel::default());
    let too_few = measured(&healthy[..2]).unwrap_err().to_string();
    assert!(too_few.contains("at least 3"), "{too_few}");
    let reference = measured(&healthy).unwrap();
    let judged = |takes: &[Take], config: &DiagnosisConfig| {
        diagnose(config, takes, &nominal, None, &NoProgress, &Cancel::default(), &|| 0.0).unwrap()
    };
    let without = |rule: &str| BTreeMap::from([(rule.to_owned(), f64::INFINITY)]);
    let by_reference = DiagnosisConfig { reference: Some(reference), ..config.clone() };
    let ablated =
        DiagnosisConfig { ablation: ["usual", "repeats_more"].map(without).into(), ..by_reference.clone() };
    let (late, _) = session(SMALL, "latency strong", 1);
    let changed = judged(&late, &ablated);
    let beside = &changed.report;
    assert_eq!(beside.reference_sessions, Some(3));
    assert!(beside.notes.iter().any(|note| note.contains("3 reference sessions")), "{:?}", beside.notes);
    // Few and short takes: the healthy ones are explained by delays of their own, nearly as strong as what is hidden here.
    assert_eq!(beside.effects, []);
    assert!(beside.in_doubt.iter().any(|effect| effect.doubt[0].check == "usual"), "{:?}", beside.in_doubt);
    // An ablation says of a rule what a diagnosis without it says: of the one that withheld, and of one that did not.
    let unusual = judged(&late, &DiagnosisConfig { rule_scales: without("usual"), ..by_reference.clone() });
    let names = |effects: &[Effect]| -> Vec<_> {
        effects.iter().map(|effect| (effect.id.clone(), effect.place.clone())).collect()
    };
    let of_each: Vec<_> = changed.ablation.iter().map(|effects| names(effects)).collect();
    assert_eq!(of_each, [names(&unusual.model.effects), Vec::new()]);
    assert!(!of_each[0].is_empty());
    // A session is no stranger among those that it is judged by.
    let report = judged(&healthy[0], &by_reference).report;
    assert_eq!(report.effects, [], "{:?}", report.sentence);
    assert_eq!(report.unexplained.because, []);
}

#[test]
fn a_diagnosis_has_the_same_bits_for_any_number_of_threads() {
    let (takes, nominal) = session(SMALL, "latency strong", 1);
    let config = DiagnosisConfig { max_effects: 1, bootstrap_resamples: 20, ..DiagnosisConfig::default() };
    let report = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let run = || diagnose(&config, &takes, &nominal, None, &NoProgress, &Cancel::default(), &|| 0.0);
        serde_json::to_string(&pool.install(run).unwrap().report).unwrap()
    };
    assert_eq!(report(1), report(3));
}

#[test]
fn a_second_diagnosis_begins_where_the_first_ended_and_keeps_what_it_found() {
    let (takes, nominal) = session(TUNE, "latency strong", 3);
    let config = DiagnosisConfig { bootstrap_resamples: 0, ..DiagnosisConfig::default() };
    let diagnosed = |start: &SensorModel| {
        diagnose(&config, &takes, start, None, &NoProgress, &Cancel::default(), &|| 0.0).unwrap()
    };
    let first = diagnosed(&nominal);
    let names: Vec<&str> = first.report.effects.iter().map(|effect| effect.id.as_str()).collect();
    assert_eq!(names, ["latency"]);
    let second = diagnosed(&first.model);
    assert_eq!(second.report.held_out.nominal, first.report.held_out.diagnosed);
    assert!(second.report.gap.calibrated <= first.report.gap.diagnosed, "{:?}", second.report.gap);
    assert!(second.report.gap.diagnosed <= second.report.gap.calibrated, "{:?}", second.report.gap);
    assert!(second.report.held_out.diagnosed <= 1.1 * second.report.held_out.nominal, "{:?}", second.report);
    assert!(second.report.effects.is_empty(), "{:?}", second.report.effects);
    assert_eq!(second.model.effects, first.model.effects);
    // The loop: what was recorded next is diagnosed with what was there, from what was known.
    let (again, _) = session(TUNE, "latency strong", 4);
    let mut both = takes.clone();
    both.extend(again.into_iter().filter(|take| take.meta.primitive == "slide").map(|mut take| {
        take.id = format!("next/{}", take.id);
        take
    }));
    assert!(both.len() > takes.len());
    // As it was saved.
    let saved = SensorModel::from_toml("model.toml", &first.model.to_toml()).unwrap();
    let third = diagnose(&config, &both, &saved, None, &NoProgress, &Cancel::default(), &|| 0.0).unwrap();
    let known = |model: &SensorModel| {
        let named = model.effects.iter().find(|effect| effect.id == "latency");
        named.map(|effect| (effect.place.clone(), effect.parameters["delay_s"]))
    };
    let ((place, before_s), (still, after_s)) = (known(&first.model).unwrap(), known(&third.model).unwrap());
    assert_eq!(place, still);
    assert!((before_s - after_s).abs() < 0.005, "{before_s} s, then {after_s} s");
    assert!(third.report.effects.is_empty(), "{:?}", third.report.effects);
    assert!(third.report.gap.diagnosed <= 1.1 * third.report.gap.nominal, "{:?}", third.report.gap);
}

#[test]
fn without_marks_of_repetitions_nobody_can_tell_whether_something_is_left() {
    let (mut takes, nominal) = session(TUNE, "latency strong", 3);
    takes.iter_mut().for_each(|take| take.spans.retain(|span| span.kind != SpanKind::Repetition));
    let config = DiagnosisConfig { bootstrap_resamples: 0, max_effects: 1, ..DiagnosisConfig::default() };
    let outcome = diagnose(&config, &takes, &nominal, None, &NoProgress, &Cancel::default(), &|| 0.0);
    let report = outcome.unwrap().report;
    assert_eq!(report.verdict, Verdict::CannotBeJudged, "{:?}", report.unexplained.because);
    assert!(report.sentence.contains("no motion is repeated"), "{}", report.sentence);
    // So the first thing to do is to repeat one, that which touches most.
    let next = report.next_experiment.unwrap();
    assert_eq!((next.purpose, next.separates.len()), (Purpose::Repeat, 0), "{next:?}");
    let is_of_session =
        |take: &Take| take.meta.primitive == next.primitive && take.meta.object == next.object;
    assert!(takes.iter().any(is_of_session) && next.sentence.contains("touches most channels"), "{next:?}");
}

#[test]
fn nothing_hidden_is_given_no_name() {
    let scores = touch("nothing", 7).scores;
    assert_eq!((scores.null_cases, scores.false_alarms), (1, 0), "{scores:?}");
}

#[test]
fn the_hum_of_the_mains_is_unexplained_and_not_misnamed() {
    let scores = touch("mains_hum strong", 7).scores;
    assert_eq!((scores.unknown_cases, scores.unknown_flagged), (1, 1), "{scores:?}");
}

#[test]
fn a_gain_that_bends_with_a_joint_is_unexplained_and_the_joint_is_told() {
    let (takes, nominal) = session(TUNE, "joint_dependent_gain medium", 5);
    let config = DiagnosisConfig { bootstrap_resamples: 0, ..DiagnosisConfig::default() };
    let outcome = diagnose(&config, &takes, &nominal, None, &NoProgress, &Cancel::default(), &|| 0.0);
    let report = outcome.unwrap().report;
    assert_eq!(report.verdict, Verdict::Unexplained);
    let because = &report.unexplained.because;
    let about = because.iter().filter(|because| because.sentence.contains("a rad of middle_mcp_side"));
    assert_eq!(about.count(), 1, "{because:?}");
    let next = report.next_experiment.unwrap();
    assert!(matches!(next.purpose, Purpose::ShowMore | Purpose::Separate), "{next:?}");
    assert!(next.expected_gain > 0.0 && !next.primitive.is_empty() && !next.object.is_empty(), "{next:?}");
}

#[test]
fn a_stuck_channel_that_no_effect_explains_is_not_said_to_wrap() {
    let config = BlindConfig { leave_out: true, ..config("stuck_channel strong", 3) };
    let report = tactile(Path::new(TUNE), &config, &NoProgress, &Cancel::default()).unwrap();
    assert_eq!(report.scores.named_correctly, 1);
    let left_out = report.scores.left_out;
    assert_eq!((left_out.cases, left_out.misnamed, left_out.flagged), (1, 0, 1), "{left_out:?}");
}

#[test]
fn coulomb_friction_of_a_servo_is_named() {
    let report = actuator(&config("coulomb_friction, strong", 7), &NoProgress, &Cancel::default()).unwrap();
    assert_eq!((report.scores.cases, report.scores.named_correctly), (1, 1), "{report:?}");
}

#[test]
fn a_bench_without_a_case_says_so() {
    let error = actuator(&config("no such effect", 7), &NoProgress, &Cancel::default()).unwrap_err();
    assert!(matches!(error, BlindError::NoCase(_)), "{error}");
}

#[test]
fn answers_that_are_kept_are_not_asked_for_again() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("answers.jsonl");
    let config =
        BlindConfig { answers: Some(path.clone()), leave_out: true, ..config("coulomb_friction, strong", 7) };
    let asked = || actuator(&config, &NoProgress, &Cancel::default());
    let report = asked().unwrap();
    let lines = std::fs::read_to_string(&path).unwrap();
    assert_eq!(lines.lines().count(), 2, "as recorded, and with the effect left out");

    // What was said of the first, whichever was answered first, is changed, and the second cut off in the middle.
    let end = lines.find('\n').unwrap();
    let changed = lines[..end].replacen("\"explanation\":\"", "\"explanation\":\"Kept: ", 1);
    assert_ne!(changed, lines[..end]);
    std::fs::write(&path, format!("{changed}\n{}", &lines[end + 1..end + 100])).unwrap();
    assert_eq!(asked().unwrap().scores.left_out, report.scores.left_out);
    let again = std::fs::read_to_string(&path).unwrap();
    assert_eq!(
        again,
        format!("{changed}\n{}", &lines[end + 1..]),
        "the first is kept, the second asked for again"
    );

    std::fs::write(&path, "{}\n").unwrap();
    let error = asked().unwrap_err().to_string();
    assert!(error.contains("answers.jsonl: line 1: missing field"), "{error}");
}
