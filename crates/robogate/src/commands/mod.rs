//! The verbs.

pub(crate) mod analyze;
pub(crate) mod check;
pub(crate) mod compare;
pub(crate) mod evidence;
pub(crate) mod export;
pub(crate) mod import;
pub(crate) mod keys;
pub(crate) mod replay;
pub(crate) mod report;
pub(crate) mod resume;
pub(crate) mod robots;
pub(crate) mod run;
pub(crate) mod study;
pub(crate) mod suites;
pub(crate) mod verify;
