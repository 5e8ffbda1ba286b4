//! The hand: a 3-D view and a flat map of the same taxels, replaying a take or following the live station.
//!
//! [`scene`] and [`signal`] say what is to be seen (pure), [`renderer`] draws it, the others are widgets.

mod bars;
mod camera;
mod detail;
mod details;
mod flat_map;
mod hull;
mod mesh;
mod object_view;
mod placement_view;
mod renderer;
pub mod residual;
mod scene;
mod signal;
#[cfg(test)]
mod tests;
mod transport;
mod view3d;

use std::sync::Arc;

use egui::{Color32, Key, Panel, Rgba, RichText, accesskit::Role};
use nalgebra::Isometry3;
use palpate_reports::wording;
use palpate_robot_model::Station;
use palpate_wire::{
    api::{Source, TakeSummary},
    proto::{LiveFrame, ReplayTrace},
};

use self::{
    bars::{controls_ui, legend_ui, live_rates_ui, views_ui},
    details::{Details, details_ui, tooltip_ui},
    flat_map::{FlatMap, click, flat_map_ui, taxel_name},
    residual::Residual,
    scene::{Geometry, TaxelLook},
    signal::{Coloring, Sample, Signal},
    view3d::{Moment, ViewState, view3d_ui},
};
pub use self::{
    flat_map::channel_map_ui,
    object_view::ObjectView,
    placement_view::{Placement, PlacementView},
};
use super::{
    About, ScreenContext, Subject, View,
    control::{
        devices::devices_ui,
        joints::Controls,
        panel::{PanelState, control_panel_ui},
    },
    empty_ui, ensure_take_ui, failed_ui, loaded_ui, loading_ui, words,
};
use crate::{
    playback::{HandSource, ModelRef},
    route::Screen,
    store::Loadable,
    take_data::TakeData,
    theme::{is_narrow, taxel_scale},
};

const SIDE_WIDTH: f32 = 360.0;
/// With sliders, which are finer the longer they are.
const CONTROL_WIDTH: f32 = 410.0;

/// This screen.
pub const ABOUT: About = About {
    label: "Hand",
    slug: "hand",
    key: Some(egui::Key::Num2),
    icon: "\u{270b}",
    purpose: "Watch the hand replay a take, taxels lit by what they felt",
    group: Some("Operate"),
    document: ("safety", None),
    subject: Subject::Take,
    needs_station: false,
    shows_stream: true,
    new: || Box::<HandState>::default(),
};

/// On a narrow page: how much of the height the map has, below the picture.
const BELOW: f32 = 0.6;

/// What the screen remembers between frames.
#[derive(Default)]
struct HandState {
    view: ViewState,
    signal: Signal,
    coloring: Coloring,
    /// The diagnosis whose residual map was put on the hand already.
    residual_of: Option<String>,
    tab: SideTab,
    panel: PanelState,
    /// What can be moved on the station that it was made for.
    controls: Option<(Arc<Station>, Arc<Controls>)>,
    /// This page held the lease in the frame before.
    had_control: bool,
}

/// What the side panel shows of a station that takes commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
enum SideTab {
    #[default]
    Control,
    Touch,
    Devices,
}

impl SideTab {
    const ALL: [Self; 3] = [Self::Control, Self::Touch, Self::Devices];

    fn label(self) -> &'static str {
        match self {
            Self::Control => "Control",
            Self::Touch => "Touch",
            Self::Devices => "Devices",
        }
    }
}

impl HandState {
    fn controls_of(&mut self, station: &Arc<Station>) -> Arc<Controls> {
        if let Some((known, controls)) = &self.controls
            && Arc::ptr_eq(known, station)
        {
            return Arc::clone(controls);
        }
        let controls = Arc::new(Controls::new(station));
        self.controls = Some((Arc::clone(station), Arc::clone(&controls)));
        controls
    }
}

/// Everything that one frame shows, recorded or live.
struct Shot {
    station: Arc<Station>,
    positions: Vec<f64>,
    /// Where the joints are told to be; empty where nothing is commanded.
    commanded: Vec<f64>,
    real: Vec<Sample>,
    nominal: Vec<Sample>,
    compared: Vec<Sample>,
    diagnosed: Vec<Sample>,
    object: Option<(String, Isometry3<f64>)>,
    take: Option<(Arc<TakeData>, f64)>,
    replays: [Option<Arc<ReplayTrace>>; 3],
    banner: Banner,
}

/// Where the data comes from, in words.
struct Banner {
    source: String,
    color: egui::Color32,
    about: String,
    /// Why a simulation that was asked for is not shown.
    missing: Option<String>,
    /// The compared simulation was asked for, and none is chosen.
    nothing_to_compare: bool,
}

impl View for HandState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        if !cx.store.is_live() && cx.store.info.ready().is_some() {
            cx.playback.hand_source = HandSource::Recorded;
        }
        // Who has just taken control wants to see what moves.
        let has_control = cx.store.control.lease() != 0;
        if has_control && !self.had_control {
            cx.playback.hand_source = HandSource::Live;
        }
        self.had_control = has_control;
        let shot = match cx.playback.hand_source {
            HandSource::Recorded => recorded_shot(ui, cx, self),
            HandSource::Live => live_shot(ui, cx, self),
        };
        if let Some(shot) = shot {
            shot_ui(ui, cx, self, &shot);
        }
    }
}

/// The chosen take at the cursor. `None` while something is missing, which is then on the screen.
fn recorded_shot(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut HandState) -> Option<Shot> {
    let live_wanted =
        cx.store.is_live() && cx.store.sessions().ready().is_none_or(|sessions| sessions.is_empty());
    if live_wanted {
        source_switch_ui(ui, cx);
    }
    if !ensure_take_ui(ui, cx) {
        return None;
    }
    let (session, take_id) = (cx.playback.session.clone()?, cx.playback.take.clone()?);
    let station = cx.store.station(&session);
    let station = loaded_ui(
        ui,
        cx,
        station,
        "Reading the station",
        &format!("The station of session {session} could not be read"),
    )?;
    let take = cx.store.take(&session, &take_id);
    let take = loaded_ui(
        ui,
        cx,
        take,
        &format!("Loading {take_id}"),
        &format!("Take {take_id} of session {session} did not arrive"),
    )?;
    if let Err(error) = take.check_against(&station) {
        failed_ui(ui, cx, &format!("Take {take_id} does not match its station"), &error);
        return None;
    }
    if take.num_frames() == 0 {
        let text = "Nothing was logged from the joints in this take, so there is no posture to show.";
        if empty_ui(ui, &format!("Take {take_id} holds no joint frames"), text, "Choose another take") {
            cx.go_to_screen(Screen::Sessions);
        }
        return None;
    }
    cx.playback.duration_s = take.duration_s();
    let time_s = cx.playback.time_s.min(take.duration_s());

    let replay = |cx: &mut ScreenContext<'_>, model: &ModelRef| {
        let loaded = cx.store.replay(&session, &take_id, model);
        let problem = match &loaded {
            Loadable::Ready(replay) => crate::take_data::check_replay(replay, &take, &station).err(),
            Loadable::Failed(error) => Some(error.clone()),
            Loadable::Idle | Loadable::Loading => None,
        };
        let usable = loaded.ready().filter(|_| problem.is_none()).cloned();
        (usable, problem)
    };
    let (nominal, nominal_problem) = replay(cx, &ModelRef::Nominal);
    let compared_model = cx.playback.compared.clone();
    let (compared, compared_problem) =
        compared_model.as_ref().map_or((None, None), |model| replay(cx, model));
    let diagnosed_model = cx.playback.diagnosed.clone();
    let (diagnosed, diagnosed_problem) =
        diagnosed_model.as_ref().map_or((None, None), |model| replay(cx, model));
    let at_cursor = |replay: &Option<Arc<ReplayTrace>>| {
        replay.as_ref().map_or_else(Vec::new, |replay| signal::simulated(&station, &take, replay, time_s))
    };
    let missing = match state.signal {
        Signal::Real => None,
        Signal::Nominal => {
            nominal.is_none().then(|| nominal_problem.unwrap_or_else(|| "simulating\u{2026}".to_owned()))
        }
        Signal::Calibrated if compared_model.is_none() => Some("choose a model to compare with".to_owned()),
        Signal::Calibrated => {
            compared.is_none().then(|| compared_problem.unwrap_or_else(|| "simulating\u{2026}".to_owned()))
        }
        Signal::Diagnosed if diagnosed_model.is_none() => Some("diagnose the session first".to_owned()),
        Signal::Diagnosed => {
            diagnosed.is_none().then(|| diagnosed_problem.unwrap_or_else(|| "simulating\u{2026}".to_owned()))
        }
    };
    let summary = cx
        .store
        .session(&session)
        .ready()
        .and_then(|detail| detail.takes.iter().find(|summary| summary.id == take_id).cloned());
    let object = summary.as_ref().and_then(|summary| {
        let pose = take.object_pose_at(time_s).or_else(|| signal::pose_from(&summary.object_pose))?;
        Some((summary.object.clone(), pose))
    });
    Some(Shot {
        positions: take.joint_positions_at(time_s),
        commanded: Vec::new(),
        real: signal::recorded(&station, &take, time_s),
        nominal: at_cursor(&nominal),
        compared: at_cursor(&compared),
        diagnosed: at_cursor(&diagnosed),
        object,
        banner: Banner {
            source: "REPLAY".to_owned(),
            color: cx.palette.text_weak,
            about: about_take(&station, &take_id, summary.as_ref()),
            missing,
            nothing_to_compare: state.signal == Signal::Calibrated && compared_model.is_none(),
        },
        take: Some((take, time_s)),
        replays: [nominal, compared, diagnosed],
        station,
    })
}

fn about_take(station: &Station, take_id: &str, summary: Option<&TakeSummary>) -> String {
    let Some(summary) = summary else { return take_id.to_owned() };
    let object = station.objects.get(&summary.object).map_or(summary.object.as_str(), |object| &object.label);
    [take_id, &words(&summary.primitive), object]
        .into_iter()
        .filter(|word| !word.is_empty())
        .collect::<Vec<_>>()
        .join(" \u{b7} ")
}

/// The newest frame of the live station.
fn live_shot(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut HandState) -> Option<Shot> {
    let station = match cx.store.live_station() {
        Loadable::Ready(station) => station,
        other => {
            source_switch_ui(ui, cx);
            match other {
                Loadable::Failed(error) => failed_ui(ui, cx, "The live station could not be read", &error),
                _ => loading_ui(ui, "Reading the live station"),
            }
            return None;
        }
    };
    let Some(frame) = cx.store.live_frame().cloned() else {
        source_switch_ui(ui, cx);
        loading_ui(ui, "Waiting for the first live frame");
        return None;
    };
    if frame.joint_positions.len() != station.robot.num_dofs()
        || frame.joint_positions.iter().any(|value| !value.is_finite())
    {
        source_switch_ui(ui, cx);
        let why = format!(
            "It sent {} joint positions, and its robot has {}. Restart the server with the station file in use.",
            frame.joint_positions.len(),
            station.robot.num_dofs()
        );
        failed_ui(ui, cx, "The live station does not match its description", &why);
        return None;
    }
    state.signal = Signal::Real;
    let commanded = frame.control.as_ref().map_or(&[][..], |control| &control.commanded);
    let usable = commanded.len() == frame.joint_positions.len() && commanded.iter().all(|at| at.is_finite());
    Some(Shot {
        commanded: commanded.iter().filter(|_| usable).map(|&position| f64::from(position)).collect(),
        positions: frame.joint_positions.iter().map(|&position| f64::from(position)).collect(),
        real: signal::live(&station, &frame),
        nominal: Vec::new(),
        compared: Vec::new(),
        diagnosed: Vec::new(),
        object: signal::pose_from(&frame.object_pose).map(|pose| (frame.object.clone(), pose)),
        take: None,
        replays: [None, None, None],
        banner: live_banner(cx, &frame),
        station,
    })
}

fn live_banner(cx: &ScreenContext<'_>, frame: &LiveFrame) -> Banner {
    let emulated = cx.store.info.ready().is_some_and(|info| info.source == Source::Emulated);
    match cx.store.frozen_since(cx.now_s) {
        Some((since, _)) => Banner {
            source: format!("FROZEN SINCE {since}"),
            color: cx.palette.mismatch,
            about: "nothing comes from the station; this is the last frame that arrived".to_owned(),
            missing: None,
            nothing_to_compare: false,
        },
        None => Banner {
            source: if emulated { "LIVE (EMULATED)" } else { "LIVE" }.to_owned(),
            color: if emulated { cx.palette.warning } else { cx.palette.mismatch },
            about: frame.activity.clone(),
            missing: None,
            nothing_to_compare: false,
        },
    }
}

fn source_switch_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    ui.horizontal(|ui| {
        ui.selectable_value(&mut cx.playback.hand_source, HandSource::Recorded, "Recorded");
        ui.selectable_value(&mut cx.playback.hand_source, HandSource::Live, "Live");
    });
}

fn shot_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut HandState, shot: &Shot) {
    let mut root_from_link = Vec::new();
    shot.station.robot.forward_kinematics(&shot.positions, &mut root_from_link);
    let geometry = state.view.geometry_of(&shot.station);
    let mut commanded_from_link = Vec::new();
    if !shot.commanded.is_empty() {
        shot.station.robot.forward_kinematics(&shot.commanded, &mut commanded_from_link);
    }
    let shown = match state.signal {
        Signal::Real => &shot.real,
        Signal::Nominal => &shot.nominal,
        Signal::Calibrated => &shot.compared,
        Signal::Diagnosed => &shot.diagnosed,
    };
    // A simulation that is not here yet shows as unknown, never as the recording.
    let unknown = vec![Sample::default(); shot.station.layout.num_channels()];
    let samples = if shown.is_empty() { &unknown } else { shown };
    if cx.playback.residual_of != state.residual_of {
        state.residual_of.clone_from(&cx.playback.residual_of);
        state.coloring = if state.residual_of.is_some() { Coloring::Mismatch } else { Coloring::default() };
    }
    let residual = residual_of(cx, &shot.station);
    if residual.is_none() && state.coloring == Coloring::Mismatch && cx.playback.residual_of.is_none() {
        state.coloring = Coloring::default();
    }
    let (signal, coloring, palette) = (state.signal, state.coloring, cx.palette);
    let mismatch = |channel: usize| residual.as_ref()?.of(signal).get(channel).copied().flatten();
    let colors: Vec<Color32> = samples
        .iter()
        .enumerate()
        .map(|(channel, sample)| match (coloring, &residual) {
            (Coloring::Mismatch, Some(residual)) => mismatch(channel)
                .map_or(palette.dead, |per_s| taxel_scale((per_s / residual.full_scale_per_s) as f32)),
            _ => sample.color(coloring, signal, &palette),
        })
        .collect();
    let name = |channel: usize| {
        let name = taxel_name(&shot.station, channel, &samples[channel], signal);
        match mismatch(channel).filter(|_| coloring == Coloring::Mismatch) {
            Some(per_s) => format!("{name}; mismatch {} a second", wording::number(per_s)),
            None => name,
        }
    };
    let looks: Vec<TaxelLook> = samples
        .iter()
        .zip(&colors)
        .enumerate()
        .map(|(channel, (sample, &color))| {
            let rgba = Rgba::from(color);
            TaxelLook {
                color: [rgba.r(), rgba.g(), rgba.b()],
                active: sample.active == Some(true),
                marked: cx.playback.highlighted() == Some(channel)
                    || cx.playback.pinned == Some(channel)
                    || cx.playback.selected.contains(&channel),
            }
        })
        .collect();
    let moment = Moment {
        station: &shot.station,
        root_from_link: &root_from_link,
        looks: &looks,
        object: shot.object.as_ref().map(|(id, pose)| (id.as_str(), pose)),
        commanded_from_link: &commanded_from_link,
        surroundings: shot.take.as_ref().map_or(&[], |(take, _)| take.surroundings()),
    };
    let details = Details {
        station: &shot.station,
        samples: [&shot.real, &shot.nominal, &shot.compared, &shot.diagnosed],
        take: shot.take.as_ref().map(|(take, time_s)| (&**take, *time_s)),
        replays: [0, 1, 2].map(|idx| shot.replays[idx].as_deref()),
    };

    // A phone is for looking: the map stands below the picture, and nothing is moved from it.
    let narrow = is_narrow(ui.ctx());
    let frame = egui::Frame::NONE;
    Panel::top("hand_controls").frame(frame).show_separator_line(false).show(ui, |ui| {
        controls_ui(ui, cx, state, shot, residual.is_some());
        if narrow {
            ui.collapsing("View", |ui| views_ui(ui, state, &geometry, &moment));
        } else {
            views_ui(ui, state, &geometry, &moment);
        }
        ui.add_space(4.0);
    });
    Panel::bottom("hand_transport").frame(frame).show_separator_line(false).show(ui, |ui| {
        ui.add_space(6.0);
        match &shot.take {
            Some((take, _)) => transport::transport_ui(ui, cx.playback, take, &palette),
            None => live_rates_ui(ui, cx, &shot.station),
        }
    });
    let commandable = shot.take.is_none() && cx.store.control_state().is_some() && !narrow;
    let side = if narrow {
        Panel::bottom("hand_below").exact_size((ui.available_height() * BELOW).floor())
    } else {
        Panel::right("hand_side").exact_size(if commandable { CONTROL_WIDTH } else { SIDE_WIDTH })
    };
    // Filled, as lists that scroll fade into the colour of their panel.
    side.frame(frame.fill(palette.background)).resizable(false).show_separator_line(false).show(ui, |ui| {
        let map = FlatMap {
            station: &shot.station,
            samples,
            real: (signal != Signal::Real && !shown.is_empty()).then_some(shot.real.as_slice()),
            signal,
            colors: &colors,
            name: &name,
        };
        let full_scale = residual.as_ref().map(|residual| residual.full_scale_per_s);
        let tab = if commandable { tabs_ui(ui, &mut state.tab) } else { SideTab::Touch };
        if tab == SideTab::Touch {
            side_ui(ui, cx, &map, &details, (coloring, full_scale));
            return;
        }
        let controls = state.controls_of(&shot.station);
        let room = ui.available_rect_before_wrap().shrink2(egui::vec2(8.0, 0.0));
        ui.scope_builder(egui::UiBuilder::new().max_rect(room), |ui| {
            egui::ScrollArea::vertical().id_salt(tab.label()).auto_shrink(false).show(ui, |ui| match tab {
                SideTab::Control => {
                    control_panel_ui(ui, cx, &mut state.panel, &controls, &shot.positions);
                }
                _ => devices_ui(ui, cx),
            });
        });
    });
    egui::CentralPanel::default().frame(egui::Frame::NONE).show(ui, |ui| {
        let rect = ui.available_rect_before_wrap();
        if rect.width() < 40.0 || rect.height() < 40.0 {
            return;
        }
        let seen = view3d_ui(ui, rect, &mut state.view, &geometry, &moment, &palette, cx.surface);
        let reset =
            seen.hovered.is_none() && seen.response.as_ref().is_some_and(egui::Response::double_clicked);
        if reset {
            state.view.reset(&geometry, &moment);
        }
        if let Some(channel) = seen.hovered {
            cx.playback.hovered = Some(channel);
            if let Some(response) = seen.response {
                response.on_hover_ui_at_pointer(|ui| tooltip_ui(ui, &details, channel, signal));
            }
        }
        if let Some(channel) = seen.clicked {
            let only_select = ui.input(|input| input.modifiers.command);
            click(cx.playback, channel, only_select);
        }
    });
    keys(ui, state, &geometry, &moment);
}

/// The residual map that the operator put on the hand, once it is here and belongs to the session shown.
fn residual_of(cx: &mut ScreenContext<'_>, station: &Station) -> Option<Residual> {
    let run = cx.playback.residual_of.clone()?;
    if cx.playback.hand_source == HandSource::Live {
        return None;
    }
    let run = cx.store.diagnosis(&run);
    let run = run.ready().filter(|run| Some(&run.request.session) == cx.playback.session.as_ref())?;
    Some(Residual::new(run.report.as_ref()?, station))
}

/// Which part of the side panel is open.
fn tabs_ui(ui: &mut egui::Ui, chosen: &mut SideTab) -> SideTab {
    ui.horizontal(|ui| {
        ui.add_space(8.0);
        for tab in SideTab::ALL {
            let is_chosen = *chosen == tab;
            let response = ui.selectable_label(is_chosen, RichText::new(tab.label()).strong());
            response.widget_info(|| egui::WidgetInfo::selected(Role::Tab, true, is_chosen, tab.label()));
            if response.clicked() {
                *chosen = tab;
            }
        }
    });
    *chosen
}

/// Flat map on top, the taxel at hand below.
fn side_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    map: &FlatMap<'_>,
    details: &Details<'_>,
    scale: (Coloring, Option<f64>),
) {
    let room = ui.available_rect_before_wrap().shrink2(egui::vec2(8.0, 0.0));
    let share = if is_narrow(ui.ctx()) { 0.68 } else { 0.52 };
    let map_height = (room.height() * share).clamp(120.0, 420.0);
    let rect = egui::Rect::from_min_size(room.min, egui::vec2(room.width(), map_height));
    ui.scope_builder(egui::UiBuilder::new().max_rect(room), |ui| {
        flat_map_ui(ui, rect, map, cx.playback, &cx.palette);
        ui.advance_cursor_after_rect(rect);
        legend_ui(ui, map, scale, &cx.palette);
        ui.separator();
        egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            let channel = cx
                .playback
                .pinned
                .or(cx.playback.highlighted())
                .filter(|&channel| channel < map.samples.len());
            match channel {
                Some(channel) => {
                    let pinned = cx.playback.pinned == Some(channel);
                    if details_ui(ui, details, channel, pinned, &cx.palette) {
                        click(cx.playback, channel, false);
                    }
                }
                None => nothing_pinned_ui(ui, map, cx.palette.text_weak),
            }
        });
    });
}

fn nothing_pinned_ui(ui: &mut egui::Ui, map: &FlatMap<'_>, weak: egui::Color32) {
    let active = map.samples.iter().filter(|sample| sample.active == Some(true)).count();
    ui.label(RichText::new(format!("{active} of {} taxels active", map.samples.len())).strong());
    ui.label(
        RichText::new(
            "Point at a taxel, here or on the hand, to see what it reads. Click to keep it here with its trace; \
             Ctrl-click picks several for the timelines.",
        )
        .color(weak),
    );
}

/// R and the numbers; everything else belongs to the whole page.
fn keys(ui: &egui::Ui, state: &mut HandState, geometry: &Geometry, moment: &Moment<'_>) {
    if ui.ctx().text_edit_focused() {
        return;
    }
    const NUMBERS: [Key; 9] =
        [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7, Key::Num8, Key::Num9];
    let (reset, number) = ui.input(|input| {
        let plain = input.modifiers.is_none();
        (plain && input.key_pressed(Key::R), NUMBERS.iter().position(|&key| plain && input.key_pressed(key)))
    });
    if reset {
        state.view.reset(geometry, moment);
    }
    if let Some(view) = number.and_then(|idx| geometry.views.get(idx)) {
        state.view.look_at(geometry, moment, view);
    }
}
