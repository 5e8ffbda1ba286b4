//! The frame around the screens: rail, top bar, address bar, shortcuts, and what comes in from the server.

mod bars;
mod frame_rate;
mod help;
mod jobs_drawer;
mod lag;
mod name;
mod notes;
mod overlays;
mod picture;
mod stop;
mod strip;

#[cfg(target_arch = "wasm32")]
pub(crate) use stop::STOP_NAME;

use std::{collections::HashMap, time::Duration};

use overlays::Place;

use crate::{
    api_client::Api,
    commands::Command,
    playback::{HandSource, ModelRef, Playback},
    route::{HelpPlace, Route, Screen},
    screens::{self, PickedFile, ScreenContext, Subject, View},
    store::{Connection, Store},
    surface::Surface,
    theme::{self, Palette},
};

/// Seconds between attempts to open the stream socket again.
const RECONNECT_AFTER_S: f64 = 2.0;
/// The page is painted at least this often while it holds the lease.
const CONTROL_REPAINT: Duration = Duration::from_millis(50);
/// So soon is the station's state drawn in the bar of a screen that shows nothing else of the stream.
const BAR_REPAINT: Duration = Duration::from_millis(200);
/// So soon is it drawn on a screen that shows what the hand feels: in the next frame. Not zero, for which egui draws two.
const STREAM_REPAINT: Duration = Duration::from_millis(1);
/// Seconds between writes of the cursor's time to the address bar: browsers refuse more than a few a second.
const ADDRESS_EVERY_S: f64 = 0.5;
/// The space bar still means STOP this long after torque went off, s: a station that disarms by itself may do so just
/// before the hand of whoever saw the trouble comes down.
const STOP_AFTER_ARMED_S: f64 = 2.0;

/// What the frame needs of the window it runs in.
pub trait Platform {
    /// The address bar's part after and with `#`; empty if there is none.
    fn hash(&self) -> String;
    /// Goes to `hash`, so that "back" returns.
    fn push_hash(&mut self, hash: &str);
    /// Goes to `hash` without a step for "back".
    fn replace_hash(&mut self, hash: &str);
    /// The whole address, which opens the same view elsewhere.
    fn address(&self) -> String;
    /// The operator's time of day, e.g. `14:03:12`.
    fn time_of_day(&self) -> String;
    /// A time as RFC 3339 has it, in the operator's time zone, e.g. `2026-03-02 10:30:00`; `None` if it cannot be read.
    fn local_time(&self, rfc3339: &str) -> Option<String>;
    /// The theme that was chosen in an earlier visit.
    fn saved_theme(&self) -> Option<egui::Theme>;
    /// Keeps the theme for the next visit.
    fn save_theme(&mut self, theme: egui::Theme);
    /// Who sat at this page in an earlier visit; empty for nobody.
    fn saved_operator(&self) -> String;
    /// Keeps who sits at this page for the next visit.
    fn save_operator(&mut self, operator: &str);
    /// Whether somebody can be looking: the page can be seen and has the focus.
    fn is_watched(&self) -> bool;
    /// Says what is open where the window says it.
    fn set_title(&mut self, title: &str);
    /// Keeps `picture` as a PNG file called `file_name`; `false` where that cannot be done.
    fn save_picture(&mut self, file_name: &str, picture: &egui::ColorImage) -> bool;
    /// Opens the file dialog.
    fn pick_file(&mut self);
    /// Files that were chosen in the file dialog, or dropped on the page, since the last call.
    fn picked_files(&mut self) -> Vec<PickedFile>;
}

/// The page.
pub struct StudioApp {
    /// Everything the server said.
    pub store: Store,
    /// The shared cursor and selection.
    pub playback: Playback,
    api: Box<dyn Api>,
    platform: Box<dyn Platform>,
    route: Route,
    last_hash: String,
    last_address_s: f64,
    title: String,
    next_connect_s: f64,
    next_control_s: f64,
    last_armed_s: f64,
    surface: Option<Surface>,
    overlays: overlays::Overlays,
    help: Option<help::HelpState>,
    library: help::Library,
    strip: strip::StripState,
    jobs_drawer: jobs_drawer::JobsDrawer,
    picture: picture::PictureState,
    name_question: Option<name::NameQuestion>,
    frame_rate: frame_rate::FrameRate,
    lag: lag::Lag,
    views: HashMap<Screen, Box<dyn View>>,
}

impl StudioApp {
    /// A page that has asked for nothing yet. `surface` is what wgpu paints on, if there is one.
    pub fn new(
        ctx: &egui::Context,
        api: Box<dyn Api>,
        platform: Box<dyn Platform>,
        surface: Option<Surface>,
    ) -> Self {
        theme::install(ctx);
        // A button that is pressed for long is pressed, and where a frame takes a second every press is long.
        ctx.options_mut(|options| options.input_options.max_click_duration = f64::INFINITY);
        if let Some(theme) = platform.saved_theme() {
            ctx.set_theme(theme);
        }
        let mut app = Self {
            store: Store::default(),
            playback: Playback::default(),
            api,
            platform,
            route: Route::default(),
            last_hash: String::new(),
            last_address_s: 0.0,
            title: String::new(),
            next_connect_s: 0.0,
            next_control_s: 0.0,
            last_armed_s: f64::NEG_INFINITY,
            surface,
            overlays: overlays::Overlays::default(),
            help: None,
            library: help::Library::default(),
            strip: strip::StripState::default(),
            jobs_drawer: jobs_drawer::JobsDrawer::default(),
            picture: picture::PictureState::default(),
            name_question: None,
            frame_rate: frame_rate::FrameRate::default(),
            lag: lag::Lag::default(),
            views: HashMap::new(),
        };
        app.store.ask_info();
        app.store.control.operator = app.platform.saved_operator();
        app.last_hash = app.platform.hash();
        app.apply_hash(&app.last_hash.clone());
        app
    }

    /// The screen that is open.
    pub fn screen(&self) -> Screen {
        self.route.screen
    }

    /// How long a stretch of time `screen` shows, s, once it does.
    pub fn shown_span_s(&self, screen: Screen) -> Option<f64> {
        self.views.get(&screen)?.shown_span_s()
    }

    /// One frame.
    pub fn ui(&mut self, ui: &mut egui::Ui) {
        let ctx = ui.ctx().clone();
        let now_s = ctx.input(|input| input.time);
        self.take_in(now_s);
        self.follow_address_bar();
        self.playback.begin_frame(f64::from(ctx.input(|input| input.stable_dt)));
        if self.playback.playing {
            ctx.request_repaint();
        }

        let mut go_to = None;
        let commandable = self.store.is_commandable();
        if self.store.is_armed() {
            self.last_armed_s = now_s;
        }
        let space_stops = now_s - self.last_armed_s < STOP_AFTER_ARMED_S;
        if Command::stop_pressed(&ctx, commandable && space_stops) || (commandable && stop::is_pressed(&ctx))
        {
            self.store.control.stop();
            // Before anything is drawn: that may take long.
            self.send_commands();
        }
        let counts = self.store.control.lease() != 0 && self.platform.is_watched();
        self.frame_rate.frame(now_s, counts);
        let reads = self.help.is_some();
        let mut commands = if self.overlays.palette_is_open() {
            Vec::new()
        } else {
            Command::pressed(&ctx, commandable, reads)
        };
        commands.extend(self.overlays.take_chosen());
        if let Some(place) = self.overlays.take_place() {
            go_to = Some(place);
        }

        // What is asked for in this frame shows the next one, without the menu that it was asked from.
        let takes_picture = self.picture.is_wanted();
        self.top_bar_ui(ui, now_s);
        self.rail_ui(ui, &mut go_to);
        for command in commands {
            self.run_command(&ctx, command, &mut go_to);
        }
        let ground = screen_ground(ui.style(), self.route.screen);
        let screen =
            egui::CentralPanel::default().frame(ground).show(ui, |ui| self.screen_ui(ui, now_s, &mut go_to));
        self.picture_ui(&ctx, screen.response.rect, takes_picture);
        if self.store.control.take_control_wanted() {
            self.ask_for_control();
        }
        let places = if self.overlays.palette_is_open() { self.places() } else { Vec::new() };
        if let Some(place) = screens::help::asked(&ctx) {
            self.open_help(place);
        }
        self.help_ui(&ctx);
        self.overlays.ui(&ctx, commandable, &places);
        self.take_over_ui(&ctx);
        self.name_ui(&ctx);
        if commandable {
            self.stop_ui(&ctx);
        }

        if let Some(route) = go_to {
            self.go(route);
        }
        self.write_address_bar(now_s);
        self.write_title();
        self.send_commands();
        self.keep_control(&ctx);
        self.api.draw_stream_within(stream_within(self.route.screen));
        let lease = self.store.control.lease();
        for request in self.store.take_outbox() {
            self.api.send(lease, request);
        }
    }

    /// Sends what the operator commanded in this frame, a stop first.
    fn send_commands(&mut self) {
        for (lease, request) in self.store.control.take_outbox() {
            let sequence = self.api.send_control(lease, request.clone());
            self.store.control.sent(sequence, &request);
        }
    }

    /// Keeps the lease alive.
    fn keep_control(&mut self, ctx: &egui::Context) {
        let lease = self.store.control.lease();
        self.api.beat((lease != 0).then_some(lease));
        if lease != 0 {
            // What is shown of a robot that may move is never older than this.
            ctx.request_repaint_after(CONTROL_REPAINT);
        }
    }

    fn screen_ui(&mut self, ui: &mut egui::Ui, now_s: f64, go_to: &mut Option<Route>) {
        let route = self.route.clone();
        let mut picked_files = self.platform.picked_files();
        let mut pick_file = false;
        let platform = &self.platform;
        let mut cx = ScreenContext {
            store: &mut self.store,
            playback: &mut self.playback,
            palette: Palette::of(ui.ctx().theme()),
            route: &route,
            go_to,
            surface: self.surface,
            now_s,
            local_time: &|text| platform.local_time(text),
            picked_files: &mut picked_files,
            pick_file: &mut pick_file,
        };
        if let Some(slug) = &route.lost {
            return screens::lost_ui(ui, &mut cx, slug);
        }
        view_of(&mut self.views, route.screen).ui(ui, &mut cx);
        if pick_file {
            self.platform.pick_file();
        }
    }

    fn take_in(&mut self, now_s: f64) {
        let events = self.api.poll();
        let time_of_day = if events.is_empty() { String::new() } else { self.platform.time_of_day() };
        for event in events {
            self.store.receive(event, now_s, &time_of_day);
        }
        if self.store.connection != Connection::Open && now_s >= self.next_connect_s {
            self.next_connect_s = now_s + RECONNECT_AFTER_S;
            self.api.open_socket();
        }
        // Only a station that has told about its safety layer takes commands.
        if self.store.control_state().is_some()
            && !self.store.control.is_open()
            && now_s >= self.next_control_s
        {
            self.next_control_s = now_s + RECONNECT_AFTER_S;
            self.api.open_control();
        }
    }

    /// Takes over what the operator (or "back") wrote into the address bar.
    fn follow_address_bar(&mut self) {
        let hash = self.platform.hash();
        if hash != self.last_hash {
            self.last_hash.clone_from(&hash);
            self.apply_hash(&hash);
        }
    }

    /// Help lies over the screen that was open; every other address is a screen's.
    fn apply_hash(&mut self, hash: &str) {
        match HelpPlace::from_hash(hash) {
            Some(place) => self.show_help(place),
            None => {
                self.help = None;
                self.apply_route(Route::from_hash(hash));
            }
        }
    }

    fn apply_route(&mut self, route: Route) {
        if route.screen.about().subject == Subject::Take {
            let source = if route.live { HandSource::Live } else { HandSource::Recorded };
            self.playback.hand_source = source;
        }
        if let (Some(session), Some(take)) = (&route.session, &route.take) {
            self.playback.open(session, take);
        } else if let Some(session) = &route.session {
            self.playback.open_session(session);
        }
        if let Some(time_s) = route.time_s {
            self.playback.seek(time_s);
        }
        if let Some(model) = route.model.as_deref().and_then(ModelRef::from_key) {
            self.playback.compared = Some(model);
        }
        if let Some(model) = route.diagnosed.as_deref().and_then(ModelRef::from_key) {
            self.playback.diagnosed = Some(model);
        }
        self.route = route;
    }

    fn go(&mut self, route: Route) {
        // The simulations of one session mean nothing on another.
        let stays = route.session.is_none() || route.session == self.playback.session;
        let key = |model: &Option<ModelRef>| model.as_ref().filter(|_| stays).map(ModelRef::key);
        let (model, diagnosed) = (key(&self.playback.compared), key(&self.playback.diagnosed));
        let route = Route { model: route.model.or(model), diagnosed: route.diagnosed.or(diagnosed), ..route };
        let hash = route.to_string();
        self.platform.push_hash(&hash);
        self.last_hash = self.platform.hash();
        self.help = None;
        self.apply_route(route);
    }

    /// Keeps the address bar saying what is on the screen: a new take is a step for "back", a new time is not.
    fn write_address_bar(&mut self, now_s: f64) {
        if self.help.is_some() {
            return;
        }
        let shows_take = self.route.screen.about().subject == Subject::Take;
        let route = if shows_take {
            Route {
                session: self.playback.session.clone(),
                take: self.playback.take.clone(),
                time_s: self.playback.take.as_ref().map(|_| (self.playback.time_s * 1000.0).round() / 1000.0),
                model: self.playback.compared.as_ref().map(ModelRef::key),
                diagnosed: self.playback.diagnosed.as_ref().map(ModelRef::key),
                live: self.playback.hand_source == HandSource::Live,
                ..self.route.clone()
            }
        } else {
            self.route.clone()
        };
        let hash = route.to_string();
        if hash == self.last_hash {
            return;
        }
        // Filling in what the screen chose by itself is no step; changing one take for another is.
        let chosen_by_hand = self.route.take.is_some() && !self.route.is_same_place(&route);
        if chosen_by_hand {
            self.platform.push_hash(&hash);
        } else if !self.playback.playing && now_s - self.last_address_s >= ADDRESS_EVERY_S {
            self.last_address_s = now_s;
            self.platform.replace_hash(&hash);
        } else {
            return;
        }
        self.last_hash = self.platform.hash();
        self.route = route;
    }

    fn write_title(&mut self) {
        let shown = [self.playback.session.as_deref(), self.playback.take.as_deref()];
        let shown: Vec<&str> = shown.into_iter().flatten().collect();
        let place = if shown.is_empty() { String::new() } else { format!(" \u{b7} {}", shown.join(" ")) };
        let screen = if self.route.lost.is_some() { "Not found" } else { self.route.screen.label() };
        let shown = self.help_title().unwrap_or_else(|| format!("{screen}{place}"));
        let title = format!("{shown} \u{2013} Palpate");
        if title != self.title {
            self.platform.set_title(&title);
            self.title = title;
        }
    }

    fn run_command(&mut self, ctx: &egui::Context, command: Command, go_to: &mut Option<Route>) {
        match command {
            Command::Open(screen) => *go_to = Some(self.route_of(screen)),
            Command::PlayPause => self.playback.toggle_playing(),
            Command::PreviousTake => self.step_take(-1),
            Command::NextTake => self.step_take(1),
            Command::PreviousFrame => self.step_frame(-1),
            Command::NextFrame => self.step_frame(1),
            Command::ToggleTheme => self.toggle_theme(ctx),
            Command::Shortcuts => self.overlays.toggle_shortcuts(),
            Command::Help => self.open_help(HelpPlace::default()),
            Command::CopyLink => ctx.copy_text(self.platform.address()),
            Command::SavePicture => self.want_picture(ctx),
            Command::Palette => {
                self.close_help();
                self.overlays.open_palette();
            }
            Command::PreviousMismatch | Command::NextMismatch | Command::FitTake => {
                view_of(&mut self.views, Screen::Timelines).take_command(command);
            }
            Command::Stop => self.store.control.stop(),
            Command::ResetStop => self.store.control.reset_stop(),
            Command::TakeControl => self.ask_for_control(),
            Command::GiveBackControl => self.store.control.release(),
            Command::Arm => self.store.control.arm(),
            Command::Disarm => self.store.control.disarm(),
            Command::Tare => self.store.control.tare(),
        }
    }

    fn route_of(&self, screen: Screen) -> Route {
        let subject = screen.about().subject;
        Route {
            // What is being recorded is the station's own business.
            session: self.playback.session.clone().filter(|_| subject != Subject::Station),
            take: self.playback.take.clone().filter(|_| subject == Subject::Take),
            run: match (screen, &self.playback.compared, &self.playback.diagnosed) {
                (Screen::Calibrate, Some(ModelRef::Run(run)), _) => Some(run.clone()),
                (Screen::Diagnose, _, Some(ModelRef::Diagnosis(run))) => Some(run.clone()),
                _ => None,
            },
            live: subject == Subject::Take && self.playback.hand_source == HandSource::Live,
            ..Route::to(screen)
        }
    }

    /// What the palette finds besides commands.
    fn places(&mut self) -> Vec<Place> {
        let mut places = Vec::new();
        let session = self.playback.session.clone();
        let here = |screen: Screen| Route { session: session.clone(), ..Route::to(screen) };
        if let Some(sessions) = self.store.sessions().ready() {
            places.extend(sessions.iter().map(|known| Place {
                label: format!("Session {}", known.id),
                route: Route::to(Screen::Sessions).with_session(known.id.clone()),
            }));
        }
        if let Some(session) = &session
            && let Some(detail) = self.store.session(session).ready()
        {
            places.extend(detail.takes.iter().map(|take| Place {
                label: format!("Take {}: {} on {}", take.id, screens::words(&take.primitive), take.object),
                route: here(Screen::Timelines).with_take(take.id.clone()),
            }));
        }
        if let Some(models) = self.store.models().ready() {
            places.extend(models.iter().map(|model| {
                let (key, route) = (Some(model.id.clone()), here(Screen::Timelines));
                let route = match model.effects.is_empty() {
                    true => Route { model: key, ..route },
                    false => Route { diagnosed: key, ..route },
                };
                Place { label: format!("Compare with model {}", model.name), route }
            }));
        }
        let run = |what: &str, screen: Screen, id: &str, session: &str| Place {
            label: format!("{what} {id} of {session}"),
            route: Route { run: Some(id.to_owned()), ..Route::to(screen).with_session(session) },
        };
        if let Some(runs) = self.store.runs().ready() {
            places.extend(
                runs.iter()
                    .map(|known| run("Calibration", Screen::Calibrate, &known.id, &known.request.session)),
            );
        }
        if let Some(runs) = self.store.diagnoses().ready() {
            places.extend(
                runs.iter()
                    .map(|known| run("Diagnosis", Screen::Diagnose, &known.id, &known.request.session)),
            );
        }
        places
    }

    fn step_take(&mut self, step: isize) {
        let Some(session) = self.playback.session.clone() else { return };
        let detail = self.store.session(&session);
        let Some(detail) = detail.ready() else { return };
        let current = detail.takes.iter().position(|take| Some(&take.id) == self.playback.take.as_ref());
        let next = current.and_then(|idx| idx.checked_add_signed(step)).and_then(|idx| detail.takes.get(idx));
        if let Some(take) = next {
            self.playback.open(&session, &take.id);
        }
    }

    fn step_frame(&mut self, step: isize) {
        let (Some(session), Some(take)) = (self.playback.session.clone(), self.playback.take.clone()) else {
            return;
        };
        let take = self.store.take(&session, &take);
        if let Some(take) = take.ready() {
            self.playback.step_frames(take, step);
        }
    }
}

/// The frame around a screen. On the Hand screen, which is drawn most often, what the canvas was cleared with is the
/// background: without a graphics card every pixel that is filled twice costs time.
fn screen_ground(style: &egui::Style, screen: Screen) -> egui::Frame {
    let frame = egui::Frame::central_panel(style);
    if screen == Screen::Hand { frame.fill(egui::Color32::TRANSPARENT) } else { frame }
}

/// How soon what comes on the stream is drawn on `screen`. Without a graphics card a frame costs a good part of a core.
fn stream_within(screen: Screen) -> Duration {
    if screen.about().shows_stream { STREAM_REPAINT } else { BAR_REPAINT }
}

/// `screen`, as it was left.
fn view_of(views: &mut HashMap<Screen, Box<dyn View>>, screen: Screen) -> &mut dyn View {
    views.entry(screen).or_insert_with(screen.about().new).as_mut()
}
