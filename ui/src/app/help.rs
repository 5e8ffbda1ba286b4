//! Help: the documents of the manual and what words mean, over whatever screen is open, to be looked through together.
//!
//! The server has the documents. What words mean is part of the page, and stays there when the server does not answer.

mod blocks;
mod document;
mod glossary;
mod search;

use std::{cmp::Reverse, collections::BTreeMap, sync::Arc};

use egui::{Key, Modifiers, RichText, UiBuilder, accesskit::Role};
use palpate_wire::{
    api::DocSummary,
    markdown::{self, Target},
};

use self::{
    blocks::{Block, blocks},
    search::Hit,
};
use super::{StudioApp, overlays};
use crate::{
    route::HelpPlace,
    screens::{announced_ui, for_people, heading_ui},
    store::{Loadable, Store},
    theme::{Palette, is_narrow},
};

/// Widest dialog, points.
const WIDTH: f32 = 1120.0;
/// In a dialog narrower than this, the list and the document are shown one at a time, points.
const ONE_COLUMN: f32 = 760.0;
/// Width of the list beside the document, points.
const LIST_WIDTH: f32 = 300.0;
/// An arrow key scrolls the document by so much, points.
const LINE: f32 = 48.0;
/// A page key scrolls it by this share of its height.
const PAGE: f32 = 0.9;

/// What Help shows, and what was typed into it.
#[derive(Debug)]
pub(super) struct HelpState {
    place: HelpPlace,
    words: String,
    /// The heading that is still to be scrolled to.
    section: Option<String>,
    /// The document is shown, in place of the glossary and, where only one has room, of the list.
    reads: bool,
    /// Entry of the list that Enter opens; as long as nobody chose one, the document that is open, or the first.
    marked_idx: Option<usize>,
    /// The list scrolls to that entry in the next frame.
    scrolls: bool,
    /// The field of words wants the focus: whoever looks for something types.
    wants_focus: bool,
}

impl HelpState {
    fn new(place: HelpPlace) -> Self {
        Self {
            words: place.words.clone().unwrap_or_default(),
            section: place.section.clone(),
            reads: place.doc.is_some(),
            wants_focus: place.doc.is_none(),
            marked_idx: None,
            scrolls: false,
            place,
        }
    }

    /// Another place, with the words that were typed.
    fn go(&mut self, place: HelpPlace) {
        let words = std::mem::take(&mut self.words);
        *self = Self { words: place.words.clone().unwrap_or(words), wants_focus: false, ..Self::new(place) };
    }

    /// Whether words were typed.
    fn searches(&self) -> bool {
        !self.words.trim().is_empty()
    }
}

/// Documents that were opened, split into blocks, and the documents that have the words typed last.
#[derive(Debug, Default)]
pub(super) struct Library {
    glossary: Option<Arc<String>>,
    blocks: BTreeMap<String, (Arc<String>, Arc<Vec<Block>>)>,
    found: Found,
}

/// The documents that have the words, in the order of the list.
#[derive(Debug, Default)]
struct Found {
    /// The words, and the number of documents that were there to be searched.
    key: (String, usize),
    hits: Arc<Vec<(DocSummary, Hit)>>,
}

/// What the reader wants next.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Step {
    Stay,
    Close,
    Shortcuts,
    Open(HelpPlace),
}

/// An entry of the list.
struct Entry {
    name: String,
    face: String,
    /// Below it.
    excerpt: Option<String>,
    place: HelpPlace,
}

impl StudioApp {
    /// Opens Help at `place`; "back" returns.
    pub(super) fn open_help(&mut self, place: HelpPlace) {
        self.platform.push_hash(&place.to_string());
        self.last_hash = self.platform.hash();
        self.show_help(place);
    }

    /// Shows what the address bar says already.
    pub(super) fn show_help(&mut self, place: HelpPlace) {
        self.overlays.close_shortcuts();
        match &mut self.help {
            Some(state) => state.go(place),
            None => self.help = Some(HelpState::new(place)),
        }
    }

    /// Closes Help, if it is open; the address bar names the screen again.
    pub(super) fn close_help(&mut self) {
        if self.help.take().is_some() {
            self.platform.push_hash(&self.route.to_string());
            self.last_hash = self.platform.hash();
        }
    }

    /// What the window is called while Help is open.
    pub(super) fn help_title(&mut self) -> Option<String> {
        let name = self.help.as_ref()?.place.doc.clone();
        let Some(name) = name else { return Some("Help".to_owned()) };
        let list = self.store.docs.list();
        let known = list.ready().and_then(|list| list.iter().find(|doc| doc.name == name));
        Some(format!("Help: {}", known.map_or(name.as_str(), |doc| doc.title.as_str())))
    }

    pub(super) fn help_ui(&mut self, ctx: &egui::Context) {
        let Some(state) = &mut self.help else { return };
        let (store, library) = (&mut self.store, &mut self.library);
        let palette = Palette::of(ctx.theme());
        let modal = overlays::modal(ctx, "help", WIDTH, |ui, height| {
            Help { state, store, library, palette }.ui(ui, height)
        });
        match modal.inner {
            _ if modal.should_close() => self.close_help(),
            Step::Stay => {}
            Step::Close => self.close_help(),
            Step::Shortcuts => {
                self.close_help();
                self.overlays.toggle_shortcuts();
            }
            Step::Open(place) => self.open_help(place),
        }
    }
}

/// What one frame of Help works with.
struct Help<'a> {
    state: &'a mut HelpState,
    store: &'a mut Store,
    library: &'a mut Library,
    palette: Palette,
}

impl Help<'_> {
    fn ui(mut self, ui: &mut egui::Ui, height: f32) -> Step {
        let mut step = Step::Stay;
        let bottom = ui.cursor().top() + height;
        ui.horizontal_wrapped(|ui| {
            heading_ui(ui, "Help");
            let size = egui::vec2(0.0, 32.0);
            if ui.add(egui::Button::new("Keyboard shortcuts").min_size(size)).clicked() {
                step = Step::Shortcuts;
            }
            if ui.add(egui::Button::new("Close help").min_size(size)).clicked() {
                step = Step::Close;
            }
        });
        let entries = self.entries();
        let chosen = self.field_ui(ui, &entries);
        ui.add_space(4.0);
        let rest = egui::Rect::from_min_max(ui.cursor().min, egui::pos2(ui.max_rect().right(), bottom));
        let rest = rest.with_max_y(rest.max.y.max(rest.min.y + 80.0));
        let is_narrow = rest.width() < ONE_COLUMN;
        let list = if is_narrow { rest } else { rest.with_max_x(rest.min.x + LIST_WIDTH) };
        let read = if is_narrow { rest } else { rest.with_min_x(list.max.x + 16.0) };
        let mut opened = chosen;
        if !is_narrow || !self.state.reads {
            ui.scope_builder(UiBuilder::new().id_salt("list").max_rect(list), |ui| {
                opened = self.list_ui(ui, &entries, is_narrow).or(opened.take());
            });
        }
        if !is_narrow || self.state.reads {
            ui.scope_builder(UiBuilder::new().id_salt("read").max_rect(read), |ui| {
                if is_narrow && ui.button("All documents").clicked() {
                    self.state.reads = false;
                }
                opened = self.read_ui(ui).or(opened.take());
            });
        }
        ui.advance_cursor_after_rect(rest);
        opened.map_or(step, Step::Open)
    }

    /// The field of words, and its keys. Gives what Enter opens.
    fn field_ui(&mut self, ui: &mut egui::Ui, entries: &[Entry]) -> Option<HelpPlace> {
        let id = egui::Id::unique("words of help");
        let typing = ui.memory(|memory| memory.has_focus(id));
        let pressed = |key| typing && ui.input_mut(|input| input.consume_key(Modifiers::NONE, key));
        let (up, down, enter) = (pressed(Key::ArrowUp), pressed(Key::ArrowDown), pressed(Key::Enter));
        let field = egui::TextEdit::singleline(&mut self.state.words)
            .id(id)
            .background_color(self.palette.background)
            .hint_text("Words to look for, here and in all documents")
            .desired_width(f32::INFINITY)
            .min_size(egui::vec2(0.0, 32.0));
        let field = ui.add(field).accessible_name("Search help");
        // On a phone the keyboard would hide the list.
        if std::mem::take(&mut self.state.wants_focus) && !is_narrow(ui.ctx()) {
            field.request_focus();
        }
        if field.changed() {
            self.state.marked_idx = None;
            self.state.reads = !self.state.searches() && self.state.place.doc.is_some();
        }
        let mut marked_idx = self.marked_idx(entries);
        if down {
            marked_idx = (marked_idx + 1).min(entries.len().saturating_sub(1));
        }
        if up {
            marked_idx = marked_idx.saturating_sub(1);
        }
        if up || down {
            self.state.marked_idx = Some(marked_idx);
            self.state.scrolls = true;
        }
        entries.get(marked_idx).filter(|_| enter).map(|entry| entry.place.clone())
    }

    fn marked_idx(&self, entries: &[Entry]) -> usize {
        let open = || entries.iter().position(|entry| Some(&entry.name) == self.state.place.doc.as_ref());
        self.state.marked_idx.or_else(open).unwrap_or(0).min(entries.len().saturating_sub(1))
    }

    /// What the list has: all documents, or those that have the words.
    fn entries(&mut self) -> Vec<Entry> {
        let list = self.store.docs.list();
        let mut docs: Vec<DocSummary> = list.ready().map(|list| list.to_vec()).unwrap_or_default();
        // What words mean needs no server.
        if docs.iter().all(|doc| doc.name != glossary::NAME) {
            docs.push(DocSummary {
                name: glossary::NAME.to_owned(),
                title: "Glossary".to_owned(),
                sentence: String::new(),
            });
        }
        docs.sort_by_key(|doc| (doc.name != markdown::TOUR, doc.title.to_lowercase()));
        if !self.state.searches() {
            let entry = |doc: DocSummary| Entry {
                face: doc.title,
                excerpt: None,
                place: HelpPlace::doc(doc.name.clone()),
                name: doc.name,
            };
            return docs.into_iter().map(entry).collect();
        }
        let found = self.found(&docs);
        let entry = |(doc, hit): &(DocSummary, Hit)| Entry {
            name: doc.name.clone(),
            face: match &hit.heading {
                Some(heading) => format!("{}: {heading}", doc.title),
                None => doc.title.clone(),
            },
            excerpt: Some(match hit.num_sections {
                1 => hit.excerpt.clone(),
                num => format!("{} ({num} sections)", hit.excerpt),
            }),
            place: HelpPlace::doc(doc.name.clone()).at(hit.section.clone()),
        };
        found.iter().map(entry).collect()
    }

    /// Which of `docs` have the words that were typed; those whose title or heading has them first, then those with most
    /// sections.
    fn found(&mut self, docs: &[DocSummary]) -> Arc<Vec<(DocSummary, Hit)>> {
        let texts: Vec<(&DocSummary, Arc<String>)> =
            docs.iter().filter_map(|doc| Some((doc, self.text(&doc.name).ready()?.clone()))).collect();
        let key = (self.state.words.clone(), texts.len());
        if self.library.found.key != key {
            let words = search::words_of(&self.state.words);
            let mut hits: Vec<(DocSummary, Hit)> = texts
                .iter()
                .filter_map(|(doc, text)| Some(((*doc).clone(), search::look(text, &words)?)))
                .collect();
            hits.sort_by_key(|(_, hit)| (!hit.in_title, !hit.in_heading, Reverse(hit.num_sections)));
            self.library.found = Found { key, hits: Arc::new(hits) };
        }
        Arc::clone(&self.library.found.hits)
    }

    /// The Markdown of a document: the server's, or the page's own glossary.
    fn text(&mut self, name: &str) -> Loadable<Arc<String>> {
        if name == glossary::NAME {
            let text = self.library.glossary.get_or_insert_with(|| Arc::new(glossary::text().to_owned()));
            return Loadable::Ready(Arc::clone(text));
        }
        self.store.docs.text(name)
    }

    fn list_ui(&mut self, ui: &mut egui::Ui, entries: &[Entry], is_narrow: bool) -> Option<HelpPlace> {
        let mut opened = None;
        let scrolls = std::mem::take(&mut self.state.scrolls);
        let marked_idx = self.marked_idx(entries);
        egui::ScrollArea::vertical().id_salt("documents").auto_shrink(false).show(ui, |ui| {
            if is_narrow {
                scroll_by_keys(ui);
            }
            self.state_of_list_ui(ui);
            if self.state.searches() && entries.is_empty() && !self.is_looking() {
                ui.label("No document has all of these words. Delete one to see more.");
            }
            for (idx, entry) in entries.iter().enumerate() {
                let is_open = self.state.place.doc.as_ref() == Some(&entry.name);
                let is_marked = idx == marked_idx;
                let mut text = RichText::new(&entry.face);
                if is_open {
                    text = text.strong();
                }
                let button = egui::Button::selectable(is_marked, text)
                    .wrap()
                    .right_text("")
                    .min_size(egui::vec2(ui.available_width() - 8.0, 32.0));
                let response = ui.add(button);
                response.widget_info(|| egui::WidgetInfo::selected(Role::Button, true, is_open, &entry.face));
                if is_marked && scrolls {
                    response.scroll_to_me(None);
                }
                if response.clicked() {
                    self.state.marked_idx = Some(idx);
                    opened = Some(entry.place.clone());
                }
                if let Some(excerpt) = &entry.excerpt {
                    ui.label(RichText::new(excerpt).color(self.palette.text_weak).small());
                    ui.add_space(4.0);
                }
            }
            ui.add_space(8.0);
            let api = egui::Hyperlink::from_label_and_url("What scripts can ask for", "/api/docs");
            ui.add(api.open_in_new_tab(true));
            if is_narrow {
                ui.add_space(8.0);
                self.words_ui(ui);
            }
        });
        opened
    }

    /// What words mean: all of them, or those that were looked for.
    fn words_ui(&mut self, ui: &mut egui::Ui) {
        heading_ui(ui, "What words mean");
        glossary::glossary_ui(ui, &self.state.words);
    }

    /// Whether texts that words are looked for in are on their way.
    fn is_looking(&mut self) -> bool {
        let list = self.store.docs.list();
        let Some(list) = list.ready() else { return list.is_loading() };
        list.iter().any(|doc| self.store.docs.text(&doc.name).is_loading())
    }

    /// Names of documents that did not come, so that words in them are not found, and why the last of them did not.
    fn missing(&mut self) -> Option<(String, String)> {
        let list = self.store.docs.list();
        let (mut names, mut why) = (Vec::new(), String::new());
        for doc in list.ready()?.iter() {
            if let Some(error) = self.store.docs.text(&doc.name).error() {
                error.clone_into(&mut why);
                names.push(doc.name.clone());
            }
        }
        Some((names.join(", "), why)).filter(|(names, _)| !names.is_empty())
    }

    /// Says that the documents are on their way, or why they do not come.
    fn state_of_list_ui(&mut self, ui: &mut egui::Ui) {
        let list = self.store.docs.list();
        let searches = self.state.searches();
        if let Some(error) = list.error() {
            self.failed_ui(ui, "The list of documents did not arrive", error);
        } else if list.is_loading() || (searches && self.is_looking()) {
            announced_ui(ui, "Looking through the documents\u{2026}", false);
        } else if searches && let Some((names, why)) = self.missing() {
            self.failed_ui(ui, &format!("Not looked through, because they did not arrive: {names}"), &why);
        }
    }

    fn failed_ui(&mut self, ui: &mut egui::Ui, what: &str, why: &str) {
        let text = RichText::new(format!("\u{26a0} {what}")).color(self.palette.mismatch);
        announced_ui(ui, text, false);
        ui.label(for_people(why));
        if ui.button("Try again").clicked() {
            self.store.docs.retry_failed();
        }
        ui.add_space(8.0);
    }

    /// The document, or what words mean where none was chosen. Gives what a link leads to.
    fn read_ui(&mut self, ui: &mut egui::Ui) -> Option<HelpPlace> {
        let name = self.state.place.doc.clone().filter(|_| self.state.reads);
        let Some(name) = name else {
            egui::ScrollArea::vertical().id_salt("words").auto_shrink(false).show(ui, |ui| {
                scroll_by_keys(ui);
                self.words_ui(ui);
            });
            return None;
        };
        let text = match self.text(&name) {
            Loadable::Ready(text) => text,
            Loadable::Failed(error) => {
                self.failed_ui(ui, &format!("The document {name} did not arrive"), &error);
                return None;
            }
            Loadable::Idle | Loadable::Loading => {
                announced_ui(ui, format!("Opening {name}\u{2026}"), false);
                return None;
            }
        };
        let blocks = self.library.blocks_of(&name, &text);
        let palette = self.palette;
        let section = self.state.section.clone();
        let reading =
            egui::ScrollArea::vertical().id_salt(("document", &name)).auto_shrink(false).show(ui, |ui| {
                scroll_by_keys(ui);
                // Tables and code reach to the bar otherwise.
                ui.set_max_width(ui.available_width() - 10.0);
                document::document_ui(ui, &palette, &blocks, section.as_deref())
            });
        // A heading that is not there is not waited for.
        if reading.inner.is_there || !ui.is_sizing_pass() {
            self.state.section = None;
        }
        match reading.inner.followed? {
            Target::Section(section) => Some(HelpPlace::doc(name).at(Some(section))),
            Target::Doc { name, section } => Some(HelpPlace::doc(name).at(section)),
            Target::Picture(_) | Target::Outside(_) | Target::Source(_) => None,
        }
    }
}

impl Library {
    fn blocks_of(&mut self, name: &str, text: &Arc<String>) -> Arc<Vec<Block>> {
        if let Some((known, blocks)) = self.blocks.get(name)
            && Arc::ptr_eq(known, text)
        {
            return Arc::clone(blocks);
        }
        let blocks = Arc::new(blocks(name, text));
        self.blocks.insert(name.to_owned(), (Arc::clone(text), Arc::clone(&blocks)));
        blocks
    }
}

/// Arrow and page keys scroll the document; arrows only while no field and no button has the focus.
fn scroll_by_keys(ui: &egui::Ui) {
    let focused = ui.memory(|memory| memory.focused().is_some());
    let page = ui.clip_rect().height() * PAGE;
    let keys = [(Key::ArrowUp, LINE), (Key::ArrowDown, -LINE), (Key::PageUp, page), (Key::PageDown, -page)];
    for (key, delta) in keys {
        let is_arrow = matches!(key, Key::ArrowUp | Key::ArrowDown);
        if !(focused && is_arrow) && ui.input(|input| input.key_pressed(key)) {
            ui.scroll_with_delta(egui::vec2(0.0, delta));
        }
    }
}
