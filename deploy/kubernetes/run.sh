#!/usr/bin/env bash
# Runs the campaign of these manifests: writes its plan, runs its rounds one after the other, and merges them. Stops as soon as a Job
# fails. The same command continues.
#
# Usage: deploy/kubernetes/run.sh, where kubectl has access to the cluster.
set -euo pipefail
cd "$(dirname "$0")"

# Waits for the end of a Job: await JOB
await() {
    local conditions
    while :; do
        conditions=$(kubectl get "$1" --output=jsonpath='{.status.conditions[*].type}')
        case $conditions in
            *Complete*) return ;;
            *Failed*)
                kubectl logs "$1" --tail=20 >&2 || true
                echo "error: $1 has failed. Hint: kubectl describe $1" >&2
                exit 5
                ;;
        esac
        sleep 5
    done
}

kubectl apply --filename=campaign.yaml
await job.batch/robogate-divide
while :; do
    job=$(kubectl create --filename=round.yaml --output=name)
    echo "$job"
    await "$job"
    # All pods of a Job after the last round find nothing to do.
    case $(kubectl logs "$job") in
        *"all rounds are complete"*) break ;;
    esac
done
job=$(kubectl create --filename=merge.yaml --output=name)
await "$job"
kubectl logs "$job"
