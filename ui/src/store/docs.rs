//! The manual: which documents there are, and their text.

use std::{collections::BTreeMap, sync::Arc};

use palpate_wire::api::DocSummary;

use super::{Loadable, ask, parse_json, reset, shared};
use crate::api_client::Request;

/// Documents as the server has them. They never change while it runs.
#[derive(Debug, Default)]
pub struct DocTable {
    list: Loadable<Arc<Vec<DocSummary>>>,
    texts: BTreeMap<String, Loadable<Arc<String>>>,
    outbox: Vec<Request>,
}

impl DocTable {
    /// All documents, by name.
    pub fn list(&mut self) -> Loadable<Arc<Vec<DocSummary>>> {
        ask(&mut self.list, &mut self.outbox, || Request::Docs)
    }

    /// The Markdown of the document called `name`.
    pub fn text(&mut self, name: &str) -> Loadable<Arc<String>> {
        let slot = self.texts.entry(name.to_owned()).or_default();
        ask(slot, &mut self.outbox, || Request::Doc(name.to_owned()))
    }

    /// What failed is asked for again when Help wants it.
    pub fn retry_failed(&mut self) {
        reset(&mut self.list);
        self.texts.values_mut().for_each(reset);
    }

    pub(super) fn take_outbox(&mut self) -> Vec<Request> {
        std::mem::take(&mut self.outbox)
    }

    pub(super) fn receive_list(&mut self, result: Result<Vec<u8>, String>) {
        self.list = shared(parse_json(result));
    }

    pub(super) fn receive_text(&mut self, name: String, result: Result<Vec<u8>, String>) {
        let text = result.and_then(|bytes| {
            String::from_utf8(bytes).map_err(|err| format!("the document {name:?} is no text: {err}"))
        });
        self.texts.insert(name, shared(Loadable::from_result(text)));
    }
}
