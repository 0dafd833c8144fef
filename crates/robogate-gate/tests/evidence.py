"""Reads keys and evidence of RoboGate with cryptography, securesystemslib (the library of in-toto and TUF) and in-toto-attestation.

Usage: evidence.py PRIVATE_KEY PUBLIC_KEY EVIDENCE_FOLDER
"""

import hashlib
import json
import pathlib
import sys

from cryptography.hazmat.primitives import serialization
from google.protobuf import json_format
from in_toto_attestation.predicates.test_result.v0.test_result_pb2 import TestResult
from in_toto_attestation.v1 import statement_pb2
from in_toto_attestation.v1.statement import Statement
from securesystemslib.dsse import Envelope
from securesystemslib.exceptions import VerificationError
from securesystemslib.signer import SSlibKey

private, public, folder = (pathlib.Path(path) for path in sys.argv[1:])
secret = serialization.load_pem_private_key(private.read_bytes(), password=None)
key = serialization.load_pem_public_key(public.read_bytes())
der = key.public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)
assert der == secret.public_key().public_bytes(
    serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo
)
keyid = hashlib.sha256(der).hexdigest()
trusted = SSlibKey.from_crypto(key, keyid=keyid)
manifest = hashlib.sha256((folder / "manifest.json").read_bytes()).hexdigest()

for name, predicate_type in [
    ("test-result", "https://in-toto.io/attestation/test-result/v0.1"),
    ("evidence", "urn:robogate:evidence:v1"),
]:
    document = json.loads((folder / f"{name}.dsse.json").read_text())
    envelope = Envelope.from_dict(json.loads(json.dumps(document)))
    accepted = envelope.verify([trusted], 1)
    assert list(accepted) == [keyid], accepted
    # ed25519 is deterministic: another implementation signs with the same bytes.
    signature = next(iter(envelope.signatures.values())).signature
    assert secret.sign(envelope.pae()).hex() == signature
    changed = Envelope(envelope.payload + b" ", envelope.payload_type, envelope.signatures)
    try:
        changed.verify([trusted], 1)
    except VerificationError:
        pass
    else:
        raise AssertionError("a changed payload was accepted")
    # The types of the in-toto attestation framework: a field with another name or type is an error.
    Statement.copy_from_pb(json_format.Parse(envelope.payload, statement_pb2.Statement())).validate()
    statement = json.loads(envelope.payload)
    if name == "test-result":
        result = json_format.ParseDict(statement["predicate"], TestResult())
        assert result.result in ("PASSED", "WARNED", "FAILED"), result
        assert result.configuration, result
        assert (result.result == "PASSED") == (not result.failed_tests), result
        for file in result.configuration:
            found = hashlib.sha256((folder / file.name).read_bytes()).hexdigest()
            assert file.digest["sha256"] == found, file
    assert statement["_type"] == "https://in-toto.io/Statement/v1", statement
    assert statement["predicateType"] == predicate_type, statement
    assert {"name": "manifest.json", "digest": {"sha256": manifest}} in statement["subject"], statement
    for subject in statement["subject"]:
        found = hashlib.sha256((folder / subject["name"]).read_bytes()).hexdigest()
        assert subject["digest"] == {"sha256": found}, subject
print(f"both envelopes verified with securesystemslib by key {keyid}")
