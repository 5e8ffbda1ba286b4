//! Who may do what, with which tokens, what was done, and how much room data has, as the page knows it.

use std::sync::Arc;

use palpate_wire::api::{
    CreatedToken, Me, NewPerson, NewToken, Person, PersonChanges, Role, Scope, Token, Via,
};
use serde::Deserialize;

use super::{Loadable, ask, parse_json, reset, shared};
use crate::api_client::Request;

/// A line of the audit log.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct AuditLine {
    /// When, RFC 3339.
    pub time: String,
    /// Who: a person, or `station` for what the station did by itself.
    pub who: String,
    /// What happened, in words.
    pub what: String,
}

impl AuditLine {
    /// Whether `words` (any order, any case) all occur in it.
    pub fn matches(&self, words: &str) -> bool {
        let text = format!("{} {} {}", self.time, self.who, self.what).to_lowercase();
        words.to_lowercase().split_whitespace().all(|word| text.contains(word))
    }
}

/// See the module.
#[derive(Debug, Default)]
pub struct PeopleTable {
    me: Loadable<Arc<Me>>,
    people: Loadable<Arc<Vec<Person>>>,
    tokens: Loadable<Arc<Vec<Token>>>,
    audit: Loadable<Arc<Vec<AuditLine>>>,
    free_bytes: Loadable<Option<f64>>,
    /// A token that was just made: its secret is here until [`PeopleTable::forget_created`], and nowhere else.
    pub created: Option<CreatedToken>,
    /// Why the last change did not work; `None` when all is well.
    pub problem: Option<String>,
    /// A change was asked for, and the server has not answered yet.
    pub is_busy: bool,
    outbox: Vec<Request>,
}

impl PeopleTable {
    /// Who asks, and what they may.
    pub fn me(&mut self) -> Loadable<Arc<Me>> {
        ask(&mut self.me, &mut self.outbox, || Request::Me)
    }

    /// Whether whoever sits here has `role` and a part of the API. `false` until it is known.
    pub fn may(&mut self, role: Role, scope: Scope) -> bool {
        self.me().ready().is_some_and(|me| me.role >= role && me.scopes.contains(&scope))
    }

    /// Who sits here, where they are known to lack `role` or a part of the API. Where that is not known, the server
    /// decides.
    pub fn lacks(&mut self, role: Role, scope: Scope) -> Option<Arc<Me>> {
        let me = self.me().ready().cloned()?;
        (me.role < role || !me.scopes.contains(&scope)).then_some(me)
    }

    /// Under which name the server knows whoever sits here; `None` without a login.
    pub fn login(&self) -> Option<&str> {
        self.me.ready().filter(|me| me.via != Via::Local).map(|me| me.name.as_str())
    }

    /// People who may log in; only admins are told.
    pub fn people(&mut self) -> Loadable<Arc<Vec<Person>>> {
        ask(&mut self.people, &mut self.outbox, || Request::People)
    }

    /// API tokens: one's own, or everybody's for admins.
    pub fn tokens(&mut self) -> Loadable<Arc<Vec<Token>>> {
        ask(&mut self.tokens, &mut self.outbox, || Request::Tokens)
    }

    /// The newest lines of the audit log, newest first.
    pub fn audit(&mut self) -> Loadable<Arc<Vec<AuditLine>>> {
        ask(&mut self.audit, &mut self.outbox, || Request::Audit)
    }

    /// Asks for the newest lines of the audit log again. What is known of it stays on the page until then.
    pub fn ask_audit_again(&mut self) {
        self.outbox.push(Request::Audit);
    }

    /// Room on the disk of the data folder, bytes; `None` where the studio does not know.
    pub fn free_bytes(&mut self) -> Loadable<Option<f64>> {
        ask(&mut self.free_bytes, &mut self.outbox, || Request::Metrics)
    }

    /// Adds somebody.
    pub fn add(&mut self, person: NewPerson) {
        self.change(Request::AddPerson(person));
    }

    /// Gives `person` another role.
    pub fn set_role(&mut self, person: &str, role: Role) {
        let changes = PersonChanges { role: Some(role), password: None };
        self.change(Request::ChangePerson { person: person.to_owned(), changes });
    }

    /// Removes `person`, with their logins and tokens.
    pub fn remove(&mut self, person: &str) {
        self.change(Request::RemovePerson(person.to_owned()));
    }

    /// Makes a token; see [`PeopleTable::created`].
    pub fn create_token(&mut self, token: NewToken) {
        self.change(Request::CreateToken(token));
    }

    /// Ends a token.
    pub fn revoke_token(&mut self, id: u64) {
        self.change(Request::RevokeToken(id));
    }

    /// The secret of the new token was kept elsewhere.
    pub fn forget_created(&mut self) {
        self.created = None;
    }

    fn change(&mut self, request: Request) {
        self.is_busy = true;
        self.problem = None;
        self.outbox.push(request);
    }

    pub(super) fn take_outbox(&mut self) -> Vec<Request> {
        std::mem::take(&mut self.outbox)
    }

    /// Takes in the answer to `request`, one of this table's.
    pub(super) fn receive(&mut self, request: &Request, result: Result<Vec<u8>, String>) {
        match request {
            Request::Me => self.me = shared(parse_json(result)),
            Request::People => self.people = shared(parse_json(result)),
            Request::Tokens => self.tokens = shared(parse_json(result)),
            Request::Metrics => {
                let free = result.map(|body| metric(&String::from_utf8_lossy(&body), DISK_FREE));
                self.free_bytes = Loadable::from_result(free);
            }
            Request::Audit => self.audit = shared(Loadable::from_result(result.map(|body| lines(&body)))),
            Request::CreateToken(_) => {
                self.is_busy = false;
                match parse_json::<CreatedToken>(result) {
                    Loadable::Ready(created) => {
                        self.created = Some(created);
                        self.outbox.push(Request::Tokens);
                    }
                    Loadable::Failed(error) => self.problem = Some(error),
                    Loadable::Idle | Loadable::Loading => {}
                }
            }
            Request::RevokeToken(_) => self.receive_changed(result, &[Request::Tokens]),
            // Tokens go with their person, and may do no more than they.
            _ => self.receive_changed(result, &[Request::People, Request::Tokens, Request::Me]),
        }
    }

    fn receive_changed(&mut self, result: Result<Vec<u8>, String>, again: &[Request]) {
        self.is_busy = false;
        self.problem = result.err();
        self.outbox.extend_from_slice(again);
    }

    pub(super) fn retry_failed(&mut self) {
        reset(&mut self.me);
        reset(&mut self.people);
        reset(&mut self.tokens);
        reset(&mut self.audit);
        reset(&mut self.free_bytes);
    }
}

/// Name of the room on the disk among the studio's numbers.
const DISK_FREE: &str = "palpate_disk_free_bytes";

/// A number without labels of a document in the form of OpenMetrics.
fn metric(text: &str, name: &str) -> Option<f64> {
    let mut values = text.lines().filter_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    values.next()?.split_whitespace().next()?.parse().ok().filter(|value: &f64| value.is_finite())
}

/// The lines of the log that can be read, newest first. A line that another version wrote is left out.
fn lines(body: &[u8]) -> Vec<AuditLine> {
    let text = String::from_utf8_lossy(body);
    text.lines().rev().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_disk_is_found_among_the_numbers() {
        let text = "# TYPE palpate_disk_free_bytes gauge\n# UNIT palpate_disk_free_bytes bytes\n\
            palpate_disk_free_bytes 1.5e9\npalpate_disk_free_bytes_total 7\n# EOF\n";
        assert_eq!(metric(text, DISK_FREE), Some(1.5e9));
        assert_eq!(metric("palpate_disk_free_bytes inf\n", DISK_FREE), None);
        assert_eq!(metric("", DISK_FREE), None);
    }

    #[test]
    fn newest_lines_come_first_and_broken_ones_are_left_out() {
        let body = br#"{"time":"t1","who":"ada","what":"started job run-1"}
{"time":
{"time":"t2","who":"station","connection":"c1","what":"stopped"}
"#;
        let lines = lines(body);
        assert_eq!(lines.iter().map(|line| line.time.as_str()).collect::<Vec<_>>(), ["t2", "t1"]);
        assert!(lines[1].matches("RUN-1 ada") && !lines[1].matches("ada stopped") && lines[1].matches(""));
    }
}
