//! `palpate serve` beyond its own computer: people, TLS, and clients that know nothing of this project.

use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::TcpStream,
    path::Path,
    process::{Child, Command, Output, Stdio},
    time::{Duration, Instant},
};

use serde_json::Value;

use crate::support::{arg, palpate_ok, palpate_refuses};

/// A studio in a process of its own.
struct Served {
    process: Child,
    ready: Value,
}

impl Served {
    fn new(data: &Path, more: &[&str]) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_palpate"))
            .args(["serve", "--listen", "127.0.0.1:0", "--json", "--data", arg(data)])
            .args(more)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let ready = serde_json::from_str(&line).unwrap_or_else(|err| panic!("{err}: {line:?}"));
        Self { process, ready }
    }

    fn url(&self) -> &str {
        self.ready["url"].as_str().unwrap()
    }

    fn address(&self) -> &str {
        self.url().split_once("://").unwrap().1
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let pid = rustix::process::Pid::from_child(&self.process);
        // It may have ended already.
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        self.process.wait().unwrap();
    }
}

fn add_person(data: &Path, name: &str, role: &str, password: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"))
        .args(["people", "add", name, "--role", role, "--data", arg(data), "--json"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    writeln!(command.stdin.take().unwrap(), "{password}").unwrap();
    command.wait_with_output().unwrap()
}

fn curl(args: &[&str]) -> (i32, String) {
    let output = Command::new("curl").args(["-sS", "--max-time", "30"]).args(args).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    (output.status.code().unwrap(), text)
}

#[test]
fn people_and_tokens_are_managed_by_the_command_and_needed_beyond_this_computer() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    let listen = ["serve", "--listen", "0.0.0.0:0", "--data", arg(&data)];
    let refused = palpate_refuses(&listen);
    assert!(refused.contains("has to log in") && refused.contains("palpate people add"), "{refused}");
    let added = add_person(&data, "ada", "operator", "correct horse battery");
    assert!(added.status.success(), "{}", String::from_utf8_lossy(&added.stderr));
    let weak = add_person(&data, "bob", "viewer", "short");
    assert_eq!(weak.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&weak.stderr).contains("shorter than 10 characters"));
    let list: Value =
        serde_json::from_str(&palpate_ok(&["people", "list", "--json", "--data", arg(&data)])).unwrap();
    assert_eq!((list.as_array().unwrap().len(), &list[0]["role"]), (1, &Value::from("operator")));
    let refused = palpate_refuses(&["people", "role", "eve", "viewer", "--data", arg(&data)]);
    assert!(refused.contains("no person \"eve\""), "{refused}");
    assert!(palpate_ok(&["people", "role", "ada", "admin", "--data", arg(&data)]).contains("admin"));
    let refused = palpate_refuses(&["people", "remove", "ada", "--data", arg(&data)]);
    assert!(refused.contains("last admin"), "{refused}");
    let create = [
        "tokens",
        "create",
        "ada",
        "--name",
        "ci",
        "--scopes",
        "read,jobs",
        "--expires",
        "30d",
        "--data",
        arg(&data),
    ];
    let secret = palpate_ok(&create);
    assert!(secret.starts_with("plp_") && secret.trim_end().len() == 68, "{secret}");
    let list = palpate_ok(&["tokens", "list", "--data", arg(&data)]);
    assert!(list.contains("read,jobs") && !list.contains(secret.trim_end()), "{list}");
    palpate_ok(&["tokens", "revoke", "1", "--data", arg(&data)]);
    assert!(palpate_refuses(&["tokens", "revoke", "1", "--data", arg(&data)]).contains("no token \"1\""));
    for both in ["--login", "--behind-proxy"] {
        let refused = palpate_refuses(&[listen.as_slice(), &["--insecure", both]].concat());
        assert!(refused.contains("--insecure"), "{refused}");
    }
    let refused =
        palpate_refuses(&[listen.as_slice(), &["--tls-cert", "no.pem", "--tls-key", "no.pem"]].concat());
    assert!(refused.contains("no.pem"), "{refused}");
}

#[test]
fn curl_gets_in_over_tls_with_a_token_and_stalled_handshakes_are_cut_off() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    assert!(add_person(&data, "ada", "viewer", "correct horse battery").status.success());
    let token = palpate_ok(&["tokens", "create", "ada", "--name", "curl", "--data", arg(&data)]);
    let authorization = format!("Authorization: Bearer {}", token.trim_end());
    let studio = Served::new(&data, &["--login", "--tls"]);
    let (url, cert) = (studio.url(), studio.ready["certificate"].as_str().unwrap());
    assert!(url.starts_with("https://127.0.0.1:"), "{url}");
    assert_eq!(studio.ready["fingerprint"].as_str().unwrap().len(), 95);

    let me = format!("{url}/api/v1/me");
    let (untrusted, _) = curl(&[&me]);
    assert_eq!(untrusted, 60, "curl does not know the certificate");
    for version in ["--tlsv1.2", "--tlsv1.3"] {
        let (code, text) = curl(&[version, "--cacert", cert, "-H", &authorization, &me]);
        assert_eq!(code, 0);
        let me: Value = serde_json::from_str(&text).unwrap();
        assert_eq!((&me["name"], &me["via"], &me["token"]), (&"ada".into(), &"token".into(), &"curl".into()));
    }
    let (_, status) = curl(&[
        "--cacert",
        cert,
        "-o",
        "/dev/null",
        "-w",
        "%{http_code} %{redirect_url}",
        &format!("{url}/"),
    ]);
    assert_eq!(status, format!("303 {url}/login"));
    let health = format!("{url}/healthz");
    assert_eq!(curl(&["--cacert", cert, &health]), (0, "ok\n".to_owned()));

    let (_, plain) = curl(&[&url.replace("https", "http")]);
    assert!(plain.contains("speaks HTTPS"), "{plain}");

    // Connections that begin no handshake, or half of one, are cut off; meanwhile others get in.
    let begun = Instant::now();
    let mut stalled: Vec<TcpStream> =
        (0..40).map(|_| TcpStream::connect(studio.address()).unwrap()).collect();
    for stream in stalled.iter_mut().skip(20) {
        stream.write_all(&[0x16, 0x03, 0x01, 0x02]).unwrap();
    }
    assert_eq!(curl(&["--cacert", cert, &health]).0, 0);
    for stream in &mut stalled {
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        // Closed or reset, after an alert perhaps; a time-out would be an error of another kind.
        let ended = stream.read_to_end(&mut Vec::new());
        assert!(!ended.is_err_and(|err| err.kind() == std::io::ErrorKind::WouldBlock));
    }
    assert!(begun.elapsed() >= Duration::from_secs(1), "not at once: slow networks need a moment");
}
