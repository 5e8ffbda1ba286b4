//! What was deleted here and by others, and how it comes back.

use std::sync::Arc;

use palpate_wire::api::TrashEntry;

use super::{Loadable, Store, ask, parse_json, shared};
use crate::api_client::Request;

impl Store {
    /// What is in the trash, the one that was deleted last first.
    pub fn trash(&mut self) -> Loadable<Arc<Vec<TrashEntry>>> {
        ask(&mut self.trash, &mut self.outbox, || Request::Trash)
    }

    /// Moves a session to the trash; see [`Store::deleted_session`].
    pub fn delete_session(&mut self, session: &str) {
        self.deleted_session = Loadable::Loading;
        self.outbox.push(Request::DeleteSession(session.to_owned()));
    }

    /// Takes a session out of the trash.
    pub fn restore_session(&mut self, session: &str) {
        self.outbox.push(Request::RestoreSession(session.to_owned()));
    }

    /// Moves a saved model to the trash; see [`Store::deleted_model`].
    pub fn delete_model(&mut self, model: &str) {
        self.deleted_model = Loadable::Loading;
        self.outbox.push(Request::DeleteModel(model.to_owned()));
    }

    /// Takes a saved model out of the trash.
    pub fn restore_model(&mut self, model: &str) {
        self.outbox.push(Request::RestoreModel(model.to_owned()));
    }

    pub(super) fn receive_trash(&mut self, request: Request, result: Result<Vec<u8>, String>) {
        match request {
            Request::Trash => {
                self.trash = shared(parse_json(result));
                return;
            }
            Request::DeleteSession(session) => {
                self.deleted_session = Loadable::from_result(result.map(|_| session));
                self.outbox.push(Request::Sessions);
            }
            Request::RestoreSession(session) => {
                self.deleted_session = result.map_or_else(Loadable::Failed, |_| Loadable::Idle);
                self.details.remove(&session);
                self.outbox.push(Request::Sessions);
            }
            Request::DeleteModel(model) => {
                self.deleted_model = Loadable::from_result(result.map(|_| model));
                self.models_changed();
            }
            Request::RestoreModel(_) => {
                self.deleted_model = result.map_or_else(Loadable::Failed, |_| Loadable::Idle);
                self.models_changed();
            }
            _ => return,
        }
        self.trash_changed();
    }

    /// The old list stays on the page until the new one is here.
    pub(super) fn trash_changed(&mut self) {
        if self.trash.ready().is_some() {
            self.outbox.push(Request::Trash);
        }
    }
}
