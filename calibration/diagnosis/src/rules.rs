//! The rules that withhold names of touch: what each measures, and its limit.
//!
//! `docs/diagnosis.md` shows this table; a test compares them. Benches switch rules off and scale their limits
//! ([`DiagnosisConfig::rule_scales`]), to tell what each is good for.
//!
//! [`DiagnosisConfig::rule_scales`]: crate::DiagnosisConfig::rule_scales

use crate::fired::{BY_TAKE, GAP_GROWS, REPEATS_MORE, USUAL, WEAK_BESIDE_REST};
use crate::tactile::adequacy;
use crate::{steps, withhold};

/// A rule that withholds names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// Its name in reports, for `--without-rule` and for `--scale-rule`.
    pub id: &'static str,
    /// What it measures, and in which unit.
    pub measures: &'static str,
    /// Names are withheld where the measure is above this.
    pub limit: f64,
}

/// Every rule, in the order in which they are asked.
pub static RULES: &[Rule] = &[
    Rule {
        id: USUAL,
        measures: "highest Wald statistic of effects of the same reach in reference sessions, over the effect's own",
        limit: withhold::MOST_USUAL,
    },
    Rule {
        id: BY_TAKE,
        measures: "spread of the effect's size between takes, over its size",
        limit: withhold::MOST_BY_TAKE,
    },
    Rule {
        id: WEAK_BESIDE_REST,
        measures: "Wald statistic that a name needs where more is left than may be (80 for each time as much as that), over the \
                   effect's own",
        limit: 1.0,
    },
    Rule {
        id: REPEATS_MORE,
        measures: "repeatable residual with the effects, over that without, where all are of channels",
        limit: adequacy::MOST_RAISED,
    },
    Rule {
        id: GAP_GROWS,
        measures: "frames that are mistaken on the fitted takes with the effects, over those without, where the \
                   model had effects already",
        limit: steps::MOST_MISTAKEN,
    },
];

#[cfg(test)]
mod tests {
    use palpate_reports::wording;

    use super::*;

    #[test]
    fn every_rule_has_words() {
        for Rule { id, .. } in RULES {
            assert_ne!(wording::objection(id), wording::words(id));
        }
    }

    #[test]
    fn what_a_weak_name_needs_is_what_the_table_says() {
        let needs = format!("({} for each", withhold::EVIDENCE_BESIDE_REST);
        let weak = RULES.iter().find(|rule| rule.id == WEAK_BESIDE_REST);
        assert!(weak.is_some_and(|rule| rule.measures.contains(&needs)), "{needs}");
    }

    #[test]
    fn the_page_about_diagnosis_shows_this_table() {
        let page = include_str!("../../../docs/diagnosis.md");
        for Rule { id, measures, limit } in RULES {
            let row = format!("| `{id}` | {measures} | {limit:.3} |");
            assert!(page.contains(&row), "docs/diagnosis.md lacks the row\n{row}");
        }
        // Rows of other tables end in words.
        let is_rule = |line: &&str| {
            let last = line.trim_end_matches([' ', '|']).rsplit('|').next();
            line.starts_with("| `") && last.is_some_and(|last| last.trim().parse::<f64>().is_ok())
        };
        let rows = page.lines().filter(is_rule).count();
        assert_eq!(rows, RULES.len(), "docs/diagnosis.md has rules that are no more");
    }
}
