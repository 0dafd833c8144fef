//! DSSE envelopes, protocol version 1 (<https://github.com/secure-systems-lab/dsse>).

use base64ct::{Base64, Base64Url, Encoding};
use serde::{Deserialize, Serialize};

use super::{PrivateKey, PublicKey};

/// The signed bytes: PAE(type, body), which separates type and body unambiguously.
pub fn pre_authentication_encoding(payload_type: &str, body: &[u8]) -> Vec<u8> {
    let mut message = format!("DSSEv1 {} {payload_type} {} ", payload_type.len(), body.len()).into_bytes();
    message.extend_from_slice(body);
    message
}

/// A signed payload.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Envelope {
    /// The payload in base64.
    pub payload: String,
    /// The payload type.
    #[serde(rename = "payloadType")]
    pub payload_type: String,
    /// The signatures.
    pub signatures: Vec<Signature>,
}

/// One signature of an envelope.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Signature {
    /// A hint at the key. It is not signed and is not relied on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keyid: Option<String>,
    /// The signature in base64.
    pub sig: String,
}

impl Envelope {
    /// Signs `body`.
    pub fn sign(payload_type: &str, body: &[u8], key: &PrivateKey) -> Self {
        let signature = key.sign(&pre_authentication_encoding(payload_type, body));
        Self {
            payload: Base64::encode_string(body),
            payload_type: payload_type.to_owned(),
            signatures: vec![Signature { keyid: Some(key.public().id()), sig: Base64::encode_string(&signature) }],
        }
    }

    /// Serialises the envelope.
    pub fn to_json(&self) -> String {
        // Strings always serialise.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// The payload. `None` if it is not base64 of either alphabet.
    pub fn body(&self) -> Option<Vec<u8>> {
        decode(&self.payload)
    }

    /// The file that robogate writes for the same payload with one signature, by the key `keyid`.
    pub(super) fn written_again(&self, keyid: &str) -> Option<String> {
        let [signature] = self.signatures.as_slice() else {
            return None;
        };
        let signature =
            Signature { keyid: Some(keyid.to_owned()), sig: Base64::encode_string(&decode(&signature.sig)?) };
        let payload = Base64::encode_string(&self.body()?);
        Some(Self { payload, payload_type: self.payload_type.clone(), signatures: vec![signature] }.to_json())
    }

    /// Whether one of its signatures is by `key`.
    pub fn is_signed_by(&self, key: &PublicKey) -> bool {
        let Some(body) = self.body() else {
            return false;
        };
        let message = pre_authentication_encoding(&self.payload_type, &body);
        self.signatures
            .iter()
            .filter_map(|signature| decode(&signature.sig))
            .any(|signature| key.verifies(&message, &signature))
    }
}

/// Decodes base64. Signers may use either alphabet, so verifiers must accept both.
fn decode(text: &str) -> Option<Vec<u8>> {
    Base64::decode_vec(text).or_else(|_| Base64Url::decode_vec(text)).ok()
}
