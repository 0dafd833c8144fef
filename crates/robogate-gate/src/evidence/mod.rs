//! Evidence: a verdict as a folder that others can verify.
//!
//! [`write()`] puts everything that a verdict depends on into one folder: the rows, the requirements, their baseline, the
//! plan, the evaluation, and a [`Manifest`] with the SHA-256 of each file. Two in-toto statements describe the result:
//! the [test-result] predicate, which other tools read, and RoboGate's own, which contains the whole manifest. If a
//! [`PrivateKey`] is given, each is in a DSSE envelope.
//!
//! [`verify`] needs only the folder. It hashes every file, recomputes the evaluation from the rows, compares plan, suite,
//! robot, policy, question and registration with the provenance of the rows, rebuilds both statements, and names each file
//! that differs. Each of these bindings has a module of its own.
//!
//! The folder contains no time of day: the same run and key give the same bytes.
//!
//! [test-result]: https://in-toto.io/attestation/test-result/v0.1

mod afterwards;
mod coverage;
mod draw;
mod dsse;
mod environment;
mod error;
mod facts;
mod judged;
mod keys;
mod manifest;
mod origin;
mod policy;
mod question;
mod registration;
mod statement;
mod verify;
mod write;

pub use afterwards::conditions;
pub use coverage::Covered;
pub use draw::random_positions;
pub use dsse::{Envelope, Signature, pre_authentication_encoding};
pub use environment::EnvironmentBinding;
pub use error::{EvidenceError, Problem};
pub use judged::Judged;
pub use keys::{PrivateKey, PublicKey};
pub use manifest::{FileRecord, Manifest, Role};
pub use policy::PolicyBinding;
pub use question::QuestionBinding;
pub use registration::{
    REGISTRATION, REGISTRATION_KEY, REGISTRATION_PREDICATE, Registered, Registration, list_of, register,
};
pub use statement::{EVIDENCE_PREDICATE, PAYLOAD_TYPE, STATEMENT_TYPE, TEST_RESULT_PREDICATE};
pub use verify::{Signed, Verified, verify};
pub use write::{Content, Documents, Ingredients, write};

/// The path of the manifest in the folder.
pub const MANIFEST: &str = "manifest.json";

/// The rows.
const DICTIONARY: &str = "dictionary.parquet";
/// The rows of the policy that may be replaced.
const AGAINST: &str = "against.parquet";
/// The requirements.
const REQUIREMENTS: &str = "requirements.toml";
/// The baseline of relative requirements.
const BASELINE: &str = "baseline.json";
/// The evaluation: every figure and the verdict.
const EVALUATION: &str = "evaluation.json";
/// The public key of the signer.
const SIGNER: &str = "signer.pub.pem";
/// The two statements, in envelopes if they are signed.
const TEST_RESULT: &str = "test-result";
const ATTESTATION: &str = "evidence";
const SIGNED_ENDING: &str = ".dsse.json";
const BARE_ENDING: &str = ".intoto.json";
