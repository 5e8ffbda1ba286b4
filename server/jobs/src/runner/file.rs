//! `runners.toml` of the data folder: where jobs run.

use std::{
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
    thread,
};

use serde::Deserialize;

use super::{
    Capacity, ProcessRunner, ProcessRunnerConfig, Runner, SlurmConfig, SlurmRunner, StationVariables,
};
use crate::JobsError;

/// How much jobs give way to other processes, where the file does not say so.
const NICE: i32 = 10;
/// Short jobs that run beside others, where the file does not say so.
const SHORT_JOBS: u32 = 1;

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RunnersFile {
    /// Name of the runner of jobs that name none.
    default: Option<String>,
    #[serde(default)]
    process: ProcessFile,
    #[serde(default)]
    slurm: Vec<SlurmConfig>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct ProcessFile {
    /// Cores that jobs share; all of the computer's without.
    cores: Option<u32>,
    /// Short jobs that run beside others.
    short_jobs: Option<u32>,
    /// Whether there is a GPU for jobs; without, whether there is the device file of one.
    gpu: Option<bool>,
    /// 0..=19.
    nice: Option<i32>,
}

/// The runners of the data folder `root`, the usual one first. `command` is what runs a job on this computer: a
/// program, and what comes before `--dir DIR`; `station` is what jobs on the station are told there.
pub fn runners(
    root: &Path,
    command: Vec<PathBuf>,
    station: Option<StationVariables>,
) -> Result<Vec<Arc<dyn Runner>>, JobsError> {
    let path = root.join("runners.toml");
    let problem = |problem: String| JobsError::Content { path: path.clone(), problem };
    let file: RunnersFile = match fs::read_to_string(&path) {
        Ok(text) => {
            toml::from_str(&text).map_err(|err| problem(err.to_string().trim().replace('\n', " ")))?
        }
        Err(err) if err.kind() == io::ErrorKind::NotFound => RunnersFile::default(),
        Err(source) => return Err(JobsError::Io { action: "read", path, source }),
    };
    let all_cores =
        || thread::available_parallelism().map_or(1, |cores| u32::try_from(cores.get()).unwrap_or(1));
    let nice = file.process.nice.unwrap_or(NICE);
    if !(0..=19).contains(&nice) {
        return Err(problem(format!("process.nice = {nice}; expected 0 to 19")));
    }
    if file.process.cores == Some(0) {
        return Err(problem("process.cores = 0; expected at least 1".to_owned()));
    }
    let process = ProcessRunner::new(ProcessRunnerConfig {
        command,
        nice,
        capacity: Capacity {
            cores: file.process.cores.unwrap_or_else(all_cores),
            gpu: file.process.gpu.unwrap_or_else(|| Path::new("/dev/nvidia0").exists()),
            short_jobs: file.process.short_jobs.unwrap_or(SHORT_JOBS).max(1),
        },
        station,
    });
    let mut runners: Vec<Arc<dyn Runner>> = vec![Arc::new(process)];
    for slurm in file.slurm {
        if runners.iter().any(|runner| runner.name() == slurm.name) {
            return Err(problem(format!(
                "two runners are called {:?}; give each a name of its own",
                slurm.name
            )));
        }
        runners.push(Arc::new(SlurmRunner::new(slurm, root)?));
    }
    if let Some(default) = file.default {
        let Some(idx) = runners.iter().position(|runner| runner.name() == default) else {
            let known: Vec<&str> = runners.iter().map(|runner| runner.name()).collect();
            return Err(problem(format!("default = {default:?}; expected one of {}", known.join(", "))));
        };
        runners[..=idx].rotate_right(1);
    }
    Ok(runners)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(text: Option<&str>) -> Result<Vec<String>, String> {
        let dir = tempfile::tempdir().unwrap();
        if let Some(text) = text {
            fs::write(dir.path().join("runners.toml"), text).unwrap();
        }
        let runners = runners(dir.path(), vec!["palpate".into()], None).map_err(|err| err.to_string())?;
        Ok(runners.iter().map(|runner| runner.name().to_owned()).collect())
    }

    #[test]
    fn file_is_optional_and_its_default_comes_first() {
        assert_eq!(names(None).unwrap(), ["process"]);
        let slurm = "[[slurm]]\nname = \"lab\"\nprogram = \"/opt/palpate\"\npartition = \"gpu\"\nlines = [\"#SBATCH --time=60\"]\n";
        assert_eq!(names(Some(slurm)).unwrap(), ["process", "lab"]);
        assert_eq!(names(Some(&format!("default = \"lab\"\n{slurm}"))).unwrap(), ["lab", "process"]);
    }

    #[test]
    fn mistakes_are_named_with_the_file() {
        for (text, word) in [
            ("default = \"lab\"", "expected one of process"),
            ("[process]\nnice = 40", "expected 0 to 19"),
            ("[process]\ncores = 0", "at least 1"),
            ("[process]\nspeed = 3", "unknown field `speed`"),
            ("[[slurm]]\nname = \"process\"\nprogram = \"x\"", "name"),
            ("[[slurm]]\nname = \"a\"", "missing field `program`"),
        ] {
            let err = names(Some(text)).unwrap_err();
            assert!(err.contains(word), "{word:?} is missing in {err:?}");
        }
    }
}
