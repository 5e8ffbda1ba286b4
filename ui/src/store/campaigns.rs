//! Campaigns as the page knows them.

use std::{collections::BTreeMap, sync::Arc};

use palpate_wire::api::{Campaign, CampaignPlan, CampaignResults, CampaignSummary};

use super::{Loadable, ask, parse_json, reset, shared};
use crate::api_client::{CampaignAct, Request};

/// A campaign, and whether it is seen as a scorer may see it.
type Seen = (String, bool);

/// The list of campaigns, and those that were opened.
#[derive(Debug, Default)]
pub struct CampaignTable {
    list: Loadable<Arc<Vec<CampaignSummary>>>,
    opened: BTreeMap<Seen, Loadable<Arc<Campaign>>>,
    results: BTreeMap<String, Loadable<Arc<CampaignResults>>>,
    /// A campaign that was asked for: its id once the server made it.
    pub made: Loadable<String>,
    /// Why the last thing that was done in a campaign did not work; `None` when all is well.
    pub problem: Option<String>,
    /// Something was done, and the server has not answered yet.
    pub is_busy: bool,
    outbox: Vec<Request>,
}

impl CampaignTable {
    /// All campaigns, newest first.
    pub fn list(&mut self) -> Loadable<Arc<Vec<CampaignSummary>>> {
        ask(&mut self.list, &mut self.outbox, || Request::Campaigns)
    }

    /// Campaign `id`, as `scorer` sees it who may not know more than scorers do if `as_scorer`.
    pub fn campaign(&mut self, id: &str, scorer: &str, as_scorer: bool) -> Loadable<Arc<Campaign>> {
        let slot = self.opened.entry((id.to_owned(), as_scorer)).or_default();
        ask(slot, &mut self.outbox, || request(id, scorer, as_scorer))
    }

    /// Asks for campaign `id` again, because somebody else looks at it now.
    pub fn ask_again(&mut self, id: &str, scorer: &str, as_scorer: bool) {
        self.outbox.push(request(id, scorer, as_scorer));
    }

    /// What the verdicts of campaign `id` say.
    pub fn results(&mut self, id: &str) -> Loadable<Arc<CampaignResults>> {
        let slot = self.results.entry(id.to_owned()).or_default();
        ask(slot, &mut self.outbox, || Request::CampaignResults(id.to_owned()))
    }

    /// Makes a campaign; see [`CampaignTable::made`].
    pub fn make(&mut self, plan: CampaignPlan) {
        self.made = Loadable::Loading;
        self.outbox.push(Request::MakeCampaign(plan));
    }

    /// Does something in campaign `id`.
    pub fn act(&mut self, id: &str, as_scorer: bool, act: CampaignAct) {
        self.is_busy = true;
        self.problem = None;
        self.outbox.push(Request::ActOnCampaign { campaign: id.to_owned(), as_scorer, act });
    }

    pub(super) fn take_outbox(&mut self) -> Vec<Request> {
        std::mem::take(&mut self.outbox)
    }

    pub(super) fn receive_list(&mut self, result: Result<Vec<u8>, String>) {
        self.list = shared(parse_json(result));
    }

    pub(super) fn receive_campaign(&mut self, seen: Seen, result: Result<Vec<u8>, String>) {
        self.opened.insert(seen, shared(parse_json(result)));
    }

    pub(super) fn receive_results(&mut self, id: String, result: Result<Vec<u8>, String>) {
        self.results.insert(id, shared(parse_json(result)));
    }

    pub(super) fn receive_made(&mut self, result: Result<Vec<u8>, String>) {
        self.made = match parse_json::<Campaign>(result) {
            Loadable::Ready(campaign) => {
                let id = campaign.summary.id.clone();
                self.opened.insert((id.clone(), false), Loadable::Ready(Arc::new(campaign)));
                Loadable::Ready(id)
            }
            Loadable::Failed(error) => Loadable::Failed(error),
            Loadable::Idle | Loadable::Loading => Loadable::Loading,
        };
        self.outbox.push(Request::Campaigns);
    }

    pub(super) fn receive_acted(&mut self, id: String, as_scorer: bool, result: Result<Vec<u8>, String>) {
        self.is_busy = false;
        match parse_json::<Campaign>(result) {
            Loadable::Ready(campaign) => {
                self.opened.insert((id, as_scorer), Loadable::Ready(Arc::new(campaign)));
            }
            Loadable::Failed(error) => self.problem = Some(error),
            Loadable::Idle | Loadable::Loading => {}
        }
    }

    /// Somebody changed campaign `id`: what of it is on the page is asked for again under the name `scorer`.
    pub(super) fn changed(&mut self, id: &str, scorer: &str) {
        if self.list.ready().is_some() {
            self.outbox.push(Request::Campaigns);
        }
        let opened = self
            .opened
            .iter()
            .filter(|((opened, _), campaign)| (id.is_empty() || opened == id) && campaign.ready().is_some());
        self.outbox.extend(opened.map(|((id, as_scorer), _)| request(id, scorer, *as_scorer)));
        let results = self.results.iter().filter(|(opened, results)| {
            (id.is_empty() || *opened == id) && !matches!(results, Loadable::Loading)
        });
        self.outbox.extend(results.map(|(id, _)| Request::CampaignResults(id.clone())));
    }

    pub(super) fn retry_failed(&mut self) {
        reset(&mut self.list);
        self.opened.values_mut().for_each(reset);
        self.results.values_mut().for_each(reset);
    }
}

fn request(id: &str, scorer: &str, as_scorer: bool) -> Request {
    Request::Campaign { campaign: id.to_owned(), scorer: scorer.trim().to_owned(), as_scorer }
}
