//! What a job reads, by hash: the same job on other data is another job.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    fs::File,
    io::{self, Read as _},
    path::{Path, PathBuf},
};

use palpate_wire::api::JobSpec;
use sha2::{Digest as _, Sha256};

use crate::{Database, JobsError};

/// SHA-256 of each of `files` by its path relative to `root`.
pub(crate) fn hash(
    database: &Database,
    root: &Path,
    files: &[PathBuf],
) -> Result<BTreeMap<String, String>, JobsError> {
    let mut hashes = BTreeMap::new();
    for path in files {
        let name = path.strip_prefix(root).unwrap_or(path).to_string_lossy().into_owned();
        let file = File::open(path).map_err(JobsError::io("read", path))?;
        let meta = file.metadata().map_err(JobsError::io("read", path))?;
        let hash = match database.known_hash(&name, &meta)? {
            Some(hash) => hash,
            None => {
                let hash = hash_file(file).map_err(JobsError::io("read", path))?;
                database.keep_hash(&name, &meta, &hash)?;
                hash
            }
        };
        hashes.insert(name, hash);
    }
    Ok(hashes)
}

/// Refuses inputs that are not what they were when the job was asked for. Paths are relative to `root`.
pub fn check_inputs(spec: &JobSpec, root: &Path) -> Result<(), JobsError> {
    for (name, expected) in &spec.inputs {
        let path = root.join(name);
        let found = File::open(&path).and_then(hash_file).map_err(JobsError::io("read", &path))?;
        if found != *expected {
            return Err(JobsError::Content {
                path,
                problem: "it has changed since the job was asked for; ask for the job again".to_owned(),
            });
        }
    }
    Ok(())
}

fn hash_file(mut file: File) -> io::Result<String> {
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 20];
    loop {
        let read = file.read(&mut buffer)?;
        if read == 0 {
            break;
        }
        hasher.update(&buffer[..read]);
    }
    let mut text = String::with_capacity(64);
    for byte in hasher.finalize() {
        // Writing into a string cannot fail.
        let _ = write!(text, "{byte:02x}");
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn input_that_changed_is_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let database = Database::open(&dir.path().join("palpate.sqlite")).unwrap();
        let path = dir.path().join("take.mcap");
        fs::write(&path, "abc").unwrap();
        let inputs = hash(&database, dir.path(), std::slice::from_ref(&path)).unwrap();
        // FIPS 180-2, appendix B.1.
        assert_eq!(inputs["take.mcap"], "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert_eq!(hash(&database, dir.path(), std::slice::from_ref(&path)).unwrap(), inputs, "kept");
        let spec = JobSpec {
            kind: "calibrate".to_owned(),
            request: serde_json::Value::Null,
            inputs,
            seed: 0,
            software: String::new(),
            priority: 0,
            resources: palpate_wire::api::Resources::default(),
        };
        check_inputs(&spec, dir.path()).unwrap();
        fs::write(&path, "abcd").unwrap();
        let err = check_inputs(&spec, dir.path()).unwrap_err().to_string();
        assert!(err.contains("take.mcap") && err.contains("changed"), "{err}");
        let again = hash(&database, dir.path(), std::slice::from_ref(&path)).unwrap();
        assert_ne!(again, spec.inputs, "what is kept belongs to the file as it was");
    }
}
