//! The documents of `docs/` and their pictures, which the binary carries, so that the page can show them anywhere.

use std::sync::OnceLock;

use palpate_wire::{
    api::DocSummary,
    markdown::{first_sentence, headings, plain},
};

use crate::Error;

/// Sorted by name. `README.md` is among them as `tour.md`.
static FILES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/docs.rs"));

/// What each document is called and about, by name.
pub(crate) fn list() -> &'static [DocSummary] {
    static LIST: OnceLock<Vec<DocSummary>> = OnceLock::new();
    LIST.get_or_init(|| {
        let names = FILES.iter().filter_map(|(file, _)| file.strip_suffix(".md"));
        names.filter_map(|name| read(name).map(|text| summary(name, text))).collect()
    })
}

/// The Markdown of the document called `name`.
pub(crate) fn text(name: &str) -> Result<&'static str, Error> {
    static NAMES: OnceLock<String> = OnceLock::new();
    let hint = NAMES.get_or_init(|| {
        let names: Vec<&str> = list().iter().map(|doc| doc.name.as_str()).collect();
        format!("there are {}", names.join(", "))
    });
    read(name).ok_or_else(|| Error::NotFound { what: "document", id: name.to_owned(), hint })
}

/// Content type and bytes of the picture called `name`, which a document shows.
pub(crate) fn picture(name: &str) -> Result<(&'static str, &'static [u8]), Error> {
    static NAMES: OnceLock<String> = OnceLock::new();
    let pictures = || FILES.iter().filter_map(|(file, bytes)| Some((*file, content_type(file)?, *bytes)));
    let hint = NAMES.get_or_init(|| {
        let names: Vec<&str> = pictures().map(|(file, _, _)| file).collect();
        format!("there are {}", names.join(", "))
    });
    let found = pictures().find(|(file, _, _)| *file == name);
    found.map(|(_, content_type, bytes)| (content_type, bytes)).ok_or_else(|| Error::NotFound {
        what: "picture",
        id: name.to_owned(),
        hint,
    })
}

fn read(name: &str) -> Option<&'static str> {
    let (_, bytes) = FILES.iter().find(|(file, _)| file.strip_suffix(".md") == Some(name))?;
    std::str::from_utf8(bytes).ok()
}

fn summary(name: &str, text: &str) -> DocSummary {
    let title = headings(text).next().map_or_else(|| name.to_owned(), |(_, title)| plain(title));
    DocSummary { name: name.to_owned(), title, sentence: first_sentence(text) }
}

fn content_type(file: &str) -> Option<&'static str> {
    match file.rsplit_once('.')?.1 {
        "png" => Some("image/png"),
        "svg" => Some("image/svg+xml"),
        _ => None,
    }
}
