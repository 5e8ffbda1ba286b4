//! Who makes a request, and whether they may.
//!
//! The door finds out who asks, for every request; each route then looks whether that is enough ([`allow`]), by the table
//! that it is made from. A cookie counts only for requests that the studio's own page or a person's click makes.

use std::{
    net::{IpAddr, SocketAddr},
    sync::Arc,
    time::Duration,
};

use axum::{
    extract::{ConnectInfo, Request, State},
    http::{HeaderMap, HeaderValue, Method, header},
    middleware::Next,
    response::{Html, IntoResponse as _, Redirect, Response},
};
use palpate_people::{Denied, People, Presented, Principal, now_s};

use super::{
    problem::problem,
    route::{Needs, NeedsLease},
};
use crate::AppState;
use palpate_wire::api::{ProblemType, Role, Scope};

/// The cookie of a login. Browsers take one of this name only from this very host, over TLS, for all paths.
const COOKIE: &str = "__Host-palpate";
/// A socket of whoever may not any more is closed after this long.
const LOOK_AGAIN: Duration = Duration::from_secs(1);
/// Longest request that the audit log shows, characters.
const MAX_SHOWN: usize = 200;

/// Who asks, as far as that is known.
#[derive(Clone, Debug)]
pub(crate) struct Shown(pub(crate) Result<Principal, Denied>);

/// Where a request comes from.
#[derive(Clone, Debug)]
pub(crate) struct Client {
    /// The address, if it is known.
    pub(crate) address: Option<IpAddr>,
    /// In words.
    pub(crate) text: String,
}

impl Client {
    /// Where `request` comes from. A proxy appends the address that it knows to `X-Forwarded-For`, so the last counts.
    pub(crate) fn of(request: &Request, behind_proxy: bool) -> Self {
        let peer = request.extensions().get::<ConnectInfo<SocketAddr>>().map(|info| info.0);
        let forwarded = request.headers().get_all("x-forwarded-for").iter().next_back();
        let forwarded = forwarded.filter(|_| behind_proxy).and_then(|value| {
            let last = value.to_str().ok()?.rsplit(',').next()?.trim();
            last.parse::<IpAddr>().ok()
        });
        match (forwarded, peer) {
            (Some(address), _) => Self { address: Some(address), text: address.to_string() },
            (None, Some(peer)) => Self { address: Some(peer.ip()), text: peer.to_string() },
            (None, None) => Self { address: None, text: "an unknown address".to_owned() },
        }
    }
}

/// Who sends these headers, or shows `query_token` where there is no header for it.
pub(crate) fn identify(
    people: &People,
    headers: &HeaderMap,
    query_token: Option<&str>,
) -> Result<Principal, Denied> {
    let now_s = now_s();
    let mut bearers = headers.get_all(header::AUTHORIZATION).iter().filter_map(|value| {
        let (scheme, secret) = value.to_str().ok()?.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then(|| secret.trim())
    });
    match (bearers.next(), bearers.next()) {
        (Some(secret), None) => return people.authenticate(Presented::Bearer(secret), now_s),
        (Some(_), Some(_)) => return Err(Denied::Unknown),
        (None, _) => {}
    }
    if let Some(secret) = query_token {
        return people.authenticate(Presented::Bearer(secret), now_s);
    }
    let is_foreign = headers
        .get("sec-fetch-site")
        .is_some_and(|site| !matches!(site.as_bytes(), b"same-origin" | b"none"));
    match cookie(headers).filter(|_| !is_foreign) {
        Some(secret) => people.authenticate(Presented::Cookie(secret), now_s),
        None => Err(Denied::Missing),
    }
}

/// The value of the login's cookie.
fn cookie(headers: &HeaderMap) -> Option<&str> {
    let values = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut cookies =
        values.flat_map(|value| value.split(';')).filter_map(|cookie| cookie.trim().split_once('='));
    cookies.find(|(name, _)| *name == COOKIE).map(|(_, value)| value)
}

/// The header that gives a browser the cookie of a login for `lasts_s`, or takes it away with no secret.
pub(crate) fn set_cookie(secret: &str, lasts_s: i64) -> Option<HeaderValue> {
    let text = format!("{COOKIE}={secret}; Path=/; Max-Age={lasts_s}; Secure; HttpOnly; SameSite=Strict");
    HeaderValue::from_str(&text).ok()
}

/// What a route asks of whoever comes.
#[derive(Clone)]
pub(crate) struct Gate {
    pub(crate) state: Arc<AppState>,
    pub(crate) needs: Needs,
}

/// What keeps `principal` from what needs this `role` and `scope`, if anything does.
pub(crate) fn lack(principal: &Principal, role: Role, scope: Scope) -> Option<String> {
    if principal.may(role, scope) {
        return None;
    }
    Some(match principal.role() >= role {
        true => format!(
            "{} is not good for {scope:?}, which this needs; make a token with that scope",
            principal.label(),
            scope = scope.name()
        ),
        false => format!(
            "{} may do what a {} may, and this needs the role of {role}; ask an admin",
            principal.label(),
            principal.role()
        ),
    })
}

/// Lets a request through to its route, if whoever makes it may; notes what was changed, and by whom.
pub(crate) async fn allow(State(gate): State<Arc<Gate>>, request: Request, next: Next) -> Response {
    let Needs { role, scope, lease } = gate.needs;
    let Some(role) = role else { return next.run(request).await };
    let shown =
        request.extensions().get::<Shown>().map_or(Err(Denied::Missing), |Shown(shown)| shown.clone());
    let principal = match shown {
        Ok(principal) => principal,
        Err(denied) => return unknown(denied),
    };
    if let Some(detail) = lack(&principal, role, scope) {
        return problem(ProblemType::NotPermitted, &detail);
    }
    // The control loop notes what needs a lease, and people's routes say what they do in words.
    let is_noted = !matches!(*request.method(), Method::GET | Method::HEAD)
        && lease == NeedsLease::No
        && scope != Scope::People;
    let note = is_noted.then(|| {
        let path = request.uri().path_and_query().map_or("", |path| path.as_str());
        let what: String = format!("{} {path}", request.method()).chars().take(MAX_SHOWN).collect();
        let from =
            request.extensions().get::<Client>().map_or_else(String::new, |client| client.text.clone());
        (what, format!("http from {from}"))
    });
    let response = next.run(request).await;
    if let Some((what, connection)) = note.filter(|_| response.status().is_success()) {
        gate.state.audit().note(&principal.label(), &connection, &what);
    }
    response
}

/// The answer to a request of whoever is not known.
fn unknown(denied: Denied) -> Response {
    let mut response = problem(ProblemType::NotLoggedIn, &denied.to_string());
    response
        .headers_mut()
        .insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer realm=\"palpate\""));
    response
}

/// A page that loads itself again: a browser sends the cookie then, which it keeps back on the way from another site.
const AGAIN: &str = "<!doctype html><html lang=\"en\"><meta http-equiv=\"refresh\" content=\"0; url=/\"><title>Palpate</title>\
    <p><a href=\"/\">Open the studio</a></p></html>";

/// Sends whoever has to log in to the login page instead of the studio's.
pub(crate) async fn page_needs_login(
    State(state): State<Arc<AppState>>,
    request: Request,
    next: Next,
) -> Response {
    let is_page = matches!(request.uri().path(), "/" | "/index.html");
    let is_known = request.extensions().get::<Shown>().is_some_and(|Shown(shown)| shown.is_ok());
    if !is_page || is_known || !state.access().login {
        return next.run(request).await;
    }
    let site = request.headers().get("sec-fetch-site").map(HeaderValue::as_bytes);
    let mut response = match site {
        Some(b"cross-site" | b"same-site") => Html(AGAIN).into_response(),
        _ => Redirect::to("/login").into_response(),
    };
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}

/// Completes when `principal` may not do any more what it may now: its login or token ended, or its role was taken away.
pub(crate) async fn no_longer_valid(people: Arc<People>, principal: Principal) {
    if principal.is_local() {
        return std::future::pending().await;
    }
    while people.is_still_valid(&principal, now_s()) {
        tokio::time::sleep(LOOK_AGAIN).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cookies_are_found_among_others_by_their_whole_name() {
        let headers = |values: &[&str]| {
            let pairs = values.iter().map(|value| (header::COOKIE, HeaderValue::from_str(value).unwrap()));
            pairs.collect::<HeaderMap>()
        };
        let found = |values: &[&str]| cookie(&headers(values)).map(str::to_owned);
        assert_eq!(found(&["a=b; __Host-palpate=xyz; c=d"]).as_deref(), Some("xyz"));
        assert_eq!(found(&["a=b", "__Host-palpate=xyz"]).as_deref(), Some("xyz"));
        for none in ["palpate=xyz", "x__Host-palpate=xyz", "__Host-palpate2=xyz", "__Host-palpate", ""] {
            assert_eq!(found(&[none]), None, "{none}");
        }
    }

    #[test]
    fn an_address_that_a_client_invents_counts_for_nothing() {
        let request = |forwarded: &[&str]| {
            let mut request = Request::new(axum::body::Body::empty());
            for value in forwarded {
                request.headers_mut().append("x-forwarded-for", HeaderValue::from_str(value).unwrap());
            }
            request.extensions_mut().insert(ConnectInfo(SocketAddr::from(([10, 0, 0, 1], 4000))));
            request
        };
        let address = |forwarded: &[&str], behind_proxy| Client::of(&request(forwarded), behind_proxy).text;
        assert_eq!(address(&["1.2.3.4"], false), "10.0.0.1:4000");
        assert_eq!(address(&["6.6.6.6, 1.2.3.4"], true), "1.2.3.4");
        assert_eq!(address(&["6.6.6.6", "1.2.3.4"], true), "1.2.3.4");
        assert_eq!(address(&["rubbish"], true), "10.0.0.1:4000");
        assert_eq!(address(&[], true), "10.0.0.1:4000");
    }
}
