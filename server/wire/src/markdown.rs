//! What the server and the page both must know of the manual's Markdown: headings and their addresses, where links lead,
//! plain text.

/// The document that `README.md` is served as.
pub const TOUR: &str = "tour";

/// Where a link of a document leads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// To a heading of the same document, by its [`slug`].
    Section(String),
    /// To a document, or to a heading of one.
    Doc {
        /// Name of the document.
        name: String,
        /// [`slug`] of the heading.
        section: Option<String>,
    },
    /// To a picture that is served with the documents.
    Picture(String),
    /// To an address that a browser opens.
    Outside(String),
    /// To a file of the sources that is no document, by its path from their root.
    Source(String),
}

impl Target {
    /// Where `link` of the document `doc` leads, as [`TOUR`] lies in the root of the sources and all others in `docs/`.
    ///
    /// ```
    /// use palpate_wire::markdown::Target;
    ///
    /// let section = Some("the-lease".to_owned());
    /// let expected = Target::Doc { name: "safety".to_owned(), section };
    /// assert_eq!(Target::of("learning", "safety.md#the-lease"), expected);
    /// assert_eq!(Target::of("tour", "docs/safety.md#the-lease"), expected);
    /// ```
    pub fn of(doc: &str, link: &str) -> Self {
        if link.contains("://") || link.starts_with('/') || link.starts_with("mailto:") {
            return Self::Outside(link.to_owned());
        }
        let (file, section) = link.split_once('#').unwrap_or((link, ""));
        let section = Some(section.to_owned()).filter(|section| !section.is_empty());
        if file.is_empty() {
            return Self::Section(section.unwrap_or_default());
        }
        let mut path: Vec<&str> = if doc == TOUR { Vec::new() } else { vec!["docs"] };
        for part in file.split('/') {
            match part {
                "" | "." => {}
                ".." => {
                    path.pop();
                }
                part => path.push(part),
            }
        }
        let to_doc = |name: &str| Self::Doc { name: name.to_owned(), section: section.clone() };
        match path.as_slice() {
            ["README.md"] => to_doc(TOUR),
            ["docs", "openapi.json"] => Self::Outside("/api/v1/openapi.json".to_owned()),
            ["docs", file] => match file.rsplit_once('.') {
                Some((name, "md")) => to_doc(name),
                Some((_, "png" | "svg")) => Self::Picture((*file).to_owned()),
                _ => Self::Source(path.join("/")),
            },
            path => Self::Source(path.join("/")),
        }
    }
}

/// Headings of `text` in order, each with its level from 1. Lines of code are none.
pub fn headings(text: &str) -> impl Iterator<Item = (usize, &str)> {
    prose(text).filter_map(heading)
}

/// The lines of `text` outside fenced and indented code.
pub fn prose(text: &str) -> impl Iterator<Item = &str> {
    let mut is_prose = is_prose();
    text.lines().filter(move |line| is_prose(line))
}

/// `text` cut before each of its headings.
pub fn sections(text: &str) -> impl Iterator<Item = &str> {
    let (mut starts, mut at, mut is_prose) = (vec![0], 0, is_prose());
    for line in text.split_inclusive('\n') {
        if is_prose(line) && heading(line).is_some() && at > 0 {
            starts.push(at);
        }
        at += line.len();
    }
    let ends: Vec<usize> = starts.iter().copied().skip(1).chain([text.len()]).collect();
    starts.into_iter().zip(ends).map(|(start, end)| &text[start..end])
}

/// Level and words of a line that is a heading.
fn heading(line: &str) -> Option<(usize, &str)> {
    let words = line.trim_start_matches('#');
    let level = line.len() - words.len();
    let words = words.strip_prefix(' ')?;
    (1..=6).contains(&level).then_some((level, words.trim()))
}

/// Whether the next line of a text stands outside fenced and indented code.
fn is_prose() -> impl FnMut(&str) -> bool {
    let mut is_fenced = false;
    move |line| {
        let is_fence = line.trim_start().starts_with("```");
        is_fenced ^= is_fence;
        !is_fenced && !is_fence && !line.starts_with("    ")
    }
}

/// The address of a heading within its document: letters and digits in lower case, hyphens for spaces, nothing else.
///
/// ```
/// assert_eq!(palpate_wire::markdown::slug("Station, layout and `servo` logs"), "station-layout-and-servo-logs");
/// ```
pub fn slug(heading: &str) -> String {
    let words = plain(heading).to_lowercase();
    let letters = words.chars().filter_map(|letter| match letter {
        ' ' | '-' => Some('-'),
        '_' => Some('_'),
        letter => letter.is_alphanumeric().then_some(letter),
    });
    letters.collect()
}

/// One line of Markdown without its marks: links as their words, no back quotes, no stars of emphasis.
///
/// ```
/// let line = "**One** file, as [safety.md](safety.md) has it: `a * b`";
/// assert_eq!(palpate_wire::markdown::plain(line), "One file, as safety.md has it: a * b");
/// ```
pub fn plain(line: &str) -> String {
    let mut plain = String::new();
    let mut rest = line;
    while let Some((before, after)) = rest.split_once('[') {
        let Some((words, target)) = after.split_once("](") else { break };
        let Some((_, behind)) = target.split_once(')') else { break };
        plain.push_str(before.strip_suffix('!').unwrap_or(before));
        plain.push_str(words);
        rest = behind;
    }
    plain.push_str(rest);
    plain.replace("**", "").replace('`', "")
}

/// `text` in parts: those that name a document, as `docs/jobs.md` does, come with its name.
///
/// ```
/// let parts = palpate_wire::markdown::named_docs("see docs/jobs.md.");
/// assert_eq!(parts, [("see ", None), ("docs/jobs.md", Some("jobs")), (".", None)]);
/// ```
pub fn named_docs(text: &str) -> Vec<(&str, Option<&str>)> {
    let (mut parts, mut rest) = (Vec::new(), text);
    for (at, _) in text.match_indices("docs/") {
        let start = at - (text.len() - rest.len()).min(at);
        let Some(named) = rest.get(start..) else { continue };
        let name = named.strip_prefix("docs/").unwrap_or_default();
        let len =
            name.find(|letter: char| !letter.is_ascii_lowercase() && letter != '_').unwrap_or(name.len());
        if len == 0 || !name[len..].starts_with(".md") {
            continue;
        }
        let (before, link) = rest.split_at(start);
        let (link, behind) = link.split_at("docs/".len() + len + ".md".len());
        parts.extend([(before, None), (link, Some(&name[..len]))]);
        rest = behind;
    }
    parts.push((rest, None));
    parts.retain(|(part, _)| !part.is_empty());
    parts
}

/// The first sentence of the first paragraph of `text`, as [`plain`] text; empty if it has none.
pub fn first_sentence(text: &str) -> String {
    let is_paragraph = |line: &&str| {
        line.starts_with(|letter: char| letter.is_alphanumeric() || "*`[\"".contains(letter))
            && !line.starts_with("* ")
    };
    let mut lines = prose(text).skip_while(|line| !is_paragraph(line));
    let paragraph: Vec<&str> = lines.by_ref().take_while(|line| !line.trim().is_empty()).collect();
    let paragraph = plain(&paragraph.join(" "));
    let end = paragraph.find(". ").map_or(paragraph.len(), |end| end + 1);
    paragraph[..end].trim_end_matches(':').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# A hand\n\n| a | b |\n|---|---|\n\n    # no heading\n\n\
        **Stop** is `soft` ([why](safety.md#why)). More\nof it.\n\n```toml\n# none either\n```\n\n\
        ## Its `taxels`, 2 of them\n#hash\n";

    #[test]
    fn headings_are_not_comments_of_code() {
        assert_eq!(headings(TEXT).collect::<Vec<_>>(), [(1, "A hand"), (2, "Its `taxels`, 2 of them")]);
    }

    #[test]
    fn sections_are_the_whole_text() {
        let found: Vec<&str> = sections(TEXT).collect();
        assert_eq!(found.concat(), TEXT);
        assert!(found.len() == 2 && found[1].starts_with("## Its"), "{found:?}");
        assert_eq!(sections("no heading").collect::<Vec<_>>(), ["no heading"]);
        assert_eq!(sections("").collect::<Vec<_>>(), [""]);
    }

    #[test]
    fn addresses_are_those_that_code_hosts_make() {
        let slugs =
            ["Its `taxels`, 2 of them", "Bits & builds", "snake_case names", "A [link](x.md)"].map(slug);
        assert_eq!(slugs, ["its-taxels-2-of-them", "bits--builds", "snake_case-names", "a-link"]);
    }

    #[test]
    fn first_sentence_is_plain_and_of_a_paragraph() {
        assert_eq!(first_sentence(TEXT), "Stop is soft (why).");
        assert_eq!(first_sentence("# Only a heading\n\n- an item\n"), "");
        assert_eq!(first_sentence("No end:\n\n    code\n"), "No end");
    }

    #[test]
    fn links_lead_to_documents_pictures_and_sources() {
        let doc = |name: &str| Target::Doc { name: name.to_owned(), section: None };
        let outside = |url: &str| Target::Outside(url.to_owned());
        for (of, link, expected) in [
            ("jobs", "people.md", doc("people")),
            ("jobs", "../README.md", doc(TOUR)),
            ("jobs", "#runners", Target::Section("runners".to_owned())),
            ("jobs", "hand.png", Target::Picture("hand.png".to_owned())),
            ("jobs", "openapi.json", outside("/api/v1/openapi.json")),
            ("jobs", "https://viser.studio", outside("https://viser.studio")),
            ("jobs", "../clients/python/README.md", Target::Source("clients/python/README.md".to_owned())),
            (TOUR, "docs/hand.png", Target::Picture("hand.png".to_owned())),
            (TOUR, "CHANGELOG.md", Target::Source("CHANGELOG.md".to_owned())),
            (TOUR, "../../up.md", Target::Source("up.md".to_owned())),
        ] {
            assert_eq!(Target::of(of, link), expected, "{link} of {of}");
        }
    }

    #[test]
    fn names_of_documents_are_found_in_messages() {
        let text = "Mend it; docs/objects.md shows how (see docs/emulated_devices.md).";
        let expected = [
            ("Mend it; ", None),
            ("docs/objects.md", Some("objects")),
            (" shows how (see ", None),
            ("docs/emulated_devices.md", Some("emulated_devices")),
            (").", None),
        ];
        assert_eq!(named_docs(text), expected);
        for plain in ["nothing", "docs/", "docs/.md", "docs/a.toml, docs/B.md", "\u{e4} docs/\u{e4}.md"] {
            assert_eq!(named_docs(plain), [(plain, None)]);
        }
        assert_eq!(named_docs(""), []);
    }

    #[test]
    fn half_a_link_stays_as_it_is() {
        assert_eq!(plain("a [b](c and [d"), "a [b](c and [d");
        assert_eq!(plain("![a picture](x.png) of it"), "a picture of it");
    }
}
