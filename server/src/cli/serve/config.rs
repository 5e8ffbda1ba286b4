//! `palpate.toml`: what `palpate serve` is started with, in a file.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
};

use clap::ValueEnum;
use palpate_server::{Error, RetentionConfig};
use serde::Deserialize;

use super::ServeArgs;

/// How the log is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub(crate) enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// A JSON object a line, for programs.
    Json,
}

/// What `--print-default-config` prints.
pub(super) const DEFAULT: &str = r#"# Configuration of `palpate serve --config FILE`. Each key is an option of the command line, which wins where both are given.
# Relative paths start at this file's folder. Keys that are commented out have no default.

# Address to listen on. Beyond this computer people log in, over TLS (docs/people.md).
listen = "127.0.0.1:8080"
# Where sessions, models and jobs are kept.
data = "data"
# How the log is written: "text" or "json".
log = "text"

# The station: a station file, or the id of a shipped one; and where its devices are, if not where the file says.
# station = "station.toml"
# ports = ["u2d2=/dev/ttyUSB1", "xarm=192.168.1.212"]
# Or an emulated station: a truth file, or the name of a shipped one.
# emulate = "demo"

# Host names by which browsers reach this studio, besides localhost and addresses.
allow_hosts = []
# Origins whose pages may watch over Foxglove's protocol (docs/tools.md), e.g. ["https://app.foxglove.dev"].
foxglove_origins = []
# Everybody has to log in, also on this computer.
login = false
# A proxy in front has TLS, and says in X-Forwarded-For from where requests come.
behind_proxy = false
# Speak TLS on this computer too, by the studio's own certificate; or by one of the lab.
tls = false
# tls_cert = "chain.pem"
# tls_key = "key.pem"
# Neither login nor TLS, whatever the address: anybody in the network may take control of the robot.
insecure = false

# The program that learns, for jobs such as "expert" (docs/jobs.md); without, the one beside palpate, or on PATH.
[train]
# binary = "palpate-train"

# What goes by itself (docs/operations.md): nothing, unless a number of days is given here. Accepted takes stay, and so does
# what something refers to. `palpate retention --config FILE --dry-run` says what would go, and why.
[retention]
# Jobs that ended longer ago than this go to the trash.
# jobs_days = 180
# Logs and curves of jobs that ended longer ago than this are deleted.
# log_days = 90
# What has been in the trash for longer than this is deleted.
# trash_days = 90
"#;

#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Config {
    listen: Option<SocketAddr>,
    pub(crate) data: Option<PathBuf>,
    log: Option<LogFormat>,
    station: Option<PathBuf>,
    #[serde(default)]
    ports: Vec<String>,
    emulate: Option<PathBuf>,
    #[serde(default)]
    allow_hosts: Vec<String>,
    #[serde(default)]
    foxglove_origins: Vec<String>,
    #[serde(default)]
    login: bool,
    #[serde(default)]
    behind_proxy: bool,
    #[serde(default)]
    tls: bool,
    tls_cert: Option<PathBuf>,
    tls_key: Option<PathBuf>,
    #[serde(default)]
    insecure: bool,
    #[serde(default)]
    train: TrainConfig,
    #[serde(default)]
    pub(crate) retention: RetentionConfig,
}

/// `[train]`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
struct TrainConfig {
    binary: Option<PathBuf>,
}

impl Config {
    /// The file at `path`.
    pub(crate) fn read(path: &Path) -> Result<Self, Error> {
        Self::parse(path, &std::fs::read_to_string(path).map_err(Error::io("read", path))?)
    }

    fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        // The parser's message shows line, column and the keys that there are.
        toml::from_str(text).map_err(|err| Error::Content(format!("{}: {err}", path.display())))
    }
}

impl ServeArgs {
    /// Fills in what the configuration file says and the command line does not.
    pub(crate) fn read_config(&mut self) -> Result<(), Error> {
        let Some(path) = &self.config else { return Ok(()) };
        let config = Config::read(path)?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let refused = |problem: &str| Err(Error::Content(format!("{}: {problem}", path.display())));
        if config.tls_cert.is_some() != config.tls_key.is_some() {
            return refused("tls_cert and tls_key belong together; give both or none");
        }
        if config.station.is_some() && config.emulate.is_some() {
            return refused("station and emulate are two stations; give one of them");
        }
        if config.station.is_none() && !config.ports.is_empty() {
            return refused("ports say where devices of a station are; give the station too");
        }
        let at = |path: PathBuf| folder.join(path);
        // A name is that of a shipped one, unless there is such a file.
        let found = |name: PathBuf| if folder.join(&name).exists() { folder.join(name) } else { name };
        self.listen = self.listen.or(config.listen);
        self.data = self.data.take().or(config.data.map(at));
        self.log = self.log.or(config.log);
        if self.emulate.is_none() && !self.station.is_given() {
            self.emulate = config.emulate.map(found);
            self.station.fill_in(config.station.map(found), config.ports);
        }
        if self.hosts.is_empty() {
            self.hosts = config.allow_hosts;
        }
        if self.foxglove_origins.is_empty() {
            self.foxglove_origins = config.foxglove_origins;
        }
        self.train = self.train.take().or(config.train.binary.map(at));
        self.retention.fill_in(config.retention);
        self.login |= config.login;
        self.behind_proxy |= config.behind_proxy;
        self.insecure |= config.insecure;
        if self.tls_cert.is_none() && !self.tls {
            self.tls = config.tls;
            self.tls_cert = config.tls_cert.map(at);
            self.tls_key = config.tls_key.map(at);
        }
        Ok(())
    }

    /// How the log is written.
    pub(crate) fn log_format(&self) -> LogFormat {
        self.log.unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use clap::Parser as _;

    use super::*;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        serve: ServeArgs,
    }

    fn args(line: &[&str]) -> ServeArgs {
        Line::try_parse_from([&["palpate"], line].concat()).unwrap().serve
    }

    #[test]
    fn the_default_that_is_printed_says_what_is_the_default() {
        let printed = Config::parse(Path::new("palpate.toml"), DEFAULT).unwrap();
        let nothing = Config {
            listen: Some(super::super::LISTEN.parse().unwrap()),
            data: Some(super::super::DATA.into()),
            log: Some(LogFormat::Text),
            ..Config::default()
        };
        assert_eq!(printed, nothing);
        // What is commented out is known as well.
        let (mut all, mut last) = (String::new(), "");
        for line in DEFAULT.lines() {
            let key = line.trim_start_matches("# ");
            let is_key = key
                .split_once(" = ")
                .is_some_and(|(name, _)| name.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_'));
            let is_table = line.starts_with('[');
            if is_table || is_key && key != last {
                all += key;
                all.push('\n');
                last = key;
            }
        }
        let all = Config::parse(Path::new("palpate.toml"), &all).unwrap();
        assert_eq!(all.tls_key, Some("key.pem".into()));
        assert_eq!(all.train.binary, Some("palpate-train".into()));
        assert_eq!(
            all.retention,
            RetentionConfig { jobs_days: Some(180), log_days: Some(90), trash_days: Some(90) }
        );
        assert_eq!(all.emulate, Some("demo".into()));
    }

    #[test]
    fn flags_win_and_paths_start_at_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("palpate.toml");
        fs::write(dir.path().join("mine.toml"), "").unwrap();
        fs::write(
            &path,
            "listen = \"127.0.0.1:1\"\ndata = \"d\"\nstation = \"mine.toml\"\nports = [\"u2d2=/dev/x\"]\nallow_hosts = [\"a\"]\nlog = \"json\"\nlogin = true\n",
        )
        .unwrap();
        let config = path.to_str().unwrap();
        let mut from_file = args(&["--config", config]);
        from_file.read_config().unwrap();
        assert_eq!(from_file.listen, Some("127.0.0.1:1".parse().unwrap()));
        assert_eq!(from_file.data, Some(dir.path().join("d")));
        assert!(from_file.station.is_given() && from_file.login);
        assert_eq!((from_file.log_format(), from_file.hosts), (LogFormat::Json, vec!["a".to_owned()]));
        let mut both = args(&[
            "--config",
            config,
            "--listen",
            "127.0.0.1:2",
            "--data",
            "e",
            "--emulate",
            "demo",
            "--allow-host",
            "b",
            "--log",
            "text",
        ]);
        both.read_config().unwrap();
        assert_eq!(both.listen, Some("127.0.0.1:2".parse().unwrap()));
        assert_eq!((both.data.clone(), both.emulate.clone()), (Some("e".into()), Some("demo".into())));
        assert!(!both.station.is_given());
        assert_eq!((both.log_format(), both.hosts), (LogFormat::Text, vec!["b".to_owned()]));
    }

    #[test]
    fn what_is_wrong_is_named_with_file_and_key() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("palpate.toml");
        for (text, words) in [
            ("lisen = \"127.0.0.1:1\"", "unknown field `lisen`"),
            ("listen = \"here\"", "listen"),
            ("login = \"yes\"", "login"),
            ("log = \"xml\"", "log"),
            ("tls_cert = \"a.pem\"", "tls_cert and tls_key belong together"),
            ("station = \"a\"\nemulate = \"b\"", "two stations"),
            ("ports = [\"a=b\"]", "give the station too"),
            ("listen = ", "line 1"),
            ("[train]\nprogram = \"x\"", "unknown field `program`"),
            ("[retention]\njobs_days = -1", "jobs_days"),
        ] {
            fs::write(&path, text).unwrap();
            let err = args(&["--config", path.to_str().unwrap()]).read_config().unwrap_err().to_string();
            assert!(err.contains(words) && err.contains("palpate.toml"), "{text}: {err}");
        }
    }
}
