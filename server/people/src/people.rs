//! People, logins and tokens: kept in the database, looked up in memory.

use std::{
    collections::{BTreeMap, HashMap},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock},
    time::{Duration, Instant},
};

use palpate_wire::api::{Person, Role, Scope, Token};
use rusqlite::{Connection, params};

use crate::{
    Denied, PeopleError, Presented, Principal, password,
    principal::Key,
    rfc3339,
    secret::{self, Hash, TOKEN_PREFIX},
    tables::{self, Contents, LoginRow, PersonRow, STEPS, TokenRow},
};

/// A login ends after this long, s: a week.
const LOGIN_S: i64 = 7 * 86_400;
/// Logins of a person at a time; the oldest end beyond that.
const MAX_LOGINS: i64 = 32;
/// Tokens of a person.
const MAX_TOKENS: i64 = 100;
/// When a token was used is noted to this, s: not each request is a write.
const USED_RESOLUTION_S: i64 = 60;
/// Unknown secrets make it look at the database no more often than so many times in so long: whoever guesses costs little,
/// and a token that was made just now is good at once although somebody guessed a moment ago.
const MAX_LOOKS: u32 = 10;
const LOOKS_WITHIN: Duration = Duration::from_secs(1);
/// Days that a token is good for.
const MAX_TOKEN_DAYS: u32 = 730;

/// The people of a data folder.
#[derive(Debug)]
pub struct People {
    path: PathBuf,
    connection: Mutex<Connection>,
    known: RwLock<Arc<Known>>,
    /// When tokens were used, as far as the database has not been told.
    used: Mutex<HashMap<Hash, i64>>,
    /// Since when unknown secrets made it look at the database, and how often.
    looked: Mutex<Option<(Instant, u32)>>,
}

/// Everything that the database holds, by what it is looked up by.
#[derive(Debug, Default)]
struct Known {
    count: i64,
    people: BTreeMap<String, PersonRow>,
    logins: HashMap<Hash, LoginRow>,
    tokens: HashMap<Hash, TokenRow>,
}

impl From<Contents> for Known {
    fn from(contents: Contents) -> Self {
        let Contents { count, people, logins, tokens } = contents;
        Self {
            count,
            people: people.into_iter().map(|row| (row.name.clone(), row)).collect(),
            logins: logins.into_iter().map(|row| (row.hash, row)).collect(),
            tokens: tokens.into_iter().map(|row| (row.hash, row)).collect(),
        }
    }
}

/// Somebody who has just logged in.
#[derive(Clone)]
pub struct LoggedIn {
    /// Value of the cookie.
    pub secret: String,
    /// Seconds for which it is good.
    pub lasts_s: i64,
    /// Who it is.
    pub principal: Principal,
}

/// A token that somebody wants.
#[derive(Clone, Debug)]
pub struct TokenRequest<'a> {
    /// In whose name it will act.
    pub person: &'a str,
    /// What it is for.
    pub name: &'a str,
    /// What it may do; what its person may without.
    pub role: Option<Role>,
    /// The parts of the API that it is good for; all without.
    pub scopes: Option<&'a [Scope]>,
    /// Days until it ends.
    pub expires_days: u32,
}

impl People {
    /// Opens the people in the database at `path`, which is made if there is none.
    pub fn open(path: &Path) -> Result<Self, PeopleError> {
        let mut connection = tables::open(path, STEPS)?;
        let known = read(&mut connection)?;
        Ok(Self {
            path: path.to_owned(),
            connection: Mutex::new(connection),
            known: RwLock::new(Arc::new(known)),
            used: Mutex::default(),
            looked: Mutex::default(),
        })
    }

    /// Where the database is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether there is nobody.
    pub fn is_empty(&self) -> bool {
        self.known().people.is_empty()
    }

    /// Everybody, by name.
    pub fn list(&self) -> Vec<Person> {
        self.known().people.values().map(person_of).collect()
    }

    /// Adds somebody.
    pub fn add(&self, name: &str, role: Role, password: &str, now_s: i64) -> Result<Person, PeopleError> {
        check_name(name)?;
        password::check(name, password)?;
        let hash = password::hash(password)?;
        self.change("add a person", |transaction| {
            let added = transaction
                .execute(
                    "INSERT INTO people (name, role, password, created_s) VALUES (?1, ?2, ?3, ?4) ON CONFLICT DO NOTHING",
                    params![name, role.name(), hash, now_s],
                )
                .map_err(PeopleError::sql("add a person"))?;
            match added {
                0 => Err(PeopleError::Conflict(format!("there is a person {name:?} already; take another name"))),
                _ => Ok(()),
            }
        })?;
        self.person(name)
    }

    /// Removes somebody, with their logins and tokens.
    pub fn remove(&self, name: &str) -> Result<(), PeopleError> {
        let sql = || PeopleError::sql("remove a person");
        self.change("remove a person", |transaction| {
            let role = tables::role_of(transaction, name).map_err(sql())?;
            let role = role.ok_or_else(|| PeopleError::no_person(name))?;
            if role == Role::Admin && !tables::has_other_admin(transaction, name).map_err(sql())? {
                return Err(last_admin(name));
            }
            transaction.execute("DELETE FROM people WHERE name = ?1", [name]).map_err(sql())?;
            Ok(())
        })
    }

    /// Gives somebody another role. Their tokens may do no more than that from now on.
    pub fn set_role(&self, name: &str, role: Role) -> Result<Person, PeopleError> {
        let sql = || PeopleError::sql("change a role");
        self.change("change a role", |transaction| {
            let before = tables::role_of(transaction, name).map_err(sql())?;
            let before = before.ok_or_else(|| PeopleError::no_person(name))?;
            let loses_admin = before == Role::Admin && role != Role::Admin;
            if loses_admin && !tables::has_other_admin(transaction, name).map_err(sql())? {
                return Err(last_admin(name));
            }
            transaction
                .execute("UPDATE people SET role = ?2 WHERE name = ?1", params![name, role.name()])
                .map_err(sql())?;
            Ok(())
        })?;
        self.person(name)
    }

    /// Gives somebody another password, and ends all their logins.
    pub fn set_password(&self, name: &str, password: &str) -> Result<Person, PeopleError> {
        if !self.known().people.contains_key(name) {
            return Err(PeopleError::no_person(name));
        }
        password::check(name, password)?;
        let hash = password::hash(password)?;
        let sql = || PeopleError::sql("change a password");
        self.change("change a password", |transaction| {
            let changed = transaction
                .execute("UPDATE people SET password = ?2 WHERE name = ?1", params![name, hash])
                .map_err(sql())?;
            if changed == 0 {
                return Err(PeopleError::no_person(name));
            }
            transaction.execute("DELETE FROM logins WHERE person = ?1", [name]).map_err(sql())?;
            Ok(())
        })?;
        self.person(name)
    }

    /// Whether `password` is that of `name`. It takes some tens of milliseconds, whoever is asked for.
    pub fn verify(&self, name: &str, password: &str) -> Result<(), PeopleError> {
        let kept = self.known().people.get(name).map(|person| person.password.clone());
        let fits = password::fits(kept.as_deref().unwrap_or(password::NOBODY), password);
        if fits && kept.is_some() { Ok(()) } else { Err(PeopleError::WrongLogin) }
    }

    /// Logs somebody in, if the password is theirs.
    pub fn log_in(&self, name: &str, password: &str, now_s: i64) -> Result<LoggedIn, PeopleError> {
        self.verify(name, password)?;
        let kept = self.known().people.get(name).map(|person| person.password.clone());
        let (secret, hash) = secret::new("")?;
        let expires_s = now_s + LOGIN_S;
        let sql = || PeopleError::sql("log in");
        self.change("log in", |transaction| {
            // Not with a password that was changed meanwhile.
            let known = transaction
                .execute(
                    "UPDATE people SET last_login_s = ?3 WHERE name = ?1 AND password = ?2",
                    params![name, kept, now_s],
                )
                .map_err(sql())?;
            if known == 0 {
                return Err(PeopleError::WrongLogin);
            }
            transaction.execute("DELETE FROM logins WHERE expires_s <= ?1", [now_s]).map_err(sql())?;
            transaction
                .execute(
                    "INSERT INTO logins (hash, person, created_s, expires_s) VALUES (?1, ?2, ?3, ?4)",
                    params![hash, name, now_s, expires_s],
                )
                .map_err(sql())?;
            transaction
                .execute(
                    "DELETE FROM logins WHERE person = ?1 AND hash NOT IN
                     (SELECT hash FROM logins WHERE person = ?1 ORDER BY created_s DESC, hash = ?3 DESC LIMIT ?2)",
                    params![name, MAX_LOGINS, hash],
                )
                .map_err(sql())?;
            Ok(())
        })?;
        let principal = self.of_login(&hash, now_s).map_err(|_| PeopleError::WrongLogin)?;
        Ok(LoggedIn { secret, lasts_s: LOGIN_S, principal })
    }

    /// Ends the login of `principal`, if it is one.
    pub fn log_out(&self, principal: &Principal) -> Result<(), PeopleError> {
        let Key::Login(hash) = principal.key else { return Ok(()) };
        self.change("log out", |transaction| {
            transaction
                .execute("DELETE FROM logins WHERE hash = ?1", [hash])
                .map_err(PeopleError::sql("log out"))?;
            Ok(())
        })
    }

    /// Makes a token; gives it and its secret, which is not kept.
    pub fn create_token(
        &self,
        request: &TokenRequest<'_>,
        now_s: i64,
    ) -> Result<(Token, String), PeopleError> {
        let &TokenRequest { person, name, role, scopes, expires_days } = request;
        let length = name.chars().count();
        if !(1..=64).contains(&length) || name.trim() != name || name.chars().any(char::is_control) {
            return Err(PeopleError::Argument(format!(
                "{name:?} cannot be the name of a token; expected 1 to 64 characters that say what it is for"
            )));
        }
        if !(1..=MAX_TOKEN_DAYS).contains(&expires_days) {
            return Err(PeopleError::Argument(format!(
                "a token is good for 1 to {MAX_TOKEN_DAYS} days, not for {expires_days}"
            )));
        }
        let mut scopes = scopes.unwrap_or(&Scope::ALL).to_vec();
        scopes.sort_unstable();
        scopes.dedup();
        if scopes.is_empty() {
            return Err(PeopleError::Argument(
                "a token without scopes is good for nothing; name some, or leave them out for all".to_owned(),
            ));
        }
        let (secret, hash) = secret::new(TOKEN_PREFIX)?;
        let words: Vec<&str> = scopes.iter().map(|scope| scope.name()).collect();
        let sql = || PeopleError::sql("make a token");
        let id = self.change("make a token", |transaction| {
            let theirs = tables::role_of(transaction, person).map_err(sql())?;
            let theirs = theirs.ok_or_else(|| PeopleError::no_person(person))?;
            let role = role.unwrap_or(theirs);
            if role > theirs {
                return Err(PeopleError::Argument(format!(
                    "{person:?} is {theirs}, and a token may do no more than its person; give it that role at most"
                )));
            }
            let num_tokens: i64 = transaction
                .query_row("SELECT count(*) FROM tokens WHERE person = ?1", [person], |row| row.get(0))
                .map_err(sql())?;
            if num_tokens >= MAX_TOKENS {
                return Err(PeopleError::Conflict(format!(
                    "{person:?} has {num_tokens} tokens; revoke those that nobody uses any more"
                )));
            }
            transaction
                .execute(
                    "INSERT INTO tokens (hash, name, person, role, scopes, created_s, expires_s)
                     VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
                    params![
                        hash,
                        name,
                        person,
                        role.name(),
                        words.join(" "),
                        now_s,
                        now_s + i64::from(expires_days) * 86_400
                    ],
                )
                .map_err(sql())?;
            Ok(transaction.last_insert_rowid())
        })?;
        let known = self.known();
        let made = known.tokens.get(&hash).ok_or_else(|| no_token(&id.to_string()))?;
        Ok((token_of(made), secret))
    }

    /// The tokens of `person`, or everybody's, oldest first.
    pub fn tokens(&self, person: Option<&str>) -> Vec<Token> {
        let known = self.known();
        let theirs = known.tokens.values().filter(|token| person.is_none_or(|person| token.person == person));
        let mut tokens: Vec<Token> = theirs.map(token_of).collect();
        tokens.sort_by_key(|token| token.id);
        tokens
    }

    /// Revokes the token `id`, of `person` if one is named; it is good for nothing from now on.
    pub fn revoke(&self, id: u64, person: Option<&str>) -> Result<(), PeopleError> {
        let sql = || PeopleError::sql("revoke a token");
        let row = i64::try_from(id).map_err(|_| no_token(&id.to_string()))?;
        self.change("revoke a token", |transaction| {
            let revoked = transaction
                .execute(
                    "DELETE FROM tokens WHERE id = ?1 AND (?2 IS NULL OR person = ?2)",
                    params![row, person],
                )
                .map_err(sql())?;
            if revoked == 0 { Err(no_token(&id.to_string())) } else { Ok(()) }
        })
    }

    /// Who shows this. It waits for no disk and for nobody who writes. A secret that is not known may have been made by
    /// another process just now, so the count of changes is looked at then, not more often than ten times a second.
    pub fn authenticate(&self, presented: Presented<'_>, now_s: i64) -> Result<Principal, Denied> {
        let found = self.find(presented, now_s);
        if found == Err(Denied::Unknown) && self.learns_more() {
            return self.find(presented, now_s);
        }
        found
    }

    /// Whether there was something to learn that another process changed.
    fn learns_more(&self) -> bool {
        {
            let mut looked = self.looked.lock().unwrap_or_else(PoisonError::into_inner);
            let (since, looks) =
                looked.filter(|(since, _)| since.elapsed() < LOOKS_WITHIN).unwrap_or((Instant::now(), 0));
            if looks >= MAX_LOOKS {
                return false;
            }
            *looked = Some((since, looks + 1));
        }
        let Ok(mut connection) = self.connection.try_lock() else { return false };
        tables::count(&connection).is_ok_and(|count| count != self.known().count)
            && self.learn(&mut connection).is_ok()
    }

    fn find(&self, presented: Presented<'_>, now_s: i64) -> Result<Principal, Denied> {
        match presented {
            Presented::Cookie(secret) => {
                self.of_login(&secret::hash_of_client(secret).ok_or(Denied::Unknown)?, now_s)
            }
            Presented::Bearer(secret) => {
                let hash = secret::hash_of_client(secret).ok_or(Denied::Unknown)?;
                let principal = self.of_token(&hash, now_s)?;
                self.used().insert(hash, now_s);
                Ok(principal)
            }
        }
    }

    /// Whether `principal` may still do what it might when it was authenticated.
    pub fn is_still_valid(&self, principal: &Principal, now_s: i64) -> bool {
        let now = match &principal.key {
            Key::Local => return true,
            Key::Login(hash) => self.of_login(hash, now_s),
            Key::Token(hash) => self.of_token(hash, now_s),
        };
        now.is_ok_and(|now| now.role >= principal.role)
    }

    /// Learns what other processes changed, and notes when tokens were used. To be called every second or so.
    pub fn refresh(&self, now_s: i64) -> Result<(), PeopleError> {
        let sql = || PeopleError::sql("look after people");
        let mut connection = self.connection();
        if tables::count(&connection).map_err(sql())? != self.known().count {
            self.learn(&mut connection)?;
        }
        let known = self.known();
        let is_new = |hash: &Hash, used_s: i64| {
            let noted_s = known.tokens.get(hash).map(|token| token.last_used_s.unwrap_or(i64::MIN));
            noted_s.is_some_and(|noted_s| used_s.saturating_sub(noted_s) >= USED_RESOLUTION_S)
        };
        let used: Vec<(Hash, i64)> = std::mem::take(&mut *self.used())
            .into_iter()
            .filter(|&(hash, used_s)| used_s <= now_s && is_new(&hash, used_s))
            .collect();
        if !used.is_empty() {
            tables::note_used(&mut connection, &used).map_err(sql())?;
            self.learn(&mut connection)?;
        }
        Ok(())
    }

    fn of_login(&self, hash: &Hash, now_s: i64) -> Result<Principal, Denied> {
        let known = self.known();
        let login = known.logins.get(hash).ok_or(Denied::Unknown)?;
        let person = known.people.get(&login.person).ok_or(Denied::Unknown)?;
        if login.expires_s <= now_s {
            return Err(Denied::Expired);
        }
        Ok(Principal {
            name: person.name.as_str().into(),
            role: person.role,
            scopes: Scope::ALL.into(),
            token: None,
            expires_s: Some(login.expires_s),
            key: Key::Login(*hash),
        })
    }

    fn of_token(&self, hash: &Hash, now_s: i64) -> Result<Principal, Denied> {
        let known = self.known();
        let token = known.tokens.get(hash).ok_or(Denied::Unknown)?;
        let person = known.people.get(&token.person).ok_or(Denied::Unknown)?;
        if token.expires_s <= now_s {
            return Err(Denied::Expired);
        }
        Ok(Principal {
            name: person.name.as_str().into(),
            role: token.role.min(person.role),
            scopes: token.scopes.iter().copied().collect(),
            token: Some(token.name.as_str().into()),
            expires_s: Some(token.expires_s),
            key: Key::Token(*hash),
        })
    }

    fn person(&self, name: &str) -> Result<Person, PeopleError> {
        self.known().people.get(name).map(person_of).ok_or_else(|| PeopleError::no_person(name))
    }

    fn change<T>(
        &self,
        action: &'static str,
        change: impl FnOnce(&rusqlite::Transaction<'_>) -> Result<T, PeopleError>,
    ) -> Result<T, PeopleError> {
        let mut connection = self.connection();
        let done = tables::change(&mut connection, action, change)?;
        self.learn(&mut connection)?;
        Ok(done)
    }

    fn learn(&self, connection: &mut Connection) -> Result<(), PeopleError> {
        let known = Arc::new(read(connection)?);
        *self.known.write().unwrap_or_else(PoisonError::into_inner) = known;
        Ok(())
    }

    fn known(&self) -> Arc<Known> {
        self.known.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn connection(&self) -> MutexGuard<'_, Connection> {
        self.connection.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn used(&self) -> MutexGuard<'_, HashMap<Hash, i64>> {
        self.used.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn read(connection: &mut Connection) -> Result<Known, PeopleError> {
    tables::read(connection).map(Known::from).map_err(PeopleError::sql("read people"))
}

/// Names are plain, so that no two look alike in the audit log.
fn check_name(name: &str) -> Result<(), PeopleError> {
    let is_plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit();
    let begins_well = name.bytes().next().is_some_and(is_plain);
    let is_named = begins_well
        && name.len() <= 32
        && name.bytes().all(|byte| is_plain(byte) || matches!(byte, b'.' | b'-' | b'_'));
    // Names by which the audit log means no person.
    let is_taken = ["station", "local", "nobody", "somebody"].contains(&name);
    if is_named && !is_taken {
        return Ok(());
    }
    Err(PeopleError::Argument(format!(
        "{name:?} cannot be the name of a person; expected 1 to 32 of a-z, 0-9, dot, dash and underscore, beginning with a \
         letter or digit, and none of station, local, nobody, somebody"
    )))
}

fn last_admin(name: &str) -> PeopleError {
    PeopleError::Conflict(format!("{name:?} is the last admin; make somebody else admin first"))
}

fn no_token(id: &str) -> PeopleError {
    PeopleError::NotFound { what: "token", id: id.to_owned(), hint: "`palpate tokens list` lists them" }
}

fn person_of(row: &PersonRow) -> Person {
    Person {
        name: row.name.clone(),
        role: row.role,
        created: rfc3339(row.created_s),
        last_login: row.last_login_s.map(rfc3339),
    }
}

fn token_of(row: &TokenRow) -> Token {
    Token {
        id: row.id.unsigned_abs(),
        name: row.name.clone(),
        person: row.person.clone(),
        role: row.role,
        scopes: row.scopes.clone(),
        created: rfc3339(row.created_s),
        expires: rfc3339(row.expires_s),
        last_used: row.last_used_s.map(rfc3339),
    }
}

#[cfg(test)]
mod tests;
