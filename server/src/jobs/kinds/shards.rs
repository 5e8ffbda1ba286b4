//! Jobs whose work falls into parts that need not know of each other, divided into shards.
//!
//! A shard is asked like a job of its kind, of some of the parts. The job's own process comes last: it takes over what
//! the shards have left in their folders and then does what it always does, for which it finds the work done. So a job
//! has the same outcome divided or not, and one whose shards left nothing does all of it by itself.

use std::{fs, io, ops::Range, path::Path};

use palpate_jobs::{JobFolder, Shard};
use palpate_wire::api::{JobSpec, Resources};
use serde::Serialize;
use serde_json::Value;

use super::{JobKind, JobWork, KINDS};
use crate::Error;

/// Most shards of a job: Slurm takes arrays of a thousand, and each is looked after.
const MAX_SHARDS: u32 = 256;

/// How the jobs of a kind are divided.
pub(crate) struct Sharding {
    /// What the parts are, for people.
    pub(crate) parts: &'static str,
    /// How many a request has.
    pub(crate) count: fn(&Value) -> Result<u64, Error>,
    /// The request and the seed of some of the parts, by those of all.
    pub(crate) shard: fn(&Value, u64, Range<u64>) -> Result<Shard, Error>,
    /// Puts what a shard has left where the job's own work looks for it. It may have been done before.
    pub(crate) take_over: fn(&JobWork<'_>, &JobFolder) -> Result<(), Error>,
}

/// What each shard of a job of `kind` is asked.
pub(crate) fn shards(
    kind: &JobKind,
    request: &Value,
    seed: u64,
    resources: &Resources,
) -> Result<Vec<Shard>, Error> {
    let &Resources { shards, at_once, station, .. } = resources;
    if shards == 0 {
        return match at_once {
            0 => Ok(Vec::new()),
            _ => Err(Error::Argument(format!(
                "resources.at_once = {at_once}, and the job is not divided; give resources.shards too"
            ))),
        };
    }
    let Some(sharding) = &kind.sharding else {
        let divided: Vec<&str> =
            KINDS.iter().filter(|kind| kind.sharding.is_some()).map(|kind| kind.name).collect();
        return Err(Error::Argument(format!(
            "resources.shards = {shards}: a job of kind {:?} cannot be divided; leave it out (it is for {})",
            kind.name,
            divided.join(", ")
        )));
    };
    if station {
        return Err(Error::Argument(format!(
            "resources.shards = {shards}: there is one station, and shards would share it; leave one out"
        )));
    }
    let parts = (sharding.count)(request)?;
    let most = parts.min(MAX_SHARDS.into());
    if u64::from(shards) > most {
        return Err(Error::Argument(format!(
            "resources.shards = {shards}, and the job has {parts} {}; give at most {most}",
            sharding.parts
        )));
    }
    let num_shards = u64::from(shards);
    // Rounded down, without a product that may not fit.
    let (each, over) = (parts / num_shards, parts % num_shards);
    let begin = |shard: u64| shard * each + shard.min(over);
    (0..num_shards).map(|shard| (sharding.shard)(request, seed, begin(shard)..begin(shard + 1))).collect()
}

/// Takes over what the shards of the job have left.
pub(crate) fn take_over(cx: &JobWork<'_>, kind: &JobKind, spec: &JobSpec) -> Result<(), Error> {
    let Some(sharding) = &kind.sharding else { return Ok(()) };
    (0..spec.resources.shards).try_for_each(|shard| (sharding.take_over)(cx, &cx.folder.shard(shard)))
}

/// Those of `all` that a shard has.
pub(super) fn some_of(all: Vec<String>, of_shard: Range<u64>) -> Vec<String> {
    let each = (0..).zip(all).filter(|(idx, _)| of_shard.contains(idx));
    each.map(|(_, one)| one).collect()
}

/// A shard that is asked `request`.
pub(super) fn shard(request: &impl Serialize, seed: u64) -> Result<Shard, Error> {
    let request = serde_json::to_value(request).map_err(|err| Error::Internal(err.to_string()))?;
    Ok(Shard { request, seed })
}

/// Moves a shard's files, one an object, from folder `from` to the job's `to`: what is there is not made again.
pub(super) fn take_files_over(from: &Path, to: &Path) -> Result<(), Error> {
    let entries = match fs::read_dir(from) {
        Err(err) if err.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(Error::io("read", from))?,
    };
    fs::create_dir_all(to).map_err(Error::io("make", to))?;
    for entry in entries {
        let entry = entry.map_err(Error::io("read", from))?;
        // Each object is one shard's; of what was cut off while it was written nobody takes notice.
        fs::rename(entry.path(), to.join(entry.file_name())).map_err(Error::io("move", entry.path()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use palpate_wire::api::{BlindRequest, EvaluationRequest, GatheringRequest};
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    fn divided(kind: &str, request: &Value, seed: u64, shards: u32) -> Result<Vec<Shard>, Error> {
        let kind = super::super::kind(kind).unwrap();
        super::shards(kind, request, seed, &Resources { shards, ..kind.resources })
    }

    #[test]
    fn field_is_refused_by_name() {
        let refused = |kind: &str, request: Value, shards: u32| {
            divided(kind, &request, 0, shards).unwrap_err().to_string()
        };
        let err = refused("expert", json!({ "object": "cube" }), 2);
        assert!(
            err.contains("resources.shards = 2") && err.contains("it is for blind, evaluation, gathering"),
            "{err}"
        );
        let err = refused("blind", json!({ "seeds": 3 }), 4);
        assert!(err.contains("3 seeds; give at most 3"), "{err}");
        let err = refused("blind", json!({ "seeds": u64::MAX }), 1000);
        assert!(err.contains("give at most 256"), "{err}");
        let err = refused("gathering", json!({ "objects": ["cube"] }), 2);
        assert!(err.contains("1 objects; give at most 1"), "{err}");
        let err = refused("evaluation", json!({ "policy": "cube" }), 2);
        assert!(err.contains("without a protocol"), "{err}");
        let err = refused("evaluation", json!({ "policy": "imitation-1", "protocol": "wide" }), 2);
        assert!(err.contains("give objects, or \"seen\""), "{err}");
        let kind = super::super::kind("blind").unwrap();
        let request = json!({ "seeds": 3 });
        let err = |resources| super::shards(kind, &request, 0, &resources).unwrap_err().to_string();
        assert!(err(Resources { at_once: 2, ..kind.resources }).contains("at_once = 2"));
        assert!(err(Resources { shards: 2, station: true, ..kind.resources }).contains("one station"));
        assert_eq!(super::shards(kind, &request, 0, &kind.resources).unwrap(), []);
    }

    #[test]
    fn objects_are_those_of_the_group_each_once() {
        let objects = |request: Value, shards: u32| -> Vec<Vec<String>> {
            let shards = divided("gathering", &request, 7, shards).unwrap();
            let of_shard = |shard: Shard| {
                assert_eq!(shard.seed, 7);
                serde_json::from_value::<GatheringRequest>(shard.request).unwrap().objects
            };
            shards.into_iter().map(of_shard).collect()
        };
        let seen = objects(json!({}), 4);
        assert_eq!(seen.iter().map(Vec::len).collect::<Vec<_>>(), [3, 3, 2, 2]);
        assert_eq!(seen, objects(json!({ "objects": ["seen"] }), 4));
        let unseen = objects(json!({ "objects": ["unseen"] }), 1).concat();
        assert!(unseen.contains(&"ring".to_owned()) && !seen.concat().contains(&"ring".to_owned()));
        assert_eq!(objects(json!({ "objects": ["all"] }), 20).len(), 20);
        assert_eq!(objects(json!({ "objects": ["ring", "cube"], "count": 3 }), 2), [["ring"], ["cube"]]);
        let request =
            json!({ "policy": "imitation-1", "protocol": "wide", "objects": ["all"], "controls": true });
        for (shard, of_gathering) in divided("evaluation", &request, 7, 6)
            .unwrap()
            .into_iter()
            .zip(objects(json!({ "objects": ["all"] }), 6))
        {
            let of_shard: EvaluationRequest = serde_json::from_value(shard.request).unwrap();
            assert_eq!((of_shard.objects, of_shard.controls, shard.seed), (of_gathering, true, 7));
        }
    }

    proptest! {
        #[test]
        fn shards_have_each_seed_once_and_in_order(seeds in 1u64..2000, shards in 1u32..=256, first in 0u64..1 << 40) {
            prop_assume!(u64::from(shards) <= seeds);
            let request = json!({ "seeds": seeds, "nulls": 3, "only": ["gain"] });
            let parts = divided("blind", &request, first, shards).unwrap();
            prop_assert_eq!(parts.len(), shards as usize);
            let mut next = first;
            for part in parts {
                let of_part: BlindRequest = serde_json::from_value(part.request).unwrap();
                prop_assert_eq!((part.seed, of_part.nulls, of_part.only.len()), (next, 3, 1));
                prop_assert!(of_part.seeds >= seeds / u64::from(shards) && of_part.seeds > 0);
                next += of_part.seeds;
            }
            prop_assert_eq!(next, first + seeds);
        }
    }
}
