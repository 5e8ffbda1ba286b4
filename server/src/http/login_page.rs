//! The login page: plain HTML, before the studio's page is loaded.

use std::sync::Arc;

use axum::{
    Form,
    extract::{Extension, State},
    http::{HeaderValue, StatusCode, header},
    response::{Html, IntoResponse as _, Redirect, Response},
};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use palpate_wire::api::Login;

use super::{
    identity::{Client, Shown, set_cookie},
    problem::Problem,
    routes::people::check_login,
};
use crate::{AppState, chain};

/// What the login page may load and do. Its form goes nowhere else.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; form-action 'self'; \
    frame-ancestors 'none'; base-uri 'none'";

const STYLE: &str = "
:root { color-scheme: light dark; }
body { font: 1rem/1.5 system-ui, sans-serif; margin: 15vh auto 0; max-width: 20rem; padding: 0 1rem; }
h1 { font-size: 1.4rem; }
label { display: block; margin-top: 1rem; }
input, button { box-sizing: border-box; font: inherit; padding: .5rem; width: 100%; }
button { margin-top: 1.5rem; }
[role=alert] { border-left: 4px solid #c33; padding-left: .75rem; }
";

/// `GET /login`.
pub(super) async fn show(
    State(state): State<Arc<AppState>>,
    Extension(Shown(shown)): Extension<Shown>,
) -> Response {
    match shown.is_ok() || !state.access().login {
        true => Redirect::to("/").into_response(),
        false => page(StatusCode::OK, "", ""),
    }
}

/// `POST /login`: the form.
pub(super) async fn log_in(
    State(state): State<Arc<AppState>>,
    Extension(client): Extension<Client>,
    Form(login): Form<Login>,
) -> Response {
    let name = login.name.clone();
    match check_login(&state, &client, login).await {
        Ok(login) => {
            let mut response = Redirect::to("/").into_response();
            if let Some(cookie) = set_cookie(&login.secret, login.lasts_s) {
                response.headers_mut().insert(header::SET_COOKIE, cookie);
            }
            response
        }
        Err(err) => {
            let problem = Problem(err);
            page(problem.status(), &name, &chain(&problem.0))
        }
    }
}

/// `POST /logout`: the way out for whoever has no script.
pub(super) async fn log_out(
    State(state): State<Arc<AppState>>,
    Extension(Shown(shown)): Extension<Shown>,
) -> Response {
    if let Ok(principal) = shown
        && let Err(err) = state.people().log_out(&principal)
    {
        return Problem(err.into()).into_response();
    }
    let mut response = Redirect::to("/login").into_response();
    if let Some(cookie) = set_cookie("", 0) {
        response.headers_mut().insert(header::SET_COOKIE, cookie);
    }
    response
}

/// `GET /logout`: says who is logged in, with a button to end that.
pub(super) async fn ask_to_log_out(
    State(state): State<Arc<AppState>>,
    Extension(Shown(shown)): Extension<Shown>,
) -> Response {
    let principal = match shown {
        Ok(principal) if state.access().login => principal,
        _ => return Redirect::to("/").into_response(),
    };
    let main = html! {
        p { "You are " (principal.name()) " (" (principal.role()) ")." }
        form method="post" action="/logout" { button type="submit" autofocus { "Log out" } }
        p { a href="/" { "Back to the studio" } }
    };
    document(StatusCode::OK, "Log out", &main)
}

fn page(status: StatusCode, name: &str, problem: &str) -> Response {
    let has_problem = !problem.is_empty();
    // The first field that is empty gets the keyboard.
    let is_named = !name.is_empty();
    let main = html! {
        @if has_problem { p #problem role="alert" { (problem) "." } }
        form method="post" action="/login" {
            label for="name" { "Name" }
            input #name name="name" value=(name) autocomplete="username" autocapitalize="none" spellcheck="false" required
                autofocus[!is_named];
            label for="password" { "Password" }
            input #password name="password" type="password" autocomplete="current-password" required
                aria-describedby=[has_problem.then_some("problem")] autofocus[is_named];
            button type="submit" { "Log in" }
        }
        p { small { "An admin of this studio gives names and passwords (" code { "palpate people add" } ")." } }
    };
    document(status, "Log in", &main)
}

fn document(status: StatusCode, title: &str, main: &Markup) -> Response {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) " - Palpate" }
                style { (PreEscaped(STYLE)) }
            }
            body { main { h1 { "Palpate" } (main) } }
        }
    };
    let mut response = (status, Html(page.into_string())).into_response();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        // Without a referrer browsers would not say that the form comes from here.
        (header::REFERRER_POLICY, "same-origin"),
        (header::CACHE_CONTROL, "no-store"),
    ] {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}
