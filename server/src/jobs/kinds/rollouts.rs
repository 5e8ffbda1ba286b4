//! `palpate-train rollout` as a job: the trials of a campaign on the hand of this studio.

use std::{fs, path::PathBuf};

use palpate_recording::GrowingSession;
use palpate_trials::{Viewer, campaign_of_folder};
use palpate_wire::api::{Campaign, RolloutsRequest};
use serde_json::Value;

use super::{
    JobKind, JobWork, LONG, parse,
    training::{Arguments, PolicyOf, Workplace, check_object, script_for},
};
use crate::{
    Error, Store, assets,
    data::files,
    jobs::way_in::{OPERATOR_VARIABLE, URL_VARIABLE},
};

/// Makes the trials of a campaign.
pub(crate) const ROLLOUTS: JobKind = JobKind {
    name: "rollouts",
    prefix: "rollouts-",
    resources: palpate_wire::api::Resources { cores: 1, station: true, ..LONG },
    needs_trainer: true,
    makes: None,
    sharding: None,
    check,
    work,
};

/// Stands for the object's id in the source of a policy.
const OBJECT: &str = "{object}";
/// Says that a source is a script.
const SCRIPT: &str = "script:";
/// Says that a source imitates an expert; a policy's name says so too.
const CLONE: &str = "clone:";
/// How files of policies end.
const ENDING: &str = ".safetensors";
/// Folder of the records of a campaign's trials, in the campaign's. It belongs to no job, so that a later one knows what an
/// earlier one has begun.
pub(super) const RECORDS_DIR: &str = "rollout";

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: RolloutsRequest = parse(ROLLOUTS.name, request)?;
    let campaign = campaign(store, &request.campaign)?;
    if campaign.summary.closed.is_some() {
        return Err(Error::Conflict(format!(
            "campaign {:?} is closed; open it again, or run another one",
            request.campaign
        )));
    }
    sources(store, &campaign)?;
    if let Some(session) = request.recorded_into() {
        check_session(store, &session)?;
    }
    let mut own = Vec::new();
    for object in &campaign.plan.objects {
        own.extend(check_object(store, &object.id)?);
    }
    Ok(own)
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: RolloutsRequest = parse(ROLLOUTS.name, request)?;
    let campaign = campaign(cx.store, &request.campaign)?;
    let url = std::env::var(URL_VARIABLE).map_err(|_| {
        Error::Argument(format!(
            "{URL_VARIABLE} does not say where the studio is: a job of kind \"rollouts\" is started by the studio itself"
        ))
    })?;
    let workplace = Workplace::make(cx.folder)?;
    bring_objects(cx.store, &campaign, &workplace)?;
    let session = request.recorded_into();
    let operator = std::env::var_os(OPERATOR_VARIABLE);
    let records = folder(cx.store, &request.campaign)?.join(RECORDS_DIR);
    let mut arguments = Arguments::of("rollout")
        .with("campaign", &request.campaign)
        .flag("placed-at-page", operator.is_none())
        .path("operator", operator)
        .maybe("record", session.as_deref())
        .flag("repeat-void", request.repeat_void)
        .with("name", &campaign.summary.name)
        .with("url", url)
        .with("out", records);
    for (id, source) in sources(cx.store, &campaign)? {
        arguments = arguments.with("policy", format!("{id}={source}"));
    }
    // A log is for everybody, and scorers of a blind campaign do not learn its policies.
    if !campaign.plan.is_blind {
        arguments.log();
    }
    let mut report = cx.run_trainer_in(&workplace, arguments)?.unwrap_or_default();
    if let (Some(report), Some(session)) = (report.as_object_mut(), session) {
        report.insert("session".to_owned(), session.into());
    }
    cx.save_report(&report)?;
    // A rollout that is asked to stop ends well, and may do so before this process has heard of it.
    match report["ended"].as_str() {
        Some("cancelled") => Err(Error::Cancelled),
        _ => Ok(()),
    }
}

/// Refuses a session that takes cannot go into before the robot moves, and not at the first trial.
fn check_session(store: &Store, id: &str) -> Result<(), Error> {
    files::check_id("session", id)?;
    let dir = store.sessions_dir().join(id);
    if !dir.exists() {
        return Ok(());
    }
    let why = match GrowingSession::steps_of(&dir)? {
        None => "was not recorded by this studio",
        // Those of free takes all say why they are no steps of a plan.
        Some(steps) if steps.iter().any(|step| step.added_because.is_none()) => "follows a plan",
        Some(_) => return Ok(()),
    };
    Err(Error::Conflict(format!(
        "session {id:?} {why}, so the takes of trials cannot go into it; give another session, or without_recording"
    )))
}

/// Copies one's own objects of `campaign` to where `palpate-train` looks for objects.
pub(super) fn bring_objects(store: &Store, campaign: &Campaign, workplace: &Workplace) -> Result<(), Error> {
    for object in &campaign.plan.objects {
        if let Some(own) = check_object(store, &object.id)? {
            let place = workplace.path().join("assets/objects").join(format!("{}.toml", object.id));
            fs::copy(&own, &place).map_err(Error::io("copy", &own))?;
        }
    }
    Ok(())
}

/// The folder of campaign `id`.
pub(super) fn folder(store: &Store, id: &str) -> Result<PathBuf, Error> {
    files::check_id("campaign", id)?;
    Ok(store.root().join("campaigns").join(id))
}

/// Campaign `id`, as whoever runs trials sees it.
pub(super) fn campaign(store: &Store, id: &str) -> Result<Campaign, Error> {
    let viewer = Viewer { name: ROLLOUTS.name.to_owned(), is_scorer: false };
    Ok(campaign_of_folder(&folder(store, id)?, &viewer)?)
}

/// Where each policy of `campaign` comes from, for `palpate-train rollout`. A plan must not name files of this computer.
fn sources(store: &Store, campaign: &Campaign) -> Result<Vec<(String, String)>, Error> {
    let mut sources = Vec::new();
    for policy in &campaign.plan.policies {
        let source = policy.source.as_str();
        let text = match source.strip_prefix(SCRIPT) {
            Some(script) if script.contains(OBJECT) => {
                for object in &campaign.plan.objects {
                    script_for(store, Some(&script.replace(OBJECT, &object.id)), &object.id)?;
                }
                source.to_owned()
            }
            Some(script) => {
                let place = script_for(store, Some(script), "")?;
                format!("{SCRIPT}{}", place.argument().to_string_lossy())
            }
            None => {
                let name = source.strip_prefix(CLONE).unwrap_or(source);
                let name = name.strip_suffix(ENDING).unwrap_or(name);
                learned(store, campaign, name)?
            }
        };
        sources.push((policy.id.clone(), text));
    }
    Ok(sources)
}

/// The policy called `name`: one for each object, a shipped one, or what a job has learned.
fn learned(store: &Store, campaign: &Campaign, name: &str) -> Result<String, Error> {
    if name.contains(OBJECT) {
        let shipped = assets::names_in("policies", ENDING);
        for object in &campaign.plan.objects {
            let of_object = name.replace(OBJECT, &object.id);
            if !shipped.contains(&of_object.as_str()) {
                return Err(Error::Argument(format!(
                    "no policy {of_object:?} is shipped for the object {:?}; there are {}",
                    object.id,
                    shipped.join(", ")
                )));
            }
        }
        return Ok(format!("{name}{ENDING}"));
    }
    Ok(match PolicyOf::find(store, name)? {
        PolicyOf::Imitation { file } => format!("{CLONE}{}", file.argument().to_string_lossy()),
        PolicyOf::Expert { file, .. } => file.argument().to_string_lossy().into_owned(),
    })
}
