//! Contact maps from the command line: learned on some takes, judged on others.

use std::fs;
use std::path::Path;

use palpate_reports::ContactMapReport;
use palpate_server::assets;
use palpate_sim::job::{Cancel, NoProgress};
use palpate_truth::record_session;

use crate::support::{Data, arg, palpate_ok, palpate_refuses};

const HELD_OUT: &str = "take-02,take-05";

fn fit(session: &Path, out: &Path) -> ContactMapReport {
    let args = [
        "contact-map",
        "fit",
        "--session",
        arg(session),
        "--hold-out",
        HELD_OUT,
        "--out",
        arg(out),
        "--json",
    ];
    serde_json::from_str(&palpate_ok(&args)).unwrap()
}

#[test]
fn a_map_is_learned_on_some_takes_and_judged_on_others_alone() {
    let data = Data::with_emulated_session();
    let session = data.session();
    let out = data.path("map.toml");
    let report = fit(session, &out);
    assert_eq!(report.judged_takes, ["take-02", "take-05"]);
    assert_eq!(report.fitted_takes, ["take-01", "take-03", "take-04", "take-06"]);
    let pairs: Vec<(&str, &str)> =
        report.rows.iter().map(|row| (row.hardware.as_str(), row.simulation.as_str())).collect();
    let expected = [("thresholds", "nominal"), ("thresholds", "calibrated"), ("contact map", "calibrated")];
    assert_eq!(pairs, expected);
    assert!(report.rows[2].metrics.f1 > report.rows[0].metrics.f1, "{:?}", report.rows);

    // A file of its own says the same of the same takes, and takes that it was fitted to do not judge.
    let judge = ["contact-map", "judge", "--map", arg(&out), "--session", arg(session), "--json"];
    let judged: ContactMapReport = serde_json::from_str(&palpate_ok(&judge)).unwrap();
    assert_eq!(judged.judged_takes, report.judged_takes);
    assert_eq!(judged.rows.last().unwrap().metrics, report.rows[2].metrics);
    assert_eq!(judged.notes.len(), 4, "{:?}", judged.notes);

    // Other takes in place of the held-out ones leave every bit of the map as it is; in place of a fitted one they do not.
    let map = fs::read(&out).unwrap();
    let other = data.path("other");
    let (truth, _unpacked) = assets::truth(Path::new("bench")).unwrap();
    record_session(&truth, &other, 1, &NoProgress, &Cancel::default()).unwrap();
    for take in HELD_OUT.split(',') {
        let file = format!("{take}.mcap");
        fs::copy(other.join(&file), session.join(&file)).unwrap();
    }
    let again = fit(session, &out);
    assert_ne!(again.rows[2].metrics, report.rows[2].metrics, "other takes judge");
    assert_eq!(fs::read(&out).unwrap(), map);
    fs::copy(other.join("take-03.mcap"), session.join("take-03.mcap")).unwrap();
    fit(session, &out);
    assert_ne!(fs::read(&out).unwrap(), map);
}

#[test]
fn what_no_map_can_be_learned_from_is_refused() {
    let data = Data::with_session();
    let session = data.session();
    let refused = |args: &[&str], word: &str| {
        let args = [&["contact-map"], args].concat();
        let error = palpate_refuses(&args);
        assert!(error.contains(word), "{word:?} is missing in {error:?}");
    };
    let fit = |more: &[&str], word: &str| {
        refused(&[&["fit", "--session", arg(session)], more].concat(), word);
    };
    fit(&["--hold-out", "take-55"], "take-55");
    fit(&["--hold-out", "take-01,take-02,take-03,take-04"], "none is left to fit");
    fit(&["--out", arg(&data.path("nowhere/map.toml"))], "nowhere");
    fit(&["--target", arg(&data.path("nowhere.toml"))], "nowhere.toml");
    fit(&["--hidden", "4000"], "--hidden is 4000");
    let no_map = data.path("model.toml");
    fs::write(&no_map, "format = 1\nname = \"a sensor model\"\n").unwrap();
    let judge = ["judge", "--session", arg(session), "--map", arg(&no_map)];
    refused(&judge, "no contact map that palpate wrote");

    data.edit_session(|text| {
        let takes: Vec<&str> = text.split("[[take]]").collect();
        format!("{}[[take]]{}", takes[0], takes[1])
    });
    fit(&[], "1 accepted take");
}
