//! The manual: what is served of it, and that no link in it leads nowhere.

use std::{collections::BTreeSet, fs, path::PathBuf};

use axum::{
    body::Body,
    http::{Request, header},
};
use palpate_wire::{
    api::DocSummary,
    markdown::{Target, headings, prose, slug},
};

use crate::support::{Data, answer_of, get};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The file of a document in the checkout.
fn file(name: &str) -> PathBuf {
    if name == "tour" { root().join("README.md") } else { root().join(format!("docs/{name}.md")) }
}

fn source(name: &str) -> String {
    fs::read_to_string(file(name)).unwrap_or_else(|err| panic!("{name}: {err}"))
}

/// Names of all documents of the checkout.
fn names() -> BTreeSet<String> {
    let entries = fs::read_dir(root().join("docs")).unwrap();
    let files = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let names = files.filter_map(|file| Some(file.strip_suffix(".md")?.to_owned()));
    names.chain(["tour".to_owned()]).collect()
}

#[tokio::test]
async fn every_document_is_listed_and_served_as_it_is() {
    let app = Data::empty().app();
    let list: Vec<DocSummary> = get(&app, "/api/v1/docs").await.json();
    assert_eq!(list.iter().map(|doc| doc.name.clone()).collect::<BTreeSet<_>>(), names());
    for doc in &list {
        let answer = get(&app, &format!("/api/v1/docs/{}", doc.name)).await;
        assert_eq!(answer.header(header::CONTENT_TYPE), "text/markdown; charset=utf-8");
        assert_eq!(answer.body, source(&doc.name), "{}", doc.name);
        assert!(!doc.title.is_empty() && !doc.title.contains(['#', '`']), "{doc:?}");
        // A document that does not say what it is about before its first table does so nowhere.
        let is_sentence = doc.sentence.ends_with('.') && doc.sentence.len() > 20;
        assert!(is_sentence && !doc.sentence.contains(['`', '[', '|']), "{doc:?}");
    }
    let calibration = list.iter().find(|doc| doc.name == "calibration").unwrap();
    assert_eq!(calibration.title, "Calibration");
    assert!(calibration.sentence.starts_with("palpate calibrate fits theta"), "{calibration:?}");
}

#[tokio::test]
async fn documents_and_pictures_that_a_client_has_are_not_sent_again() {
    let app = Data::empty().app();
    for path in ["/api/v1/docs", "/api/v1/docs/learning", "/api/v1/docs/pictures/hand.png"] {
        let tag = get(&app, path).await.header(header::ETAG).to_owned();
        assert!(tag.len() > 10, "{path}");
        let request = Request::get(path).header(header::HOST, "localhost").header(header::IF_NONE_MATCH, tag);
        let again = answer_of(&app, request.body(Body::empty()).unwrap()).await;
        assert_eq!((again.status.as_u16(), again.body.len()), (304, 0), "{path}");
    }
}

#[tokio::test]
async fn what_is_not_there_is_answered_with_what_is() {
    let app = Data::empty().app();
    for name in ["nothing", "learning.md", "hand.png", "openapi", "..%2FREADME"] {
        let detail = get(&app, &format!("/api/v1/docs/{name}")).await.problem(404);
        assert!(detail.contains("no document") && detail.contains("learning, objects"), "{detail}");
    }
    for name in ["nothing.png", "learning.md", "openapi.json"] {
        let detail = get(&app, &format!("/api/v1/docs/pictures/{name}")).await.problem(404);
        assert!(detail.contains("no picture") && detail.contains("hand.png"), "{detail}");
    }
}

/// Targets of the links of a document, outside code.
fn links(text: &str) -> Vec<String> {
    let prose: Vec<&str> = prose(text).collect();
    // Every second part stands between back quotes.
    let spoken: String = prose.join("\n").split('`').step_by(2).collect();
    let targets = spoken.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    targets.map(str::to_owned).collect()
}

#[test]
fn links_are_found_and_code_is_not_searched() {
    let text = "[a](x.md), [`b`](y.md#z)\n`[c](no.md)`\n\n    [d](no.md)\n\n![e](e.png)";
    assert_eq!(links(text), ["x.md", "y.md#z", "e.png"]);
}

#[tokio::test]
async fn every_link_leads_to_something() {
    let app = Data::empty().app();
    let addresses = |name: &str| -> BTreeSet<String> {
        headings(&source(name)).map(|(_, heading)| slug(heading)).collect()
    };
    let (names, mut num_links) = (names(), 0);
    for name in &names {
        for link in links(&source(name)) {
            num_links += 1;
            match Target::of(name, &link) {
                Target::Section(section) => {
                    assert!(addresses(name).contains(&section), "{name}: {link} leads to no heading");
                }
                Target::Doc { name: to, section } => {
                    assert!(names.contains(&to), "{name}: {link} leads to no document");
                    if let Some(section) = section {
                        assert!(addresses(&to).contains(&section), "{name}: {link} leads to no heading");
                    }
                }
                Target::Picture(picture) => {
                    let answer = get(&app, &format!("/api/v1/docs/pictures/{picture}")).await;
                    assert_eq!(answer.status, 200, "{name}: {link} leads to no picture");
                    let kept = fs::read(root().join("docs").join(&picture)).unwrap();
                    assert_eq!(answer.body, kept, "{picture}");
                    assert!(answer.header(header::CONTENT_TYPE).starts_with("image/"), "{picture}");
                }
                Target::Source(path) => {
                    assert!(root().join(&path).exists(), "{name}: {link} leads to no file of the sources");
                }
                // Others may change at any time; the studio's own are there.
                Target::Outside(url) => {
                    if url.starts_with('/') {
                        assert_eq!(get(&app, &url).await.status, 200, "{name}: {link}");
                    }
                }
            }
        }
    }
    assert!(num_links > 60, "only {num_links} links were found");
}
