//! Names with one `*` in them, and names that are nearly right.

/// What `*` stands for if `name` fits `pattern`; empty where the pattern has no `*` and equals the name.
pub(super) fn matched<'a>(pattern: &str, name: &'a str) -> Option<&'a str> {
    match pattern.split_once('*') {
        None => (pattern == name).then_some(""),
        Some((before, after)) => name.strip_prefix(before)?.strip_suffix(after),
    }
}

/// The one of `known` that `name` is most likely a misspelling of, if there is one.
pub(super) fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let plain = plain(name);
    let limit = (plain.len() / 3).max(1);
    known
        .into_iter()
        .map(|known| (distance(&plain, &self::plain(known)), known))
        .filter(|&(distance, _)| distance <= limit)
        .min_by_key(|&(distance, _)| distance)
        .map(|(_, known)| known)
}

/// Without case and separators, which loggers change most.
fn plain(name: &str) -> Vec<char> {
    // Names of hundreds of characters are no misspellings.
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).take(64).collect()
}

/// How many characters have to be put in, left out, replaced or swapped with the next to make `b` of `a`.
fn distance(a: &[char], b: &[char]) -> usize {
    let mut rows: Vec<Vec<usize>> = vec![(0..=b.len()).collect()];
    for (idx_a, char_a) in a.iter().enumerate() {
        let mut row = vec![idx_a + 1];
        for (idx_b, char_b) in b.iter().enumerate() {
            let replaced = rows[idx_a][idx_b] + usize::from(char_a != char_b);
            let mut least = replaced.min(rows[idx_a][idx_b + 1] + 1).min(row[idx_b] + 1);
            if idx_a > 0 && idx_b > 0 && a[idx_a - 1] == *char_b && *char_a == b[idx_b - 1] {
                least = least.min(rows[idx_a - 1][idx_b - 1] + 1);
            }
            row.push(least);
        }
        rows.push(row);
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_star_stands_for_the_rest_of_the_name() {
        assert_eq!(matched("*_joints.csv", "book_3_joints.csv"), Some("book_3"));
        assert_eq!(matched("/state/*/pos", "/state/curl/pos"), Some("curl"));
        assert_eq!(matched("*", "x"), Some("x"));
        assert_eq!((matched("a*", "b"), matched("a", "a"), matched("ab*bc", "abc")), (None, Some(""), None));
    }

    #[test]
    fn the_nearest_name_is_found_and_only_if_it_is_near() {
        let known = ["index_pip", "index_dip", "thumb_ip"];
        assert_eq!(nearest("Index-PIP", known), Some("index_pip"));
        assert_eq!(nearest("indx_dip", known), Some("index_dip"));
        assert_eq!(nearest("thubm_ip", known), Some("thumb_ip"));
        assert_eq!(nearest("effort", known), None);
        assert_eq!(nearest("", known), None);
    }
}
