//! Timelines: real and simulated touch on one time axis.
//!
//! [`events`], [`lanes`], [`pyramid`] and [`view`] are pure: they work out what there is to see, once per take, and which
//! part of it is on the screen. [`paint`] draws that, [`toolbar`] chooses it. [`live`] has the live station instead of a
//! take.

pub mod events;
pub mod lanes;
mod live;
mod paint;
pub mod pyramid;
mod toolbar;
pub mod view;

use std::sync::Arc;

use egui::{Color32, RichText};
use palpate_robot_model::Station;
use palpate_wire::proto::ReplayTrace;

use self::{lanes::TakeLanes, view::TimeView};
use super::{ScreenContext, ensure_take_ui, failed_ui, loading_ui};
use crate::{
    commands::Command,
    playback::{HandSource, ModelRef, ShownChannels},
    route::Screen,
    store::Loadable,
    take_data::{TakeData, check_replay},
};

/// What the screen keeps from frame to frame.
#[derive(Debug, Default)]
pub struct TimelinesState {
    commands: Vec<Command>,
    view: Option<TimeView>,
    view_of: Option<(String, String)>,
    cache: Option<Cache>,
    mismatches: Option<Mismatches>,
    live: live::LiveState,
}

impl TimelinesState {
    /// Leaves a command for the screen's next frame.
    pub fn push_command(&mut self, command: Command) {
        self.commands.push(command);
    }

    /// The stretch of time on the screen, once a take is.
    pub fn view(&self) -> Option<TimeView> {
        self.view
    }
}

/// The lanes, and what they were worked out from.
#[derive(Debug)]
struct Cache {
    take: Arc<TakeData>,
    replays: Vec<Arc<ReplayTrace>>,
    lanes: Result<Arc<TakeLanes>, String>,
}

impl Cache {
    fn is_of(&self, take: &Arc<TakeData>, replays: &[Arc<ReplayTrace>]) -> bool {
        Arc::ptr_eq(&self.take, take)
            && self.replays.len() == replays.len()
            && self.replays.iter().zip(replays).all(|(a, b)| Arc::ptr_eq(a, b))
    }
}

/// Where the mismatches of the channels shown begin, and what that was worked out from.
#[derive(Debug)]
struct Mismatches {
    lanes: Arc<TakeLanes>,
    channels: Vec<usize>,
    sim: usize,
    starts_s: Arc<[f64]>,
}

/// A simulation in the picture.
struct Simulation {
    /// `nominal`, `calibrated` or `diagnosed`.
    label: &'static str,
    /// Which one: the label, and in brackets the run or the saved model.
    full_label: String,
    colour: Color32,
    /// Which of the lanes' rows it has; `None` while it is on its way.
    row: Option<usize>,
    /// Why it is not there.
    error: Option<String>,
}

/// The screen.
pub fn timelines_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut TimelinesState) {
    let commands = std::mem::take(&mut state.commands);
    if cx.playback.hand_source == HandSource::Live {
        return live::live_ui(ui, cx, &mut state.live);
    }
    if cx.store.is_live() {
        live::source_ui(ui, cx);
    }
    if !ensure_take_ui(ui, cx) {
        return;
    }
    let (Some(session), Some(take_id)) = (cx.playback.session.clone(), cx.playback.take.clone()) else {
        return;
    };
    toolbar::toolbar_ui(ui, cx, state, &session, &take_id);
    ui.separator();

    let take = match cx.store.take(&session, &take_id) {
        Loadable::Ready(take) => take,
        Loadable::Failed(error) => {
            return failed_ui(ui, cx, &format!("Take {take_id} of {session} did not open"), &error);
        }
        Loadable::Idle | Loadable::Loading => return loading_ui(ui, &format!("Loading {take_id}")),
    };
    let station = match cx.store.station(&session) {
        Loadable::Ready(station) => station,
        Loadable::Failed(error) => {
            return failed_ui(ui, cx, &format!("The station of {session} did not open"), &error);
        }
        Loadable::Idle | Loadable::Loading => return loading_ui(ui, "Loading the station"),
    };
    cx.playback.duration_s = take.duration_s();
    cx.playback.seek(cx.playback.time_s);
    let (simulations, replays) = simulations(cx, &session, &take_id);
    let lanes = match lanes_of(state, &take, replays, &station) {
        Ok(lanes) => lanes,
        Err(error) => return failed_ui(ui, cx, "This take cannot be drawn", &error),
    };
    if take.num_frames() == 0 {
        let text = "It holds no joint frame, so there is nothing to draw.";
        if super::empty_ui(ui, "This take is empty", text, "Choose another take") {
            cx.go_to_screen(Screen::Sessions);
        }
        return;
    }
    for simulation in &simulations {
        if let Some(error) = &simulation.error {
            ui.horizontal_wrapped(|ui| {
                let text = format!("\u{26a0} The {} simulation did not arrive: {error}", simulation.label);
                ui.label(RichText::new(text).color(cx.palette.mismatch));
                if ui.button("Try again").clicked() {
                    cx.store.retry_failed();
                }
            });
        }
    }

    let key = (session, take_id);
    let mut view = match state.view {
        Some(view) if state.view_of.as_ref() == Some(&key) => view,
        _ => TimeView::fit(take.duration_s()),
    };
    let channels = shown_channels(cx, &lanes);
    let judged = simulations.iter().rev().find_map(|simulation| simulation.row);
    let mismatches_s = judged.map(|sim| mismatches_of(state, &lanes, &channels, sim));
    for command in commands {
        run_command(command, cx, &mut view, mismatches_s.as_deref().unwrap_or_default());
    }
    if cx.playback.playing {
        view.reveal(cx.playback.time_s);
    }
    let picture = paint::Picture {
        take: &take,
        station: &station,
        lanes: &lanes,
        simulations: &simulations,
        channels: &channels,
        num_mismatches: mismatches_s.map(|starts_s| starts_s.len()),
    };
    paint::picture_ui(ui, cx, &picture, &mut view);
    state.view = Some(view);
    state.view_of = Some(key);
}

/// The simulations chosen, and the replays that are here.
fn simulations(
    cx: &mut ScreenContext<'_>,
    session: &str,
    take: &str,
) -> (Vec<Simulation>, Vec<Arc<ReplayTrace>>) {
    let mut chosen = vec![(ModelRef::Nominal, "nominal", "nominal".to_owned(), cx.palette.nominal)];
    if let Some(model) = cx.playback.compared.clone().filter(|model| *model != ModelRef::Nominal) {
        let full_label = cx.store.compared_label(Some(&model));
        chosen.push((model, "calibrated", full_label, cx.palette.calibrated));
    }
    if let Some(model) = cx.playback.diagnosed.clone() {
        let full_label = cx.store.compared_label(Some(&model));
        chosen.push((model, "diagnosed", full_label, cx.palette.diagnosed));
    }
    let mut replays = Vec::new();
    let simulations = chosen
        .into_iter()
        .map(|(model, label, full_label, colour)| {
            let replay = cx.store.replay(session, take, &model);
            let row = replay.ready().map(|replay| {
                replays.push(replay.clone());
                replays.len() - 1
            });
            Simulation { label, full_label, colour, row, error: replay.error().map(str::to_owned) }
        })
        .collect();
    (simulations, replays)
}

fn lanes_of(
    state: &mut TimelinesState,
    take: &Arc<TakeData>,
    replays: Vec<Arc<ReplayTrace>>,
    station: &Station,
) -> Result<Arc<TakeLanes>, String> {
    if let Some(cache) = state.cache.as_ref().filter(|cache| cache.is_of(take, &replays)) {
        return cache.lanes.clone();
    }
    let checked = take
        .check_against(station)
        .and_then(|()| replays.iter().try_for_each(|replay| check_replay(replay, take, station)));
    let lanes = checked.map(|()| {
        let replays: Vec<&ReplayTrace> = replays.iter().map(AsRef::as_ref).collect();
        Arc::new(TakeLanes::new(take, &replays, station))
    });
    state.cache = Some(Cache { take: take.clone(), replays, lanes: lanes.clone() });
    lanes
}

fn mismatches_of(
    state: &mut TimelinesState,
    lanes: &Arc<TakeLanes>,
    channels: &[usize],
    sim: usize,
) -> Arc<[f64]> {
    if let Some(known) = &state.mismatches
        && Arc::ptr_eq(&known.lanes, lanes)
        && known.channels == channels
        && known.sim == sim
    {
        return known.starts_s.clone();
    }
    let starts_s: Arc<[f64]> = lanes.mismatches(channels, sim).into();
    state.mismatches = Some(Mismatches {
        lanes: lanes.clone(),
        channels: channels.to_vec(),
        sim,
        starts_s: starts_s.clone(),
    });
    starts_s
}

fn shown_channels(cx: &ScreenContext<'_>, lanes: &TakeLanes) -> Vec<usize> {
    match cx.playback.shown {
        ShownChannels::Touched => lanes.touched(),
        ShownChannels::All => (0..lanes.channels.len()).collect(),
        ShownChannels::Picked => {
            cx.playback.selected.iter().copied().filter(|&channel| channel < lanes.channels.len()).collect()
        }
    }
}

fn run_command(command: Command, cx: &mut ScreenContext<'_>, view: &mut TimeView, mismatches_s: &[f64]) {
    /// Nearer than this is here, s.
    const NEAR_S: f64 = 1e-6;
    let cursor_s = cx.playback.time_s;
    let target_s = match command {
        Command::FitTake => {
            *view = TimeView::fit(cx.playback.duration_s);
            return;
        }
        Command::PreviousMismatch => mismatches_s.iter().rev().find(|&&start_s| start_s < cursor_s - NEAR_S),
        Command::NextMismatch => mismatches_s.iter().find(|&&start_s| start_s > cursor_s + NEAR_S),
        _ => return,
    };
    if let Some(&target_s) = target_s {
        cx.playback.playing = false;
        cx.playback.seek(target_s);
        view.reveal(target_s);
    }
}
