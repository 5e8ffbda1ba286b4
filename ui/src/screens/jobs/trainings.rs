//! What the form of jobs can start, each a list of fields, with a line of help where a name does not say all.

use palpate_wire::api::{EXPERTS, HEADS, MEMORIES, PAPER_POLICIES};

/// What can be started.
pub(super) struct Training {
    /// As requests name it.
    pub(super) kind: &'static str,
    pub(super) words: &'static str,
    pub(super) explained: &'static str,
    pub(super) fields: &'static [Field],
    /// Whether the seed of the job is used.
    pub(super) is_seeded: bool,
    /// What the parts are into which its work can be divided, if it can be.
    pub(super) parts: Option<&'static str>,
    /// Whether it can work on the graphics card.
    pub(super) may_use_gpu: bool,
}

/// Neither divided nor on the graphics card.
const PLAIN: Training = Training {
    kind: "",
    words: "",
    explained: "",
    fields: &[],
    is_seeded: true,
    parts: None,
    may_use_gpu: false,
};

/// A field of a request. What is left as it is, is left to the studio.
#[derive(Clone, Copy)]
pub(super) enum Field {
    /// The object to grasp.
    Object,
    /// Which objects, by group; the first says nothing. The form keeps the choice as `slot`.
    Objects { slot: &'static str, groups: &'static [&'static str] },
    /// A policy: a job of one of these kinds that is done, or a shipped one.
    Policy(&'static [&'static str]),
    /// A job of this kind, or none.
    Job { key: &'static str, label: &'static str, kind: &'static str },
    /// Jobs to learn from, of this kind.
    Jobs { key: &'static str, label: &'static str, kind: &'static str },
    /// A count, and what is usual in words; where it has to be said, the usual one.
    Number { key: &'static str, label: &'static str, usual: &'static str, otherwise: Option<u64> },
    /// One of these; the empty one says nothing.
    Choice { key: &'static str, label: &'static str, choices: &'static [&'static str] },
    /// The sensor model that makes touch.
    Model,
    /// Yes, or nothing.
    Flag { key: &'static str, label: &'static str, words: &'static str },
}

const PRESET: Field = Field::Choice { key: "preset", label: "Preset", choices: &["quick", "paper"] };
const PROTOCOLS: [&str; 4] = ["wide", "paper", "wide_20s", "claim"];
const SILENCE: Field = Field::Flag { key: "silence_touch", label: "Touch", words: "feels nothing" };

/// The choices `known`, behind the one that says nothing.
const fn or_nothing<const KNOWN: usize, const ALL: usize>(
    known: [&'static str; KNOWN],
) -> [&'static str; ALL] {
    assert!(ALL == KNOWN + 1);
    let mut all = [""; ALL];
    let mut idx = 0;
    while idx < KNOWN {
        all[idx + 1] = known[idx];
        idx += 1;
    }
    all
}

const PROTOCOLS_OR_NOTHING: [&str; PROTOCOLS.len() + 1] = or_nothing(PROTOCOLS);
const EXPERTS_OR_NOTHING: [&str; EXPERTS.len() + 1] = or_nothing(EXPERTS);
const POLICIES_OR_NOTHING: [&str; PAPER_POLICIES.len() + 1] = or_nothing(PAPER_POLICIES);
const HEADS_OR_NOTHING: [&str; HEADS.len() + 1] = or_nothing(HEADS);
const MEMORIES_OR_NOTHING: [&str; MEMORIES.len() + 1] = or_nothing(MEMORIES);
const GROUPS_OR_NOTHING: [&str; GROUPS.len() + 1] = or_nothing(GROUPS);

const fn number(key: &'static str, label: &'static str, usual: &'static str) -> Field {
    Field::Number { key, label, usual, otherwise: None }
}

pub(super) const TRAININGS: &[Training] = &[
    Training {
        kind: "expert",
        words: "Train an expert",
        explained: "Learns to grasp one object by touch in simulation: minutes to hours on every core.",
        fields: &[
            Field::Object,
            PRESET,
            number("total_steps", "Steps", "as the preset says"),
            Field::Model,
            SILENCE,
        ],
        ..PLAIN
    },
    Training {
        kind: "evaluation",
        words: "Evaluate a policy",
        explained: "Scores a policy in fresh trials in simulation. A policy that imitates needs a protocol.",
        fields: &[
            Field::Policy(&["expert", "imitation", "pipeline"]),
            number("trials", "Trials", "50, or the protocol's"),
            Field::Choice { key: "protocol", label: "Protocol", choices: &PROTOCOLS_OR_NOTHING },
            Field::Objects { slot: "scored", groups: &GROUPS_OR_NOTHING },
            Field::Model,
            SILENCE,
        ],
        parts: Some("objects"),
        ..PLAIN
    },
    Training {
        kind: "demonstrations",
        words: "Make demonstrations",
        explained: "Rolls a policy out in simulation and keeps the trials that succeed, to learn from.",
        fields: &[
            Field::Policy(&["expert"]),
            Field::Number { key: "count", label: "How many", usual: "64", otherwise: Some(64) },
            Field::Model,
        ],
        ..PLAIN
    },
    Training {
        kind: "pretraining",
        words: "Pretrain the encoder",
        explained: "Teaches the tactile encoder what demonstrations know beyond touch.",
        fields: &[
            Field::Jobs { key: "demonstrations", label: "Demonstrations", kind: "demonstrations" },
            PRESET,
            number("epochs", "Epochs", "as the preset says"),
            SILENCE,
        ],
        ..PLAIN
    },
    Training {
        kind: "gathering",
        words: "Gather an expert's trials",
        explained: "Lets an expert grasp in simulation and keeps every trial, won or lost, to imitate.",
        fields: &[
            Field::Objects { slot: "objects", groups: &GROUPS },
            number("count", "Trials on each object", "300"),
            Field::Choice { key: "protocol", label: "Protocol", choices: &PROTOCOLS },
            Field::Choice { key: "expert", label: "Expert", choices: &EXPERTS_OR_NOTHING },
            Field::Model,
        ],
        parts: Some("objects"),
        ..PLAIN
    },
    Training {
        kind: "imitation",
        words: "Imitate an expert",
        explained: "Learns one policy for all objects from gathered trials: a quarter of an hour on two cores.",
        fields: &[
            Field::Jobs { key: "trials", label: "Gathered trials", kind: "gathering" },
            Field::Choice { key: "preset", label: "Preset", choices: &["small", "paper"] },
            Field::Choice { key: "policy", label: "Policy of the paper", choices: &POLICIES_OR_NOTHING },
            Field::Choice { key: "head", label: "What predicts", choices: &HEADS_OR_NOTHING },
            Field::Choice { key: "memory", label: "Frames are joined", choices: &MEMORIES_OR_NOTHING },
            number("updates", "Updates", "as the preset says"),
            SILENCE,
            Field::Flag { key: "hide_tracking", label: "Tracking errors", words: "are not seen" },
            Field::Flag { key: "features", label: "Features of touch", words: "are seen" },
            Field::Job { key: "encoder", label: "Encoder", kind: "pretraining" },
            Field::Flag { key: "region", label: "Region of starts", words: "is told" },
            Field::Flag { key: "only_won", label: "Learns from", words: "trials that were won only" },
        ],
        may_use_gpu: true,
        ..PLAIN
    },
    Training {
        kind: "pipeline",
        words: "Do it all, from model to scored policies",
        explained: "Lets the expert gather trials, learns policies from them, scores them and writes a report: hours on every \
                    core. It goes on where it was when it is tried again.",
        fields: &[
            Field::Choice { key: "preset", label: "Preset", choices: &["small", "tables", "paper"] },
            Field::Model,
        ],
        is_seeded: false,
        may_use_gpu: true,
        ..PLAIN
    },
    Training {
        kind: "tune",
        words: "Tune a script",
        explained: "Makes a closing script better on one object, by trying variants of it.",
        fields: &[Field::Object, number("generations", "Generations", "8"), Field::Model],
        ..PLAIN
    },
    Training {
        kind: "blind",
        words: "Bench the diagnosis blind",
        explained: "Hides known effects in emulated sessions, has them diagnosed and scores the names: minutes a round.",
        fields: &[
            Field::Choice { key: "domain", label: "Effects of", choices: &["tactile", "actuator"] },
            number("seeds", "Rounds", "1"),
            number("nulls", "Sessions with nothing hidden", "20"),
            Field::Flag { key: "raw_only", label: "Without raw readings", words: "is not tried too" },
            Field::Flag { key: "whole_library", label: "Effects taken out", words: "are not tried too" },
        ],
        parts: Some("rounds"),
        ..PLAIN
    },
];

/// Groups of objects; the first is the usual one.
const GROUPS: [&str; 3] = ["seen", "unseen", "all"];

impl Field {
    /// Its name in the request and what the form calls it; nothing where both are the same for every job.
    pub(super) fn names(self) -> Option<(&'static str, &'static str)> {
        match self {
            Self::Job { key, label, .. }
            | Self::Jobs { key, label, .. }
            | Self::Number { key, label, .. }
            | Self::Choice { key, label, .. }
            | Self::Flag { key, label, .. } => Some((key, label)),
            Self::Object | Self::Objects { .. } | Self::Policy(_) | Self::Model => None,
        }
    }
}

/// A choice as the form shows it.
pub(super) fn shown(key: &str, choice: &'static str) -> &'static str {
    match (choice, key) {
        ("", "protocol" | "policy") => "none",
        ("", "scored" | "expert") => "as usual",
        ("", _) => "as the preset says",
        _ => choice,
    }
}

/// What a choice means, a line; nothing where its name says all.
pub(super) fn help(key: &str, choice: &str) -> &'static str {
    match (key, choice) {
        ("policy", "") => "How touch is seen and what predicts are chosen below.",
        ("policy", "raw-dp") => "Sees which channels are on; diffusion predicts.",
        ("policy", "kinematic-dp") => "Sees where each channel is and whether it is on; diffusion predicts.",
        ("policy", "pretrained-dp") => "Sees the features of an encoder; diffusion predicts.",
        ("policy", "pretrained-act") => "Sees the features of an encoder; act predicts.",
        ("policy", "pretrained-bc") => "Sees the features of an encoder; regression predicts.",
        ("head", "") => "Presets: small has regression, paper has diffusion.",
        ("head", "regression") => "Predicts the mean of what the expert does. The quickest to learn.",
        ("head", "diffusion") => {
            "Draws one of the expert's answers. An update costs about twice that of regression."
        }
        ("head", "act") => {
            "Transformers that predict the commonest answer. An update costs about seven times that of regression."
        }
        ("memory", "") => "Presets have a window.",
        ("memory", "window") => "All frames are seen side by side.",
        ("memory", "recurrent") => "A GRU reads the frames one after the other.",
        ("expert", "") => "The searching expert with both senses.",
        ("expert", "search") => "Feels where the object is, and tries again elsewhere.",
        ("expert", "search:touch") => "The same without tracking errors.",
        ("expert", "search:tracking") => "The same without touch.",
        ("expert", "repetition") => {
            "Feels nothing and tries one place after the other. The better teacher at \u{b1}2 cm."
        }
        ("features", _) => "An encoder makes them of touch; name one below.",
        ("encoder", _) => "A pretraining that is done. It becomes part of the policy's file.",
        ("region", _) => {
            "The policy sees how wide the square is that objects begin in. Needs trials of several protocols."
        }
        _ => "",
    }
}
