//! What the Python client asks for is there: every route that its sources name is in the table.

use std::{collections::BTreeSet, fs, path::Path};

use palpate_server::{Access, Studio, routes};

/// Methods and paths that a source names, written as the client's calls have them: `"GET", "/sessions/{session}"`.
fn named(source: &str) -> Vec<(String, String)> {
    let mut found = Vec::new();
    for method in ["GET", "POST", "PUT", "DELETE"] {
        let quoted = format!("\"{method}\"");
        for (start, _) in source.match_indices(&quoted) {
            let rest = source[start + quoted.len()..].trim_start_matches([',', ' ', '\n']);
            let path = rest.strip_prefix('"').and_then(|rest| rest.split('"').next());
            if let Some(path) = path.filter(|path| path.starts_with('/')) {
                found.push((method.to_owned(), path.to_owned()));
            }
        }
    }
    found
}

#[test]
fn the_search_finds_routes_and_nothing_else() {
    let source = "x(\"GET\", \"/info\")\ny(\n    \"POST\",\n    \"/models/{model}/undo\",\n)\nif method == \"GET\" else 1";
    let expected = [("GET", "/info"), ("POST", "/models/{model}/undo")];
    assert_eq!(named(source), expected.map(|(method, path)| (method.to_owned(), path.to_owned())));
}

#[test]
fn every_route_that_the_python_client_names_is_in_the_table() {
    let data = tempfile::tempdir().unwrap();
    let studio = Studio::open(data.path(), None, Access::default()).unwrap();
    let table: BTreeSet<(String, String)> =
        routes(&studio.state).iter().map(|route| (route.method.to_string(), route.path.to_owned())).collect();
    let client = Path::new(env!("CARGO_MANIFEST_DIR")).join("../clients/python/src/palpate");
    let mut asked = BTreeSet::new();
    for entry in fs::read_dir(&client).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|ending| ending == "py") {
            asked.extend(named(&fs::read_to_string(path).unwrap()));
        }
    }
    let unknown: Vec<_> = asked.difference(&table).collect();
    assert!(unknown.is_empty(), "the Python client asks for {unknown:?}, which no route serves");
    // A search that finds little has missed how the client writes its calls.
    assert!(asked.len() > 40, "only {asked:?} were found in {client:?}");
}
