//! Examples of the document: commands that a test carries out as they are written, in this order.

use axum::http::Method;

/// A command, and the status of the answer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Example {
    method: &'static str,
    path: &'static str,
    /// `$PALPATE_URL` is the address of the studio, `$LEASE` the lease of an operator who has control.
    pub(super) curl: &'static str,
    pub(super) status: u16,
}

/// The examples of a route, each with its place in the order of all.
pub(super) fn of(method: &Method, path: &str) -> impl Iterator<Item = (usize, &'static Example)> {
    let all = EXAMPLES.iter().enumerate();
    all.filter(move |(_, example)| example.method == method.as_str() && example.path == path)
}

const EXAMPLES: &[Example] = &[
    Example { method: "GET", path: "/info", curl: r#"curl "$PALPATE_URL/api/v1/info""#, status: 200 },
    Example {
        method: "GET",
        path: "/openapi.json",
        curl: r#"curl -o openapi.json "$PALPATE_URL/api/v1/openapi.json""#,
        status: 200,
    },
    Example { method: "GET", path: "/stations", curl: r#"curl "$PALPATE_URL/api/v1/stations""#, status: 200 },
    Example {
        method: "GET",
        path: "/station",
        curl: r#"curl -o station.json "$PALPATE_URL/api/v1/station""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/objects",
        curl: r#"curl -o objects.json "$PALPATE_URL/api/v1/objects""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/sessions",
        curl: r#"curl -H "Content-Type: application/zip" --data-binary @recordings.zip "$PALPATE_URL/api/v1/sessions?name=bench""#,
        status: 201,
    },
    Example { method: "GET", path: "/sessions", curl: r#"curl "$PALPATE_URL/api/v1/sessions""#, status: 200 },
    Example {
        method: "GET",
        path: "/sessions",
        curl: r#"curl -i "$PALPATE_URL/api/v1/sessions?limit=10""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/sessions/{session}",
        curl: r#"curl "$PALPATE_URL/api/v1/sessions/bench""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/sessions/{session}/check",
        curl: r#"curl "$PALPATE_URL/api/v1/sessions/bench/check""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/sessions/{session}/station",
        curl: r#"curl -o station.json "$PALPATE_URL/api/v1/sessions/bench/station""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/sessions/{session}/takes/{take}/trace",
        curl: r#"curl -o take-01.pb "$PALPATE_URL/api/v1/sessions/bench/takes/take-01/trace""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/sessions/{session}/takes/{take}/replay",
        curl: r#"curl -o replay.pb "$PALPATE_URL/api/v1/sessions/bench/takes/take-01/replay?model=nominal""#,
        status: 200,
    },
    Example {
        method: "DELETE",
        path: "/sessions/{session}",
        curl: r#"curl -X DELETE "$PALPATE_URL/api/v1/sessions/bench""#,
        status: 204,
    },
    Example {
        method: "POST",
        path: "/sessions/{session}/restore",
        curl: r#"curl -X POST "$PALPATE_URL/api/v1/sessions/bench/restore""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/calibrations",
        curl: r#"curl -H "Idempotency-Key: monday-1" --json '{"session": "bench"}' "$PALPATE_URL/api/v1/calibrations""#,
        status: 202,
    },
    Example {
        method: "POST",
        path: "/calibrations",
        curl: r#"curl -H "Idempotency-Key: monday-1" --json '{"session": "bench"}' "$PALPATE_URL/api/v1/calibrations""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/jobs/{job}/events",
        curl: r#"curl -N "$PALPATE_URL/api/v1/jobs/run-1/events""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/calibrations",
        curl: r#"curl "$PALPATE_URL/api/v1/calibrations?limit=10""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/calibrations/{run}",
        curl: r#"curl "$PALPATE_URL/api/v1/calibrations/run-1""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/calibrations/{run}/report.html",
        curl: r#"curl -o report.html "$PALPATE_URL/api/v1/calibrations/run-1/report.html""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/calibrations/{run}/cancel",
        curl: r#"curl -X POST "$PALPATE_URL/api/v1/calibrations/run-1/cancel""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/calibrations/{run}/save",
        curl: r#"curl --json '{"name": "Bench monday"}' "$PALPATE_URL/api/v1/calibrations/run-1/save""#,
        status: 201,
    },
    Example { method: "GET", path: "/models", curl: r#"curl "$PALPATE_URL/api/v1/models""#, status: 200 },
    Example {
        method: "GET",
        path: "/models/{model}",
        curl: r#"curl -o bench-monday.toml "$PALPATE_URL/api/v1/models/bench-monday""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/jobs/{job}/files/{file}",
        curl: r#"curl -O "$PALPATE_URL/api/v1/jobs/run-1/files/report.json""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/jobs/{job}/files/{file}",
        curl: r#"curl -r 0-99 "$PALPATE_URL/api/v1/jobs/run-1/files/report.json""#,
        status: 206,
    },
    Example {
        method: "POST",
        path: "/diagnoses",
        curl: r#"curl -H "Idempotency-Key: monday-2" --json '{"session": "bench", "model": "bench-monday", "max_effects": 1}' "$PALPATE_URL/api/v1/diagnoses""#,
        status: 202,
    },
    Example {
        method: "POST",
        path: "/jobs",
        curl: r#"curl -H "Idempotency-Key: monday-3" --json '{"kind": "diagnose", "request": {"session": "bench"}, "seed": 7}' "$PALPATE_URL/api/v1/jobs""#,
        status: 202,
    },
    Example {
        method: "POST",
        path: "/jobs/{job}/clone",
        curl: r#"curl --json '{"request": {"max_effects": 3}}' "$PALPATE_URL/api/v1/jobs/diagnosis-2/clone""#,
        status: 202,
    },
    Example {
        method: "POST",
        path: "/jobs/{job}/cancel",
        curl: r#"curl -X POST "$PALPATE_URL/api/v1/jobs/diagnosis-3/cancel""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/jobs/{job}/retry",
        curl: r#"curl -X POST "$PALPATE_URL/api/v1/jobs/diagnosis-3/retry""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/diagnoses/{run}/cancel",
        curl: r#"curl -X POST "$PALPATE_URL/api/v1/diagnoses/diagnosis-3/cancel""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/jobs/{job}/cancel",
        curl: r#"curl -X POST "$PALPATE_URL/api/v1/jobs/diagnosis-2/cancel""#,
        status: 200,
    },
    Example {
        method: "DELETE",
        path: "/jobs/{job}",
        curl: r#"curl -X DELETE "$PALPATE_URL/api/v1/jobs/diagnosis-2""#,
        status: 204,
    },
    Example {
        method: "GET",
        path: "/jobs",
        curl: r#"curl -i "$PALPATE_URL/api/v1/jobs?state=running&limit=10""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/jobs/{job}",
        curl: r#"curl "$PALPATE_URL/api/v1/jobs/diagnosis-1""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/jobs/{job}/log",
        curl: r#"curl "$PALPATE_URL/api/v1/jobs/diagnosis-1/log""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/jobs/{job}/metrics",
        curl: r#"curl "$PALPATE_URL/api/v1/jobs/diagnosis-1/metrics""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/jobs/{job}/events",
        curl: r#"curl -N "$PALPATE_URL/api/v1/jobs/diagnosis-1/events""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/diagnoses",
        curl: r#"curl "$PALPATE_URL/api/v1/diagnoses?limit=10""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/diagnoses/{run}",
        curl: r#"curl "$PALPATE_URL/api/v1/diagnoses/diagnosis-1""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/diagnoses/{run}/report.html",
        curl: r#"curl -o diagnosis.html "$PALPATE_URL/api/v1/diagnoses/diagnosis-1/report.html""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/diagnoses/{run}/save",
        curl: r#"curl --json '{"to": "bench-monday"}' "$PALPATE_URL/api/v1/diagnoses/diagnosis-1/save""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/models/{model}/undo",
        curl: r#"curl -X POST "$PALPATE_URL/api/v1/models/bench-monday/undo""#,
        status: 200,
    },
    Example {
        method: "DELETE",
        path: "/models/{model}",
        curl: r#"curl -X DELETE "$PALPATE_URL/api/v1/models/bench-monday""#,
        status: 204,
    },
    Example {
        method: "POST",
        path: "/models/{model}/restore",
        curl: r#"curl -X POST "$PALPATE_URL/api/v1/models/bench-monday/restore""#,
        status: 200,
    },
    Example { method: "GET", path: "/live", curl: r#"curl "$PALPATE_URL/api/v1/live""#, status: 200 },
    Example {
        method: "PUT",
        path: "/live/model",
        curl: r#"curl -X PUT --json '{"model": "nominal"}' "$PALPATE_URL/api/v1/live/model""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/recording",
        curl: r#"curl "$PALPATE_URL/api/v1/recording""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/recording",
        curl: r#"curl -H "Palpate-Lease: $LEASE" --json '{"plan": "quick_check", "session": "tuesday"}' "$PALPATE_URL/api/v1/recording""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/recording/act",
        curl: r#"curl -H "Palpate-Lease: $LEASE" --json '{"action": "confirm_object", "fixture_trusted": true}' "$PALPATE_URL/api/v1/recording/act""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/recording/wanted",
        curl: r#"curl -H "Palpate-Lease: $LEASE" --json '{"object": "sphere_50mm", "primitive": "quick_tap", "because": "one more"}' "$PALPATE_URL/api/v1/recording/wanted""#,
        status: 200,
    },
    Example {
        method: "DELETE",
        path: "/recording/wanted/{object}/{primitive}",
        curl: r#"curl -X DELETE -H "Palpate-Lease: $LEASE" "$PALPATE_URL/api/v1/recording/wanted/sphere_50mm/quick_tap""#,
        status: 200,
    },
    Example {
        method: "GET",
        path: "/emulator/faults",
        curl: r#"curl "$PALPATE_URL/api/v1/emulator/faults""#,
        status: 200,
    },
    Example {
        method: "PUT",
        path: "/emulator/faults",
        curl: r#"curl -X PUT -H "Palpate-Lease: $LEASE" -H "Content-Type: application/toml" -d '' "$PALPATE_URL/api/v1/emulator/faults""#,
        status: 200,
    },
    Example {
        method: "POST",
        path: "/emulator/object",
        curl: r#"curl -H "Palpate-Lease: $LEASE" --json '{"object": "sphere_50mm"}' "$PALPATE_URL/api/v1/emulator/object""#,
        status: 200,
    },
    Example { method: "GET", path: "/audit", curl: r#"curl "$PALPATE_URL/api/v1/audit""#, status: 200 },
];
