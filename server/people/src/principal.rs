//! Who makes a request.

use std::{collections::BTreeSet, fmt, sync::Arc};

use palpate_wire::api::{Me, Role, Scope, Via};

use crate::{rfc3339, secret::Hash};

/// Name of whoever uses a studio without a login.
const LOCAL_NAME: &str = "local operator";

/// What a client shows to prove who it is.
#[derive(Clone, Copy)]
pub enum Presented<'a> {
    /// The cookie of a login.
    Cookie(&'a str),
    /// An API token.
    Bearer(&'a str),
}

/// Why what a client shows is not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Denied {
    /// Nothing was shown.
    #[error("log in at /login, or send an API token as \"Authorization: Bearer plp_...\"")]
    Missing,
    /// It never was one, or was revoked.
    #[error(
        "this login or token is not known here: it was revoked, or never given; log in again, or make a new token"
    )]
    Unknown,
    /// It was one, once.
    #[error("this login or token has expired; log in again, or make a new token")]
    Expired,
}

/// Where a principal comes from.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Key {
    Local,
    Login(Hash),
    Token(Hash),
}

/// Whoever makes a request, and what they may do.
#[derive(Clone, PartialEq, Eq)]
pub struct Principal {
    pub(crate) name: Arc<str>,
    pub(crate) role: Role,
    pub(crate) scopes: BTreeSet<Scope>,
    /// Name of the token.
    pub(crate) token: Option<Arc<str>>,
    pub(crate) expires_s: Option<i64>,
    pub(crate) key: Key,
}

impl fmt::Debug for Principal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Principal")
            .field("name", &self.name)
            .field("role", &self.role)
            .field("scopes", &self.scopes)
            .field("token", &self.token)
            .finish_non_exhaustive()
    }
}

impl Principal {
    /// Whoever uses a studio without a login: may do everything.
    pub fn local() -> Self {
        Self {
            name: LOCAL_NAME.into(),
            role: Role::Admin,
            scopes: Scope::ALL.into(),
            token: None,
            expires_s: None,
            key: Key::Local,
        }
    }

    /// The person's name.
    pub fn name(&self) -> &Arc<str> {
        &self.name
    }

    /// What they may do.
    pub fn role(&self) -> Role {
        self.role
    }

    /// Whether they may do what `role` may, in the part of the API that `scope` names.
    pub fn may(&self, role: Role, scope: Scope) -> bool {
        self.role >= role && self.scopes.contains(&scope)
    }

    /// Whether there is no login.
    pub fn is_local(&self) -> bool {
        self.key == Key::Local
    }

    /// How they showed who they are.
    pub fn via(&self) -> Via {
        match self.key {
            Key::Local => Via::Local,
            Key::Login(_) => Via::Session,
            Key::Token(_) => Via::Token,
        }
    }

    /// As logs name them: the person, and the token if it was one.
    pub fn label(&self) -> String {
        match &self.token {
            Some(token) => format!("{} by token {token:?}", self.name),
            None => self.name.to_string(),
        }
    }

    /// As clients are told.
    pub fn me(&self) -> Me {
        Me {
            name: self.name.to_string(),
            role: self.role,
            scopes: self.scopes.iter().copied().collect(),
            via: self.via(),
            token: self.token.as_ref().map(ToString::to_string),
            expires: self.expires_s.map(rfc3339),
        }
    }
}
