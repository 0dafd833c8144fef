"""Validates deploy/kubernetes against the schemas of the Kubernetes API, and the rules that the schemas do not express.

Usage: kubernetes.py [VERSION...]; needs the packages kubernetes-validate and PyYAML.
"""

import re
import sys
from pathlib import Path

import kubernetes_validate
import yaml

FOLDER = Path(__file__).resolve().parents[2] / "deploy" / "kubernetes"
# The user of the image, who must be able to write to the volume.
USER = int(re.search(r"^USER (\d+):\1$", (FOLDER.parent / "Containerfile").read_text(), re.MULTILINE)[1])
# backoffLimitPerIndex is in the API since 1.28, and stable since 1.33.
VERSIONS = sys.argv[1:] or ["1.29", "1.33"]


def rules(job: dict) -> None:
    """Rules of the image, and of Jobs in the API reference, that are not part of the schema."""
    spec = job["spec"]
    pod = spec["template"]["spec"]
    for field in ("runAsUser", "runAsGroup", "fsGroup"):
        assert pod["securityContext"][field] == USER, f"{field} must be the user of the image, {USER}"
    if "backoffLimitPerIndex" in spec:
        assert spec["completionMode"] == "Indexed", "backoffLimitPerIndex needs completionMode Indexed"
        assert spec["maxFailedIndexes"] <= spec["completions"], "maxFailedIndexes must not exceed completions"
        shards = [word for word in pod["containers"][0]["command"] if word.startswith("$(JOB_COMPLETION_INDEX)/")]
        assert shards == [f"$(JOB_COMPLETION_INDEX)/{spec['completions']}"], "the shard must be one of `completions`"
    if "podFailurePolicy" in spec:
        assert pod["restartPolicy"] == "Never", "podFailurePolicy needs restartPolicy Never"
        names = [container["name"] for container in pod["containers"]]
        for rule in spec["podFailurePolicy"]["rules"]:
            if "onExitCodes" in rule:
                assert rule["onExitCodes"]["containerName"] in names, "onExitCodes names no container"


for file in sorted(FOLDER.glob("*.yaml")):
    for document in yaml.safe_load_all(file.read_text()):
        for version in VERSIONS:
            kubernetes_validate.validate(document, version, strict=True)
        if document["kind"] == "Job":
            rules(document)
        name = document["metadata"].get("name", document["metadata"].get("generateName"))
        print(f"  {file.name}: {document['kind']} {name}: valid (Kubernetes {', '.join(VERSIONS)}, strict)")
# A misspelt field is found.
wrong = next(yaml.safe_load_all((FOLDER / "round.yaml").read_text()))
wrong["spec"]["backoffLimitPerIndexes"] = wrong["spec"].pop("backoffLimitPerIndex")
try:
    kubernetes_validate.validate(wrong, VERSIONS[-1], strict=True)
except kubernetes_validate.ValidationError as error:
    print(f"  with a misspelt field: {str(error).splitlines()[0]}")
else:
    sys.exit("a misspelt field was accepted")
