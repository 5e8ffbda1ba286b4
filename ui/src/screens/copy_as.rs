//! How a script, a shell or a notebook asks for what a form asks for: text to copy.

use palpate_wire::api::{CalibrationRequest, DiagnosisRequest, Job, JobRequest, Resources};

use super::controls::name_button;

/// The same request in three forms.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Forms {
    /// A line for a shell, to a studio on this computer or at `$PALPATE_URL`.
    pub curl: String,
    /// A script for the Python client, which reads the same variable.
    pub python: String,
    /// `palpate` itself, on the studio's computer, beside its data folder; `None` where it does not do that.
    pub command: Option<String>,
}

/// Buttons that copy `forms`.
pub fn copy_ui(ui: &mut egui::Ui, forms: &Forms) {
    ui.horizontal_wrapped(|ui| {
        ui.label("Copy as");
        let all = [
            ("curl", Some(&forms.curl)),
            ("Python", Some(&forms.python)),
            ("command line", forms.command.as_ref()),
        ];
        for (name, text) in all {
            let Some(text) = text else { continue };
            let button = ui.button(name).on_hover_text(text);
            name_button(&button, &format!("Copy as {name}"));
            if button.clicked() {
                ui.ctx().copy_text(text.clone());
            }
        }
    });
}

/// Where `palpate serve` keeps its data unless it is told otherwise; the API does not tell.
pub const DATA_FOLDER: &str = "data";

/// A calibration; `data` is the data folder.
pub fn calibration(request: &CalibrationRequest, data: &str) -> Forms {
    let mut python = vec![json(&request.session)];
    let mut command =
        format!("palpate calibrate --session {}", quoted(&format!("{data}/sessions/{}", request.session)));
    if let Some(method) = &request.method {
        python.push(format!("method={}", json(method)));
        command += &format!(" --method {}", quoted(method));
    }
    if let Some(takes) = &request.hold_out {
        python.push(format!("hold_out={}", json(takes)));
        command += &format!(" --hold-out {}", quoted(&takes.join(",")));
    }
    if request.shared_theta {
        python.push("shared_theta=True".to_owned());
        command += " --shared-theta";
    }
    Forms {
        curl: curl("/calibrations", &json(request)),
        python: script(&format!("p.calibrate({})", python.join(", "))),
        command: Some(command),
    }
}

/// A diagnosis; `data` is the data folder.
pub fn diagnosis(request: &DiagnosisRequest, data: &str) -> Forms {
    let mut python = vec![json(&request.session)];
    let session = quoted(&format!("{data}/sessions/{}", request.session));
    let mut command = format!("palpate diagnose --session {session} --data {}", quoted(data));
    if let Some(model) = &request.model {
        python.push(format!("model={}", json(model)));
        // The station's own model has no file of its own; the command starts from it without a word.
        if model != "nominal" {
            command += &format!(" --model {}", quoted(&format!("{data}/models/{model}.toml")));
        }
    }
    if let Some(takes) = &request.hold_out {
        python.push(format!("hold_out={}", json(takes)));
        command += &format!(" --hold-out {}", quoted(&takes.join(",")));
    }
    if let Some(most) = request.max_effects {
        python.push(format!("max_effects={most}"));
        command += &format!(" --max-effects {most}");
    }
    if !request.without.is_empty() {
        python.push(format!("without={}", json(&request.without)));
        command += &format!(" --without {}", quoted(&request.without.join(",")));
    }
    if let Some(sessions) = request.null_sessions {
        python.push(format!("null_sessions={sessions}"));
        command += &format!(" --null-bar {sessions}");
    }
    if !request.references.is_empty() {
        python.push(format!("references={}", json(&request.references)));
        for reference in &request.references {
            command += &format!(" --reference {}", quoted(&format!("{data}/sessions/{reference}")));
        }
    }
    Forms {
        curl: curl("/diagnoses", &json(request)),
        python: script(&format!("p.diagnose({})", python.join(", "))),
        command: Some(command),
    }
}

/// A job that is to be started; `data` is the data folder.
pub fn submission(asked: &JobRequest, data: &str) -> Forms {
    let request = asked.request.to_string();
    let data = if data == DATA_FOLDER { String::new() } else { format!(" --data {}", quoted(data)) };
    let mut needs = String::new();
    if let Some(Resources { cores, gpu, shards, at_once, .. }) = asked.resources {
        for (flag, number) in [("cores", cores), ("shards", shards), ("at-once", at_once)] {
            if number > 0 {
                needs += &format!(" --{flag} {number}");
            }
        }
        if gpu {
            needs += " --gpu";
        }
    }
    Forms {
        command: Some(format!(
            "palpate jobs submit {} {} --seed {}{needs}{data}",
            quoted(&asked.kind),
            quoted(&request),
            asked.seed
        )),
        ..any(&asked.kind, &asked.request, asked.seed, asked.resources)
    }
}

/// A job of any kind, with its seed.
pub fn job(job: &Job, data: &str) -> Forms {
    // What its kind needs anyway need not be said.
    let resources = Some(job.spec.resources).filter(|needs| needs.shards > 0 || needs.gpu);
    let forms = any(&job.kind, &job.spec.request, job.spec.seed, resources);
    let request = job.spec.request.clone();
    let command = match job.kind.as_str() {
        "calibrate" => {
            serde_json::from_value(request).ok().and_then(|request| calibration(&request, data).command)
        }
        "diagnose" => {
            serde_json::from_value(request).ok().and_then(|request| diagnosis(&request, data).command)
        }
        _ => None,
    };
    let command = command.map(|command| format!("{command} --seed {}", job.spec.seed));
    Forms { command, ..forms }
}

/// A request of any kind, but for the command line.
fn any(kind: &str, request: &serde_json::Value, seed: u64, resources: Option<Resources>) -> Forms {
    let mut body = serde_json::json!({ "kind": kind, "request": request, "seed": seed });
    // JSON is Python where it holds neither true, false nor null; json.loads reads all of it.
    let loads = |value: &serde_json::Value| format!("json.loads({})", json(&value.to_string()));
    let mut needs = String::new();
    if let Some(resources) = resources {
        let resources = said(resources);
        needs = format!(", resources={}", loads(&resources));
        body["resources"] = resources;
    }
    let python = format!(
        "import json\nfrom palpate import Palpate\n\nwith Palpate() as p:\n    job = p.jobs.submit({}, {}, \
         seed={seed}{needs})\n    print(job.wait())\n",
        json(&kind),
        loads(request)
    );
    Forms { curl: curl("/jobs", &body.to_string()), python, command: None }
}

/// `resources` without what is as usual.
fn said(resources: Resources) -> serde_json::Value {
    // Plain data always serialises.
    let mut said = serde_json::to_value(resources).unwrap_or_default();
    if let Some(fields) = said.as_object_mut() {
        fields.retain(|_, value| {
            !matches!(value, serde_json::Value::Null | serde_json::Value::Bool(false)) && *value != 0
        });
    }
    said
}

/// A line for a shell. The address is that of a studio on this computer.
fn curl(path: &str, body: &str) -> String {
    format!(
        "curl -sS -X POST \"${{PALPATE_URL:-http://127.0.0.1:8080}}/api/v1{path}\" -H 'Content-Type: application/json' \
         -d '{}'",
        body.replace('\'', r"'\''")
    )
}

fn script(call: &str) -> String {
    format!("from palpate import Palpate\n\nwith Palpate() as p:\n    run = {call}\n    print(run.wait())\n")
}

/// Strings and lists of them read the same in JSON and in Python.
fn json(value: &impl serde::Serialize) -> String {
    // Plain data always serialises.
    serde_json::to_string(value).unwrap_or_default()
}

/// `text` as one word of a shell.
pub fn quoted(text: &str) -> String {
    let is_plain = !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || "/._-,".contains(c));
    if is_plain { text.to_owned() } else { format!("'{}'", text.replace('\'', r"'\''")) }
}

#[cfg(test)]
mod tests {
    use palpate_wire::api::{JobSpec, JobState};
    use proptest::prelude::*;

    use super::*;

    fn some_job(kind: &str, request: serde_json::Value) -> Job {
        Job {
            id: format!("{kind}-1"),
            kind: kind.into(),
            state: JobState::Done,
            created: String::new(),
            started: None,
            ended: None,
            attempts: 1,
            owner: String::new(),
            runner: "process".into(),
            fraction: 1.0,
            stage: String::new(),
            seconds_left: None,
            problem: None,
            cancel_requested: false,
            saved_as: None,
            spec: JobSpec {
                kind: kind.into(),
                request,
                inputs: [].into(),
                seed: 3,
                software: String::new(),
                priority: 0,
                resources: Default::default(),
            },
        }
    }

    #[test]
    fn a_calibration_is_asked_for_in_three_ways() {
        let request = CalibrationRequest {
            session: "Ada's".into(),
            method: Some("grid".into()),
            hold_out: Some(vec!["take-01".into(), "take-02".into()]),
            shared_theta: false,
        };
        let forms = calibration(&request, "/srv/data");
        assert!(
            forms
                .curl
                .contains(r#"-d '{"session":"Ada'\''s","method":"grid","hold_out":["take-01","take-02"]}'"#)
        );
        assert!(
            forms.python.contains(r#"p.calibrate("Ada's", method="grid", hold_out=["take-01","take-02"])"#)
        );
        let command = r"palpate calibrate --session '/srv/data/sessions/Ada'\''s' --method grid --hold-out take-01,take-02";
        assert_eq!(forms.command.as_deref(), Some(command));
    }

    #[test]
    fn a_diagnosis_carries_every_choice() {
        let request = DiagnosisRequest {
            session: "demo".into(),
            model: Some("demo-exact".into()),
            hold_out: None,
            max_effects: Some(4),
            without: vec!["latency".into()],
            null_sessions: Some(200),
            references: vec!["good-1".into(), "good-2".into(), "good-3".into()],
        };
        let forms = diagnosis(&request, "data");
        let command = "palpate diagnose --session data/sessions/demo --data data --model data/models/demo-exact.toml \
            --max-effects 4 --without latency --null-bar 200 --reference data/sessions/good-1 --reference data/sessions/good-2 \
            --reference data/sessions/good-3";
        assert_eq!(forms.command.as_deref(), Some(command));
        let call = r#"p.diagnose("demo", model="demo-exact", max_effects=4, without=["latency"], null_sessions=200, references=["good-1","good-2","good-3"])"#;
        assert!(forms.python.contains(call), "{}", forms.python);
        let nominal = DiagnosisRequest { model: Some("nominal".into()), ..request };
        assert!(!diagnosis(&nominal, "data").command.is_some_and(|command| command.contains("--model")));
    }

    #[test]
    fn a_job_quotes_what_a_shell_would_read() {
        let forms = job(&some_job("diagnose", serde_json::json!({ "session": "Ada's" })), "data");
        assert!(forms.curl.contains(r"Ada'\''s"), "{}", forms.curl);
        let call = r#"p.jobs.submit("diagnose", json.loads("{\"session\":\"Ada's\"}"), seed=3)"#;
        assert!(forms.python.contains(call), "{}", forms.python);
        assert!(forms.command.is_some_and(|command| command.ends_with("--seed 3")));
        assert_eq!(job(&some_job("blind", serde_json::json!({})), "data").command, None);
    }

    #[test]
    fn parts_and_graphics_card_are_in_every_form() {
        let asked = |resources| JobRequest {
            kind: "gathering".into(),
            request: serde_json::json!({ "count": 20 }),
            seed: 3,
            priority: 0,
            resources: Some(resources),
            runner: None,
        };
        let resources = Resources { shards: 4, cores: 2, at_once: 3, ..Resources::default() };
        let forms = submission(&asked(resources), DATA_FOLDER);
        assert!(forms.curl.contains(r#""resources":{"at_once":3,"cores":2,"shards":4}"#), "{}", forms.curl);
        let call = r#"seed=3, resources=json.loads("{\"at_once\":3,\"cores\":2,\"shards\":4}"))"#;
        assert!(forms.python.contains(call), "{}", forms.python);
        let command =
            r#"palpate jobs submit gathering '{"count":20}' --seed 3 --cores 2 --shards 4 --at-once 3"#;
        assert_eq!(forms.command.as_deref(), Some(command));
        let gpu = Resources { gpu: true, ..Resources::default() };
        let forms = submission(&asked(gpu), DATA_FOLDER);
        assert!(forms.curl.contains(r#""resources":{"gpu":true}"#), "{}", forms.curl);
        assert!(forms.command.is_some_and(|command| command.ends_with("--seed 3 --gpu")));
        // A job that was divided is asked for again divided; one that was not is left to its kind.
        let mut divided = some_job("gathering", serde_json::json!({}));
        assert!(!job(&divided, DATA_FOLDER).curl.contains("resources"));
        divided.spec.resources = resources;
        assert!(job(&divided, DATA_FOLDER).curl.contains(r#""shards":4"#));
    }

    proptest! {
        #[test]
        fn a_quoted_word_reads_back_as_one_word(text in "[^\0]{0,20}") {
            // As POSIX says: nothing is special within single quotes, and \' is a quote outside of them.
            let quoted = quoted(&text);
            let mut read = String::new();
            let mut rest = quoted.chars().peekable();
            let mut within = false;
            while let Some(c) = rest.next() {
                match c {
                    '\'' => within = !within,
                    '\\' if !within => read.extend(rest.next()),
                    c => {
                        prop_assert!(within || c.is_ascii_alphanumeric() || "/._-,".contains(c), "{quoted}");
                        read.push(c);
                    }
                }
            }
            prop_assert!(!within);
            prop_assert_eq!(read, text);
        }
    }
}
