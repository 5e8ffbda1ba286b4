//! Descriptions of messages, for files that describe themselves.

use prost::Message as _;
use prost_types::FileDescriptorSet;

/// Descriptions of every message, as compiled.
const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

/// The serialized `FileDescriptorSet` of the message of recordings called `full_name`: its file and all that it imports,
/// dependencies first, as MCAP's `protobuf` schema encoding wants it. `None` if there is no such message.
///
/// ```
/// assert!(palpate_messages::descriptor_set("palpate.TactileSample").is_some());
/// assert!(palpate_messages::descriptor_set("palpate.Unknown").is_none());
/// ```
pub fn descriptor_set(full_name: &str) -> Option<Vec<u8>> {
    descriptor_set_among(DESCRIPTORS, full_name)
}

/// The same for a message of the serialized set `descriptors`, whose files have their dependencies before them.
pub fn descriptor_set_among(descriptors: &[u8], full_name: &str) -> Option<Vec<u8>> {
    let all = FileDescriptorSet::decode(descriptors).ok()?;
    let (package, message) = full_name.rsplit_once('.')?;
    let home = all.file.iter().position(|file| {
        file.package() == package && file.message_type.iter().any(|declared| declared.name() == message)
    })?;
    let mut needed = vec![false; all.file.len()];
    let mut pending = vec![home];
    while let Some(file_idx) = pending.pop() {
        if std::mem::replace(&mut needed[file_idx], true) {
            continue;
        }
        for import in &all.file[file_idx].dependency {
            pending.extend(all.file.iter().position(|file| file.name() == import));
        }
    }
    // The compiler already put dependencies first.
    let file = all.file.into_iter().zip(needed).filter_map(|(file, needed)| needed.then_some(file)).collect();
    Some(FileDescriptorSet { file }.encode_to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_holds_the_message_and_its_imports_only_dependencies_first() {
        let files_of = |name: &str| -> Vec<String> {
            let set = FileDescriptorSet::decode(descriptor_set(name).unwrap().as_slice()).unwrap();
            set.file.iter().map(|file| file.name().to_owned()).collect()
        };
        assert_eq!(
            files_of("palpate.TactileSample"),
            ["google/protobuf/timestamp.proto", "palpate/tactile.proto"]
        );
        let joints = files_of("foxglove.JointStates");
        assert_eq!(joints.len(), 3);
        assert_eq!(joints.last().unwrap(), "foxglove/JointStates.proto");
        let poses = files_of("foxglove.PoseInFrame");
        assert_eq!(poses.len(), 5);
        assert_eq!(poses.last().unwrap(), "foxglove/PoseInFrame.proto");
    }

    #[test]
    fn every_import_precedes_the_file_that_needs_it() {
        for name in [
            "foxglove.JointStates",
            "foxglove.Log",
            "foxglove.PoseInFrame",
            "palpate.Marker",
            "palpate.TactileAxes",
        ] {
            let set = FileDescriptorSet::decode(descriptor_set(name).unwrap().as_slice()).unwrap();
            for (file_idx, file) in set.file.iter().enumerate() {
                for import in &file.dependency {
                    let import_idx = set.file.iter().position(|other| other.name() == import).unwrap();
                    assert!(import_idx < file_idx, "{import} must precede {}", file.name());
                }
            }
        }
    }

    #[test]
    fn a_message_in_no_file_has_no_set() {
        assert!(descriptor_set("TactileSample").is_none());
        assert!(descriptor_set("foxglove.TactileSample").is_none());
    }
}
