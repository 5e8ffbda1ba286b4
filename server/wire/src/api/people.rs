//! People, their roles and their API tokens.

use std::fmt;

use serde::{Deserialize, Serialize};

/// What a person may do. Each role may do everything that those before it may.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Sees everything, and may press STOP.
    Viewer,
    /// Also scores trials.
    Scorer,
    /// Also takes control, records, starts jobs, changes and deletes data.
    Operator,
    /// Also says who the people are.
    Admin,
}

impl Role {
    /// All of them, from the one that may least.
    pub const ALL: [Self; 4] = [Self::Viewer, Self::Scorer, Self::Operator, Self::Admin];

    /// As it is written.
    pub fn name(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Scorer => "scorer",
            Self::Operator => "operator",
            Self::Admin => "admin",
        }
    }

    /// The role that is written as `name`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|role| role.name() == name)
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A part of the API that a token may be limited to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// Everything that only reads, and STOP.
    Read,
    /// Scores of trials.
    Score,
    /// Jobs: start, cancel, retry, delete.
    Jobs,
    /// Sessions and models: upload, save, delete.
    Data,
    /// The station: control, recording, faults of emulated devices.
    Control,
    /// People and tokens.
    People,
}

impl Scope {
    /// All of them.
    pub const ALL: [Self; 6] = [Self::Read, Self::Score, Self::Jobs, Self::Data, Self::Control, Self::People];

    /// As it is written.
    pub fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Score => "score",
            Self::Jobs => "jobs",
            Self::Data => "data",
            Self::Control => "control",
            Self::People => "people",
        }
    }

    /// The scope that is written as `name`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|scope| scope.name() == name)
    }
}

impl fmt::Display for Scope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// An entry of `GET /api/v1/people`. Times are RFC 3339.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Person {
    /// Name to log in with, and in the audit log.
    pub name: String,
    /// What they may do.
    pub role: Role,
    /// When they were added.
    pub created: String,
    /// When they logged in last; absent before the first time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_login: Option<String>,
}

/// `POST /api/v1/people`.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct NewPerson {
    /// 1 to 32 of a-z, 0-9, dot, dash and underscore, beginning with a letter or digit.
    pub name: String,
    /// What they may do.
    pub role: Role,
    /// At least 10 characters.
    pub password: String,
}

/// `PATCH /api/v1/people/{person}`. What is absent stays as it is.
#[derive(Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct PersonChanges {
    /// What they may do from now on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub role: Option<Role>,
    /// At least 10 characters. It ends all their logins; their tokens stay.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub password: Option<String>,
}

/// `POST /api/v1/me/password`.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct PasswordChange {
    /// The one until now.
    pub old: String,
    /// The one from now on, at least 10 characters.
    pub new: String,
}

/// `POST /api/v1/login`.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Login {
    /// Name of the person.
    pub name: String,
    /// Their password.
    pub password: String,
}

/// How a request showed who makes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Via {
    /// There is no login, because the studio can be reached from its own computer alone (or was told `--insecure`).
    Local,
    /// By the cookie of a login.
    Session,
    /// By an API token.
    Token,
}

/// `GET /api/v1/me`, and the answer to a login.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Me {
    /// Name of the person; `local operator` without a login.
    pub name: String,
    /// What this request's login or token may do.
    pub role: Role,
    /// The parts of the API that it is good for.
    pub scopes: Vec<Scope>,
    /// How the request showed it.
    pub via: Via,
    /// Name of the token, if it is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub token: Option<String>,
    /// When the login or the token ends, RFC 3339.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires: Option<String>,
}

/// An entry of `GET /api/v1/tokens`: an API token as it is kept, which is not enough to use it. Times are RFC 3339.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Token {
    /// What it is revoked by.
    pub id: u64,
    /// What it is for, in its person's words.
    pub name: String,
    /// In whose name it acts.
    pub person: String,
    /// What it may do; never more than its person may at the time.
    pub role: Role,
    /// The parts of the API that it is good for.
    pub scopes: Vec<Scope>,
    /// When it was made.
    pub created: String,
    /// When it ends.
    pub expires: String,
    /// When it was used last, to a minute; absent before the first time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_used: Option<String>,
}

/// `POST /api/v1/tokens`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct NewToken {
    /// What it is for: 1 to 64 characters.
    pub name: String,
    /// In whose name it acts; whoever asks without. Only an admin may name somebody else.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub person: Option<String>,
    /// What it may do; the person's role without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub role: Option<Role>,
    /// The parts of the API that it is good for; all without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scopes: Option<Vec<Scope>>,
    /// Days until it ends, 1 to 730; 90 without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires_days: Option<u32>,
}

/// The answer to `POST /api/v1/tokens`.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CreatedToken {
    /// The token as it is kept.
    pub token: Token,
    /// What programs send as `Authorization: Bearer SECRET`. It is shown here and never again.
    pub secret: String,
}

/// `GET /readyz`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Readiness {
    /// Whether everything that the studio needs is there.
    pub ready: bool,
    /// What is not, in words.
    pub reasons: Vec<String>,
}

/// What must not be printed.
const HIDDEN: &str = "...";

impl fmt::Debug for NewPerson {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, role, password: _ } = self;
        f.debug_struct("NewPerson")
            .field("name", name)
            .field("role", role)
            .field("password", &HIDDEN)
            .finish()
    }
}

impl fmt::Debug for PersonChanges {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let password = self.password.as_ref().map(|_| HIDDEN);
        f.debug_struct("PersonChanges").field("role", &self.role).field("password", &password).finish()
    }
}

impl fmt::Debug for PasswordChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PasswordChange").finish_non_exhaustive()
    }
}

impl fmt::Debug for Login {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Login").field("name", &self.name).field("password", &HIDDEN).finish()
    }
}

impl fmt::Debug for CreatedToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CreatedToken").field("token", &self.token).field("secret", &HIDDEN).finish()
    }
}
