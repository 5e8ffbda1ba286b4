//! What was made from what: read off the files that jobs have read, which every job's specification names.

use std::collections::{BTreeMap, BTreeSet};

use palpate_jobs::Scheduler;
use palpate_wire::api::{
    Artifact, ArtifactFact, ArtifactKey, ArtifactSort, Campaign, Job, JobState, Lineage, ModelSummary,
};
use serde_json::Value;

use super::kinds::KINDS;
use crate::{Error, Store, assets};

/// Folder of the shipped policies that imitate an expert, below that of all shipped policies.
const IMITATION: &str = "imitation";
/// In the source of a campaign's policy: the id of each object in turn.
const OBJECT: &str = "{object}";
/// Before the name of a script, in the source of a campaign's policy.
const SCRIPT: &str = "script:";

/// Everything in `store`, what the jobs of `scheduler` made, and `campaigns`.
///
/// # Errors
/// Folders or the database of jobs cannot be read.
pub(crate) fn lineage(
    store: &Store,
    scheduler: &Scheduler,
    campaigns: &[Campaign],
) -> Result<Lineage, Error> {
    let mut done: Vec<(Job, ArtifactSort)> = Vec::new();
    for kind in KINDS {
        let Some(sort) = kind.makes else { continue };
        let jobs = scheduler.all_of_kind(kind.name)?.into_iter();
        done.extend(jobs.filter(|job| job.state == JobState::Done).map(|job| (job, sort)));
    }
    Ok(trace(&store.sessions()?, &store.models()?, &done, campaigns))
}

/// The same of what is known: ids of sessions, saved models, jobs that are done with what they make, campaigns.
fn trace(
    sessions: &[String],
    models: &[ModelSummary],
    done: &[(Job, ArtifactSort)],
    campaigns: &[Campaign],
) -> Lineage {
    let mut found = Found::default();
    for id in sessions {
        found.artifact(ArtifactSort::Session, id);
    }
    for model in models {
        found.artifact(ArtifactSort::Model, &model.id).name.clone_from(&model.name);
    }
    for name in shipped_policies() {
        found.artifact(ArtifactSort::Policy, name).is_shipped = true;
    }
    // Oldest first, so that the newest has the last word.
    let mut done: Vec<&(Job, ArtifactSort)> = done.iter().collect();
    done.sort_by(|(a, _), (b, _)| a.ended.cmp(&b.ended));
    let makers: BTreeMap<&str, ArtifactSort> =
        done.iter().map(|(job, sort)| (job.id.as_str(), *sort)).collect();
    for (job, sort) in done {
        let id = match sort {
            ArtifactSort::Model => job.saved_as.as_deref(),
            ArtifactSort::Session => job.spec.request["session"].as_str(),
            _ => Some(job.id.as_str()),
        };
        let Some(key) = id.map(|id| ArtifactKey::new(*sort, id)) else { continue };
        // A session or a model that has been deleted.
        let is_gone = matches!(sort, ArtifactSort::Model | ArtifactSort::Session) && !found.has(&key);
        if is_gone {
            continue;
        }
        let policy = job.spec.request["policy"].as_str().filter(|name| shipped_policies().contains(name));
        let mut sources: Vec<ArtifactKey> =
            job.spec.inputs.keys().filter_map(|path| source(path, &makers)).collect();
        sources.extend(policy.map(|name| ArtifactKey::new(ArtifactSort::Policy, name)));
        let artifact = found.artifact(key.sort, &key.id);
        artifact.made = job.ended.clone();
        artifact.jobs.push(job.id.clone());
        artifact.facts = facts(job);
        artifact.add_sources(sources);
    }
    for campaign in campaigns {
        let artifact = found.artifact(ArtifactSort::Campaign, &campaign.summary.id);
        artifact.name.clone_from(&campaign.summary.name);
        artifact.made = Some(campaign.summary.created.clone());
        artifact.facts = vec![
            fact("trials planned", campaign.summary.planned.to_string()),
            fact("trials scored", campaign.summary.scored.to_string()),
        ];
        let objects: Vec<&str> = campaign.plan.objects.iter().map(|object| object.id.as_str()).collect();
        for policy in &campaign.plan.policies {
            artifact.add_sources(tried(&policy.source, &objects));
        }
        let key = artifact.key.clone();
        for session in sessions_of(campaign) {
            // One that has been deleted is in no list.
            if let Some(session) = found.0.get_mut(&ArtifactKey::new(ArtifactSort::Session, session)) {
                session.add_sources(vec![key.clone()]);
            }
        }
    }
    found.into_lineage()
}

/// Sessions that have takes of trials of `campaign`.
fn sessions_of(campaign: &Campaign) -> BTreeSet<&str> {
    let attempts = campaign.trials.iter().flat_map(|trial| &trial.attempts);
    let takes = attempts.filter_map(|attempt| attempt.take.as_deref());
    takes.filter_map(|take| take.split_once('/')).map(|(session, _)| session).collect()
}

/// Names of the shipped policies.
fn shipped_policies() -> Vec<&'static str> {
    let mut names = assets::names_in("policies", ".safetensors");
    names.extend(assets::names_in(&format!("policies/{IMITATION}"), ".safetensors"));
    names
}

/// What the file at `path` of the data folder belongs to; `makers` are the jobs that made something.
fn source(path: &str, makers: &BTreeMap<&str, ArtifactSort>) -> Option<ArtifactKey> {
    let mut parts = path.split('/');
    match (parts.next()?, parts.next()?) {
        ("sessions", id) => Some(ArtifactKey::new(ArtifactSort::Session, id)),
        ("models", file) => Some(ArtifactKey::new(ArtifactSort::Model, file.strip_suffix(".toml")?)),
        ("runs", id) => makers.get(id).map(|&sort| ArtifactKey::new(sort, id)),
        _ => None,
    }
}

/// What a policy of a campaign with these `objects` is, by what its rollout is started with.
fn tried(source: &str, objects: &[&str]) -> Vec<ArtifactKey> {
    let each = if source.contains(OBJECT) { objects } else { &[""] };
    let texts = each.iter().map(|object| source.replace(OBJECT, object));
    let keys = texts.filter_map(|text| {
        if let Some(name) = text.strip_prefix(SCRIPT) {
            return Some(ArtifactKey::new(ArtifactSort::Script, name));
        }
        let parts: Vec<&str> = text.split(['/', ':']).collect();
        // A file of a job is in the folder with the job's id.
        if let Some(&[_, id]) = parts.windows(2).find(|pair| pair[0] == "runs") {
            return Some(ArtifactKey::new(ArtifactSort::Policy, id));
        }
        let name = parts.last()?.strip_suffix(".safetensors").or(parts.last().copied())?;
        shipped_policies().contains(&name).then(|| ArtifactKey::new(ArtifactSort::Policy, name))
    });
    keys.collect()
}

/// What was asked of a job, as far as it is short.
fn facts(job: &Job) -> Vec<ArtifactFact> {
    let asked = job.spec.request.as_object().into_iter().flatten();
    let short = asked.filter_map(|(name, value)| Some(fact(name, text(value)?)));
    let always = [
        fact("seed", job.spec.seed.to_string()),
        fact("owner", job.owner.clone()),
        fact("software", job.spec.software.clone()),
    ];
    short.chain(always).collect()
}

fn fact(name: &str, value: String) -> ArtifactFact {
    ArtifactFact { name: name.replace('_', " "), value }
}

/// A value on one line; none for what would take more, and for what was not asked.
fn text(value: &Value) -> Option<String> {
    let text = match value {
        Value::Null | Value::Object(_) => return None,
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(text).collect::<Option<Vec<_>>>()?.join(", "),
        Value::Bool(_) | Value::Number(_) => value.to_string(),
    };
    (!text.is_empty() && !text.contains('\n')).then_some(text)
}

/// Artifacts so far.
#[derive(Default)]
struct Found(BTreeMap<ArtifactKey, Artifact>);

impl Found {
    /// The artifact `id`, which is there from now on.
    fn artifact(&mut self, sort: ArtifactSort, id: &str) -> &mut Artifact {
        let key = ArtifactKey::new(sort, id);
        self.0.entry(key.clone()).or_insert_with(|| Artifact {
            key,
            name: id.to_owned(),
            made: None,
            is_shipped: false,
            jobs: Vec::new(),
            made_from: Vec::new(),
            facts: Vec::new(),
        })
    }

    fn has(&self, key: &ArtifactKey) -> bool {
        self.0.contains_key(key)
    }

    fn into_lineage(self) -> Lineage {
        let mut artifacts: Vec<Artifact> = self.0.into_values().collect();
        // RFC 3339 of the same offset sorts as text; what has no time is last, by id.
        artifacts.sort_by(|a, b| (a.key.sort, &b.made, &a.key.id).cmp(&(b.key.sort, &a.made, &b.key.id)));
        Lineage { artifacts }
    }
}

/// Adding sources to an artifact.
trait AddSources {
    /// Each once; nothing is made from itself, though a diagnosis may add to the model that it began with.
    fn add_sources(&mut self, keys: Vec<ArtifactKey>);
}

impl AddSources for Artifact {
    fn add_sources(&mut self, keys: Vec<ArtifactKey>) {
        for key in keys {
            if key != self.key && !self.made_from.contains(&key) {
                self.made_from.push(key);
            }
        }
        self.made_from.sort();
    }
}

#[cfg(test)]
mod tests;
