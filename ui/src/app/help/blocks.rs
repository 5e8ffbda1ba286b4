//! A document as blocks that can be laid out, read from its Markdown once.

use std::mem;

use palpate_wire::markdown::{Target, named_docs, slug};
use pulldown_cmark::{Event, Options, Parser, Tag, TagEnd};

/// One thing below the other.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Block {
    Heading {
        /// 1 for the title.
        level: usize,
        text: String,
        /// Its address within the document.
        slug: String,
    },
    Paragraph {
        /// In how many lists and quotations it stands.
        depth: usize,
        /// What stands before the first paragraph of a list's item: `1.`, or a dot.
        marker: Option<String>,
        spans: Vec<Span>,
    },
    Code {
        depth: usize,
        text: String,
    },
    Table(Vec<Row>),
    Rule,
}

/// A row of a table; the first one is its head.
pub(super) type Row = Vec<Vec<Span>>;

/// Text of one look that leads to one place, if anywhere.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Span {
    pub(super) text: String,
    pub(super) look: Look,
    pub(super) target: Option<Target>,
}

/// How text looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Look {
    pub(super) strong: bool,
    pub(super) emphasis: bool,
    pub(super) code: bool,
}

/// What a list's item begins with where items have no numbers.
pub(super) const DOT: &str = "\u{2022}";

/// The blocks of the document called `name`.
pub(super) fn blocks(name: &str, text: &str) -> Vec<Block> {
    let mut reader = Reader { name, ..Reader::default() };
    for event in Parser::new_ext(text, Options::ENABLE_TABLES) {
        reader.take_in(event);
    }
    reader.flush();
    reader.blocks
}

/// What has been read, and where in it the reader is.
#[derive(Default)]
struct Reader<'a> {
    name: &'a str,
    blocks: Vec<Block>,
    spans: Vec<Span>,
    look: Look,
    /// A block of code is open.
    is_code: bool,
    /// Where the link that is open leads; that of a picture within a link, the picture.
    targets: Vec<Target>,
    /// The next number of each list that is open; `None` in lists without.
    lists: Vec<Option<u64>>,
    num_quotes: usize,
    marker: Option<String>,
    rows: Vec<Row>,
}

impl Reader<'_> {
    fn take_in(&mut self, event: Event<'_>) {
        match event {
            Event::Start(tag) => self.start(tag),
            Event::End(tag) => self.end(tag),
            Event::Text(text) => match self.blocks.last_mut() {
                Some(Block::Code { text: code, .. }) if self.is_code => code.push_str(&text),
                _ => self.add(&text, self.look),
            },
            Event::Code(text) => self.add(&text, Look { code: true, ..self.look }),
            Event::SoftBreak => self.add(" ", self.look),
            Event::HardBreak => self.add("\n", self.look),
            Event::Rule => {
                self.flush();
                self.blocks.push(Block::Rule);
            }
            // Nothing of the manual is HTML; what looks like it, e.g. `<id>`, is meant as it is written.
            Event::Html(text) | Event::InlineHtml(text) => self.add(&text, self.look),
            Event::FootnoteReference(text) | Event::InlineMath(text) | Event::DisplayMath(text) => {
                self.add(&text, self.look);
            }
            Event::TaskListMarker(_) => {}
        }
    }

    fn start(&mut self, tag: Tag<'_>) {
        match tag {
            Tag::Strong => self.look.strong = true,
            Tag::Emphasis => self.look.emphasis = true,
            Tag::Link { dest_url, .. } => self.targets.push(Target::of(self.name, &dest_url)),
            Tag::Image { dest_url, .. } => {
                self.targets.push(Target::of(self.name, &dest_url));
                self.add("Picture: ", self.look);
            }
            Tag::CodeBlock(_) => {
                self.flush();
                self.blocks.push(Block::Code { depth: self.depth(), text: String::new() });
                self.is_code = true;
            }
            Tag::List(first) => {
                self.flush();
                self.lists.push(first);
            }
            Tag::Item => {
                self.flush();
                self.marker = Some(match self.lists.last_mut() {
                    Some(Some(number)) => {
                        *number += 1;
                        format!("{}.", *number - 1)
                    }
                    _ => DOT.to_owned(),
                });
            }
            Tag::BlockQuote(_) => {
                self.flush();
                self.num_quotes += 1;
            }
            Tag::TableHead | Tag::TableRow => self.rows.push(Row::new()),
            // Text of an item may stand before its first paragraph or list.
            Tag::Paragraph | Tag::Heading { .. } | Tag::Table(_) => self.flush(),
            _ => {}
        }
    }

    fn end(&mut self, tag: TagEnd) {
        match tag {
            TagEnd::Strong => self.look.strong = false,
            TagEnd::Emphasis => self.look.emphasis = false,
            TagEnd::Link | TagEnd::Image => {
                self.targets.pop();
            }
            TagEnd::CodeBlock => self.is_code = false,
            TagEnd::Heading(level) => {
                let text: String = mem::take(&mut self.spans).into_iter().map(|span| span.text).collect();
                self.blocks.push(Block::Heading { level: level as usize, slug: slug(&text), text });
            }
            TagEnd::List(_) => {
                self.flush();
                self.lists.pop();
            }
            TagEnd::BlockQuote(_) => {
                self.flush();
                self.num_quotes = self.num_quotes.saturating_sub(1);
            }
            TagEnd::Paragraph | TagEnd::Item => self.flush(),
            TagEnd::TableCell => {
                let cell = mem::take(&mut self.spans);
                if let Some(row) = self.rows.last_mut() {
                    row.push(cell);
                }
            }
            TagEnd::Table => self.blocks.push(Block::Table(mem::take(&mut self.rows))),
            _ => {}
        }
    }

    fn depth(&self) -> usize {
        self.lists.len() + self.num_quotes
    }

    /// Documents that text names are links to them, also where they were not written as links.
    fn add(&mut self, text: &str, look: Look) {
        if let Some(target) = self.targets.last().cloned() {
            return self.add_span(text, look, Some(target));
        }
        for (part, doc) in named_docs(text) {
            let target = doc.map(|name| Target::Doc { name: name.to_owned(), section: None });
            self.add_span(part, look, target);
        }
    }

    fn add_span(&mut self, text: &str, look: Look, target: Option<Target>) {
        match self.spans.last_mut() {
            Some(last) if last.look == look && last.target == target => last.text.push_str(text),
            _ => self.spans.push(Span { text: text.to_owned(), look, target }),
        }
    }

    /// What was collected is a paragraph.
    fn flush(&mut self) {
        if self.spans.is_empty() {
            return;
        }
        let (spans, marker) = (mem::take(&mut self.spans), self.marker.take());
        self.blocks.push(Block::Paragraph { depth: self.depth(), marker, spans });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(spans: &[Span]) -> String {
        spans.iter().map(|span| span.text.as_str()).collect()
    }

    #[test]
    fn headings_lists_code_and_tables_are_blocks() {
        let source = "# A `hand`\n\nOne\ntwo.\n\n1. first\n   - inner\n\n     more\n2. second\n\nThen:\n\n    let x = 1;\n    let y;\n\n\
            | a | b |\n|---|---|\n| `c` | [d](jobs.md#runners) |\n\n---\n";
        let found = blocks("people", source);
        let Block::Heading { level: 1, text: heading, slug } = &found[0] else { panic!("{found:?}") };
        assert_eq!((heading.as_str(), slug.as_str()), ("A hand", "a-hand"));
        let paragraphs: Vec<(usize, Option<&str>, String)> = found
            .iter()
            .filter_map(|block| match block {
                Block::Paragraph { depth, marker, spans } => Some((*depth, marker.as_deref(), text(spans))),
                _ => None,
            })
            .collect();
        let expected = [
            (0, None, "One two."),
            (1, Some("1."), "first"),
            (2, Some(DOT), "inner"),
            (2, None, "more"),
            (1, Some("2."), "second"),
            (0, None, "Then:"),
        ];
        assert_eq!(paragraphs, expected.map(|(depth, marker, text)| (depth, marker, text.to_owned())));
        let code = Block::Code { depth: 0, text: "let x = 1;\nlet y;\n".to_owned() };
        assert!(found.contains(&code), "{found:?}");
        let table = found.iter().find_map(|block| match block {
            Block::Table(rows) => Some(rows),
            _ => None,
        });
        let table = table.expect("a table");
        assert_eq!((table.len(), text(&table[0][1]), text(&table[1][0])), (2, "b".into(), "c".into()));
        assert!(table[1][0][0].look.code);
        let target = Target::Doc { name: "jobs".into(), section: Some("runners".into()) };
        assert_eq!(table[1][1][0].target, Some(target));
        assert_eq!(found.last(), Some(&Block::Rule));
    }

    #[test]
    fn looks_and_links_split_text_and_nothing_else_does() {
        let found =
            blocks("tour", "A **bold *and* soft** `word` <id>, [see](docs/touch.md). ![hand](docs/hand.png)");
        let [Block::Paragraph { spans, .. }] = found.as_slice() else { panic!("{found:?}") };
        let words: Vec<&str> = spans.iter().map(|span| span.text.as_str()).collect();
        assert_eq!(
            words,
            ["A ", "bold ", "and", " soft", " ", "word", " <id>, ", "see", ". ", "Picture: hand"]
        );
        assert!(spans[2].look.strong && spans[2].look.emphasis && !spans[3].look.emphasis);
        assert_eq!(
            spans.last().and_then(|span| span.target.clone()),
            Some(Target::Picture("hand.png".into()))
        );
    }

    #[test]
    fn documents_that_are_only_named_are_links() {
        let found = blocks("learning", "It needs `mujoco` (docs/grasping.md).");
        let [Block::Paragraph { spans, .. }] = found.as_slice() else { panic!("{found:?}") };
        let target = Target::Doc { name: "grasping".into(), section: None };
        let link = spans.iter().find(|span| span.target == Some(target.clone()));
        assert_eq!(link.map(|span| span.text.as_str()), Some("docs/grasping.md"));
    }

    #[test]
    fn any_text_has_blocks() {
        for source in ["", "[", "|", "| a |\n|-", "```", "1. \n2. ", "> > > x", "![](", "#", "<!--"] {
            let _ = blocks("x", source);
        }
    }
}
