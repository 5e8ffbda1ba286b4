//! What words mean: `docs/glossary.md`, to be looked through while one works.

use egui::RichText;

use super::overlays::dialog;
use crate::theme::Palette;

const GLOSSARY: &str = include_str!("../../../docs/glossary.md");

/// What was typed to look for.
#[derive(Debug)]
pub(super) struct GlossaryState {
    words: String,
    has_focus: bool,
}

impl GlossaryState {
    /// The glossary at the words that have `words`.
    pub(super) fn new(words: &str) -> Self {
        Self { words: words.to_owned(), has_focus: false }
    }
}

/// What the reader wants next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    Stay,
    Close,
    Shortcuts,
}

pub(super) fn glossary_ui(ctx: &egui::Context, state: &mut GlossaryState) -> Answer {
    let palette = Palette::of(ctx.theme());
    let modal = dialog(ctx, "glossary", 760.0, |ui| {
        let mut answer = Answer::Stay;
        ui.horizontal_wrapped(|ui| {
            crate::screens::heading_ui(ui, "What words mean");
            let size = egui::vec2(0.0, 32.0);
            if ui.add(egui::Button::new("Keyboard shortcuts").min_size(size)).clicked() {
                answer = Answer::Shortcuts;
            }
            if ui.add(egui::Button::new("Close help").min_size(size)).clicked() {
                answer = Answer::Close;
            }
        });
        let field = egui::TextEdit::singleline(&mut state.words)
            .hint_text("A word, or part of one")
            .desired_width(f32::INFINITY)
            .min_size(egui::vec2(0.0, 32.0));
        let field = ui.add(field).accessible_name("Word");
        if !state.has_focus {
            state.has_focus = true;
            field.request_focus();
        }
        ui.add_space(6.0);
        let found: Vec<(String, String)> = found(&state.words).collect();
        if found.is_empty() {
            ui.label("No word has these letters. Delete one to see more.");
        }
        for (word, meaning) in found {
            ui.horizontal_wrapped(|ui| {
                ui.label(RichText::new(word).strong());
                ui.label(meaning);
            });
        }
        ui.add_space(6.0);
        let text = "More is in the folder docs of the source: calibration.md and diagnosis.md say how numbers come about.";
        ui.label(RichText::new(text).color(palette.text_weak));
        let api = egui::Hyperlink::from_label_and_url("What scripts can ask for", "/api/docs");
        ui.add(api.open_in_new_tab(true));
        answer
    });
    if modal.should_close() { Answer::Close } else { modal.inner }
}

/// Words and meanings whose word has all of `words`, or else whose meaning has.
fn found(words: &str) -> impl Iterator<Item = (String, String)> {
    let words: Vec<String> = words.to_lowercase().split_whitespace().map(str::to_owned).collect();
    let has = move |text: &str| {
        let text = text.to_lowercase();
        words.iter().all(|word| text.contains(word))
    };
    let mut rows: Vec<(bool, (String, String))> = entries()
        .map(|entry| (has(&entry.0), entry))
        .filter(|(named, entry)| *named || has(&entry.1))
        .collect();
    rows.sort_by_key(|(named, _)| !named);
    rows.into_iter().map(|(_, entry)| entry)
}

/// The rows of the table, below its head, without the marks of Markdown.
fn entries() -> impl Iterator<Item = (String, String)> {
    GLOSSARY.lines().filter_map(|line| {
        let (word, meaning) = line.strip_prefix("| ")?.strip_suffix(" |")?.split_once(" | ")?;
        (word != "word").then(|| (word.to_owned(), plain(meaning)))
    })
}

/// `text` without back quotes, and links as the words that they stand under.
fn plain(text: &str) -> String {
    let mut plain = String::new();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once('[') {
        let Some((words, target)) = after.split_once("](") else { break };
        let Some((_, behind)) = target.split_once(')') else { break };
        plain.push_str(before);
        plain.push_str(words);
        rest = behind;
    }
    plain.push_str(rest);
    plain.replace('`', "")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_of_the_table_is_an_entry() {
        let rows = GLOSSARY.lines().filter(|line| line.starts_with("| ")).count();
        assert_eq!(entries().count(), rows - 1, "all but the head");
        assert!(entries().all(|(word, meaning)| !word.is_empty() && !meaning.contains(['`', '['])));
    }

    #[test]
    fn words_of_the_screens_are_explained() {
        let words = "lambda_con, alpha, F1, bar, null session, gap, primitive, channel-second, effect, evidence, wanted take";
        for word in words.split(", ") {
            let first = found(word).next();
            let named =
                first.as_ref().is_some_and(|(entry, _)| entry.to_lowercase().contains(&word.to_lowercase()));
            assert!(named, "{word}: {first:?}");
        }
        assert_eq!(found("no such word at all").count(), 0);
    }
}
