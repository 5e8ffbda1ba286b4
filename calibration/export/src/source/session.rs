//! Takes of a session.

use std::{fs, path::Path};

use palpate_recording::{JointLog, Session, Take};

use super::{
    Episode, Log, Origin, RawKind, Setup, StreamSetup, Touch, file_name, folder_name, sha256, words,
};
use crate::{ExportError, clock::ns_from_secs};

pub(super) fn read(session: &Session, take_idx: usize, path: &Path) -> Result<Episode, ExportError> {
    let take = session.take(take_idx)?;
    let bytes = fs::read(path).map_err(ExportError::io("read", path))?;
    let station = &take.station;
    let layout = &station.layout;
    let streams = layout.streams.iter().map(|stream| StreamSetup {
        id: stream.id.clone(),
        raw_unit: stream.raw_unit.clone(),
        rate_hz: stream.rate_hz,
        channels: layout.channels[stream.channels.clone()].iter().map(|channel| channel.id.clone()).collect(),
    });
    let setup = Setup {
        station: station.id.clone(),
        rate_hz: station.joint_rate_hz,
        joints: station.robot.dofs().map(|joint| joint.name.clone()).collect(),
        streams: streams.collect(),
        raw: RawKind::AsRead,
    };
    let object = &take.meta.object;
    let label = station.objects.get(object).map_or_else(|| words(object), |object| object.label.clone());
    let primitive = take.meta.primitive.clone();
    let task = match primitive.as_str() {
        "" => label,
        _ => format!("{}: {label}", words(&primitive)),
    };
    let object_poses = object_poses(&take);
    let touch = take.streams.into_iter().map(|log| Touch {
        active: Log { times_ns: all_ns(&log.times_s), values: log.active },
        raw: log.raw,
    });
    Ok(Episode {
        task,
        joints: joints(take.joints),
        commands: joints(take.commands),
        streams: touch.collect(),
        object_poses,
        outcome: None,
        origin: Origin {
            folder: folder_name(path),
            file: file_name(path),
            sha256: sha256(&bytes),
            format: "mcap_take",
            object: object.clone(),
            primitive,
        },
        setup,
    })
}

/// Where the object is; of one that stands still, from the start on.
fn object_poses(take: &Take) -> Log<f64> {
    let log = &take.object_poses;
    let still = [take.meta.base_from_object];
    let (times_ns, poses) = match log.poses.as_slice() {
        [] => (vec![0], &still[..]),
        poses => (all_ns(&log.times_s), poses),
    };
    let numbers = poses.iter().flat_map(|pose| {
        let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
        [t.x, t.y, t.z, q.w, q.i, q.j, q.k]
    });
    Log { times_ns, values: numbers.collect() }
}

fn joints(log: JointLog) -> Log<f64> {
    Log { times_ns: all_ns(&log.times_s), values: log.positions }
}

fn all_ns(times_s: &[f64]) -> Vec<u64> {
    times_s.iter().map(|&time_s| ns_from_secs(time_s)).collect()
}
