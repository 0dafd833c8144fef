//! The file of a fingerprint: one msgpack document, arrays as in openpi's protocol.

use rmpv::ValueRef;
use robogate_core::budget::Budget;

use super::{Fingerprint, MOST_PROBES, Probe};
use crate::array::{Array, Dtype};
use crate::chunk::Chunk;
use crate::error::PolicyError;
use crate::msgpack::{self, Keys};
use crate::profile::Profile;
use crate::query::Query;

/// The version of the format.
const VERSION: u64 = 1;
const WHAT: &str = "fingerprint";

impl Fingerprint {
    /// Encode the fingerprint. The same fingerprint gives the same bytes.
    pub fn to_bytes(&self) -> Result<Vec<u8>, PolicyError> {
        let text = |value: serde_json::Result<String>| value.map_err(|why| PolicyError::invalid_reply(WHAT, why));
        let profile = text(serde_json::to_string(&self.profile))?;
        let declared = text(serde_json::to_string(&self.declared))?;
        let answers: Vec<Vec<Array>> = self
            .probes
            .iter()
            .map(|probe| probe.answers.iter().map(written).collect::<Result<_, _>>())
            .collect::<Result<_, _>>()?;
        let probes = self.probes.iter().zip(&answers).map(|(Probe { query, .. }, answers)| {
            msgpack::map([
                ("images", msgpack::map(msgpack::arrays(&query.images, Keys::Text))),
                ("states", msgpack::map(msgpack::arrays(&query.states, Keys::Text))),
                ("instruction", ValueRef::from(query.instruction.as_str())),
                ("step", ValueRef::from(query.step)),
                ("time_s", ValueRef::F64(query.time_s)),
                ("answers", ValueRef::Array(answers.iter().map(|array| msgpack::array(array, Keys::Text)).collect())),
            ])
        });
        Ok(msgpack::encode(&msgpack::map([
            ("robogate_fingerprint", ValueRef::from(VERSION)),
            ("profile", ValueRef::from(profile.as_str())),
            ("declared", ValueRef::from(declared.as_str())),
            ("control_period_s", ValueRef::F64(self.control_period_s)),
            ("used", ValueRef::Array(self.used.iter().map(|name| ValueRef::from(name.as_str())).collect())),
            ("probes", ValueRef::Array(probes.collect())),
        ])))
    }

    /// Decode a fingerprint.
    ///
    /// # Errors
    /// Bytes that are not a fingerprint of this version, or above the budget for replies.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, PolicyError> {
        let wrong = |why: &str| PolicyError::invalid_reply(WHAT, why);
        Budget::REPLY.check_bytes(bytes.len()).map_err(|why| PolicyError::invalid_reply(WHAT, why))?;
        let document = msgpack::decode(WHAT, bytes)?;
        let get = |key: &str| msgpack::get(&document, key).ok_or_else(|| wrong(&format!("`{key}` is missing")));
        let version = get("robogate_fingerprint").ok().and_then(ValueRef::as_u64);
        if version != Some(VERSION) {
            return Err(wrong("not a fingerprint of this version. Hint: `robogate gate` writes fingerprint.msgpack"));
        }
        let json = |key: &str| {
            let text = msgpack::name(get(key)?).ok_or_else(|| wrong(&format!("`{key}` is not a text")))?;
            Budget::FILE.json(text.as_bytes()).map_err(|why| PolicyError::invalid_reply(WHAT, why))
        };
        let profile: serde_json::Value = json("profile")?;
        let profile: Profile = serde_json::from_value(profile).map_err(|why| PolicyError::invalid_reply(WHAT, why))?;
        profile.check().map_err(|why| PolicyError::invalid_reply(WHAT, why))?;
        let control_period_s = float(get("control_period_s")?).filter(|period| period.is_finite() && *period > 0.0);
        let ValueRef::Array(probes) = get("probes")? else { return Err(wrong("`probes` is not a list")) };
        if probes.is_empty() || probes.len() > MOST_PROBES {
            return Err(wrong(&format!("it has {} requests. Expected 1 to {MOST_PROBES}", probes.len())));
        }
        let ValueRef::Array(used) = get("used")? else { return Err(wrong("`used` is not a list")) };
        let used = used
            .iter()
            .map(|name| msgpack::name(name).map(str::to_owned).ok_or_else(|| wrong("`used` is not a list of names")));
        Ok(Self {
            profile,
            used: used.collect::<Result<_, _>>()?,
            declared: json("declared")?,
            control_period_s: control_period_s.ok_or_else(|| wrong("`control_period_s` is not a positive number"))?,
            probes: probes.iter().map(probe).collect::<Result<_, _>>()?,
        })
    }
}

fn float(value: &ValueRef<'_>) -> Option<f64> {
    if let ValueRef::F64(number) = value { Some(*number) } else { None }
}

/// An answer as an array of double precision.
fn written(chunk: &Chunk) -> Result<Array, PolicyError> {
    let rows = chunk.rows().iter().map(Vec::as_slice);
    Array::stacked(rows, Dtype::F64).map_err(|why| PolicyError::invalid_reply(WHAT, why))
}

fn probe(value: &ValueRef<'_>) -> Result<Probe, PolicyError> {
    let wrong = |key: &str| PolicyError::invalid_reply(WHAT, format!("a request without a valid `{key}`"));
    let get = |key: &str| msgpack::get(value, key).ok_or_else(|| wrong(key));
    let arrays = |key: &str| -> Result<Vec<(String, Array)>, PolicyError> {
        let entries = msgpack::entries(get(key)?).ok_or_else(|| wrong(key))?;
        let read = |(name, value): &(ValueRef<'_>, ValueRef<'_>)| {
            Ok((msgpack::name(name).ok_or_else(|| wrong(key))?.to_owned(), msgpack::read_array(WHAT, value)?))
        };
        entries.iter().map(read).collect()
    };
    let ValueRef::Array(answers) = get("answers")? else { return Err(wrong("answers")) };
    let answers = answers.iter().map(|answer| Chunk::of_array(&msgpack::read_array(WHAT, answer)?));
    let answers = answers.collect::<Result<Vec<_>, _>>()?;
    let finite = |chunk: &Chunk| chunk.rows().iter().flatten().all(|number| number.is_finite());
    if answers.is_empty() || !answers.iter().all(finite) {
        return Err(wrong("answers"));
    }
    Ok(Probe {
        query: Query {
            images: arrays("images")?,
            states: arrays("states")?,
            instruction: msgpack::name(get("instruction")?).ok_or_else(|| wrong("instruction"))?.to_owned(),
            step: get("step")?.as_u64().ok_or_else(|| wrong("step"))?,
            time_s: float(get("time_s")?).ok_or_else(|| wrong("time_s"))?,
        },
        answers,
    })
}
