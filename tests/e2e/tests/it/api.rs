//! The HTTP API from outside: the examples of its document as they are written, and a tester that nobody here wrote.
#![expect(clippy::unwrap_used, reason = "helpers of tests stop at what they do not expect, as tests do")]

use std::{
    fs,
    path::Path,
    process::Command,
    thread,
    time::{Duration, Instant},
};

use e2e::{Operator, Studio, Tools, alone, root, together};
use serde_json::{Value, json};

/// Whatever is waited for comes long before this, unless it never does.
const PATIENCE: Duration = Duration::from_secs(120);

/// A recording of the emulated probe bench, in `dir`.
fn record(tools: &Tools, dir: &Path) {
    let output = tools.palpate().args(["emulate", "--truth", "bench", "--out"]).arg(dir).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn wait(what: &str, mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < PATIENCE, "{what} does not come");
        thread::sleep(Duration::from_millis(50));
    }
}

/// The examples of the document that the studio serves: step, command and status.
fn examples(studio: &Studio) -> Vec<(u64, String, String)> {
    let document = studio.get("/openapi.json").unwrap();
    let mut examples = Vec::new();
    for item in document["paths"].as_object().unwrap().values() {
        for operation in item.as_object().unwrap().values() {
            for sample in operation["x-codeSamples"].as_array().into_iter().flatten() {
                let command = sample["source"].as_str().unwrap().to_owned();
                examples.push((sample["step"].as_u64().unwrap(), command, sample["status"].to_string()));
            }
        }
    }
    examples.sort();
    examples
}

#[test]
fn examples_of_the_document_are_answered_as_it_says() {
    let Some(tools) = Tools::find() else { return };
    // The studio runs a station.
    let _turn = alone();
    let dir = tempfile::tempdir().unwrap();
    record(&tools, &dir.path().join("bench"));
    let zip = Command::new(&tools.python)
        .args(["-m", "zipfile", "-c", "recordings.zip", "bench/"])
        .current_dir(dir.path())
        .status()
        .unwrap();
    assert!(zip.success());
    // The commands stay as they are; this makes each print its status last.
    let config = "silent\nshow-error\nmax-time = 300\nwrite-out = \"\\n%{http_code}\"\n";
    fs::write(dir.path().join(".curlrc"), config).unwrap();

    let studio = Studio::serve(&tools, &dir.path().join("data"), ["--emulate", "small"]).unwrap();
    wait("a station whose devices are ready", || {
        let live = studio.get("/live").unwrap();
        let devices = live["devices"].as_array().unwrap();
        !devices.is_empty() && devices.iter().all(|device| device["link"] == "ready")
    });
    let examples = examples(&studio);
    assert!(examples.len() > 50, "{examples:?}");
    let mut operator = None;
    for (_, command, status) in &examples {
        if operator.is_none() && command.contains("$LEASE") {
            let mut new = Operator::connect(&studio).unwrap();
            new.take_control("Ada").unwrap();
            operator = Some(new);
        }
        let output = Command::new("bash")
            .args(["-c", command])
            .current_dir(dir.path())
            .env("CURL_HOME", dir.path())
            .env("PALPATE_URL", &studio.url)
            .env("LEASE", operator.as_ref().map_or_else(String::new, |operator| operator.lease().to_string()))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        let complaint = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{command}: {}: {complaint}{said}", output.status);
        assert_eq!(said.lines().last(), Some(status.as_str()), "{command}: {said}");
        // A take that is over is read back before another can begin.
        wait("a take that is checked", || studio.get("/recording").unwrap()["free"]["state"] != "checking");
    }
    // They did something.
    let models = studio.get("/models").unwrap();
    assert_eq!(models[0]["id"], "bench-monday", "{models}");
    assert_eq!(studio.get("/recording").unwrap()["session"]["session"], "tuesday");
}

#[test]
fn schemathesis_finds_no_answer_that_the_document_does_not_foresee() {
    let Some(tools) = Tools::find() else { return };
    let _turn = together();
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir_all(dir.path().join("sessions")).unwrap();
    record(&tools, &dir.path().join("sessions/bench"));
    let studio = Studio::serve(&tools, dir.path(), ["--emulate", "small"]).unwrap();
    // Something for each path to be about; `hooks.py` knows the names.
    let start = json!({ "session": "bench" });
    let _accepted: Result<Value, _> = studio.post("/calibrations", &start);
    wait("a calibration that is done", || {
        studio.get("/calibrations/run-1").is_ok_and(|run| run["state"] == "done")
    });
    let _created: Result<Value, _> = studio.post("/calibrations/run-1/save", &json!({ "name": "kept" }));
    assert_eq!(studio.get("/models").unwrap()[0]["id"], "kept");

    // It keeps what it finds where it is started.
    let workplace = tempfile::tempdir().unwrap();
    for name in ["schemathesis.toml", "hooks.py"] {
        fs::copy(root().join("tests/e2e/python/api").join(name), workplace.path().join(name)).unwrap();
    }
    let report = tools.artifacts.join("schemathesis.xml");
    let output = Command::new(tools.python.with_file_name("st"))
        .arg("run")
        .arg(format!("{}/api/v1/openapi.json", studio.url))
        // The sockets are no requests with an answer; what moves the robot is refused without a lease.
        .args(["--exclude-path-regex", "^/(stream|control|foxglove)$", "--seed", "1", "--max-time", "30"])
        .args(["--report", "junit", "--report-junit-path"])
        .arg(&report)
        .current_dir(workplace.path())
        .env("PYTHONPATH", ".")
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .expect("schemathesis beside the Python of the tests");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    let cases = said.lines().find(|line| line.contains(" generated,")).unwrap_or("").trim().to_owned();
    let generated: u32 = cases.split(' ').next().unwrap().parse().expect("the number of cases");
    // Thousands on a machine that has nothing else to do.
    assert!(generated > 50, "only {cases}");
    eprintln!("schemathesis: {cases}");
    // Whatever it asked for, the robot stands and nobody has control.
    let live = studio.get("/live").unwrap();
    assert_eq!((&live["phase"], &live["holder"]), (&json!("disarmed"), &json!("")));
    assert!(!studio.log().contains("panicked"), "{}", studio.log());
}
