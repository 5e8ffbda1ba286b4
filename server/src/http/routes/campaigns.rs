//! Campaigns: trials of policies, scored by people.

use std::sync::Arc;

use axum::{
    Json,
    extract::{FromRequestParts, State},
    http::{StatusCode, header, request::Parts},
    response::{IntoResponse, Response},
};
use palpate_people::Principal;
use palpate_trials::{Campaigns, Format, TrialsError, Viewer, render};
use palpate_wire::api::{
    Campaign, CampaignPlan, CampaignResults, CampaignSummary, Role, ScoreBack, ScoreRequest, TrialEnd,
};
use serde::Deserialize;

use crate::{
    AppState, Error,
    data::files,
    http::{
        documented::Refusal,
        extract::{Asking, Body, Ids, Params, Peer},
        problem::{Answer, Problem},
    },
    hub::List,
    work::Kind,
};

/// How somebody wants to look at a campaign.
#[derive(Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct View {
    /// Their name, where nobody logs in.
    #[serde(default)]
    scorer: String,
    /// As a scorer, whom a blind campaign tells nothing that they are not to know.
    #[serde(default)]
    as_scorer: bool,
}

/// Who looks or acts.
pub(super) struct Who {
    principal: Principal,
    peer: Arc<str>,
}

impl FromRequestParts<Arc<AppState>> for Who {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, state: &Arc<AppState>) -> Result<Self, Response> {
        let Asking(principal) = Asking::from_request_parts(parts, state).await?;
        let Ok(Peer(peer)) = Peer::from_request_parts(parts, state).await;
        Ok(Self { principal, peer })
    }
}

impl Who {
    /// A login's own name counts before the `given` one, and who is no operator sees what scorers see.
    fn viewer(&self, given: &str, as_scorer: bool) -> Viewer {
        let name = match (self.principal.is_local(), given.trim()) {
            (false, _) => self.principal.name().to_string(),
            // The address without the port, which is another one for each connection.
            (true, "") => self.peer.rsplit_once(':').map_or(&*self.peer, |(address, _)| address).to_owned(),
            (true, given) => given.to_owned(),
        };
        Viewer { name, is_scorer: as_scorer || self.principal.role() < Role::Operator }
    }

    /// As nothing else is said.
    pub(super) fn operator(&self) -> Viewer {
        self.viewer("", false)
    }
}

/// Lists campaigns, newest first.
#[utoipa::path(
    get,
    path = "/campaigns",
    tag = "campaigns",
    responses((status = 200, description = "Done.", body = Vec<CampaignSummary>)),
)]
pub(super) async fn list(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<CampaignSummary>>> {
    state.run(Kind::Read, move |state| Ok(Json(state.campaigns().list()?))).await
}

/// Makes a campaign; its id is made from its name.
#[utoipa::path(
    post,
    path = "/campaigns",
    tag = "campaigns",
    request_body = CampaignPlan,
    responses(
        (status = 201, description = "Done.", body = Campaign,
            headers(("Location" = String, description = "Path of the campaign"))),
        Refusal<409>,
    ),
)]
pub(super) async fn create(
    State(state): State<Arc<AppState>>,
    who: Who,
    Body(plan): Body<CampaignPlan>,
) -> Answer<Response> {
    let campaign = state
        .run(Kind::Read, move |state| {
            let id = files::slug(&plan.name)?;
            let campaign = state.campaigns().create(&id, plan, &who.operator())?;
            state.hub().publish_changed(List::Campaigns, &id);
            Ok(campaign)
        })
        .await?;
    let location = [(header::LOCATION, format!("/api/v1/campaigns/{}", campaign.summary.id))];
    Ok((StatusCode::CREATED, location, Json(campaign)).into_response())
}

/// Answers with a campaign: plan, trials, scores, and whose turn it is.
#[utoipa::path(
    get,
    path = "/campaigns/{campaign}",
    tag = "campaigns",
    params(View),
    responses((status = 200, description = "Done.", body = Campaign), Refusal<404>, Refusal<422>),
)]
pub(super) async fn detail(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Params(view): Params<View>,
    who: Who,
) -> Answer<Json<Campaign>> {
    let viewer = who.viewer(&view.scorer, view.as_scorer);
    state.run(Kind::Read, move |state| Ok(Json(state.campaigns().campaign(&id, &viewer)?))).await
}

/// Answers with what the verdicts say: rates with intervals, failures, comparisons, agreement.
#[utoipa::path(
    get,
    path = "/campaigns/{campaign}/results",
    tag = "campaigns",
    params(View),
    responses((status = 200, description = "Done.", body = CampaignResults), Refusal<404>, Refusal<409>, Refusal<422>),
)]
pub(super) async fn results(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Params(view): Params<View>,
    who: Who,
) -> Answer<Json<CampaignResults>> {
    let viewer = who.viewer(&view.scorer, view.as_scorer);
    state.run(Kind::Compute, move |state| Ok(Json(state.campaigns().results(&id, &viewer)?))).await
}

/// Answers with the results as a file, `results.csv`, `results.tex`, `results.txt` or `results.svg`, or with every attempt,
/// `trials.csv`.
#[utoipa::path(
    get,
    path = "/campaigns/{campaign}/tables/{file}",
    tag = "campaigns",
    params(View),
    responses(
        (status = 200, description = "Done, in the format that the name of the file says.", content(
            (String = "text/plain"),
            (String = "text/csv"),
            (String = "application/x-tex"),
            (String = "image/svg+xml"),
        )),
        Refusal<404>, Refusal<409>, Refusal<422>,
    ),
)]
pub(super) async fn table(
    State(state): State<Arc<AppState>>,
    Ids((id, file)): Ids<(String, String)>,
    Params(view): Params<View>,
    who: Who,
) -> Answer<Response> {
    let viewer = who.viewer(&view.scorer, view.as_scorer);
    let format = file.strip_prefix("results.").and_then(Format::from_ending);
    let (format, text) = match format {
        Some(format) => {
            let render =
                move |state: &AppState| Ok(render(&state.campaigns().results(&id, &viewer)?, format)?);
            (format, state.run(Kind::Compute, render).await?)
        }
        None if file == "trials.csv" => {
            let trials = move |state: &AppState| Ok(state.campaigns().trials_csv(&id, &viewer)?);
            (Format::Csv, state.run(Kind::Read, trials).await?)
        }
        None => {
            let hint = "expected results.txt, results.csv, results.tex, results.svg or trials.csv";
            return Err(Problem(Error::NotFound { what: "table", id: file, hint }));
        }
    };
    Ok(([(header::CONTENT_TYPE, format.media_type())], text).into_response())
}

/// Begins a trial: its object is placed.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/trials/{trial}/begin",
    tag = "campaigns",
    responses((status = 200, description = "Done.", body = Campaign), Refusal<404>, Refusal<409>, Refusal<422>),
)]
pub(super) async fn begin(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    who: Who,
) -> Answer<Json<Campaign>> {
    change(&state, id, move |campaigns, id| campaigns.begin(id, trial, &who.operator())).await
}

/// Ends a trial with what its rollout says.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/trials/{trial}/outcome",
    tag = "campaigns",
    request_body = TrialEnd,
    responses((status = 200, description = "Done.", body = Campaign), Refusal<404>, Refusal<409>),
)]
pub(super) async fn outcome(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    who: Who,
    Body(end): Body<TrialEnd>,
) -> Answer<Json<Campaign>> {
    let take = end.outcome.take.clone();
    let ended = change(&state, id, move |campaigns, id| {
        campaigns.end(id, (trial, end.attempt), &end.outcome, &who.operator())
    })
    .await?;
    // Its take was recorded meanwhile, which pages that show the session's list have not heard of.
    if let Some((session, _)) = take.as_deref().and_then(|take| take.split_once('/')) {
        state.hub().publish_changed(List::Sessions, session);
    }
    Ok(ended)
}

/// Gives a trial a verdict.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/trials/{trial}/score",
    tag = "campaigns",
    params(View),
    request_body = ScoreRequest,
    responses((status = 200, description = "Done.", body = Campaign), Refusal<404>, Refusal<409>),
)]
pub(super) async fn score(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    Params(view): Params<View>,
    who: Who,
    Body(request): Body<ScoreRequest>,
) -> Answer<Json<Campaign>> {
    let viewer = who.viewer(&request.scorer, view.as_scorer);
    change(&state, id, move |campaigns, id| campaigns.score(id, trial, &request, &viewer)).await
}

/// Takes a verdict back.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/trials/{trial}/unscore",
    tag = "campaigns",
    params(View),
    request_body = ScoreBack,
    responses((status = 200, description = "Done.", body = Campaign), Refusal<404>, Refusal<409>),
)]
pub(super) async fn unscore(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    Params(view): Params<View>,
    who: Who,
    Body(back): Body<ScoreBack>,
) -> Answer<Json<Campaign>> {
    let viewer = who.viewer(&back.scorer, view.as_scorer);
    change(&state, id, move |campaigns, id| campaigns.unscore(id, (trial, back.attempt), &viewer)).await
}

/// Decides on a trial on which scorers differ.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/trials/{trial}/settle",
    tag = "campaigns",
    request_body = ScoreRequest,
    responses((status = 200, description = "Done.", body = Campaign), Refusal<404>, Refusal<409>),
)]
pub(super) async fn settle(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    who: Who,
    Body(request): Body<ScoreRequest>,
) -> Answer<Json<Campaign>> {
    let viewer = who.viewer(&request.scorer, false);
    change(&state, id, move |campaigns, id| campaigns.settle(id, trial, &request, &viewer)).await
}

/// Writes routes that lead a campaign to another state.
macro_rules! step_routes {
    ($($(#[$doc:meta])+ $step:ident,)+) => {$(
        $(#[$doc])+
        #[utoipa::path(
            post,
            path = concat!("/campaigns/{campaign}/", stringify!($step)),
            tag = "campaigns",
            responses((status = 200, description = "Done.", body = Campaign), Refusal<404>, Refusal<409>, Refusal<422>),
        )]
        pub(super) async fn $step(
            State(state): State<Arc<AppState>>,
            Ids(id): Ids<String>,
            who: Who,
        ) -> Answer<Json<Campaign>> {
            change(&state, id, move |campaigns, id| campaigns.$step(id, &who.operator())).await
        }
    )+};
}

step_routes! {
    /// Pauses a campaign: no trial begins until it is resumed; the one that runs goes on to its end.
    pause,
    /// Goes on with a paused campaign.
    resume,
    /// Closes a campaign: no trial is made any more, and a blind one is open to everybody.
    close,
    /// Goes on with a closed campaign, unless it was blind.
    reopen,
}

/// Changes campaign `id`, and tells everybody.
async fn change(
    state: &Arc<AppState>,
    id: String,
    work: impl FnOnce(&Campaigns, &str) -> Result<Campaign, TrialsError> + Send + 'static,
) -> Answer<Json<Campaign>> {
    state
        .run(Kind::Read, move |state| {
            let campaign = work(state.campaigns(), &id)?;
            state.hub().publish_changed(List::Campaigns, &id);
            Ok(Json(campaign))
        })
        .await
}
