//! The tables of people in the database of the data folder.
//!
//! Jobs number the steps of their tables by `PRAGMA user_version`; people number theirs in a table of their own, so that
//! neither has to know of the other. Every change counts, so that another process (`palpate people` beside a studio) is
//! noticed by its count.

use std::{path::Path, time::Duration};

use palpate_wire::api::{Role, Scope};
use rusqlite::{Connection, OptionalExtension as _, Transaction, TransactionBehavior, params};

use crate::{PeopleError, secret::Hash};

/// Another process that writes is waited for this long.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);

/// The steps from no tables to the newest version. A released step never changes.
pub(crate) const STEPS: &[&str] = &[
    // 1: people, logins, tokens, and the count of changes.
    "CREATE TABLE people (
        name TEXT PRIMARY KEY,
        role TEXT NOT NULL CHECK (role IN ('viewer', 'scorer', 'operator', 'admin')),
        password TEXT NOT NULL,
        created_s INTEGER NOT NULL,
        last_login_s INTEGER
    ) STRICT, WITHOUT ROWID;
    CREATE TABLE logins (
        hash BLOB PRIMARY KEY,
        person TEXT NOT NULL REFERENCES people (name) ON DELETE CASCADE,
        created_s INTEGER NOT NULL,
        expires_s INTEGER NOT NULL
    ) STRICT, WITHOUT ROWID;
    CREATE INDEX logins_by_person ON logins (person, created_s);
    CREATE TABLE tokens (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        hash BLOB NOT NULL UNIQUE,
        name TEXT NOT NULL,
        person TEXT NOT NULL REFERENCES people (name) ON DELETE CASCADE,
        role TEXT NOT NULL CHECK (role IN ('viewer', 'scorer', 'operator', 'admin')),
        scopes TEXT NOT NULL,
        created_s INTEGER NOT NULL,
        expires_s INTEGER NOT NULL,
        last_used_s INTEGER
    ) STRICT;
    CREATE INDEX tokens_by_person ON tokens (person);
    CREATE TABLE people_changes (one INTEGER PRIMARY KEY CHECK (one = 1), count INTEGER NOT NULL) STRICT;
    INSERT INTO people_changes VALUES (1, 0);",
];

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PersonRow {
    pub(crate) name: String,
    pub(crate) role: Role,
    pub(crate) password: String,
    pub(crate) created_s: i64,
    pub(crate) last_login_s: Option<i64>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct LoginRow {
    pub(crate) hash: Hash,
    pub(crate) person: String,
    pub(crate) expires_s: i64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TokenRow {
    pub(crate) id: i64,
    pub(crate) hash: Hash,
    pub(crate) name: String,
    pub(crate) person: String,
    pub(crate) role: Role,
    pub(crate) scopes: Vec<Scope>,
    pub(crate) created_s: i64,
    pub(crate) expires_s: i64,
    pub(crate) last_used_s: Option<i64>,
}

/// Everything that there is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Contents {
    pub(crate) count: i64,
    pub(crate) people: Vec<PersonRow>,
    pub(crate) logins: Vec<LoginRow>,
    pub(crate) tokens: Vec<TokenRow>,
}

/// Opens the database at `path` and brings the tables of people to the newest version.
pub(crate) fn open(path: &Path, steps: &[&str]) -> Result<Connection, PeopleError> {
    let failed = |err: rusqlite::Error| PeopleError::Database {
        path: path.to_owned(),
        problem: format!("the tables of people cannot be opened: {err}"),
    };
    let mut connection = Connection::open(path).map_err(failed)?;
    connection.busy_timeout(BUSY_TIMEOUT).map_err(failed)?;
    connection
        .execute_batch("PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON;")
        .map_err(failed)?;
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate).map_err(failed)?;
    transaction
        .execute_batch(
            "CREATE TABLE IF NOT EXISTS people_version (one INTEGER PRIMARY KEY CHECK (one = 1), version INTEGER NOT NULL) STRICT;
             INSERT OR IGNORE INTO people_version VALUES (1, 0);",
        )
        .map_err(failed)?;
    let version: i64 =
        transaction.query_row("SELECT version FROM people_version", [], |row| row.get(0)).map_err(failed)?;
    let pending = usize::try_from(version).ok().and_then(|done| steps.get(done..));
    let pending = pending.ok_or_else(|| PeopleError::Database {
        path: path.to_owned(),
        problem: format!(
            "the tables of people have version {version}, and this program knows versions up to {}: a newer palpate \
             wrote them; start that one, or give another data folder",
            steps.len()
        ),
    })?;
    for step in pending {
        transaction.execute_batch(step).map_err(failed)?;
    }
    transaction.execute("UPDATE people_version SET version = ?1", [steps.len() as i64]).map_err(failed)?;
    transaction.commit().map_err(failed)?;
    Ok(connection)
}

/// How many changes there have been.
pub(crate) fn count(connection: &Connection) -> rusqlite::Result<i64> {
    connection.query_row("SELECT count FROM people_changes", [], |row| row.get(0))
}

/// Reads everything, as it was at one moment.
pub(crate) fn read(connection: &mut Connection) -> rusqlite::Result<Contents> {
    let transaction = connection.transaction()?;
    let count = count(&transaction)?;
    let people = transaction
        .prepare("SELECT name, role, password, created_s, last_login_s FROM people ORDER BY name")?
        .query_map([], |row| {
            Ok(PersonRow {
                name: row.get(0)?,
                role: role(&row.get::<_, String>(1)?)?,
                password: row.get(2)?,
                created_s: row.get(3)?,
                last_login_s: row.get(4)?,
            })
        })?
        .collect::<Result<_, _>>()?;
    let logins = transaction
        .prepare("SELECT hash, person, expires_s FROM logins")?
        .query_map([], |row| Ok(LoginRow { hash: row.get(0)?, person: row.get(1)?, expires_s: row.get(2)? }))?
        .collect::<Result<_, _>>()?;
    let tokens = transaction
        .prepare(
            "SELECT id, hash, name, person, role, scopes, created_s, expires_s, last_used_s FROM tokens ORDER BY id",
        )?
        .query_map([], |row| {
            let scopes: String = row.get(5)?;
            Ok(TokenRow {
                id: row.get(0)?,
                hash: row.get(1)?,
                name: row.get(2)?,
                person: row.get(3)?,
                role: role(&row.get::<_, String>(4)?)?,
                // A scope of a newer program permits nothing here.
                scopes: scopes.split(' ').filter_map(Scope::from_name).collect(),
                created_s: row.get(6)?,
                expires_s: row.get(7)?,
                last_used_s: row.get(8)?,
            })
        })?
        .collect::<Result<_, _>>()?;
    Ok(Contents { count, people, logins, tokens })
}

fn role(name: &str) -> rusqlite::Result<Role> {
    Role::from_name(name).ok_or(rusqlite::Error::InvalidQuery)
}

/// Does `change` as a whole or not at all, and counts it.
pub(crate) fn change<T>(
    connection: &mut Connection,
    action: &'static str,
    change: impl FnOnce(&Transaction<'_>) -> Result<T, PeopleError>,
) -> Result<T, PeopleError> {
    let transaction = connection
        .transaction_with_behavior(TransactionBehavior::Immediate)
        .map_err(PeopleError::sql(action))?;
    let done = change(&transaction)?;
    transaction
        .execute("UPDATE people_changes SET count = count + 1", [])
        .map_err(PeopleError::sql(action))?;
    transaction.commit().map_err(PeopleError::sql(action))?;
    Ok(done)
}

/// Role of a person, if there is one of that name.
pub(crate) fn role_of(connection: &Connection, name: &str) -> rusqlite::Result<Option<Role>> {
    let found: Option<String> = connection
        .query_row("SELECT role FROM people WHERE name = ?1", [name], |row| row.get(0))
        .optional()?;
    found.as_deref().map(role).transpose()
}

/// Whether somebody but `name` is an admin.
pub(crate) fn has_other_admin(connection: &Connection, name: &str) -> rusqlite::Result<bool> {
    connection.query_row(
        "SELECT EXISTS (SELECT 1 FROM people WHERE role = 'admin' AND name <> ?1)",
        [name],
        |row| row.get(0),
    )
}

/// Notes when tokens were used. That is no change that others need to hear of.
pub(crate) fn note_used(connection: &mut Connection, used: &[(Hash, i64)]) -> rusqlite::Result<()> {
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    for (hash, used_s) in used {
        transaction.execute("UPDATE tokens SET last_used_s = ?2 WHERE hash = ?1", params![hash, used_s])?;
    }
    transaction.commit()
}
