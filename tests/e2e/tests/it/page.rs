//! The page in a real browser.

use std::{
    ffi::OsStr,
    fs,
    io::Write as _,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use e2e::{Studio, Tools, alone, demo_session, root, together};

/// A data folder with the demonstration session alone: what one test saves is not there for another.
fn own_data(tools: &Tools) -> anyhow::Result<tempfile::TempDir> {
    let recorded = demo_session(tools)?.join("sessions/demo");
    let data = tempfile::tempdir()?;
    let session = data.path().join("sessions/demo");
    fs::create_dir_all(&session)?;
    for entry in fs::read_dir(recorded)? {
        let entry = entry?;
        fs::copy(entry.path(), session.join(entry.file_name()))?;
    }
    Ok(data)
}

/// Runs a script of the browser tests on `studio`. It must leave nothing in the temporary folder.
fn run_script(tools: &Tools, studio: &Studio, script: &str) {
    let temporary = tempfile::tempdir().expect("a folder");
    let status = Command::new("node")
        .arg(script)
        .arg(&studio.url)
        .arg(&tools.artifacts)
        .current_dir(&tools.browser_tests)
        .env("TMPDIR", temporary.path())
        .status()
        .expect("node");
    assert!(status.success(), "{script} failed; see above and the pictures in target/e2e");
    let left: Vec<_> = fs::read_dir(temporary.path()).expect("the folder").flatten().collect();
    assert!(left.is_empty(), "{script} left {left:?} in the temporary folder");
}

/// Runs a script of the browser tests on a studio with the demonstration session.
fn browser_test(script: &str) {
    let Some(tools) = Tools::find_with_browser() else { return };
    let _turn = together();
    let data = own_data(&tools).expect("the demonstration session");
    let studio = Studio::start(&tools, data.path()).expect("a studio");
    run_script(&tools, &studio, script);
}

/// Runs a script that commands the emulated station of `truth`. It comes first on the machine: a page that waits a moment
/// does no harm, a station that does holds.
fn station_test(script: &str, truth: &Path) {
    let Some(tools) = Tools::find_with_browser() else { return };
    let _turn = alone();
    let data = tempfile::tempdir().expect("a folder");
    let arguments = [OsStr::new("--emulate"), truth.as_os_str()];
    let studio = Studio::serve(&tools, data.path(), arguments).expect("a studio");
    run_script(&tools, &studio, script);
}

/// The shipped station with a plan of short takes, which comes first among its plans; gives the folder and the truth file.
fn station_with_short_takes() -> anyhow::Result<(tempfile::TempDir, PathBuf)> {
    let dir = tempfile::tempdir()?;
    copy_folder(&root().join("assets"), dir.path())?;
    let plan = "four_short_takes.toml";
    fs::copy(root().join("tests/e2e/plans").join(plan), dir.path().join("plans").join(plan))?;
    let truth = dir.path().join("truth/demo.toml");
    for (file, list) in [("truth/demo.toml", "plan = "), ("stations/xarm6_leap.toml", "plans = [")] {
        let path = dir.path().join(file);
        let text = fs::read_to_string(&path)?;
        let comma = if list.ends_with('[') { ", " } else { " #" };
        let first = format!("{list}\"../plans/{plan}\"{comma}");
        anyhow::ensure!(text.contains(list), "{file} has no {list:?}");
        fs::write(&path, text.replacen(list, &first, 1))?;
    }
    Ok((dir, truth))
}

fn copy_folder(from: &Path, to: &Path) -> std::io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let copy = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            copy_folder(&entry.path(), &copy)?;
        } else {
            fs::copy(entry.path(), copy)?;
        }
    }
    Ok(())
}

/// Adds somebody who may log in with "a password of NAME".
fn add_person(tools: &Tools, data: &Path, name: &str, role: &str) {
    let mut add = tools
        .palpate()
        .args(["people", "add", name, "--role", role, "--data"])
        .arg(data)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .expect("the command starts");
    let mut input = add.stdin.take().expect("its input");
    writeln!(input, "a password of {name}").expect("it reads the password");
    drop(input);
    assert!(add.wait().expect("it ends").success());
}

#[test]
fn people_may_what_their_role_says() {
    let Some(tools) = Tools::find_with_browser() else { return };
    let _turn = together();
    let data = own_data(&tools).expect("the demonstration session");
    add_person(&tools, data.path(), "vera", "viewer");
    add_person(&tools, data.path(), "olga", "operator");
    let studio = Studio::serve(&tools, data.path(), ["--login", "--tls"]).expect("a studio");
    run_script(&tools, &studio, "people.mjs");
}

#[test]
fn operator_calibrates_by_clicking() {
    browser_test("studio.mjs");
}

#[test]
fn operator_diagnoses_adds_and_undoes_by_clicking() {
    browser_test("diagnose.mjs");
}

#[test]
fn accessible_mirror_of_every_screen_has_no_serious_fault() {
    browser_test("axe.mjs");
}

#[test]
fn operator_commands_the_station_and_others_can_watch() {
    station_test("operate.mjs", &root().join("assets/truth/demo.toml"));
}

#[test]
fn page_of_another_origin_gets_nowhere() {
    station_test("foreign.mjs", &root().join("assets/truth/small.toml"));
}

#[test]
fn stop_is_free_at_every_size_and_zoom() {
    station_test("stop.mjs", &root().join("assets/truth/demo.toml"));
}

#[test]
fn operator_records_a_session_by_the_wizard_and_calibrates_on_it() {
    let (_dir, truth) = station_with_short_takes().expect("a station with a plan of its own");
    station_test("record.mjs", &truth);
}
