//! People, logins and tokens.

use std::sync::Arc;

use axum::{
    Json,
    extract::{Extension, State},
    http::{StatusCode, header},
    response::{IntoResponse as _, Response},
};
use palpate_people::{LoggedIn, PeopleError, Principal, TokenRequest, now_s};
use palpate_wire::api::{
    CreatedToken, Login, Me, NewPerson, NewToken, PasswordChange, Person, PersonChanges, Role, Scope, Token,
    Via,
};

use crate::{
    AppState, Error,
    http::{
        documented::Refusal,
        extract::{Asking, Body, Ids, Peer},
        identity::{Client, Shown, set_cookie},
        problem::{Answer, Problem},
    },
    work::Kind,
};

/// Days that a token is good for without a word.
const TOKEN_DAYS: u32 = 90;
/// Of a name that somebody tried to log in with, so many characters are shown.
const MAX_SHOWN_NAME: usize = 40;

/// Logs in: the answer sets the cookie of the login.
#[utoipa::path(
    post,
    path = "/login",
    tag = "people",
    request_body = Login,
    responses((status = 200, description = "Done.", body = Me), Refusal<401>, Refusal<409>),
)]
pub(super) async fn log_in(
    State(state): State<Arc<AppState>>,
    Extension(client): Extension<Client>,
    Body(login): Body<Login>,
) -> Answer<Response> {
    let login = check_login(&state, &client, login).await.map_err(Problem)?;
    let mut response = Json(login.principal.me()).into_response();
    if let Some(cookie) = set_cookie(&login.secret, login.lasts_s) {
        response.headers_mut().insert(header::SET_COOKIE, cookie);
    }
    Ok(response)
}

/// Logs somebody in, if they have not tried too often.
pub(in crate::http) async fn check_login(
    state: &Arc<AppState>,
    client: &Client,
    login: Login,
) -> Result<LoggedIn, Error> {
    if !state.access().login {
        return Err(Error::Conflict("this studio has no login: whoever reaches it may use it".to_owned()));
    }
    let Login { name, password } = login;
    let name = name.trim().to_owned();
    let shown: String = name.chars().take(MAX_SHOWN_NAME).collect();
    if let Err(after_s) = state.logins().take(&name, client.address, now_s()) {
        tracing::warn!(name = shown, from = client.text, "too many attempts to log in");
        let after_s = after_s.unsigned_abs();
        return Err(Error::TooOften { what: "there were too many attempts to log in", after_s });
    }
    let address = client.address;
    let (account, shared) = (name.clone(), state.clone());
    let attempt = move || {
        let login = shared.people().log_in(&account, &password, now_s())?;
        shared.logins().succeeded(&account, address);
        Ok(login)
    };
    let attempt = state.work().run(Kind::Compute, attempt).await;
    let connection = format!("http from {}", client.text);
    match &attempt {
        Ok(login) => state.audit().note(&login.principal.label(), &connection, "logged in"),
        Err(Error::People(PeopleError::WrongLogin)) => {
            state.audit().note("somebody", &connection, &format!("failed to log in as {shown:?}"));
        }
        Err(_) => {}
    }
    attempt
}

/// Ends the login of the cookie, and takes the cookie away.
#[utoipa::path(
    post,
    path = "/logout",
    tag = "people",
    responses((status = 204, description = "Done.")),
)]
pub(super) async fn log_out(
    State(state): State<Arc<AppState>>,
    Extension(Shown(shown)): Extension<Shown>,
) -> Answer<Response> {
    if let Ok(principal) = shown {
        state.run(Kind::Read, move |state| Ok(state.people().log_out(&principal)?)).await?;
    }
    let mut response = StatusCode::NO_CONTENT.into_response();
    if let Some(cookie) = set_cookie("", 0) {
        response.headers_mut().insert(header::SET_COOKIE, cookie);
    }
    Ok(response)
}

/// Says who asks, and what they may.
#[utoipa::path(
    get,
    path = "/me",
    tag = "people",
    responses((status = 200, description = "Done.", body = Me)),
)]
pub(super) async fn me(Asking(principal): Asking) -> Json<Me> {
    Json(principal.me())
}

/// Changes the password of whoever is logged in, and ends all their logins.
#[utoipa::path(
    post,
    path = "/me/password",
    tag = "people",
    request_body = PasswordChange,
    responses((status = 204, description = "Done."), Refusal<409>),
)]
pub(super) async fn change_own_password(
    State(state): State<Arc<AppState>>,
    Asking(principal): Asking,
    Extension(client): Extension<Client>,
    Peer(peer): Peer,
    Body(PasswordChange { old, new }): Body<PasswordChange>,
) -> Answer<StatusCode> {
    if principal.via() != Via::Session {
        return Err(Problem(Error::Conflict(
            "only somebody who is logged in with a name and password can change that password here"
                .to_owned(),
        )));
    }
    // Whoever sits at somebody else's screen must not try passwords for ever.
    state.logins().take(principal.name(), client.address, now_s()).map_err(|after_s| {
        Problem(Error::TooOften {
            what: "there were too many attempts to change the password",
            after_s: after_s.unsigned_abs(),
        })
    })?;
    let shared = state.clone();
    let change = move || {
        let name = principal.name();
        shared.people().verify(name, &old)?;
        shared.logins().succeeded(name, client.address);
        shared.people().set_password(name, &new)?;
        shared.audit().note(&principal.label(), &format!("http from {peer}"), "changed the own password");
        Ok(StatusCode::NO_CONTENT)
    };
    state.work().run(Kind::Compute, change).await.map_err(Problem)
}

/// Lists who may log in.
#[utoipa::path(
    get,
    path = "/people",
    tag = "people",
    responses((status = 200, description = "Done.", body = Vec<Person>)),
)]
pub(super) async fn list(State(state): State<Arc<AppState>>) -> Json<Vec<Person>> {
    Json(state.people().list())
}

/// Adds somebody who may log in.
#[utoipa::path(
    post,
    path = "/people",
    tag = "people",
    request_body = NewPerson,
    responses(
        (status = 201, description = "Done.", body = Person,
            headers(("Location" = String, description = "Path of the person"))),
        Refusal<409>,
    ),
)]
pub(super) async fn add(
    State(state): State<Arc<AppState>>,
    by: By,
    Body(NewPerson { name, role, password }): Body<NewPerson>,
) -> Answer<Response> {
    let shared = state.clone();
    let add = move || {
        let person = shared.people().add(&name, role, &password, now_s())?;
        by.note(&shared, &format!("added {name:?} as {role}"));
        Ok(person)
    };
    let person = state.work().run(Kind::Compute, add).await.map_err(Problem)?;
    let location = [(header::LOCATION, format!("/api/v1/people/{}", person.name))];
    Ok((StatusCode::CREATED, location, Json(person)).into_response())
}

/// Gives somebody another role or password, which ends their logins.
#[utoipa::path(
    patch,
    path = "/people/{person}",
    tag = "people",
    request_body = PersonChanges,
    responses((status = 200, description = "Done.", body = Person), Refusal<404>, Refusal<409>),
)]
pub(super) async fn change(
    State(state): State<Arc<AppState>>,
    Ids(name): Ids<String>,
    by: By,
    Body(PersonChanges { role, password }): Body<PersonChanges>,
) -> Answer<Json<Person>> {
    if role.is_none() && password.is_none() {
        return Err(Problem(Error::Argument(
            "nothing is to be changed; give a role or a password".to_owned(),
        )));
    }
    let shared = state.clone();
    let change = move || {
        let mut changed = None;
        // A password that is refused must not leave the role changed.
        if let Some(password) = password {
            changed = Some(shared.people().set_password(&name, &password)?);
            by.note(&shared, &format!("gave {name:?} another password"));
        }
        if let Some(role) = role {
            changed = Some(shared.people().set_role(&name, role)?);
            by.note(&shared, &format!("gave {name:?} the role of {role}"));
        }
        changed.ok_or_else(|| Error::Argument("nothing is to be changed".to_owned()))
    };
    state.work().run(Kind::Compute, change).await.map(Json).map_err(Problem)
}

/// Removes somebody with their logins and tokens.
#[utoipa::path(
    delete,
    path = "/people/{person}",
    tag = "people",
    responses((status = 204, description = "Done."), Refusal<404>, Refusal<409>),
)]
pub(super) async fn remove(
    State(state): State<Arc<AppState>>,
    Ids(name): Ids<String>,
    by: By,
) -> Answer<StatusCode> {
    let remove = move |state: &AppState| {
        state.people().remove(&name)?;
        by.note(state, &format!("removed {name:?}"));
        Ok(StatusCode::NO_CONTENT)
    };
    state.run(Kind::Read, remove).await
}

/// Lists one's own API tokens, and for an admin everybody's.
#[utoipa::path(
    get,
    path = "/tokens",
    tag = "people",
    responses((status = 200, description = "Done.", body = Vec<Token>)),
)]
pub(super) async fn tokens(
    State(state): State<Arc<AppState>>,
    Asking(principal): Asking,
) -> Json<Vec<Token>> {
    Json(state.people().tokens(theirs(&principal)))
}

/// Makes an API token. The answer shows its secret, this once.
#[utoipa::path(
    post,
    path = "/tokens",
    tag = "people",
    request_body = NewToken,
    responses(
        (status = 201, description = "Done.", body = CreatedToken,
            headers(("Location" = String, description = "Path of the token"))),
        Refusal<404>,
        Refusal<409>,
    ),
)]
pub(super) async fn create_token(
    State(state): State<Arc<AppState>>,
    Asking(principal): Asking,
    by: By,
    Body(request): Body<NewToken>,
) -> Answer<Response> {
    let NewToken { name, person, role, scopes, expires_days } = request;
    let person = match person {
        Some(person) => person,
        None if principal.is_local() => {
            return Err(Problem(Error::Argument(
                "say in whose name the token will act: there is no login here (\"person\")".to_owned(),
            )));
        }
        None => principal.name().to_string(),
    };
    if theirs(&principal).is_some_and(|own| own != person) {
        return Err(Problem(Error::NotPermitted(format!(
            "only an admin may make a token that acts in the name of {person:?}"
        ))));
    }
    // A token must not make one that may do more than itself.
    let is_own = person == **principal.name();
    let role = role.or_else(|| is_own.then(|| principal.role()));
    let exceeds_role = is_own && role.is_some_and(|role| role > principal.role());
    let exceeds_scopes = match (&scopes, principal.via()) {
        (_, Via::Local | Via::Session) => false,
        (Some(scopes), Via::Token) => !scopes.iter().all(|&scope| principal.may(Role::Viewer, scope)),
        (None, Via::Token) => !Scope::ALL.iter().all(|&scope| principal.may(Role::Viewer, scope)),
    };
    if exceeds_role || exceeds_scopes {
        return Err(Problem(Error::NotPermitted(format!(
            "{} cannot make a token that may do more than itself; name a role and scopes that it has",
            principal.label()
        ))));
    }
    let create = move |state: &AppState| {
        let request = TokenRequest {
            person: &person,
            name: &name,
            role,
            scopes: scopes.as_deref(),
            expires_days: expires_days.unwrap_or(TOKEN_DAYS),
        };
        let (token, secret) = state.people().create_token(&request, now_s())?;
        by.note(state, &format!("made token {} ({name:?}, {}) of {person:?}", token.id, token.role));
        Ok(CreatedToken { token, secret })
    };
    let created = state.run(Kind::Read, create).await?;
    let headers = [
        (header::LOCATION, format!("/api/v1/tokens/{}", created.token.id)),
        (header::CACHE_CONTROL, "no-store".to_owned()),
    ];
    Ok((StatusCode::CREATED, headers, Json(created)).into_response())
}

/// Revokes an API token: one's own, or as an admin anybody's.
#[utoipa::path(
    delete,
    path = "/tokens/{token}",
    tag = "people",
    responses((status = 204, description = "Done."), Refusal<404>),
)]
pub(super) async fn revoke_token(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<u64>,
    Asking(principal): Asking,
    by: By,
) -> Answer<StatusCode> {
    let revoke = move |state: &AppState| {
        state.people().revoke(id, theirs(&principal))?;
        by.note(state, &format!("revoked token {id}"));
        Ok(StatusCode::NO_CONTENT)
    };
    state.run(Kind::Read, revoke).await
}

/// Whose tokens somebody may see; `None` for everybody's.
fn theirs(principal: &Principal) -> Option<&str> {
    (principal.role() < Role::Admin).then(|| &**principal.name())
}

/// Whoever asks, for the audit log.
pub(super) struct By {
    who: String,
    connection: String,
}

impl By {
    fn note(&self, state: &AppState, what: &str) {
        state.audit().note(&self.who, &self.connection, what);
    }
}

impl<S: Send + Sync> axum::extract::FromRequestParts<S> for By {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut axum::http::request::Parts, state: &S) -> Result<Self, Response> {
        let Asking(principal) = Asking::from_request_parts(parts, state).await?;
        let client = parts.extensions.get::<Client>().map_or_else(String::new, |client| client.text.clone());
        Ok(Self { who: principal.label(), connection: format!("http from {client}") })
    }
}
