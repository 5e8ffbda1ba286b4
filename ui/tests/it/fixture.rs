//! A page on a made-up server: one session of the shipped probe bench with two takes, whose simulation lags.

use std::{
    cell::RefCell,
    collections::{BTreeMap, VecDeque},
    path::Path,
    rc::Rc,
    time::Duration,
};

use base64::Engine as _;
use egui_kittest::Harness;
use palpate_messages::bits;
use palpate_reports::ThetaReport;
use palpate_robot_model::Station;
use palpate_ui::{
    Platform, StudioApp,
    api_client::{Api, ApiEvent, FakeApi, Request},
    playback::ModelRef,
    screens::PickedFile,
};
use palpate_wire::{
    api::{Info, ModelSummary, SessionDetail, SessionSummary, Source, StationDocument, TakeSummary},
    proto::{ReplayTrace, SpanTrace, StreamTrace, TakeTrace, control_request},
};
use prost::Message as _;
use raster::Raster;

pub(crate) const FRAMES: usize = 200;
pub(crate) const FRAME_S: f64 = 0.1;
/// The nominal simulation lags by so many frames; the saved model is right.
pub(crate) const LAG_FRAMES: usize = 3;

/// A server that the test can talk to while the page has it.
#[derive(Clone, Default)]
pub(crate) struct SharedApi(pub(crate) Rc<RefCell<FakeApi>>);

impl Api for SharedApi {
    fn send(&mut self, lease: u64, request: Request) {
        self.0.borrow_mut().send(lease, request);
    }

    fn open_socket(&mut self) {
        self.0.borrow_mut().open_socket();
    }

    fn open_control(&mut self) {
        self.0.borrow_mut().open_control();
    }

    fn send_control(&mut self, lease: u64, request: control_request::Request) -> Option<u64> {
        self.0.borrow_mut().send_control(lease, request)
    }

    fn beat(&mut self, lease: Option<u64>) {
        self.0.borrow_mut().beat(lease);
    }

    fn draw_stream_within(&mut self, within: Duration) {
        self.0.borrow_mut().draw_stream_within(within);
    }

    fn poll(&mut self) -> Vec<ApiEvent> {
        self.0.borrow_mut().poll()
    }
}

/// An address bar with a history.
#[derive(Clone, Default)]
pub(crate) struct FakeWindow(pub(crate) Rc<RefCell<History>>);

#[derive(Default)]
pub(crate) struct History {
    pub(crate) entries: Vec<String>,
    pub(crate) theme: Option<egui::Theme>,
    pub(crate) title: String,
    pub(crate) operator: String,
    pub(crate) unwatched: bool,
    pub(crate) picked: Vec<PickedFile>,
    /// Pictures that were kept: name, width and height in pixels.
    pub(crate) pictures: Vec<(String, [usize; 2])>,
}

impl FakeWindow {
    pub(crate) fn at(hash: &str) -> Self {
        Self(Rc::new(RefCell::new(History { entries: vec![hash.to_owned()], ..History::default() })))
    }

    /// The window of a browser that knows who sits there.
    pub(crate) fn of(operator: &str, hash: &str) -> Self {
        let window = Self::at(hash);
        window.0.borrow_mut().operator = operator.to_owned();
        window
    }

    pub(crate) fn back(&self) {
        self.0.borrow_mut().entries.pop();
    }

    pub(crate) fn current(&self) -> String {
        self.0.borrow().entries.last().cloned().unwrap_or_default()
    }

    pub(crate) fn steps(&self) -> usize {
        self.0.borrow().entries.len()
    }
}

impl Platform for FakeWindow {
    fn hash(&self) -> String {
        self.current()
    }

    fn push_hash(&mut self, hash: &str) {
        self.0.borrow_mut().entries.push(hash.to_owned());
    }

    fn replace_hash(&mut self, hash: &str) {
        let mut history = self.0.borrow_mut();
        history.entries.pop();
        history.entries.push(hash.to_owned());
    }

    fn address(&self) -> String {
        format!("http://127.0.0.1:7480/{}", self.current())
    }

    fn time_of_day(&self) -> String {
        "14:03:12".to_owned()
    }

    fn local_time(&self, rfc3339: &str) -> Option<String> {
        rfc3339.strip_suffix('Z').map(|utc| utc.replace('T', " "))
    }

    fn saved_theme(&self) -> Option<egui::Theme> {
        self.0.borrow().theme
    }

    fn save_theme(&mut self, theme: egui::Theme) {
        self.0.borrow_mut().theme = Some(theme);
    }

    fn saved_operator(&self) -> String {
        self.0.borrow().operator.clone()
    }

    fn save_operator(&mut self, operator: &str) {
        self.0.borrow_mut().operator = operator.to_owned();
    }

    fn is_watched(&self) -> bool {
        !self.0.borrow().unwatched
    }

    fn set_title(&mut self, title: &str) {
        self.0.borrow_mut().title = title.to_owned();
    }

    fn save_picture(&mut self, file_name: &str, picture: &egui::ColorImage) -> bool {
        self.0.borrow_mut().pictures.push((file_name.to_owned(), picture.size));
        true
    }

    fn pick_file(&mut self) {}

    fn picked_files(&mut self) -> Vec<PickedFile> {
        std::mem::take(&mut self.0.borrow_mut().picked)
    }
}

pub(crate) fn station() -> Station {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/stations");
    Station::read("probe_bench.toml", |path| {
        std::fs::read(folder.join(path)).map_err(|err| format!("{path}: {err}"))
    })
    .expect("the shipped station is sound")
}

/// Channel `channel` is touched for ten frames from frame `20 + 4 * channel` on, `lag` frames later in a simulation, and
/// once more at frame 150 in simulations that lag.
pub(crate) fn is_active(frame: usize, channel: usize, lag: usize) -> bool {
    let start = 20 + 4 * channel + lag;
    (start..start + 10).contains(&frame) || (lag > 0 && channel == 0 && (150..153).contains(&frame))
}

fn activations(num_channels: usize, lag: usize) -> Vec<u8> {
    bits::pack(
        (0..FRAMES).flat_map(|frame| (0..num_channels).map(move |channel| is_active(frame, channel, lag))),
    )
}

pub(crate) fn take_trace(station: &Station) -> TakeTrace {
    let num_channels = station.layout.num_channels();
    let frame_times_s: Vec<f64> = (0..FRAMES).map(|frame| frame as f64 * FRAME_S).collect();
    let streams = station
        .layout
        .streams
        .iter()
        .zip(&station.streams)
        .map(|(stream, config)| {
            let samples = || (0..FRAMES).flat_map(|frame| stream.channels.clone().map(move |c| (frame, c)));
            let raw = samples()
                .map(
                    |(frame, channel)| {
                        if is_active(frame, channel, 0) { 2.0 * config.on_threshold as f32 } else { 1.0 }
                    },
                )
                .collect();
            StreamTrace {
                stream: stream.id.clone(),
                times_s: frame_times_s.clone(),
                raw,
                active: bits::pack(samples().map(|(frame, channel)| is_active(frame, channel, 0))),
                axes: Vec::new(),
            }
        })
        .collect();
    TakeTrace {
        object_poses: Vec::new(),
        surroundings: Vec::new(),
        joint_positions: vec![0.0; FRAMES * station.robot.num_dofs()],
        real_active: activations(num_channels, 0),
        streams,
        spans: vec![
            SpanTrace { kind: "baseline".into(), start_s: 0.0, end_s: 1.5, label: String::new() },
            SpanTrace { kind: "repetition".into(), start_s: 2.0, end_s: 9.0, label: "tap".into() },
        ],
        frame_times_s,
    }
}

fn replay(station: &Station, lag: usize) -> ReplayTrace {
    let num_channels = station.layout.num_channels();
    ReplayTrace {
        model: String::new(),
        active: activations(num_channels, lag),
        raw: vec![0.0; FRAMES * num_channels],
        thresholds: vec![0.5; num_channels],
    }
}

pub(crate) fn summary() -> SessionSummary {
    SessionSummary {
        id: "bench-1".into(),
        station: "probe-bench".into(),
        takes: 2,
        frames: 2 * FRAMES,
        duration_s: 2.0 * FRAMES as f64 * FRAME_S,
        objects: vec!["sphere_50mm".into()],
        recorded: "2026-05-04T10:00:00Z".into(),
        error: None,
    }
}

fn take_summary(id: &str) -> TakeSummary {
    TakeSummary {
        id: id.into(),
        object: "sphere_50mm".into(),
        object_pose: [0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0],
        primitive: "tap".into(),
        frames: FRAMES,
        duration_s: FRAMES as f64 * FRAME_S,
        accepted: true,
        has_raw: true,
    }
}

fn json(value: &impl serde::Serialize) -> Vec<u8> {
    serde_json::to_vec(value).expect("it serialises")
}

/// A server with everything.
pub(crate) fn full_api() -> SharedApi {
    let station = station();
    let mut api = FakeApi::default();
    let info = Info {
        name: "palpate".into(),
        version: "0.1.0".into(),
        station: Some("Probe bench".into()),
        source: Source::Emulated,
        insecure: false,
    };
    api.answer(&Request::Info, json(&info));
    api.answer(&Request::Sessions, json(&vec![summary()]));
    let takes = vec![take_summary("take-01"), take_summary("take-02")];
    api.answer(&Request::Session("bench-1".into()), json(&SessionDetail { summary: summary(), takes }));
    let files_base64: BTreeMap<String, String> = station
        .files
        .files
        .iter()
        .map(|(path, bytes)| (path.clone(), base64::engine::general_purpose::STANDARD.encode(bytes)))
        .collect();
    let document = StationDocument { station_toml: station.files.station_toml.clone(), files_base64 };
    api.answer(&Request::Station("bench-1".into()), json(&document));
    let model = ModelSummary {
        id: "bench-fit".into(),
        name: "Bench fit".into(),
        theta: ThetaReport { lambda_con_m: 0.001, alpha_per_m: 100.0, lambda_pre_pa: 10.0 },
        streams: Default::default(),
        provenance: vec!["calibrated on bench-1".into()],
        effects: Vec::new(),
        earlier_versions: 0,
    };
    api.answer(&Request::Models, json(&vec![model]));
    api.answer(&Request::Runs, b"[]".to_vec());
    api.answer(&Request::Diagnoses, b"[]".to_vec());
    for take in ["take-01", "take-02"] {
        let (session, take) = ("bench-1".to_owned(), take.to_owned());
        let request = Request::Take { session: session.clone(), take: take.clone() };
        api.answer(&request, take_trace(&station).encode_to_vec());
        for (model, lag) in [(ModelRef::Nominal, LAG_FRAMES), (ModelRef::Saved("bench-fit".into()), 0)] {
            let request = Request::Replay { session: session.clone(), take: take.clone(), model };
            api.answer(&request, replay(&station, lag).encode_to_vec());
        }
    }
    SharedApi(Rc::new(RefCell::new(api)))
}

/// What a server says of itself that has recordings and no station.
pub(crate) fn without_station() -> Info {
    Info {
        name: "palpate".into(),
        version: "0.1.0".into(),
        station: None,
        source: Source::Replay,
        insecure: false,
    }
}

/// A page of 1280 x 800 points that has come to rest.
pub(crate) fn page(api: &SharedApi, window: &FakeWindow) -> Harness<'static, Option<StudioApp>> {
    page_of(api, window, [1280.0, 800.0])
}

/// A page of `size` points that has come to rest.
pub(crate) fn page_of(
    api: &SharedApi,
    window: &FakeWindow,
    size: [f32; 2],
) -> Harness<'static, Option<StudioApp>> {
    let (api, window) = (api.clone(), window.clone());
    let mut harness = Harness::builder()
        .renderer(Raster::default())
        .with_size(size)
        .with_max_steps(60)
        .with_step_dt(0.02)
        .build_ui_state(
            move |ui, app: &mut Option<StudioApp>| {
                let app = app.get_or_insert_with(|| {
                    StudioApp::new(ui.ctx(), Box::new(api.clone()), Box::new(window.clone()), None)
                });
                app.ui(ui);
            },
            None,
        );
    // Fonts and sizes are set in the first frame and hold from the second.
    harness.run_steps(12);
    harness
}

pub(crate) fn app<'a>(harness: &'a Harness<'static, Option<StudioApp>>) -> &'a StudioApp {
    harness.state().as_ref().expect("the page is there after the first frame")
}

pub(crate) fn app_mut<'a>(harness: &'a mut Harness<'static, Option<StudioApp>>) -> &'a mut StudioApp {
    harness.state_mut().as_mut().expect("the page is there after the first frame")
}

/// Events for the page's next frame.
pub(crate) fn deliver(api: &SharedApi, events: impl IntoIterator<Item = ApiEvent>) {
    api.0.borrow_mut().events.extend(VecDeque::from_iter(events));
}

/// What the page copies within the next frames, if anything.
pub(crate) fn copied(harness: &mut Harness<'static, Option<StudioApp>>) -> Option<String> {
    for _ in 0..4 {
        harness.step();
        let commands = &harness.output().platform_output.commands;
        let text = commands.iter().find_map(|command| match command {
            egui::OutputCommand::CopyText(text) => Some(text.clone()),
            _ => None,
        });
        if text.is_some() {
            return text;
        }
    }
    None
}
