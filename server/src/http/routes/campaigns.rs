//! Campaigns: trials of policies, scored by people.

use std::sync::Arc;

use axum::{
    Json,
    extract::State,
    http::{StatusCode, header},
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
        document::Refusal,
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

/// Who looks or acts: a login's own name counts before the `given` one, and who is no operator sees what scorers see.
fn viewer(principal: &Principal, peer: &str, given: &str, as_scorer: bool) -> Viewer {
    let name = match (principal.is_local(), given.trim()) {
        (false, _) => principal.name().to_string(),
        // The address without the port, which is another one for each connection.
        (true, "") => peer.rsplit_once(':').map_or(peer, |(address, _)| address).to_owned(),
        (true, given) => given.to_owned(),
    };
    Viewer { name, is_scorer: as_scorer || principal.role() < Role::Operator }
}

/// Lists campaigns, newest first.
#[utoipa::path(
    get,
    path = "/campaigns",
    tag = "campaigns",
    responses(
        (status = 200, description = "Done.", body = Vec<CampaignSummary>),
    ),
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
        (status = 201, description = "Done.", body = Campaign),
        Refusal<409>,
        Refusal<413>,
        Refusal<415>,
        Refusal<422>,
    ),
)]
pub(super) async fn create(
    State(state): State<Arc<AppState>>,
    Asking(principal): Asking,
    Peer(peer): Peer,
    Body(plan): Body<CampaignPlan>,
) -> Answer<Response> {
    let campaign = state
        .run(Kind::Read, move |state| {
            let id = files::slug(&plan.name)?;
            let campaign = state.campaigns().create(&id, plan, &viewer(&principal, &peer, "", false))?;
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
    responses(
        (status = 200, description = "Done.", body = Campaign),
        Refusal<404>,
        Refusal<422>,
    ),
)]
pub(super) async fn detail(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Params(view): Params<View>,
    Asking(principal): Asking,
    Peer(peer): Peer,
) -> Answer<Json<Campaign>> {
    let viewer = viewer(&principal, &peer, &view.scorer, view.as_scorer);
    state.run(Kind::Read, move |state| Ok(Json(state.campaigns().campaign(&id, &viewer)?))).await
}

/// Answers with what the verdicts say: rates with intervals, failures, comparisons, agreement.
#[utoipa::path(
    get,
    path = "/campaigns/{campaign}/results",
    tag = "campaigns",
    params(View),
    responses(
        (status = 200, description = "Done.", body = CampaignResults),
        Refusal<404>,
        Refusal<409>,
        Refusal<422>,
    ),
)]
pub(super) async fn results(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Params(view): Params<View>,
    Asking(principal): Asking,
    Peer(peer): Peer,
) -> Answer<Json<CampaignResults>> {
    let viewer = viewer(&principal, &peer, &view.scorer, view.as_scorer);
    state.run(Kind::Compute, move |state| Ok(Json(state.campaigns().results(&id, &viewer)?))).await
}

/// Answers with the results as a file: `results.csv`, `results.tex`, `results.txt` or `results.svg`.
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
        Refusal<404>,
        Refusal<409>,
        Refusal<422>,
    ),
)]
pub(super) async fn table(
    State(state): State<Arc<AppState>>,
    Ids((id, file)): Ids<(String, String)>,
    Params(view): Params<View>,
    Asking(principal): Asking,
    Peer(peer): Peer,
) -> Answer<Response> {
    let format = file.strip_prefix("results.").and_then(Format::from_ending);
    let Some(format) = format else {
        let hint = "expected results.txt, results.csv, results.tex or results.svg";
        return Err(Problem(Error::NotFound { what: "table", id: file, hint }));
    };
    let viewer = viewer(&principal, &peer, &view.scorer, view.as_scorer);
    let text = state
        .run(Kind::Compute, move |state| Ok(render(&state.campaigns().results(&id, &viewer)?, format)?))
        .await?;
    Ok(([(header::CONTENT_TYPE, format.media_type())], text).into_response())
}

/// Begins a trial: its object is placed.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/trials/{trial}/begin",
    tag = "campaigns",
    responses(
        (status = 200, description = "Done.", body = Campaign),
        Refusal<404>,
        Refusal<409>,
        Refusal<422>,
    ),
)]
pub(super) async fn begin(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    Asking(principal): Asking,
    Peer(peer): Peer,
) -> Answer<Json<Campaign>> {
    change(&state, id, move |campaigns, id| campaigns.begin(id, trial, &viewer(&principal, &peer, "", false)))
        .await
}

/// Ends a trial with what its rollout says.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/trials/{trial}/outcome",
    tag = "campaigns",
    request_body = TrialEnd,
    responses(
        (status = 200, description = "Done.", body = Campaign),
        Refusal<404>,
        Refusal<409>,
        Refusal<413>,
        Refusal<415>,
        Refusal<422>,
    ),
)]
pub(super) async fn outcome(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    Asking(principal): Asking,
    Peer(peer): Peer,
    Body(end): Body<TrialEnd>,
) -> Answer<Json<Campaign>> {
    change(&state, id, move |campaigns, id| {
        campaigns.end(id, (trial, end.attempt), &end.outcome, &viewer(&principal, &peer, "", false))
    })
    .await
}

/// Gives a trial a verdict.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/trials/{trial}/score",
    tag = "campaigns",
    params(View),
    request_body = ScoreRequest,
    responses(
        (status = 200, description = "Done.", body = Campaign),
        Refusal<404>,
        Refusal<409>,
        Refusal<413>,
        Refusal<415>,
        Refusal<422>,
    ),
)]
pub(super) async fn score(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    Params(view): Params<View>,
    Asking(principal): Asking,
    Peer(peer): Peer,
    Body(request): Body<ScoreRequest>,
) -> Answer<Json<Campaign>> {
    let viewer = viewer(&principal, &peer, &request.scorer, view.as_scorer);
    change(&state, id, move |campaigns, id| campaigns.score(id, trial, &request, &viewer)).await
}

/// Takes a verdict back.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/trials/{trial}/unscore",
    tag = "campaigns",
    params(View),
    request_body = ScoreBack,
    responses(
        (status = 200, description = "Done.", body = Campaign),
        Refusal<404>,
        Refusal<409>,
        Refusal<413>,
        Refusal<415>,
        Refusal<422>,
    ),
)]
pub(super) async fn unscore(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    Params(view): Params<View>,
    Asking(principal): Asking,
    Peer(peer): Peer,
    Body(back): Body<ScoreBack>,
) -> Answer<Json<Campaign>> {
    let viewer = viewer(&principal, &peer, &back.scorer, view.as_scorer);
    change(&state, id, move |campaigns, id| campaigns.unscore(id, (trial, back.attempt), &viewer)).await
}

/// Decides on a trial on which scorers differ.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/trials/{trial}/settle",
    tag = "campaigns",
    request_body = ScoreRequest,
    responses(
        (status = 200, description = "Done.", body = Campaign),
        Refusal<404>,
        Refusal<409>,
        Refusal<413>,
        Refusal<415>,
        Refusal<422>,
    ),
)]
pub(super) async fn settle(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    Asking(principal): Asking,
    Peer(peer): Peer,
    Body(request): Body<ScoreRequest>,
) -> Answer<Json<Campaign>> {
    let viewer = viewer(&principal, &peer, &request.scorer, false);
    change(&state, id, move |campaigns, id| campaigns.settle(id, trial, &request, &viewer)).await
}

/// Pauses a campaign: no trial begins until it is resumed; the one that runs goes on to its end.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/pause",
    tag = "campaigns",
    responses(
        (status = 200, description = "Done.", body = Campaign),
        Refusal<404>,
        Refusal<409>,
        Refusal<422>,
    ),
)]
pub(super) async fn pause(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Asking(principal): Asking,
    Peer(peer): Peer,
) -> Answer<Json<Campaign>> {
    change(&state, id, move |campaigns, id| campaigns.pause(id, &viewer(&principal, &peer, "", false))).await
}

/// Goes on with a paused campaign.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/resume",
    tag = "campaigns",
    responses(
        (status = 200, description = "Done.", body = Campaign),
        Refusal<404>,
        Refusal<409>,
        Refusal<422>,
    ),
)]
pub(super) async fn resume(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Asking(principal): Asking,
    Peer(peer): Peer,
) -> Answer<Json<Campaign>> {
    change(&state, id, move |campaigns, id| campaigns.resume(id, &viewer(&principal, &peer, "", false))).await
}

/// Closes a campaign: no trial is made any more, and a blind one is open to everybody.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/close",
    tag = "campaigns",
    responses(
        (status = 200, description = "Done.", body = Campaign),
        Refusal<404>,
        Refusal<409>,
        Refusal<422>,
    ),
)]
pub(super) async fn close(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Asking(principal): Asking,
    Peer(peer): Peer,
) -> Answer<Json<Campaign>> {
    change(&state, id, move |campaigns, id| campaigns.close(id, &viewer(&principal, &peer, "", false))).await
}

/// Goes on with a closed campaign, unless it was blind.
#[utoipa::path(
    post,
    path = "/campaigns/{campaign}/reopen",
    tag = "campaigns",
    responses(
        (status = 200, description = "Done.", body = Campaign),
        Refusal<404>,
        Refusal<409>,
        Refusal<422>,
    ),
)]
pub(super) async fn reopen(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Asking(principal): Asking,
    Peer(peer): Peer,
) -> Answer<Json<Campaign>> {
    change(&state, id, move |campaigns, id| campaigns.reopen(id, &viewer(&principal, &peer, "", false))).await
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
