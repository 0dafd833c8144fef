//! The verbs of the command.

pub(crate) mod analyze;
pub(crate) mod baseline;
pub(crate) mod bridge;
pub(crate) mod check;
pub(crate) mod compare;
pub(crate) mod demos;
pub(crate) mod evidence;
pub(crate) mod export;
pub(crate) mod gate;
pub(crate) mod import;
pub(crate) mod keys;
pub(crate) mod leaderboard;
pub(crate) mod list;
pub(crate) mod monitor;
pub(crate) mod policy;
pub(crate) mod replay;
pub(crate) mod report;
pub(crate) mod resume;
pub(crate) mod robots;
pub(crate) mod run;
pub(crate) mod serve;
pub(crate) mod snapshot;
pub(crate) mod study;
pub(crate) mod suites;
pub(crate) mod verify;
