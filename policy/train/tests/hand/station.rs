//! The physical emulated station: a studio drives it as any other, and an object that a rollout closes the hand on is lifted.

use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

use serde_json::{Value, json};

use super::recorded;
use super::rollouts::replay;
use super::{palpate_train, root, turn};

/// A process that prints a line when it is ready, and ends with its owner.
pub(crate) struct Ready {
    process: Child,
    pub(crate) line: String,
    _stdout: BufReader<ChildStdout>,
}

impl Ready {
    pub(crate) fn start(command: &mut Command) -> Self {
        let mut process = command
            .current_dir(root())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the command starts");
        let mut stdout = BufReader::new(process.stdout.take().expect("its output"));
        let mut line = String::new();
        stdout.read_line(&mut line).expect("a line");
        Self { process, line, _stdout: stdout }
    }

    /// What it printed, as JSON.
    pub(crate) fn says(&self) -> Value {
        serde_json::from_str(&self.line).expect("JSON")
    }
}

/// The physical emulated station with a cube, its links in `dir`, and what it says of itself.
pub(crate) fn cube_station(dir: &Path) -> (Ready, Value) {
    let station = Ready::start(
        palpate_train()
            .args(["station", "--object", "cube", "--xarm-ports", "any", "--real-time", "--dir"])
            .arg(dir),
    );
    let says = station.says();
    (station, says)
}

/// A studio with the data folder `data`, started with `flags` too, that drives the station that `says` so, if any; and its
/// address.
pub(crate) fn studio(palpate: &Path, data: &Path, flags: &[&str], says: &Value) -> (Ready, String) {
    let serve = says["serve"].as_array().into_iter().flatten().filter_map(Value::as_str);
    let mut command = Command::new(palpate);
    command
        .args(["serve", "--json", "--listen", "127.0.0.1:0"])
        .args(flags)
        .arg("--data")
        .arg(data)
        .args(serve);
    let studio = Ready::start(&mut command);
    let url = studio.says()["url"].as_str().expect("an address").to_owned();
    (studio, url)
}

impl Drop for Ready {
    fn drop(&mut self) {
        // SIGTERM lets it remove its links and end all motion.
        let _ = Command::new("kill").arg(self.process.id().to_string()).status();
        let _ = self.process.wait();
    }
}

/// The `palpate` command; `None` where `PALPATE_SKIP` names `e2e`.
pub(crate) fn palpate() -> Option<PathBuf> {
    if skip::leaves_out("e2e") {
        return None;
    }
    let palpate = std::env::var_os("PALPATE_BIN").map(PathBuf::from);
    assert!(
        palpate.is_some(),
        "the studio is set up by `cargo xtask test`; PALPATE_SKIP=e2e leaves these tests out"
    );
    palpate
}

/// What a test needs that opens the page.
pub(crate) struct Browser {
    /// The `palpate` command, with the page inside.
    pub(crate) palpate: PathBuf,
    /// The folder of the scripts, with what drives the browser.
    pub(crate) scripts: PathBuf,
    /// Where pictures go.
    pub(crate) artifacts: PathBuf,
}

/// A browser; `None` where `PALPATE_SKIP` names `e2e` or `browser`.
pub(crate) fn browser() -> Option<Browser> {
    if skip::leaves_out("browser") {
        return None;
    }
    let palpate = palpate()?;
    let path = |name: &str| {
        let path = std::env::var_os(name).map(PathBuf::from);
        path.expect(
            "the browser is set up by `cargo xtask test`; PALPATE_SKIP=browser leaves these tests out",
        )
    };
    Some(Browser { palpate, scripts: path("PALPATE_BROWSER_TESTS"), artifacts: path("PALPATE_ARTIFACTS") })
}

/// Asks the operator of the station.
fn ask(socket: &str, request: &Value) -> Value {
    let mut stream = UnixStream::connect(socket).expect("the operator's socket");
    writeln!(stream, "{request}").expect("a request");
    let mut line = String::new();
    BufReader::new(stream).read_line(&mut line).expect("an answer");
    serde_json::from_str(&line).expect("JSON")
}

/// How far any channel rose in the mean of half a second above that of the first half second, counts: noise is a hundredth of a
/// threshold in such a mean.
fn most_pressed(frames: &[&Value]) -> f64 {
    const HALF_A_SECOND: usize = 15;
    let mean = |frames: &[&Value], channel: usize| -> f64 {
        let raw = frames.iter().filter_map(|frame| frame["raw"][channel].as_f64());
        raw.sum::<f64>() / frames.len() as f64
    };
    let num_channels = frames[0]["raw"].as_array().map_or(0, Vec::len);
    let rises = (0..num_channels).map(|channel| {
        let before = mean(&frames[..HALF_A_SECOND], channel);
        let later = frames.chunks(HALF_A_SECOND).map(|chunk| mean(chunk, channel));
        later.fold(0.0, f64::max) - before
    });
    rises.fold(0.0, f64::max)
}

#[test]
fn a_rollout_on_the_physical_station_feels_the_cube_and_lifts_it() {
    let Some(palpate) = palpate() else { return };
    let _turn = turn();
    let folder = tempfile::tempdir().expect("a folder");
    let dir = folder.path().join("devices");
    let (_station, found) = cube_station(&dir);
    let operator = found["operator"].as_str().expect("a socket").to_owned();
    let (_studio, url) = studio(&palpate, &folder.path().join("data"), &[], &found);

    // What makes no sense is refused with its reason, and changes nothing.
    let before = ask(&operator, &json!({ "act": "state" }));
    for (request, expected) in [
        (json!({ "act": "place", "object": "no such thing" }), "no object in"),
        (json!({ "act": "place", "side": 2.0 }), "side is 2"),
        (json!({ "act": "dance" }), "not a request"),
        (json!({ "act": "start", "seed": 1, "trial": 0, "start_cm": -1.0 }), "start_cm is -1"),
    ] {
        let reply = ask(&operator, &request);
        let problem = reply["problem"].as_str().unwrap_or_default();
        assert!(reply["ok"] == false && problem.contains(expected), "{request}: {reply}");
    }
    assert_eq!(ask(&operator, &json!({ "act": "state" }))["placements"], before["placements"]);

    let out = folder.path().join("rollout");
    let output = palpate_train()
        .args(["rollout", "--json", "--policy", "assets/policies/cube.safetensors", "--seed", "5", "--url"])
        .arg(&url)
        .args(["--operator", &operator, "--record", "grasps", "--out"])
        .arg(&out)
        .output()
        .expect("the command starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let outcome: Value = serde_json::from_slice(&output.stdout).expect("an outcome");
    eprintln!("{outcome:#}");
    recorded::check(&palpate, &url, &folder.path().join("data/sessions/grasps"), &outcome);
    let truth = &outcome["truth"];
    // In 14 of 200 such trials the cube slid in the soft grip and hung less than the 15 mm up that a success needs; the
    // lowest hung 4.9 mm up.
    assert!(truth["lift_m"].as_f64().expect("a height") > 0.003, "it is off the table: {truth}");
    assert_eq!(truth["touched"], true);
    assert_eq!(outcome["suggested"], "success");

    let text = std::fs::read_to_string(out.join("trial-0000.jsonl")).expect("a record");
    let record: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let frames: Vec<&Value> = record.iter().filter(|line| line["kind"] == "frame").collect();
    let drawn = |frame: &Value| -> f64 {
        frame["currents_a"].as_array().into_iter().flatten().filter_map(Value::as_f64).map(f64::abs).sum()
    };
    let (first, last) = (frames.first().expect("frames"), frames.last().expect("frames"));
    assert!(drawn(last) > drawn(first) + 0.3, "fingers that press draw current: {first} {last}");
    // Fingers that are as weak as the shipped station's press too softly for most thresholds; the skin gives way all the same.
    let felt = most_pressed(&frames);
    assert!(felt > 25.0, "the channel that is pressed most rose by {felt} counts");
    assert!(replay(&record) > 40);

    // The trial is found again in the grasp world: it begins where it began, and its touch is compared.
    let output = palpate_train()
        .args(["compare-rollout", "--json", "--truth", "assets/truth/demo.toml", "--rollout"])
        .arg(&out)
        .output()
        .expect("the command starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let compared: Value = serde_json::from_slice(&output.stdout).expect("a document");
    eprintln!("{compared:#}");
    assert_eq!((&compared["compared"], &compared["hand"]["seen_by_operator"]), (&json!(1), &json!(1)));
    for model in compared["models"].as_array().expect("models") {
        // The expert wins this start in every sense of touch.
        assert_eq!(model["same_start"]["successes"], 1, "{model}");
        let apart = model["same_commands"]["joint_difference"].as_array().expect("joints");
        let arm = &apart[..6];
        assert!(
            arm.iter().flat_map(Value::as_f64).all(|apart| apart < 0.05),
            "the arm goes the same way: {model}"
        );
    }
}
