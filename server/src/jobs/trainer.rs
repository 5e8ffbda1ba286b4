//! `palpate-train` as a child process: the program that learns, which is built apart so that the studio never links
//! MuJoCo.
//!
//! It runs as [`child`] says. What it prints besides events goes to the log of the job.

use std::{
    env,
    ffi::OsString,
    fs,
    os::unix::{fs::PermissionsExt as _, process::ExitStatusExt as _},
    path::{Path, PathBuf},
    process::ExitStatus,
};

use palpate_terminal::child::{self, Listener};
use serde_json::Value;

use crate::Error;

/// Its name.
pub(crate) const PROGRAM: &str = "palpate-train";
/// Where `palpate-train` is looked for.
#[derive(Clone, Debug, Default)]
pub(crate) struct Trainer {
    /// What the configuration says; where it says nothing, it is looked for beside `palpate` and on `PATH`.
    pub(crate) configured: Option<PathBuf>,
    /// The `palpate` program.
    pub(crate) palpate: Option<PathBuf>,
}

impl Trainer {
    /// The program, or why there is none and what to do.
    pub(crate) fn find(&self) -> Result<PathBuf, Error> {
        if let Some(path) = &self.configured {
            return match is_program(path) {
                // It is run in another folder.
                true => std::path::absolute(path).map_err(Error::io("find", path)),
                false => Err(Error::NotInstalled(format!(
                    "the configuration says that {PROGRAM} is {path:?}, and no program is there; build it with `cargo build \
                     --release -p palpate_train --features mujoco`, or change [train] binary"
                ))),
            };
        }
        let beside = self.palpate.as_deref().and_then(Path::parent).map(|folder| folder.join(PROGRAM));
        let path = env::var_os("PATH").unwrap_or_default();
        let on_path = env::split_paths(&path).filter(|folder| folder.is_absolute());
        let mut places = beside.into_iter().chain(on_path.map(|folder| folder.join(PROGRAM)));
        places.find(|place| is_program(place)).ok_or_else(|| {
            Error::NotInstalled(format!(
                "{PROGRAM} is not installed beside palpate; build it with `cargo build --release -p palpate_train --features \
                 mujoco` and put it beside palpate or on PATH, or name it in the configuration ([train] binary)"
            ))
        })
    }

    /// Runs it in the folder `dir` with `args`; gives its report, if it made one.
    pub(crate) fn run(
        &self,
        dir: &Path,
        args: &[OsString],
        listener: &Listener<'_>,
    ) -> Result<Option<Value>, Error> {
        let program = self.find()?;
        let mut command = child::command(&program);
        let ended =
            child::run(command.args(args).current_dir(dir), listener).map_err(Error::io("run", &program))?;
        if listener.cancel.is_cancelled() {
            return Err(Error::Cancelled);
        }
        match ended.status.success() {
            true => Ok(ended.report),
            false => Err(failure(ended.status, &ended.complaint)),
        }
    }
}

fn is_program(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|meta| meta.is_file() && meta.permissions().mode() & 0o111 != 0)
}

fn failure(status: ExitStatus, complaint: &str) -> Error {
    match (status.signal(), complaint) {
        (Some(9), _) => Error::Internal(format!(
            "{PROGRAM} was killed (signal 9), by somebody or because memory ran out; see the log"
        )),
        (Some(signal), _) => Error::Internal(format!("{PROGRAM} ended by signal {signal}; see the log")),
        (None, "") => Error::Internal(format!(
            "{PROGRAM} ended with code {} and did not say why; see the log",
            status.code().unwrap_or(-1)
        )),
        (None, complaint) => Error::Content(complaint.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use std::{
        io,
        sync::{Arc, Mutex},
        thread,
        time::{Duration, Instant},
    };

    use palpate_sim::job::{Cancel, Progress};
    use serde_json::json;

    use super::*;

    #[derive(Default)]
    struct Heard(Mutex<Vec<(f64, String)>>);

    impl Progress for Heard {
        fn report(&self, fraction: f64, stage: &str) {
            self.0.lock().unwrap().push((fraction, stage.to_owned()));
        }
    }

    struct Ran {
        result: Result<Option<Value>, Error>,
        progress: Vec<(f64, String)>,
        points: Vec<Value>,
    }

    /// Runs a shell script in place of the program.
    fn run(script: &str, cancel: &Cancel) -> Ran {
        let dir = tempfile::tempdir().unwrap();
        let program = dir.path().join(PROGRAM);
        fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        let trainer = Trainer { palpate: Some(dir.path().join("palpate")), ..Trainer::default() };
        let (heard, points) = (Heard::default(), Mutex::new(Vec::new()));
        let listener = Listener {
            progress: &heard,
            metrics: &|point| points.lock().unwrap().push(Value::Object(point.clone())),
            log: &|_| {},
            cancel,
        };
        let mut tries = 0;
        let result = loop {
            match trainer.run(dir.path(), &["tune".into(), "--seed".into()], &listener) {
                // A process that was forked meanwhile may still hold the script open for writing.
                Err(Error::Io { source, .. })
                    if source.kind() == io::ErrorKind::ExecutableFileBusy && tries < 100 =>
                {
                    tries += 1;
                    thread::sleep(Duration::from_millis(10));
                }
                result => break result,
            }
        };
        Ran { result, progress: heard.0.into_inner().unwrap(), points: points.into_inner().unwrap() }
    }

    fn refused(script: &str) -> String {
        run(script, &Cancel::default()).result.unwrap_err().to_string()
    }

    #[test]
    fn events_are_passed_on_and_garbage_is_not_mistaken_for_one() {
        let ran = run(
            r#"echo "$@" >&2
echo '{"event":"progress","fraction":0.25,"stage":"trials"}'
echo 'not JSON at all'
printf '\377\376 no text\n'
echo '{"event":"progress","fraction":"much"}'
echo '{"event":"dance"}'
echo '[1,2'
echo '{"event":"metrics","point":{"step":3,"loss":0.5,"label":"cube","list":[1]}}'
echo '{"event":"metrics","point":{"loss":0.5}}'
echo '{"event":"report","report":{"won":4}}'
printf '{"event":"progress","fraction":0.75,"stage":"the last line has no end"}'"#,
            &Cancel::default(),
        );
        assert_eq!(ran.result.unwrap(), Some(json!({ "won": 4 })));
        let expected = [(0.25, "trials".to_owned()), (0.75, "the last line has no end".to_owned())];
        assert_eq!(ran.progress, expected);
        assert_eq!(ran.points, [json!({ "step": 3, "loss": 0.5 })]);
    }

    #[test]
    fn crash_is_told_from_a_refusal_and_both_say_why() {
        let said = "echo 'some warning' >&2; echo 'palpate-train: --object is \"cueb\"' >&2; exit 1";
        assert_eq!(refused(said), "--object is \"cueb\"");
        assert!(
            refused("echo \"error: unexpected argument '--events' found\" >&2; exit 2")
                .contains("unexpected")
        );
        assert!(refused("exit 3").contains("code 3 and did not say why"));
        assert!(refused("kill -9 $$").contains("killed (signal 9)"));
        assert!(refused("kill -11 $$").contains("signal 11"));
        // A report does not make up for a crash.
        assert!(refused("echo '{\"event\":\"report\",\"report\":1}'; exit 4").contains("code 4"));
        assert_eq!(run("true", &Cancel::default()).result.unwrap(), None, "there is no report");
    }

    #[test]
    fn request_to_stop_reaches_it_and_counts_however_it_ends() {
        for script in [
            "trap 'exit 0' TERM; echo '{\"event\":\"progress\",\"fraction\":0.5,\"stage\":\"on\"}'; read line",
            "exec sleep 600",
        ] {
            let cancel = Arc::new(Cancel::default());
            let (asked, begun) = (cancel.clone(), Instant::now());
            let asks = thread::spawn(move || {
                thread::sleep(Duration::from_millis(200));
                asked.cancel();
            });
            let ran = run(script, &cancel);
            asks.join().unwrap();
            assert!(matches!(ran.result, Err(Error::Cancelled)), "{script}: {:?}", ran.result);
            assert!(begun.elapsed() < Duration::from_secs(300), "it was not waited for");
        }
    }

    #[test]
    fn missing_program_says_how_to_get_it() {
        let dir = tempfile::tempdir().unwrap();
        let configured = dir.path().join(PROGRAM);
        let trainer = Trainer { configured: Some(configured.clone()), ..Trainer::default() };
        let err = trainer.find().unwrap_err();
        assert!(err.to_string().contains("cargo build"), "{err}");
        assert_eq!(err.class(), crate::Class::NotInstalled);
        fs::write(&configured, "").unwrap();
        assert!(trainer.find().is_err(), "a file that cannot be run is no program");
        fs::set_permissions(&configured, fs::Permissions::from_mode(0o755)).unwrap();
        assert_eq!(trainer.find().unwrap(), configured);
        let up: PathBuf = env::current_dir().unwrap().iter().skip(1).map(|_| "..").collect();
        let relative = up.join(configured.strip_prefix("/").unwrap());
        let found = Trainer { configured: Some(relative), ..Trainer::default() }.find().unwrap();
        assert!(found.is_absolute() && found.canonicalize().unwrap() == configured.canonicalize().unwrap());
    }
}
