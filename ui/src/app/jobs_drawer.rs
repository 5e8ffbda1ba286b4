//! The jobs at work, in a drawer of the bar that every screen has.

use std::collections::BTreeSet;

use egui::{Popup, PopupCloseBehavior, RectAlign, RichText, accesskit::Role};
use palpate_wire::api::{Job, JobState, Role as PersonRole, Scope};

use super::{StudioApp, stop};
use crate::{
    api_client::JobAct,
    route::{Route, Screen},
    screens::{controls::name_button, jobs, progress_bar},
    theme::Palette,
};

/// Width of the drawer, points; on a narrow page, that of its menu.
const WIDTH: f32 = 340.0;
/// The drawer shows so many jobs; the screen has the rest.
const MAX_JOBS: usize = 6;

/// What this page has seen of jobs.
#[derive(Debug, Default)]
pub(super) struct JobsDrawer {
    /// Jobs that had not ended when they were seen last, by id.
    unfinished: BTreeSet<String>,
    /// Jobs that have ended since, and that nobody has looked at, by id.
    news: BTreeSet<String>,
}

impl JobsDrawer {
    /// Takes in the jobs as they are now. The screen of jobs shows them all, so nothing there `is_news`.
    fn follow(&mut self, jobs: &[Job], is_news: bool) {
        for job in jobs {
            if job.is_unfinished() {
                self.unfinished.insert(job.id.clone());
                self.news.remove(&job.id);
            } else if self.unfinished.remove(&job.id) {
                self.news.insert(job.id.clone());
            }
        }
        self.news.retain(|id| is_news && jobs.iter().any(|job| job.id == *id));
    }
}

/// What was pressed in the drawer.
enum Pressed {
    Open(Box<Route>),
    Cancel(String),
}

impl StudioApp {
    /// The button of the drawer, while jobs are at work or have just ended.
    pub(super) fn jobs_button_ui(&mut self, ui: &mut egui::Ui, palette: &Palette) {
        let jobs = self.jobs_in_drawer();
        if jobs.is_empty() || self.route.screen == Screen::Jobs {
            return;
        }
        let text = summary(&jobs);
        let colour = colour(&jobs, palette);
        let response = ui.button(RichText::new(format!("{text} \u{23f7}")).color(colour));
        // To the left: STOP is on the right, and nothing comes over it.
        let popup = Popup::menu(&response)
            .align(RectAlign::BOTTOM_END)
            .align_alternatives(&[])
            .close_behavior(PopupCloseBehavior::CloseOnClickOutside);
        let inner = popup.show(|ui| {
            ui.set_width(WIDTH);
            let pressed = self.jobs_list_ui(ui, palette, &jobs);
            if matches!(pressed, Some(Pressed::Open(_))) {
                ui.close();
            }
            pressed
        });
        response
            .widget_info(|| egui::WidgetInfo::labeled(Role::Button, true, format!("Jobs at work: {text}")));
        self.carry_out(inner.and_then(|inner| inner.inner));
    }

    /// The same as part of a menu that is open.
    pub(super) fn jobs_menu_ui(&mut self, ui: &mut egui::Ui, palette: &Palette) {
        let jobs = self.jobs_in_drawer();
        if jobs.is_empty() {
            return;
        }
        ui.separator();
        let pressed = self.jobs_list_ui(ui, palette, &jobs);
        if matches!(pressed, Some(Pressed::Open(_))) {
            ui.close();
        }
        self.carry_out(pressed);
    }

    /// The jobs at work, then those that have ended and that nobody has looked at, as they are now.
    fn jobs_in_drawer(&mut self) -> Vec<Job> {
        let list = self.store.jobs.list();
        let jobs = list.ready().map_or(&[][..], |jobs| jobs.as_slice());
        self.jobs_drawer.follow(jobs, self.route.screen != Screen::Jobs);
        // Whoever has its result on the screen has looked.
        if let Some(run) = &self.route.run {
            self.jobs_drawer.news.remove(run);
        }
        let news = &self.jobs_drawer.news;
        let at_work = jobs.iter().filter(|job| job.is_unfinished());
        at_work.chain(jobs.iter().filter(|job| news.contains(&job.id))).cloned().collect()
    }

    fn jobs_list_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, jobs: &[Job]) -> Option<Pressed> {
        let may = self.store.people.lacks(PersonRole::Operator, Scope::Jobs).is_none();
        let mut pressed = None;
        let height = (ui.ctx().content_rect().height() - stop::NARROW_BAR - 40.0).max(120.0);
        egui::ScrollArea::vertical().id_salt("jobs_drawer").max_height(height).show(ui, |ui| {
            for job in jobs.iter().take(MAX_JOBS) {
                if let Some(now) = entry_ui(ui, palette, job, may) {
                    if let Pressed::Open(_) = now {
                        self.jobs_drawer.news.remove(&job.id);
                    }
                    pressed = Some(now);
                }
                ui.separator();
            }
            ui.horizontal(|ui| {
                if ui.button("All jobs").clicked() {
                    pressed = Some(Pressed::Open(Box::new(Route::to(Screen::Jobs))));
                }
                if jobs.len() > MAX_JOBS {
                    ui.label(format!("and {} more", jobs.len() - MAX_JOBS));
                }
                let has_news = !self.jobs_drawer.news.is_empty();
                if has_news && ui.button("Seen").on_hover_text("Takes what has ended off this list").clicked()
                {
                    self.jobs_drawer.news.clear();
                }
            });
        });
        pressed
    }

    fn carry_out(&mut self, pressed: Option<Pressed>) {
        match pressed {
            Some(Pressed::Open(route)) => self.go(*route),
            Some(Pressed::Cancel(id)) => self.store.jobs.act(&id, JobAct::Cancel),
            None => {}
        }
    }
}

fn entry_ui(ui: &mut egui::Ui, palette: &Palette, job: &Job, may: bool) -> Option<Pressed> {
    let mut pressed = None;
    ui.horizontal(|ui| {
        let name = RichText::new(format!("{} {}", jobs::mark(job.state), job.id)).strong();
        let open = ui.add(egui::Button::new(name).frame(false)).on_hover_text("Shows the job");
        name_button(&open, &format!("Show job {}", job.id));
        if open.clicked() {
            let route = Route { job: Some(job.id.clone()), ..Route::to(Screen::Jobs) };
            pressed = Some(Pressed::Open(Box::new(route)));
        }
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            if job.is_unfinished() {
                let can = may && !job.cancel_requested;
                let cancel = ui.add_enabled(can, egui::Button::new("Cancel"));
                name_button(&cancel, &format!("Cancel job {}", job.id));
                if cancel.clicked() {
                    pressed = Some(Pressed::Cancel(job.id.clone()));
                }
            } else if let Some((route, face)) = jobs::outcome_of(job) {
                let open = ui.button(face);
                name_button(&open, &format!("{face} of job {}", job.id));
                if open.clicked() {
                    pressed = Some(Pressed::Open(Box::new(route)));
                }
            }
        });
    });
    match job.state {
        JobState::Running => {
            let bar = progress_bar(job.fraction, &jobs::progress_text(job));
            ui.add(bar.desired_width(ui.available_width()));
            ui.add(egui::Label::new(RichText::new(&job.stage).color(palette.text_weak)).truncate());
        }
        JobState::Failed => {
            let problem = job.problem.as_deref().unwrap_or("its log may say why");
            ui.add(egui::Label::new(RichText::new(problem).color(palette.mismatch)).truncate());
        }
        JobState::Queued | JobState::Done | JobState::Cancelled => {
            ui.label(RichText::new(job.state.name()).color(palette.text_weak));
        }
    }
    pressed
}

/// A failed one is what matters most, then what is at work.
fn colour(jobs: &[Job], palette: &Palette) -> egui::Color32 {
    if jobs.iter().any(|job| job.state == JobState::Failed) { palette.mismatch } else { palette.real }
}

/// On one line: what is at work and how far it is, and what has ended.
fn summary(jobs: &[Job]) -> String {
    let count = |state: JobState| jobs.iter().filter(|job| job.state == state).count();
    let (running, waiting) = (count(JobState::Running), count(JobState::Queued));
    let mut parts = Vec::new();
    if running > 0 {
        let done: f64 =
            jobs.iter().filter(|job| job.state == JobState::Running).map(|job| job.fraction).sum();
        let percent = 100.0 * done / running as f64;
        parts.push(format!("{} {running} at work, {percent:.0} %", jobs::mark(JobState::Running)));
    }
    if waiting > 0 {
        parts.push(format!("{waiting} waiting"));
    }
    for state in [JobState::Failed, JobState::Done, JobState::Cancelled] {
        if count(state) > 0 {
            parts.push(format!("{} {} {}", jobs::mark(state), count(state), state.name()));
        }
    }
    parts.join(" \u{b7} ")
}
