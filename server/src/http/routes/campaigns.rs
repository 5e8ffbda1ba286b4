//! Campaigns: trials of policies, scored by people.

use std::sync::Arc;

use axum::{
    Json,
    extract::State,
    http::{StatusCode, header},
    response::{IntoResponse, Response},
};
use palpate_trials::{Campaigns, Format, TrialsError, Viewer, render};
use palpate_wire::api::{
    Campaign, CampaignPlan, CampaignResults, CampaignSummary, ScoreBack, ScoreRequest, TrialEnd,
};
use serde::Deserialize;

use crate::{
    AppState, Error,
    data::files,
    http::{
        extract::{Body, Ids, Params, Peer},
        problem::{Answer, Problem},
    },
    hub::List,
    work::Kind,
};

/// Who looks, where nobody logs in.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct View {
    /// Their name.
    #[serde(default)]
    scorer: String,
    /// They score, and a blind campaign tells them nothing that they are not to know.
    #[serde(default)]
    as_scorer: bool,
}

impl View {
    fn viewer(self, peer: &str) -> Viewer {
        Viewer { name: name(&self.scorer, peer), is_scorer: self.as_scorer }
    }
}

/// The name that somebody gave, or where they are.
fn name(given: &str, peer: &str) -> String {
    match given.trim() {
        "" => peer.rsplit_once(':').map_or(peer, |(address, _)| address).to_owned(),
        given => given.to_owned(),
    }
}

fn operator(given: &str, peer: &str) -> Viewer {
    Viewer { name: name(given, peer), is_scorer: false }
}

pub(super) async fn list(State(state): State<Arc<AppState>>) -> Answer<Json<Vec<CampaignSummary>>> {
    state.run(Kind::Read, move |state| Ok(Json(state.campaigns().list()?))).await
}

/// Makes a campaign; its id is made from its name.
pub(super) async fn create(
    State(state): State<Arc<AppState>>,
    Peer(peer): Peer,
    Body(plan): Body<CampaignPlan>,
) -> Answer<Response> {
    let campaign = state
        .run(Kind::Read, move |state| {
            let id = files::slug(&plan.name)?;
            let campaign = state.campaigns().create(&id, plan, &operator("", &peer))?;
            state.hub().publish_changed(List::Campaigns, &id);
            Ok(campaign)
        })
        .await?;
    let location = [(header::LOCATION, format!("/api/v1/campaigns/{}", campaign.summary.id))];
    Ok((StatusCode::CREATED, location, Json(campaign)).into_response())
}

pub(super) async fn detail(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Params(view): Params<View>,
    Peer(peer): Peer,
) -> Answer<Json<Campaign>> {
    let viewer = view.viewer(&peer);
    state.run(Kind::Read, move |state| Ok(Json(state.campaigns().campaign(&id, &viewer)?))).await
}

pub(super) async fn results(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Params(view): Params<View>,
    Peer(peer): Peer,
) -> Answer<Json<CampaignResults>> {
    let viewer = view.viewer(&peer);
    state.run(Kind::Compute, move |state| Ok(Json(state.campaigns().results(&id, &viewer)?))).await
}

/// The results as a file: `results.csv`, `results.tex`, `results.txt` or `results.svg`.
pub(super) async fn table(
    State(state): State<Arc<AppState>>,
    Ids((id, file)): Ids<(String, String)>,
    Params(view): Params<View>,
    Peer(peer): Peer,
) -> Answer<Response> {
    let format = file.strip_prefix("results.").and_then(Format::from_ending);
    let Some(format) = format else {
        let hint = "expected results.txt, results.csv, results.tex or results.svg";
        return Err(Problem(Error::NotFound { what: "table", id: file, hint }));
    };
    let viewer = view.viewer(&peer);
    let text = state
        .run(Kind::Compute, move |state| Ok(render(&state.campaigns().results(&id, &viewer)?, format)?))
        .await?;
    Ok(([(header::CONTENT_TYPE, format.media_type())], text).into_response())
}

pub(super) async fn begin(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    Peer(peer): Peer,
) -> Answer<Json<Campaign>> {
    change(&state, id, move |campaigns, id| campaigns.begin(id, trial, &operator("", &peer))).await
}

pub(super) async fn outcome(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    Peer(peer): Peer,
    Body(end): Body<TrialEnd>,
) -> Answer<Json<Campaign>> {
    change(&state, id, move |campaigns, id| {
        campaigns.end(id, (trial, end.attempt), &end.outcome, &operator("", &peer))
    })
    .await
}

pub(super) async fn score(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    Params(view): Params<View>,
    Peer(peer): Peer,
    Body(request): Body<ScoreRequest>,
) -> Answer<Json<Campaign>> {
    let viewer = Viewer { name: name(&request.scorer, &peer), is_scorer: view.as_scorer };
    change(&state, id, move |campaigns, id| campaigns.score(id, trial, &request, &viewer)).await
}

pub(super) async fn unscore(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    Params(view): Params<View>,
    Peer(peer): Peer,
    Body(back): Body<ScoreBack>,
) -> Answer<Json<Campaign>> {
    let viewer = Viewer { name: name(&back.scorer, &peer), is_scorer: view.as_scorer };
    change(&state, id, move |campaigns, id| campaigns.unscore(id, (trial, back.attempt), &viewer)).await
}

pub(super) async fn settle(
    State(state): State<Arc<AppState>>,
    Ids((id, trial)): Ids<(String, u32)>,
    Peer(peer): Peer,
    Body(request): Body<ScoreRequest>,
) -> Answer<Json<Campaign>> {
    let viewer = operator(&request.scorer, &peer);
    change(&state, id, move |campaigns, id| campaigns.settle(id, trial, &request, &viewer)).await
}

pub(super) async fn close(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Peer(peer): Peer,
) -> Answer<Json<Campaign>> {
    change(&state, id, move |campaigns, id| campaigns.close(id, &operator("", &peer))).await
}

pub(super) async fn reopen(
    State(state): State<Arc<AppState>>,
    Ids(id): Ids<String>,
    Peer(peer): Peer,
) -> Answer<Json<Campaign>> {
    change(&state, id, move |campaigns, id| campaigns.reopen(id, &operator("", &peer))).await
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
