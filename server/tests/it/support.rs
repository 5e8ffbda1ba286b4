//! A small recording on the shipped probe bench, and ways to ask the server and the command about it.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    fs,
    io::{Cursor, Write as _},
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::{Arc, LazyLock},
    time::{Duration, Instant},
};

use axum::{
    Router,
    body::{Body, Bytes},
    http::{HeaderMap, Request, StatusCode, header},
};
use http_body_util::BodyExt as _;
use palpate_recording::{Session, import::import_csv};
use palpate_server::{Access, AppState, Studio, app, assets};
use palpate_sim::job::{Cancel, NoProgress};
use palpate_truth::record_session;
use palpate_wire::api::{Job, ProblemDetails};
use serde::de::DeserializeOwned;
use tower::ServiceExt as _;
use zip::{ZipWriter, write::SimpleFileOptions};

pub(crate) const STATION: &str = "probe-bench";
pub(crate) const NUM_TAKES: usize = 4;
pub(crate) const NUM_FRAMES: usize = 300;
pub(crate) const NUM_DOFS: usize = 3;
pub(crate) const NUM_CHANNELS: usize = 15;

const DURATION_S: f64 = 12.0;
/// The real sensors answer late; the nominal simulator knows nothing of it.
const LATENCY_S: f64 = 0.12;

/// A take of taps onto the sphere: with the gel in the middle, or with a film sensor at the side.
#[derive(Clone, Copy)]
struct Taps {
    x_m: f64,
    /// Stage height at which the pad just touches.
    touch_z_m: f64,
    gel: bool,
}

/// Pad and sphere are balls of 40 and 50 mm; the sphere lies on the table.
fn taps(gel: bool) -> Taps {
    let lean_rad: f64 = if gel { 0.0 } else { 0.62 };
    Taps { x_m: -0.09 * lean_rad.sin(), touch_z_m: 0.05 + 0.09 * lean_rad.cos() - 0.04, gel }
}

impl Taps {
    /// 6 mm above to 2 mm below the touch and back in 3 s, after a second of rest.
    fn z_m(self, time_s: f64) -> f64 {
        let phase = (time_s - 1.0).max(0.0) / 3.0;
        let lowered = (1.0 - (2.0 * phase.fract() - 1.0).abs()) * 0.008;
        self.touch_z_m + 0.006 - lowered
    }

    fn felt(self, time_s: f64) -> bool {
        self.z_m(time_s - LATENCY_S) < self.touch_z_m - 0.0005
    }
}

fn csv(columns: usize, letter: char, rate_hz: f64, row: impl Fn(f64, usize) -> f64) -> String {
    let mut text = "t_s".to_owned();
    for column in 0..columns {
        write!(text, ",{letter}{column}").unwrap();
    }
    for sample in 0..(DURATION_S * rate_hz).round() as usize {
        let time_s = sample as f64 / rate_hz;
        write!(text, "\n{time_s}").unwrap();
        for column in 0..columns {
            write!(text, ",{}", row(time_s, column)).unwrap();
        }
    }
    text.push('\n');
    text
}

/// Writes a CSV import folder of [`NUM_TAKES`] takes.
pub(crate) fn write_recording(dir: &Path) {
    for take_idx in 0..NUM_TAKES {
        let taps = taps(take_idx % 2 == 0);
        let take_dir = dir.join(format!("take-{:02}", take_idx + 1));
        fs::create_dir_all(&take_dir).unwrap();
        let take_toml = "object = \"sphere_50mm\"\n\
            object_pose = { position_m = [0.0, 0.0, 0.05], quaternion_wxyz = [1.0, 0.0, 0.0, 0.0] }\n\
            primitive = \"tap\"\nbaseline_s = [0.0, 0.9]\n";
        fs::write(take_dir.join("take.toml"), take_toml).unwrap();
        let joints = csv(NUM_DOFS, 'q', 25.0, |time_s, dof| [taps.x_m, 0.0, taps.z_m(time_s)][dof]);
        fs::write(take_dir.join("joints.csv"), joints).unwrap();
        // The middle taxel of the gel, and the first film sensor.
        let gel = csv(9, 'v', 200.0, |time_s, taxel| {
            if taps.gel && taxel == 4 && taps.felt(time_s) { 900.0 } else { 200.0 + taxel as f64 }
        });
        fs::write(take_dir.join("gel.csv"), gel).unwrap();
        let film =
            csv(
                6,
                'v',
                50.0,
                |time_s, sensor| {
                    if !taps.gel && sensor == 0 && taps.felt(time_s) { 1500.0 } else { 300.0 }
                },
            );
        fs::write(take_dir.join("film.csv"), film).unwrap();
    }
}

/// The same recording made the other way round: the pad stays where it was at first, and the sphere moves against it.
pub(crate) fn write_recording_of_moving_object(dir: &Path) {
    write_recording(dir);
    for take_idx in 0..NUM_TAKES {
        let taps = taps(take_idx % 2 == 0);
        let take_dir = dir.join(format!("take-{:02}", take_idx + 1));
        let joints = csv(NUM_DOFS, 'q', 25.0, |_, dof| [taps.x_m, 0.0, taps.z_m(0.0)][dof]);
        fs::write(take_dir.join("joints.csv"), joints).unwrap();
        let mut object = "t,x_mm,y_mm,z_mm\n".to_owned();
        // The frames' times, so that nothing lies between two poses.
        for sample in 0..NUM_FRAMES {
            let time_s = sample as f64 / 25.0;
            let height_mm = 1e3 * (0.05 - (taps.z_m(time_s) - taps.z_m(0.0)));
            writeln!(object, "{time_s},0,0,{height_mm}").unwrap();
        }
        fs::write(take_dir.join("object.csv"), object).unwrap();
        let take_toml = "object = \"sphere_50mm\"\nprimitive = \"tap\"\nbaseline_s = [0.0, 0.9]\n";
        fs::write(take_dir.join("take.toml"), take_toml).unwrap();
    }
}

/// A data folder with the recording as session `taps`, and the CSV folder it was made of.
pub(crate) struct Data {
    dir: tempfile::TempDir,
    root: PathBuf,
    csv: PathBuf,
    session: PathBuf,
}

impl Data {
    pub(crate) fn empty() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("data");
        Self { csv: dir.path().join("csv"), session: root.join("sessions/taps"), root, dir }
    }

    pub(crate) fn with_session() -> Self {
        let data = Self::empty();
        write_recording(data.csv());
        let station = assets::station(STATION).unwrap();
        import_csv(&station, data.csv(), data.session()).unwrap();
        data
    }

    /// A data folder with session `bench`: the shipped emulated probe bench, whose truth the simulator does not know.
    pub(crate) fn with_emulated_session() -> Self {
        let mut data = Self::empty();
        data.session = data.root.join("sessions/bench");
        fs::create_dir_all(data.root.join("sessions")).unwrap();
        let (truth, _unpacked) = assets::truth(Path::new("bench")).unwrap();
        record_session(&truth, data.session(), 0, &NoProgress, &Cancel::default()).unwrap();
        data
    }

    /// The server's folder.
    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    pub(crate) fn csv(&self) -> &Path {
        &self.csv
    }

    pub(crate) fn session(&self) -> &Path {
        &self.session
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub(crate) fn state(&self) -> Arc<AppState> {
        Studio::open(self.root(), None, access()).unwrap().state
    }

    pub(crate) fn app(&self) -> Router {
        app(self.state())
    }

    /// Ends the studio `app` and starts another on the same folder.
    pub(crate) async fn restart(&self, app: Router) -> Router {
        drop(app);
        // The thread of runs lets go of the folder a moment after a run has ended.
        let patience = Instant::now();
        loop {
            match Studio::open(self.root(), None, access()) {
                Ok(studio) => return palpate_server::app(studio.state),
                Err(err) => assert!(patience.elapsed() < Duration::from_secs(60), "{err}"),
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    /// Cuts the last third off the session's second take.
    pub(crate) fn truncate_take(&self) -> String {
        let session = Session::open(self.session()).unwrap();
        let entry = &session.file.takes[1];
        let path = session.take_path(entry);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() * 2 / 3]).unwrap();
        entry.file.clone()
    }

    /// Edits `session.toml`.
    pub(crate) fn edit_session(&self, edit: impl FnOnce(String) -> String) {
        let path = self.session().join("session.toml");
        let text = fs::read_to_string(&path).unwrap();
        let edited = edit(text.clone());
        assert_ne!(text, edited);
        fs::write(path, edited).unwrap();
    }
}

/// Every file below `dir` with its content.
pub(crate) fn tree(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let Ok(entries) = fs::read_dir(dir) else { return files };
    for entry in entries {
        let path = entry.unwrap().path();
        if path.to_string_lossy().ends_with(".sqlite-shm") {
            // What readers of an open database share is no data.
            continue;
        }
        if path.is_dir() {
            files.insert(path.clone(), Vec::new());
            files.extend(tree(&path));
        } else {
            files.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
    files
}

/// A zip archive of everything below `dir`, inside a folder called `prefix` unless that is empty.
pub(crate) fn zip_folder(dir: &Path, prefix: &str) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (path, content) in tree(dir) {
        if path.is_file() {
            let name = Path::new(prefix).join(path.strip_prefix(dir).unwrap());
            writer.start_file(name.to_str().unwrap(), SimpleFileOptions::default()).unwrap();
            writer.write_all(&content).unwrap();
        }
    }
    writer.finish().unwrap().into_inner()
}

/// An answer of the server.
pub(crate) struct Answer {
    pub(crate) status: StatusCode,
    pub(crate) headers: HeaderMap,
    pub(crate) body: Bytes,
}

impl Answer {
    pub(crate) fn json<T: DeserializeOwned>(&self) -> T {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|err| panic!("{err}: {} {:?}", self.status, String::from_utf8_lossy(&self.body)))
    }

    pub(crate) fn header(&self, name: header::HeaderName) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().unwrap())
    }

    /// Whatever it is, it must be well-formed problem details with this status; gives the detail.
    pub(crate) fn problem(&self, status: u16) -> String {
        let shown = String::from_utf8_lossy(&self.body);
        assert_eq!(self.status.as_u16(), status, "{shown}");
        assert_eq!(self.header(header::CONTENT_TYPE), "application/problem+json", "{shown}");
        let problem: ProblemDetails = self.json();
        assert_eq!(problem.status, status);
        assert!(!problem.title.is_empty() && !problem.detail.is_empty(), "{shown}");
        problem.detail
    }
}

pub(crate) async fn get(app: &Router, path: &str) -> Answer {
    send(app, "GET", path, None).await
}

pub(crate) async fn post(app: &Router, path: &str, body: &serde_json::Value) -> Answer {
    send(app, "POST", path, Some(("application/json", body.to_string().into_bytes()))).await
}

/// Job `id` as soon as it is as `until` says.
pub(crate) async fn wait(app: &Router, id: &str, until: impl Fn(&Job) -> bool) -> Job {
    let patience = Instant::now();
    loop {
        let job: Job = get(app, &format!("/api/v1/jobs/{id}")).await.json();
        if until(&job) {
            return job;
        }
        assert!(patience.elapsed() < Duration::from_secs(200), "{job:?}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Job `id` as soon as it has ended.
pub(crate) async fn ended(app: &Router, id: &str) -> Job {
    wait(app, id, |job| !job.is_unfinished()).await
}

pub(crate) async fn send(app: &Router, method: &str, path: &str, body: Option<(&str, Vec<u8>)>) -> Answer {
    let mut request = Request::builder().method(method).uri(path).header(header::HOST, "localhost");
    if let Some((content_type, _)) = &body {
        request = request.header(header::CONTENT_TYPE, *content_type);
    }
    let request = request.body(body.map_or_else(Body::empty, |(_, bytes)| Body::from(bytes))).unwrap();
    answer_of(app, request).await
}

/// Sends `request`. Whatever the answer is, the OpenAPI document must foresee it.
pub(crate) async fn answer_of(app: &Router, request: Request<Body>) -> Answer {
    let (method, path) = (request.method().clone(), request.uri().path().to_owned());
    let response = app.clone().oneshot(request).await.unwrap();
    let (parts, body) = response.into_parts();
    let body = body.collect().await.unwrap().to_bytes();
    let answer = Answer { status: parts.status, headers: parts.headers, body };
    foreseen(method.as_str(), &path, &answer);
    answer
}

/// Status and content type of an answer are among those that the document gives for the route.
fn foreseen(method: &str, path: &str, answer: &Answer) {
    static DOCUMENT: LazyLock<serde_json::Value> = LazyLock::new(palpate_server::openapi_document);
    let Some(path) = path.strip_prefix("/api/v1/") else { return };
    let parts: Vec<&str> = path.split('/').collect();
    let fits = |template: &str| {
        let template: Vec<&str> = template.trim_start_matches('/').split('/').collect();
        let same = |(template, part): (&&str, &&str)| template.starts_with('{') || template == part;
        template.len() == parts.len() && template.iter().zip(&parts).all(same)
    };
    let paths = DOCUMENT["paths"].as_object().unwrap().iter();
    // Of several templates that fit, the one with the fewest braces is meant.
    let item = paths
        .filter(|(template, _)| fits(template))
        .min_by_key(|(template, _)| template.matches('{').count());
    let Some(operation) = item.and_then(|(_, item)| item.get(method.to_lowercase())) else { return };
    let status = answer.status.as_u16().to_string();
    let mut said = &operation["responses"][&status];
    if let Some(reference) = said["$ref"].as_str() {
        said = DOCUMENT.pointer(&reference[1..]).unwrap();
    }
    assert!(said.is_object(), "{method} /{path} answered {status}, which the document does not foresee");
    let content_type = answer.header(header::CONTENT_TYPE).split(';').next().unwrap_or("");
    let said = said["content"].as_object();
    let is_said = |said: &serde_json::Map<String, serde_json::Value>| {
        said.contains_key(content_type) || said.contains_key("*/*")
    };
    let fits = said.map_or(answer.body.is_empty(), is_said);
    assert!(fits, "{method} /{path} answered {status} with {content_type:?}; the document says {said:?}");
}

/// As a studio is opened: its jobs run as the command, not as the tests.
pub(crate) fn access() -> Access {
    Access { program: Some(env!("CARGO_BIN_EXE_palpate").into()), ..Access::default() }
}

/// Runs `palpate` with `args`.
pub(crate) fn palpate(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_palpate")).args(args).env_remove("RUST_LOG").output().unwrap()
}

/// Runs `palpate`, which must succeed; gives its standard output.
pub(crate) fn palpate_ok(args: &[&str]) -> String {
    let output = palpate(args);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{args:?}: {stderr}");
    String::from_utf8(output.stdout).unwrap()
}

/// Runs `palpate`, which must refuse its input with one line of error and exit code 2; gives the line.
pub(crate) fn palpate_refuses(args: &[&str]) -> String {
    let output = palpate(args);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{args:?}: {stderr}");
    assert!(
        output.stdout.is_empty(),
        "{args:?} printed a result: {}",
        String::from_utf8_lossy(&output.stdout)
    );
    assert_eq!(stderr.trim_end().lines().count(), 1, "{args:?}: {stderr}");
    assert!(stderr.starts_with("error: ") && !stderr.contains("panicked"), "{stderr}");
    stderr
}

/// `path` as an argument.
pub(crate) fn arg(path: &Path) -> &str {
    path.to_str().unwrap()
}
