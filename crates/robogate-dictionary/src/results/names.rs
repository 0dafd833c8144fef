//! What the name of a column says about its role.

use robogate_core::Better;

use super::role::Role;
use super::survey::only_identifies;

/// The role that a column's name suggests, if no mapping assigns one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Suggested {
    /// A result of the episode (a reward, a length, a time). It would predict the outcome that it is part of.
    Measure,
    /// A number, time stamp or path that identifies the episode.
    Identifier,
    /// Anything else: a property of the scenario.
    Parameter,
}

/// Words that name a result wherever they occur.
const RESULTS: [&str; 10] =
    ["reward", "rewards", "return", "returns", "elapsed", "score", "scores", "cost", "costs", "success"];

/// Words that name a result if nothing else in the name says what they belong to: `episode_length` is a result,
/// `cable_length` is a parameter.
const EXTENTS: [&str; 9] = ["length", "len", "time", "times", "duration", "steps", "step", "horizon", "timesteps"];

/// Words that may stand beside one of [`EXTENTS`].
const BESIDE: [&str; 44] = [
    "episode",
    "ep",
    "eps",
    "total",
    "sum",
    "max",
    "min",
    "mean",
    "avg",
    "final",
    "cycle",
    "task",
    "completion",
    "rollout",
    "trajectory",
    "traj",
    "wall",
    "clock",
    "s",
    "sec",
    "secs",
    "seconds",
    "ms",
    "to",
    "goal",
    "first",
    "num",
    "n",
    "number",
    "of",
    "env",
    "sim",
    "execution",
    "run",
    "metrics",
    "control",
    "policy",
    "inference",
    "model",
    "finish",
    "done",
    "info",
    "result",
    "stats",
];

/// Words that name an identifier wherever they occur.
const IDENTIFIERS: [&str; 14] = [
    "timestamp",
    "date",
    "datetime",
    "uuid",
    "guid",
    "video",
    "videos",
    "path",
    "paths",
    "filename",
    "file",
    "sha256",
    "hash",
    "url",
];

/// Names of identifiers.
const EPISODE_IDS: [&str; 25] = [
    "index",
    "idx",
    "id",
    "row",
    "episode",
    "episode_id",
    "episode_ix",
    "episode_idx",
    "episode_index",
    "episode_number",
    "global_episode_index",
    "episode_in_env",
    "ep_id",
    "env_id",
    "env_idx",
    "env_index",
    "rebuild_idx",
    "rank",
    "worker",
    "worker_id",
    "sid",
    "eid",
    "run_id",
    "job_name",
    "created_at",
];

/// Other names of the columns of roles, in the form of [`plain`]. The role's own name comes first.
const SPELLINGS: [(Role, &[&str]); 5] = [
    (
        Role::Success,
        &[
            "is_success",
            "succeeded",
            "task_success",
            "binary_success",
            "success_rate",
            "metrics_success",
            "info_success",
            "info_is_success",
            "final_info_is_success",
        ],
    ),
    (Role::Error, &["exception", "error_message", "traceback"]),
    (Role::Seed, &["episode_seed", "env_seed"]),
    (Role::FailureMode, &["failure_category"]),
    // `model` alone is often the model of an object.
    (Role::Policy, &["policy_id", "policy_name", "model_id", "model_name", "checkpoint", "checkpoint_name"]),
];

/// Words that name what several episodes share, if nothing but a number or a prefix stands beside them.
const SHARED: [&str; 47] = [
    "scenario",
    "scene",
    "case",
    "seed",
    "layout",
    "day",
    "date",
    "week",
    "shift",
    "session",
    "block",
    "batch",
    "lot",
    "operator",
    "rater",
    "annotator",
    "evaluator",
    "experimenter",
    "inspector",
    "labeler",
    "labeller",
    "technician",
    "tester",
    "participant",
    "robot",
    "arm",
    "unit",
    "machine",
    "station",
    "cell",
    "site",
    "lab",
    "team",
    "tray",
    // German, French, Spanish, Italian, Dutch.
    "bediener",
    "pruefer",
    "datum",
    "schicht",
    "sitzung",
    "maschine",
    "roboter",
    "operateur",
    "jour",
    "equipe",
    "operador",
    "turno",
    "operatore",
];

/// Words that may stand beside one of [`SHARED`].
const NUMBERS: [&str; 15] =
    ["id", "ids", "name", "number", "no", "nr", "num", "index", "idx", "ix", "serial", "key", "code", "test", "eval"];

/// Whether the name says that episodes with the same value share something that can move their rate: a scenario, a day, an
/// operator, a session, a robot.
pub fn groups_rows(name: &str) -> bool {
    let plain = plain(name);
    // A date with its time. The time of a robot or a session is a duration.
    if is_initial_state(&plain) || plain == "date_time" {
        return true;
    }
    let mut words =
        plain.split('_').filter(|word| !word.is_empty()).map(|word| word.trim_end_matches(char::is_numeric));
    let mut shared = 0;
    words.all(|word| {
        shared += usize::from(SHARED.contains(&word));
        SHARED.contains(&word) || NUMBERS.contains(&word)
    }) && shared == 1
}

/// Whether the name says that the value follows the order of the episodes: a time, or a count of them. No effect of it is known, so it
/// explains nothing.
pub fn follows_order(name: &str) -> bool {
    const WORDS: [&str; 17] = [
        "time",
        "timestamp",
        "clock",
        "hour",
        "minute",
        "date",
        "datetime",
        "elapsed",
        "uptime",
        "cycle",
        "cycles",
        "count",
        "counter",
        "trial",
        "battery",
        "uhrzeit",
        "zeit",
    ];
    plain(name).split('_').any(|word| WORDS.contains(&word))
}

/// Whether the name is that of the number of a recorded start, such as `init_state_id`.
fn is_initial_state(plain: &str) -> bool {
    let of = |known: &[&str]| plain.split('_').any(|word| known.contains(&word));
    let (start, state) = (["init", "initial", "reset", "start"], ["state", "states", "pose", "condition"]);
    let others = |word: &str| start.contains(&word) || state.contains(&word) || NUMBERS.contains(&word);
    of(&start) && of(&state) && plain.split('_').filter(|word| !word.is_empty()).all(others)
}

/// Whether the name says that the value identifies a scenario or its seed.
pub fn names_scenario(name: &str) -> bool {
    let plain = plain(name);
    let has = |known: &[&str]| plain.split('_').any(|word| known.contains(&word.trim_end_matches(char::is_numeric)));
    has(&["scenario", "scene", "case", "layout", "task", "instruction"])
        || only_identifies(name)
        || has(&["seed"])
        || is_initial_state(&plain)
}

/// The name as that of a parameter, of letters, digits and underscores: `Mass (kg)` is `Mass_kg`. `None` if it is one already, or has nothing
/// of it.
pub(super) fn as_parameter(name: &str) -> Option<String> {
    let is_kept = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if name.chars().all(is_kept) {
        return None;
    }
    let mut found = String::with_capacity(name.len());
    for c in name.chars() {
        match c {
            c if is_kept(c) => found.push(c),
            '\u{e4}' => found += "ae",
            '\u{f6}' => found += "oe",
            '\u{fc}' => found += "ue",
            '\u{c4}' => found += "Ae",
            '\u{d6}' => found += "Oe",
            '\u{dc}' => found += "Ue",
            '\u{df}' => found += "ss",
            '\u{b5}' | '\u{3bc}' => found.push('u'),
            '\u{e0}'..='\u{e5}' => found.push('a'),
            '\u{e7}' => found.push('c'),
            '\u{e8}'..='\u{eb}' => found.push('e'),
            '\u{ec}'..='\u{ef}' => found.push('i'),
            '\u{f1}' => found.push('n'),
            '\u{f2}'..='\u{f5}' => found.push('o'),
            '\u{f9}'..='\u{fb}' => found.push('u'),
            '%' => found += "_percent",
            '\u{b0}' => found += "_deg_",
            _ => found.push('_'),
        }
    }
    let words: Vec<&str> = found.split('_').filter(|word| !word.is_empty()).collect();
    (!words.is_empty()).then(|| words.join("_"))
}

/// The name in lower case, with `_` for every other separator.
pub(super) fn plain(name: &str) -> String {
    let mut plain = String::with_capacity(name.len());
    let mut lower = false;
    for c in name.trim().chars() {
        if c.is_ascii_uppercase() && lower {
            plain.push('_');
        }
        lower = c.is_ascii_lowercase() || c.is_ascii_digit();
        plain.push(if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '_' });
    }
    plain
}

/// The column of `role` among `names`: the role's own name, the same name in another spelling, or a usual other name.
pub(super) fn column_of(role: Role, names: &[String]) -> Option<&str> {
    let exact = names.iter().find(|name| *name == role.as_str());
    let spelled = |wanted: &str| names.iter().find(|name| plain(name) == wanted);
    let others = SPELLINGS.iter().filter(|(of, _)| *of == role).flat_map(|(_, names)| names.iter());
    exact.or_else(|| spelled(role.as_str())).or_else(|| others.copied().find_map(spelled)).map(String::as_str)
}

/// The role that a name suggests.
pub(super) fn suggested(name: &str) -> Suggested {
    let plain = plain(name);
    let words: Vec<&str> = plain.split('_').filter(|word| !word.is_empty()).collect();
    let any = |known: &[&str]| words.iter().any(|word| known.contains(word));
    if any(&RESULTS) {
        return Suggested::Measure;
    }
    if groups_rows(&plain) {
        return Suggested::Parameter;
    }
    if EPISODE_IDS.contains(&plain.as_str()) || any(&IDENTIFIERS) {
        return Suggested::Identifier;
    }
    let extent = any(&EXTENTS) && words.iter().all(|word| EXTENTS.contains(word) || BESIDE.contains(word));
    if extent { Suggested::Measure } else { Suggested::Parameter }
}

/// Whether a name in the form of [`plain`] counts steps, and not seconds.
pub(super) fn counts_steps(plain: &str) -> bool {
    let steps = ["length", "len", "steps", "step", "horizon", "timesteps"];
    plain.split('_').any(|word| steps.contains(&word)) && unit(plain).is_empty()
}

/// The unit that a name states by its ending. Empty if it states none.
pub(super) fn unit(name: &str) -> &'static str {
    let plain = plain(name);
    match plain.rsplit('_').next() {
        Some("s" | "sec" | "secs" | "seconds") => "s",
        Some("ms") => "ms",
        _ => "",
    }
}

/// Which direction of a measure is better, as far as its name says.
pub(super) fn better(name: &str) -> Better {
    let plain = plain(name);
    let has = |known: &[&str]| plain.split('_').any(|word| known.contains(&word));
    if has(&["reward", "rewards", "return", "returns", "score", "scores", "success"]) {
        Better::Higher
    } else if has(&["cost", "costs"]) {
        Better::Lower
    } else {
        Better::Neither
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_not_parameters() {
        for name in [
            "reward",
            "sum_reward",
            "Return",
            "episode_length",
            "length",
            "ep_len",
            "cycle_time",
            "Time_Episode",
            "num_steps",
            "elapsed_sec",
            "Horizon",
            "episodeLength",
            "metrics.success",
            "time_to_goal",
        ] {
            assert_eq!(suggested(name), Suggested::Measure, "{name}");
        }
    }

    #[test]
    fn properties_of_scene_are_parameters() {
        for name in ["mass", "cable_length", "time_of_day", "object_length_m", "friction", "step_height", "light"] {
            assert_eq!(suggested(name), Suggested::Parameter, "{name}");
        }
    }

    #[test]
    fn identifiers_are_recognised() {
        for name in ["episode_ix", "env_id", "timestamp", "video_path", "global_episode_index", "Episode"] {
            assert_eq!(suggested(name), Suggested::Identifier, "{name}");
        }
    }

    #[test]
    fn times_of_what_is_shared_group_nothing() {
        for name in ["date_time", "experimenter", "tester_id", "operator", "Labeler", "Bediener", "schicht_nr"] {
            assert!(groups_rows(name), "{name}");
        }
        for name in ["time_of_day", "battery_percent", "Uhrzeit", "CycleCount"] {
            assert!(follows_order(name), "{name}");
        }
        for name in ["mass_kg", "temp_c", "lifetime", "friction"] {
            assert!(!follows_order(name), "{name}");
        }
        for name in ["robot_time", "cell_time", "session_time", "person", "room", "mass"] {
            assert!(!groups_rows(name), "{name}");
        }
    }

    #[test]
    fn names_of_spreadsheets_become_parameters() {
        for (name, wanted) in [
            ("Mass (kg)", Some("Mass_kg")),
            ("H\u{f6}he", Some("Hoehe")),
            ("belt-speed", Some("belt_speed")),
            ("Temp \u{b0}C", Some("Temp_deg_C")),
            ("humidity [%]", Some("humidity_percent")),
            ("dur\u{e9}e", Some("duree")),
            ("mass_kg", None),
            ("", None),
            ("--", None),
        ] {
            assert_eq!(as_parameter(name).as_deref(), wanted, "{name}");
        }
    }

    #[test]
    fn other_spellings_give_role() {
        let find = |role, names: &[&str]| {
            let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            column_of(role, &names).map(str::to_owned)
        };
        assert_eq!(find(Role::Success, &["Horizon", "Success_Rate"]).as_deref(), Some("Success_Rate"));
        assert_eq!(find(Role::Success, &["success_rate", "Success"]).as_deref(), Some("Success"));
        assert_eq!(find(Role::Success, &["Success", "success"]).as_deref(), Some("success"));
        assert_eq!(find(Role::CycleTime, &["cycle_time"]), None, "its unit is unknown");
        assert_eq!(find(Role::Policy, &["model", "Checkpoint"]).as_deref(), Some("Checkpoint"));
        assert_eq!(find(Role::Policy, &["model", "mass"]), None, "it can be the model of an object");
    }
}
