//! Looking for words in all documents.

use palpate_wire::markdown::{headings, plain, sections, slug};

/// Longest excerpt, letters.
const MAX_EXCERPT: usize = 120;

/// Where words were found in a document.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Hit {
    /// How many sections have all words.
    pub(super) num_sections: usize,
    /// Heading of the first of them, or of the first whose heading has all words; `None` for what stands below the title.
    pub(super) heading: Option<String>,
    /// Its address.
    pub(super) section: Option<String>,
    /// A line of it with one of the words.
    pub(super) excerpt: String,
    /// The title has all words.
    pub(super) in_title: bool,
    /// The heading has.
    pub(super) in_heading: bool,
}

/// The words that were typed, in lower case.
pub(super) fn words_of(typed: &str) -> Vec<String> {
    typed.to_lowercase().split_whitespace().map(str::to_owned).collect()
}

/// Where `text` has all of `words` in one section, the document's title counted among each; `None` if nowhere. A section
/// is a heading and what stands below it up to the next. Words may go on: `cali` is in "Calibrate", and not in "recalibrate".
pub(super) fn look(text: &str, words: &[String]) -> Option<Hit> {
    let title = headings(text).next().map(|(_, title)| plain(title)).unwrap_or_default();
    let title_words = title.to_lowercase();
    let mut hit: Option<Hit> = None;
    for section in sections(text).filter(|section| !section.trim().is_empty()) {
        let lower = plain(section).to_lowercase();
        if !words.iter().all(|word| has(&lower, word) || has(&title_words, word)) {
            continue;
        }
        let heading = headings(section).next().map(|(_, heading)| plain(heading));
        let heading = heading.filter(|heading| *heading != title);
        let in_heading = heading.as_ref().is_some_and(|heading| has_all(&heading.to_lowercase(), words));
        let num_sections = hit.as_ref().map_or(0, |hit| hit.num_sections) + 1;
        match &mut hit {
            // The first one, or the first one that is about the words.
            Some(hit) if hit.in_heading || !in_heading => hit.num_sections = num_sections,
            _ => {
                let in_title = has_all(&title_words, words);
                let (section, excerpt) = (heading.as_deref().map(slug), excerpt(section, words));
                hit = Some(Hit { num_sections, heading, section, excerpt, in_title, in_heading });
            }
        }
    }
    hit
}

fn has_all(text: &str, words: &[String]) -> bool {
    words.iter().all(|word| has(text, word))
}

/// Whether a word of `text` begins with `word`; both are in lower case.
fn has(text: &str, word: &str) -> bool {
    position(text, word).is_some()
}

/// Where in `text` a word begins with `word`.
fn position(text: &str, word: &str) -> Option<usize> {
    let is_start = |at: &usize| !text[..*at].ends_with(|letter: char| letter.is_alphanumeric());
    text.match_indices(word).map(|(at, _)| at).find(is_start)
}

/// The first line of `section` with most of the `words`, cut around the first of them.
fn excerpt(section: &str, words: &[String]) -> String {
    let num_words = |line: &str| {
        let line = line.to_lowercase();
        words.iter().filter(|word| has(&line, word)).count()
    };
    let lines = section.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty());
    // Of several that are alike, `max_by_key` would give the last.
    let best = lines.rev().max_by_key(|line| num_words(line)).unwrap_or_default();
    let line = plain(best.trim().trim_matches('|').trim()).replace(" | ", " \u{b7} ");
    let letters: Vec<char> = line.chars().collect();
    if letters.len() <= MAX_EXCERPT {
        return line;
    }
    let lower = line.to_lowercase();
    let first = words.iter().filter_map(|word| position(&lower, word)).min().unwrap_or(0);
    // Letters before it: some have more bytes, or other ones in lower case, which makes the cut a little later.
    let first = lower.char_indices().take_while(|(at, _)| *at < first).count();
    let start = first.saturating_sub(MAX_EXCERPT / 3).min(letters.len() - MAX_EXCERPT);
    let cut: String = letters[start..start + MAX_EXCERPT].iter().collect();
    let dots = |needed: bool| if needed { "\u{2026}" } else { "" };
    format!("{}{}{}", dots(start > 0), cut.trim(), dots(start + MAX_EXCERPT < letters.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# Learning\n\nPolicies learn by PPO.\n\n## Tactile encoder\n\nIt sees **taxels**.\n\n    # code\n\n\
        ## Memory\n\nAn encoder with memory; the encoder keeps what it felt.\n";

    fn found(typed: &str) -> Option<Hit> {
        look(TEXT, &words_of(typed))
    }

    #[test]
    fn words_are_found_in_one_section_and_the_title_counts() {
        let hit = found("encoder").expect("it is there");
        assert_eq!((hit.num_sections, hit.section.as_deref()), (2, Some("tactile-encoder")));
        assert_eq!((hit.excerpt.as_str(), hit.in_title), ("It sees taxels.", false));
        let hit = found("MEMORY felt").expect("it is there");
        assert_eq!((hit.num_sections, hit.heading.as_deref()), (1, Some("Memory")));
        assert!(found("learning felt").is_some(), "the title has one of them");
        assert_eq!(found("taxels ppo"), None, "no section has both");
        assert_eq!(found("ncoder"), None, "no word begins so");
        let hit = found("memory").expect("it is there");
        assert!(hit.in_heading && hit.section.as_deref() == Some("memory"), "{hit:?}");
        let hit = found("learning").expect("it is there");
        assert!(hit.in_title && hit.section.is_none() && hit.num_sections == 3, "{hit:?}");
    }

    #[test]
    fn long_lines_are_cut_around_the_word() {
        let line = format!("{} needle {}", "\u{c4}hm ".repeat(80), "oh ".repeat(80));
        let hit = look(&line, &words_of("NEEDLE")).expect("it is there");
        assert!(hit.excerpt.contains("needle") && hit.excerpt.chars().count() <= MAX_EXCERPT + 2, "{hit:?}");
        assert!(hit.excerpt.starts_with('\u{2026}') && hit.excerpt.ends_with('\u{2026}'), "{hit:?}");
    }

    #[test]
    fn any_text_can_be_looked_through() {
        for text in ["", "#", "# ", "#\n# \u{e4}\n", "\u{130}\n# \u{130}"] {
            let _ = look(text, &words_of("\u{130} x"));
            assert!(look(text, &[]).is_none() == text.trim().is_empty(), "{text:?}");
        }
    }
}
