//! What words mean: `docs/glossary.md`, which the page carries, so that it explains itself without a server too.

use egui::RichText;
use palpate_wire::markdown::plain;

const GLOSSARY: &str = include_str!("../../../../docs/glossary.md");

/// Name of this document among the others.
pub(super) const NAME: &str = "glossary";

/// Its Markdown.
pub(super) fn text() -> &'static str {
    GLOSSARY
}

/// Words and meanings that have `words`, all of them where none were typed.
pub(super) fn glossary_ui(ui: &mut egui::Ui, words: &str) {
    let found: Vec<(String, String)> = found(words).collect();
    if found.is_empty() {
        ui.label("No word has these letters. Delete one to see more.");
    }
    // Rows of text, not of controls.
    ui.spacing_mut().interact_size.y = 18.0;
    for (word, meaning) in found {
        ui.horizontal_wrapped(|ui| {
            ui.label(RichText::new(word).strong());
            ui.label(meaning);
        });
    }
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
