//! The page's own files under the server's Content-Security-Policy: scripts come from files, none is inline or evaluated.

use std::{fs, path::Path};

fn read(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(name);
    fs::read_to_string(&path).unwrap_or_else(|err| panic!("{path:?}: {err}"))
}

#[test]
fn index_has_no_inline_script_and_fetches_nothing_from_elsewhere() {
    let html = read("index.html");
    let scripts: Vec<&str> = html.split("<script").skip(1).collect();
    assert_eq!(scripts.len(), 2);
    for script in scripts {
        let (tag, rest) = script.split_once('>').expect("a closed tag");
        assert!(tag.contains(" src=\"/{{"), "an inline script is refused by script-src 'self': {tag}");
        assert!(rest.starts_with("</script>"), "a script with a source has no text of its own");
    }
    for forbidden in
        [" onload=", " onclick=", " onerror=", "javascript:", "<base", "<form", "http:", "https:"]
    {
        assert!(!html.contains(forbidden), "{forbidden} is refused by the policy");
    }
}

#[test]
fn scripts_evaluate_no_text() {
    for name in ["theme.js", "boot.js"] {
        let script = read(name);
        for forbidden in ["eval(", "Function(", "document.write", "innerHTML", "http:", "https:"] {
            assert!(!script.contains(forbidden), "{name} has {forbidden}");
        }
    }
    let boot = read("boot.js");
    assert!(boot.contains("/{{script}}") && boot.contains("/{{wasm}}"), "xtask fills these in");
}
