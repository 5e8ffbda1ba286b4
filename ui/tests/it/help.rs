//! Help: the list of documents, the search over them, links, addresses, and the ways into it.

use egui::{Key, Modifiers, accesskit::Role};
use egui_kittest::{Harness, kittest::Queryable as _};
use palpate_ui::{StudioApp, api_client::Request, route::Screen, screens::help::Topic};
use palpate_wire::{
    api::DocSummary,
    markdown::{headings, slug},
};

use crate::fixture::{FakeWindow, SharedApi, app, copied, full_api, page, page_of};

type Page = Harness<'static, Option<StudioApp>>;

const LEARNING: &str = "# Learning\n\nPolicies learn by **PPO**; [safety.md](safety.md#the-lease) says what stops them, \
    [the authors](https://example.org/ppo) why.\n\n![Curves](curves.svg)\n\n    palpate-train ppo --steps 9\n\n\
    ## Memory\n\n1. An encoder keeps what it felt.\n2. It forgets.\n\n\
    | word | what it means for those who read a table on a phone |\n|---|---|\n\
    | gru | a gate that decides what is kept and what is not, step after step |\n";

const SAFETY: &str =
    "# Moving a station safely\n\nFit a cut-off.\n\n## The lease\n\nOne person has control.\n";

fn doc(name: &str, title: &str) -> DocSummary {
    DocSummary { name: name.into(), title: title.into(), sentence: "A sentence.".into() }
}

/// A server with three documents.
pub(crate) fn with_docs() -> SharedApi {
    let api = full_api();
    {
        let mut api = api.0.borrow_mut();
        let list =
            [doc("learning", "Learning"), doc("safety", "Moving a station safely"), doc("tour", "Palpate")];
        api.answer(&Request::Docs, serde_json::to_vec(&list).expect("it is plain data"));
        api.answer(&Request::Doc("learning".into()), LEARNING.into());
        api.answer(&Request::Doc("safety".into()), SAFETY.into());
        api.answer(&Request::Doc("tour".into()), b"# Palpate\n\n## A five-minute tour\n\nHere.\n".to_vec());
    }
    api
}

fn click(harness: &mut Page, role: Role, name: &str) {
    harness.get_by_role_and_label(role, name).click();
    harness.run_steps(4);
}

fn type_words(harness: &mut Page, words: &str) {
    harness.event(egui::Event::Text(words.into()));
    harness.run_steps(6);
}

#[test]
fn a_link_opens_a_document_with_its_headings_code_and_title() {
    let window = FakeWindow::at("#/help/learning");
    let mut harness = page(&with_docs(), &window);
    harness.get_by_role_and_label(Role::Heading, "Learning");
    harness.get_by_role_and_label(Role::Heading, "Memory");
    harness.get_by_label_contains("An encoder keeps what it felt.");
    harness.get_by_label_contains("step after step");
    assert_eq!(window.0.borrow().title, "Help: Learning \u{2013} Palpate");
    assert_eq!(window.current(), "#/help/learning", "the address stays");
    harness.get_by_label("Copy code").click();
    assert_eq!(copied(&mut harness).as_deref(), Some("palpate-train ppo --steps 9"));
}

#[test]
fn the_list_leads_to_documents_and_back_returns() {
    let window = FakeWindow::at("#/sessions");
    let mut harness = page(&with_docs(), &window);
    click(&mut harness, Role::Button, "Help");
    assert_eq!(window.current(), "#/help");
    harness.get_by_label_contains("critical value of the evidence");
    click(&mut harness, Role::Button, "Moving a station safely");
    assert_eq!(window.current(), "#/help/safety");
    harness.get_by_role_and_label(Role::Heading, "The lease");
    click(&mut harness, Role::Button, "Glossary");
    harness.get_by_role_and_label(Role::Heading, "Glossary");
    window.back();
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::Heading, "The lease");
    window.back();
    window.back();
    harness.run_steps(4);
    assert!(harness.query_by_label("Close help").is_none(), "the screen is back");
    assert_eq!(app(&harness).screen(), Screen::Sessions);
}

#[test]
fn arrows_and_enter_choose_in_the_list() {
    let window = FakeWindow::at("#/home");
    let mut harness = page(&with_docs(), &window);
    harness.key_press(Key::F1);
    harness.run_steps(4);
    // The tour comes first, then the others by title.
    for key in [Key::ArrowDown, Key::ArrowDown, Key::ArrowUp, Key::ArrowDown, Key::Enter] {
        harness.key_press(key);
        harness.run_steps(3);
    }
    assert_eq!(window.current(), "#/help/learning");
    harness.key_press(Key::Escape);
    harness.run_steps(4);
    assert!(harness.query_by_label("Close help").is_none());
    assert_eq!(window.current(), "#/home");
}

#[test]
fn words_are_found_in_documents_and_in_the_glossary() {
    let window = FakeWindow::at("#/help");
    let mut harness = page(&with_docs(), &window);
    type_words(&mut harness, "lease");
    harness.get_by_label_contains("the right to move the robot");
    harness.get_by_label_contains("One person has control.");
    assert!(harness.query_by_label("Learning: Memory").is_none(), "it does not have the word");
    click(&mut harness, Role::Button, "Moving a station safely: The lease");
    assert_eq!(window.current(), "#/help/safety?section=the-lease");
    let heading = harness.get_by_role_and_label(Role::Heading, "The lease").rect();
    assert!(heading.bottom() < 800.0, "{heading:?} can be seen");
}

#[test]
fn words_that_are_nowhere_are_said_to_be() {
    let mut harness = page(&with_docs(), &FakeWindow::at("#/help"));
    type_words(&mut harness, "xylophone");
    harness.get_by_label_contains("No document has all of these words");
    harness.get_by_label_contains("No word has these letters");
}

#[test]
fn links_between_documents_stay_inside_and_others_open_a_tab() {
    let window = FakeWindow::at("#/help/learning");
    let mut harness = page(&with_docs(), &window);
    click(&mut harness, Role::Link, "safety.md");
    assert_eq!(window.current(), "#/help/safety?section=the-lease");
    harness.get_by_label_contains("One person has control.");
    window.back();
    harness.run_steps(4);
    for (name, address) in
        [("the authors", "https://example.org/ppo"), ("Picture: Curves", "/api/v1/docs/pictures/curves.svg")]
    {
        harness.get_by_role_and_label(Role::Link, name).click();
        let opened = (0..4).find_map(|_| {
            harness.step();
            let commands = &harness.output().platform_output.commands;
            commands.iter().find_map(|command| match command {
                egui::OutputCommand::OpenUrl(open) => Some(open.clone()),
                _ => None,
            })
        });
        let opened = opened.expect("the browser is told to open it");
        assert!(opened.new_tab && opened.url == address, "{opened:?}");
    }
    assert_eq!(window.current(), "#/help/learning");
}

#[test]
fn without_a_server_help_says_so_and_still_explains_words() {
    let api = full_api();
    let window = FakeWindow::at("#/help/learning");
    let mut harness = page(&api, &window);
    harness.get_by_label_contains("The list of documents did not arrive");
    harness.get_by_label_contains("The document learning did not arrive");
    click(&mut harness, Role::Button, "Glossary");
    harness.get_by_role_and_label(Role::Heading, "Glossary");
    let asked = || api.0.borrow().sent.iter().filter(|request| **request == Request::Docs).count();
    let before = asked();
    harness.get_by_label("Try again").click();
    harness.run_steps(3);
    assert_eq!(asked(), before + 1);
}

#[test]
fn a_phone_shows_the_list_or_the_document_and_nothing_wider_than_it() {
    let window = FakeWindow::at("#/help/learning");
    let mut harness = page_of(&with_docs(), &window, [390.0, 844.0]);
    harness.get_by_role_and_label(Role::Heading, "Memory");
    assert!(harness.query_by_label("Moving a station safely").is_none(), "the list makes room");
    for text in ["step after step", "An encoder keeps", "Policies learn by"] {
        let rect = harness.get_by_label_contains(text).rect();
        assert!(rect.left() >= 0.0 && rect.right() <= 390.0, "{text}: {rect:?}");
    }
    let close = harness.get_by_label("Close help").rect();
    assert!(close.right() <= 390.0 && close.height() >= 32.0, "{close:?}");
    click(&mut harness, Role::Button, "All documents");
    click(&mut harness, Role::Button, "Moving a station safely");
    assert_eq!(window.current(), "#/help/safety");
    harness.get_by_role_and_label(Role::Heading, "The lease");
}

#[test]
fn keys_of_screens_rest_while_help_is_open() {
    let mut harness = page(&with_docs(), &FakeWindow::at("#/help/learning"));
    let before = harness.ctx.theme();
    harness.key_press(Key::T);
    harness.run_steps(3);
    assert_eq!(harness.ctx.theme(), before);
    harness.key_press_modifiers(Modifiers::ALT, Key::Num4);
    harness.run_steps(4);
    assert_eq!(app(&harness).screen(), Screen::Sessions, "going to a screen closes it");
    assert!(harness.query_by_label("Close help").is_none());
}

#[test]
fn every_screen_leads_to_the_document_on_it() {
    let screens = [
        ("#/home", "tour"),
        ("#/timelines/bench-1?take=take-01", "tour"),
        ("#/hand/bench-1?take=take-01", "safety"),
        ("#/sessions", "recordings"),
        ("#/calibrate/bench-1", "calibration"),
        ("#/diagnose/bench-1", "diagnosis"),
    ];
    for (hash, name) in screens {
        let window = FakeWindow::at(hash);
        let mut harness = page(&with_docs(), &window);
        click(&mut harness, Role::Button, &format!("Help: {name}"));
        let expected = format!("#/help/{name}");
        assert!(window.current().starts_with(&expected), "{hash}: {}", window.current());
        click(&mut harness, Role::Button, "Close help");
        assert!(window.current().starts_with(hash.split('?').next().unwrap_or(hash)), "{}", window.current());
    }
}

#[test]
fn a_message_that_names_a_document_links_to_it() {
    let api = with_docs();
    api.0.borrow_mut().answer(&Request::Objects, b"[]".to_vec());
    let window = FakeWindow::at("#/objects");
    let mut harness = page(&api, &window);
    click(&mut harness, Role::Link, "docs/objects.md");
    assert_eq!(window.current(), "#/help/objects");
    harness.get_by_label_contains("The document objects did not arrive");
}

#[test]
fn documents_that_screens_lead_to_are_there() {
    for topic in Topic::all() {
        let (name, section) = topic.document();
        let path = if name == "tour" { "README.md".to_owned() } else { format!("docs/{name}.md") };
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path);
        let text = std::fs::read_to_string(&path).unwrap_or_else(|err| panic!("{topic:?}: {path:?}: {err}"));
        if let Some(section) = section {
            let known: Vec<String> = headings(&text).map(|(_, heading)| slug(heading)).collect();
            assert!(known.iter().any(|slug| slug == section), "{topic:?}: {section} is none of {known:?}");
        }
    }
}
