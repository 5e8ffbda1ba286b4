//! Timelines: real and simulated touch on one time axis.
//!
//! [`events`], [`lanes`], [`pyramid`] and [`view`] are pure: they work out what there is to see, once per take, and which
//! part of it is on the screen. [`paint`] draws that, [`toolbar`] chooses it. [`live`] has the live station instead of a
//! take.

mod bars;
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
use palpate_wire::{markdown, proto::ReplayTrace};

use self::{
    lanes::{Mismatch, TakeLanes},
    view::TimeView,
};
use super::{About, ScreenContext, Subject, View, ensure_take_ui, failed_ui, loaded_ui};
use crate::{
    commands::Command,
    playback::{HandSource, ModelRef, ShownChannels},
    route::Screen,
    take_data::{TakeData, check_replay},
};

/// This screen.
pub const ABOUT: About = About {
    label: "Timelines",
    slug: "timelines",
    key: Some(egui::Key::Num5),
    icon: "\u{2630}",
    purpose: "Compare real and simulated touch on one time axis",
    group: Some("Data"),
    document: (markdown::TOUR, Some("a-five-minute-tour")),
    subject: Subject::Take,
    needs_station: false,
    shows_stream: true,
    new: || Box::<TimelinesState>::default(),
};

/// What the screen keeps from frame to frame.
#[derive(Debug, Default)]
struct TimelinesState {
    commands: Vec<Command>,
    view: Option<TimeView>,
    view_of: Option<(String, String)>,
    cache: Option<Cache>,
    mismatches: Option<Mismatches>,
    /// The mismatch that was jumped to last, by its place in the list.
    at_mismatch: Option<usize>,
    live: live::LiveState,
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

/// The mismatches of the channels shown, and what they were worked out from.
#[derive(Debug)]
struct Mismatches {
    lanes: Arc<TakeLanes>,
    channels: Vec<usize>,
    sim: usize,
    found: Arc<[Mismatch]>,
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

impl View for TimelinesState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        let commands = std::mem::take(&mut self.commands);
        if cx.playback.hand_source == HandSource::Live {
            return live::live_ui(ui, cx, &mut self.live);
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
        toolbar::toolbar_ui(ui, cx, self, &session, &take_id);
        ui.separator();

        let take = cx.store.take(&session, &take_id);
        let Some(take) = loaded_ui(
            ui,
            cx,
            take,
            &format!("Loading {take_id}"),
            &format!("Take {take_id} of {session} did not open"),
        ) else {
            return;
        };
        let station = cx.store.station(&session);
        let Some(station) = loaded_ui(
            ui,
            cx,
            station,
            "Loading the station",
            &format!("The station of {session} did not open"),
        ) else {
            return;
        };
        cx.playback.duration_s = take.duration_s();
        cx.playback.seek(cx.playback.time_s);
        let (simulations, replays) = simulations(cx, &session, &take_id);
        let lanes = match lanes_of(self, &take, replays, &station) {
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
                    let text =
                        format!("\u{26a0} The {} simulation did not arrive: {error}", simulation.label);
                    ui.label(RichText::new(text).color(cx.palette.mismatch));
                    if ui.button("Try again").clicked() {
                        cx.store.retry_failed();
                    }
                });
            }
        }

        let key = (session, take_id);
        let mut view = match self.view {
            Some(view) if self.view_of.as_ref() == Some(&key) => view,
            _ => TimeView::fit(take.duration_s()),
        };
        let channels = shown_channels(cx, &lanes);
        let judged = simulations.iter().rev().find_map(|simulation| simulation.row);
        let mismatches = judged.map(|sim| mismatches_of(self, &lanes, &channels, sim));
        let mut jumped = false;
        for command in commands {
            let found = mismatches.as_deref().unwrap_or_default();
            jumped |= run_command(command, cx, &mut view, found, &mut self.at_mismatch);
        }
        if cx.playback.playing {
            view.reveal(cx.playback.time_s);
        }
        // The mark lasts as long as the cursor stays where the jump put it.
        let at = self.at_mismatch.and_then(|idx| {
            let mismatch = *mismatches.as_deref()?.get(idx)?;
            ((mismatch.start_s - cx.playback.time_s).abs() <= NEAR_S).then_some((idx, mismatch))
        });
        let picture = paint::Picture {
            take: &take,
            station: &station,
            lanes: &lanes,
            simulations: &simulations,
            channels: &channels,
            num_mismatches: mismatches.map(|found| found.len()),
            at,
            jumped,
        };
        paint::picture_ui(ui, cx, &picture, &mut view);
        self.view = Some(view);
        self.view_of = Some(key);
    }

    fn take_command(&mut self, command: Command) {
        self.commands.push(command);
    }

    fn shown_span_s(&self) -> Option<f64> {
        self.view.map(|view| view.span_s())
    }
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
) -> Arc<[Mismatch]> {
    if let Some(known) = &state.mismatches
        && Arc::ptr_eq(&known.lanes, lanes)
        && known.channels == channels
        && known.sim == sim
    {
        return known.found.clone();
    }
    let found: Arc<[Mismatch]> = lanes.mismatches(channels, sim).into();
    state.at_mismatch = None;
    state.mismatches =
        Some(Mismatches { lanes: lanes.clone(), channels: channels.to_vec(), sim, found: found.clone() });
    found
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

/// Nearer than this is here, s.
const NEAR_S: f64 = 1e-6;
/// So much is on the screen before and after a mismatch that was jumped to, s.
const AROUND_S: f64 = 1.0;

/// True when it jumped to a mismatch, which `at` then tells.
fn run_command(
    command: Command,
    cx: &mut ScreenContext<'_>,
    view: &mut TimeView,
    mismatches: &[Mismatch],
    at: &mut Option<usize>,
) -> bool {
    let cursor_s = cx.playback.time_s;
    // Several channels may differ from the same moment on: each is a step of its own.
    let here = at.filter(|&idx| {
        mismatches.get(idx).is_some_and(|mismatch| (mismatch.start_s - cursor_s).abs() <= NEAR_S)
    });
    let target = match (command, here) {
        (Command::FitTake, _) => {
            *view = TimeView::fit(cx.playback.duration_s);
            return false;
        }
        (Command::PreviousMismatch, Some(idx)) => idx.checked_sub(1),
        (Command::PreviousMismatch, None) => {
            mismatches.iter().rposition(|mismatch| mismatch.start_s < cursor_s - NEAR_S)
        }
        (Command::NextMismatch, Some(idx)) => Some(idx + 1),
        (Command::NextMismatch, None) => {
            mismatches.iter().position(|mismatch| mismatch.start_s > cursor_s + NEAR_S)
        }
        _ => return false,
    };
    let Some((idx, mismatch)) = target.and_then(|idx| Some((idx, mismatches.get(idx)?))) else {
        return false;
    };
    *at = Some(idx);
    cx.playback.playing = false;
    cx.playback.seek(mismatch.start_s);
    view.focus(mismatch.start_s, AROUND_S);
    true
}
