//! Runs of one kind as the page knows them: the list, and those that were opened.

use std::{collections::BTreeMap, sync::Arc};

use palpate_wire::{
    api::{JobState, Run},
    proto::JobUpdate,
};

use super::{Loadable, ask, parse_json, shared};
use crate::api_client::Request;

/// Runs that were asked for with a `Q` and give an `R`.
#[derive(Debug)]
pub(super) struct RunTable<Q, R> {
    list: Loadable<Arc<Vec<Run<Q, R>>>>,
    details: BTreeMap<String, Loadable<Arc<Run<Q, R>>>>,
}

// Derived, it would ask for requests and reports that have a default.
impl<Q, R> Default for RunTable<Q, R> {
    fn default() -> Self {
        Self { list: Loadable::Idle, details: BTreeMap::new() }
    }
}

impl<Q, R> RunTable<Q, R>
where
    Q: Clone + serde::de::DeserializeOwned,
    R: Clone + serde::de::DeserializeOwned,
{
    pub(super) fn list(
        &mut self,
        outbox: &mut Vec<Request>,
        request: Request,
    ) -> Loadable<Arc<Vec<Run<Q, R>>>> {
        ask(&mut self.list, outbox, || request)
    }

    pub(super) fn detail(
        &mut self,
        id: &str,
        outbox: &mut Vec<Request>,
        request: impl FnOnce() -> Request,
    ) -> Loadable<Arc<Run<Q, R>>> {
        ask(self.details.entry(id.to_owned()).or_default(), outbox, request)
    }

    pub(super) fn receive_list(&mut self, result: Result<Vec<u8>, String>) {
        self.list = shared(parse_json(result));
    }

    pub(super) fn receive_detail(&mut self, id: String, result: Result<Vec<u8>, String>) {
        match parse_json(result) {
            Loadable::Ready(run) => self.put(run),
            failed => {
                self.details.insert(id, shared(failed));
            }
        }
    }

    /// Takes in a run that was just started; gives its id.
    pub(super) fn receive_started(&mut self, result: Result<Vec<u8>, String>) -> Loadable<String> {
        match parse_json::<Run<Q, R>>(result) {
            Loadable::Ready(run) => {
                let id = run.id.clone();
                self.put(run);
                Loadable::Ready(id)
            }
            Loadable::Failed(error) => Loadable::Failed(error),
            Loadable::Idle | Loadable::Loading => Loadable::Loading,
        }
    }

    /// Ids of the runs that were opened.
    pub(super) fn opened(&self) -> impl Iterator<Item = &String> {
        self.details.iter().filter(|(_, run)| run.ready().is_some()).map(|(id, _)| id)
    }

    /// Takes in how a run gets on. True if the run should be fetched: it ended, or is new here.
    pub(super) fn update(&mut self, state: JobState, update: &JobUpdate) -> bool {
        let finished = !matches!(state, JobState::Queued | JobState::Running);
        let listed = match &mut self.list {
            Loadable::Ready(runs) => Arc::make_mut(runs).iter_mut().find(|run| run.id == update.job),
            _ => None,
        };
        let unknown = listed.is_none();
        let detailed = match self.details.get_mut(&update.job) {
            Some(Loadable::Ready(run)) => Some(Arc::make_mut(run)),
            _ => None,
        };
        for run in listed.into_iter().chain(detailed) {
            run.state = state;
            run.fraction = update.fraction;
            run.stage.clone_from(&update.stage);
            run.seconds_left = (!finished && update.seconds_left > 0.0).then_some(update.seconds_left);
            run.error = (!update.error.is_empty()).then(|| update.error.clone());
        }
        finished || unknown
    }

    pub(super) fn retry_failed(&mut self) {
        super::reset(&mut self.list);
        self.details.values_mut().for_each(super::reset);
    }

    fn put(&mut self, run: Run<Q, R>) {
        if let Loadable::Ready(runs) = &mut self.list {
            let runs = Arc::make_mut(runs);
            match runs.iter_mut().find(|known| known.id == run.id) {
                Some(known) => known.clone_from(&run),
                None => runs.push(run.clone()),
            }
            // Answers overtake each other; the list stays newest first.
            runs.sort_by_key(|run| std::cmp::Reverse(run_number(&run.id)));
        }
        self.details.insert(run.id.clone(), Loadable::Ready(Arc::new(run)));
    }
}

/// The number in a run's id, which grows from run to run.
fn run_number(id: &str) -> Option<u64> {
    id.trim_start_matches(|c: char| !c.is_ascii_digit()).parse().ok()
}
