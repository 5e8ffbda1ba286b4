//! Adding what was named to a model, undoing it, and what the saved models hold.

use egui::RichText;
use palpate_reports::{DiagnosisReport, wording};
use palpate_wire::api::{DiagnosisRun, ModelSummary, SaveDiagnosisRequest};

use super::Shown;
use crate::{
    route::Screen,
    screens::{ScreenContext, heading_ui},
    store::Loadable,
};

pub(super) fn keep_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    shown: &mut Shown,
    run: &DiagnosisRun,
    report: &DiagnosisReport,
) {
    let chosen: Vec<usize> = (0..report.effects.len()).filter(|idx| !shown.unticked.contains(idx)).collect();
    let count = match (chosen.len(), report.effects.len()) {
        (_, 0) => "nothing was named, so there is nothing to add".to_owned(),
        (some, all) if some == all => format!("all {all} named effects ticked"),
        (some, all) => format!("{some} of {all} named effects ticked"),
    };
    ui.horizontal_wrapped(|ui| {
        heading_ui(ui, "4  Keep");
        ui.label(count);
    });
    ui.horizontal_wrapped(|ui| {
        match &run.saved_as {
            Some(model) => saved_ui(ui, cx, run, model),
            None if !report.effects.is_empty() => add_ui(ui, cx, shown, run, chosen),
            None => {}
        }
        if ui.button("Timelines").on_hover_text("Real, before and after on one time axis").clicked() {
            cx.go_to_screen(Screen::Timelines);
        }
        ui.hyperlink_to("Open the report", format!("/api/v1/diagnoses/{}/report.html", run.id));
    });
    for problem in [
        cx.store.added_to.error().map(|error| format!("Nothing was added: {error}")),
        cx.store.undone_model.error().map(|error| format!("It was not undone: {error}")),
        cx.store.deleted_model.error().map(|error| format!("It was not undone: {error}")),
    ]
    .into_iter()
    .flatten()
    {
        ui.colored_label(cx.palette.mismatch, problem);
    }
}

fn add_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    shown: &mut Shown,
    run: &DiagnosisRun,
    effects: Vec<usize>,
) {
    let some = !effects.is_empty();
    if let Some(model) = &run.request.model {
        let text = RichText::new(format!("Add to {model}")).strong().color(cx.palette.surface);
        let button = egui::Button::new(text).fill(cx.palette.diagnosed);
        let hint = "Appends the ticked effects to this model's file; Undo brings the file back as it was";
        if ui.add_enabled(some, button).on_hover_text(hint).clicked() {
            let to = Some(model.clone());
            let body = SaveDiagnosisRequest { effects: Some(effects.clone()), name: None, to };
            cx.store.save_diagnosis(&run.id, body);
        }
    }
    let label = ui.label("Model name");
    let field = egui::TextEdit::singleline(&mut shown.model_name).desired_width(180.0);
    ui.add(field).labelled_by(label.id);
    let named = some && !shown.model_name.trim().is_empty();
    if ui.add_enabled(named, egui::Button::new("Add as a new model")).clicked() {
        let name = Some(shown.model_name.trim().to_owned());
        cx.store.save_diagnosis(&run.id, SaveDiagnosisRequest { effects: Some(effects), name, to: None });
    }
    if cx.store.added_to == Loadable::Loading {
        ui.spinner();
    }
}

fn saved_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, run: &DiagnosisRun, model: &str) {
    let added = run.request.model.as_deref() == Some(model);
    let what = if added { "Added to" } else { "Saved as" };
    ui.label(RichText::new(format!("\u{2714} {what} {model}, which is the model in use now.")).strong());
    let hint =
        if added { "Brings the model's file back as it was" } else { "Moves the new model to the trash" };
    if ui.button("Undo").on_hover_text(hint).clicked() {
        if added {
            cx.store.undo_model(model);
        } else {
            cx.store.delete_model(model);
        }
    }
}

/// The saved models, with the effects that they hold.
pub(super) fn models_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let models = cx.store.models();
    let Some(models) = models.ready().filter(|models| !models.is_empty()) else { return };
    ui.separator();
    ui.label(RichText::new("Models").strong());
    for model in models.iter() {
        model_ui(ui, cx, model);
    }
}

fn model_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, model: &ModelSummary) {
    let effects = match model.effects.len() {
        0 => "no effects".to_owned(),
        1 => "1 effect".to_owned(),
        many => format!("{many} effects"),
    };
    let title = format!("{} ({effects})", model.name);
    egui::CollapsingHeader::new(title)
        .id_salt((&model.id, model.effects.len()))
        .default_open(!model.effects.is_empty())
        .show(ui, |ui| {
            let weak = |text: String| RichText::new(text).color(cx.palette.text_weak).size(13.5);
            ui.label(weak(format!(
                "\u{3bb}con {}, \u{3b1} {} /m, \u{3bb}pre {} Pa",
                wording::quantity("lambda_con_m", model.theta.lambda_con_m),
                wording::number(model.theta.alpha_per_m),
                wording::number(model.theta.lambda_pre_pa),
            )));
            for (id, own) in &model.streams {
                ui.label(weak(format!("{id}: {}", wording::stream_theta(own))));
            }
            ui.hyperlink_to("Model file", format!("/api/v1/models/{}", model.id))
                .on_hover_text("The TOML file that replay, live twin and training read");
            for effect in &model.effects {
                ui.label(format!("+ {}", wording::model_effect(effect)));
            }
        });
}
