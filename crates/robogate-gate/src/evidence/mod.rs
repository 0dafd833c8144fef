//! Evidence: a folder that someone else can check.
//!
//! [`write()`] puts everything that a verdict depends on into one folder: the rows, the demands, what they
//! refer to, the plan, the evaluation, and a [`Manifest`] with the SHA-256 of each file. Two in-toto
//! statements say what was found, each in a DSSE envelope where a [`PrivateKey`] is given: the
//! [test-result] predicate, which other tools read, and our own, which holds the whole manifest.
//! [`verify`] needs nothing but the folder: it hashes every file, computes the evaluation again from the
//! rows, holds plan, suite and robot against what the rows say of them, builds both statements again, and names each file that is not what it should be.
//!
//! There is no clock in it: the same run and key give the same bytes.
//!
//! [test-result]: https://in-toto.io/attestation/test-result/v0.1

mod dsse;
mod error;
mod facts;
mod keys;
mod manifest;
mod origin;
mod statement;
mod verify;
mod write;

pub use dsse::{Envelope, Signature, pre_authentication_encoding};
pub use error::{EvidenceError, Problem};
pub use keys::{PrivateKey, PublicKey};
pub use manifest::{FileRecord, Manifest, Role};
pub use statement::{EVIDENCE_PREDICATE, PAYLOAD_TYPE, STATEMENT_TYPE, TEST_RESULT_PREDICATE};
pub use verify::{Signed, Verified, verify};
pub use write::{Content, Ingredients, write};

/// The manifest's place in the folder.
pub const MANIFEST: &str = "manifest.json";

/// The rows.
const DICTIONARY: &str = "dictionary.parquet";
/// The rows of the policy that may be replaced.
const AGAINST: &str = "against.parquet";
/// The demands.
const REQUIREMENTS: &str = "requirements.toml";
/// What relative demands refer to.
const BASELINE: &str = "baseline.json";
/// Every figure and the verdict.
const EVALUATION: &str = "evaluation.json";
/// The public half of the key that signed.
const SIGNER: &str = "signer.pub.pem";
/// The two statements, in envelopes where they are signed and bare where not.
const TEST_RESULT: &str = "test-result";
const ATTESTATION: &str = "evidence";
const SIGNED_ENDING: &str = ".dsse.json";
const BARE_ENDING: &str = ".intoto.json";
