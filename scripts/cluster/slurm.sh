#!/usr/bin/env bash
# Runs deploy/slurm/robogate.sh on a Slurm cluster of this machine (Debian's slurm-wlm and munge), requeues a running shard, and
# compares the merged files with those of `robogate run`. Needs root. Usage: scripts/cluster/slurm.sh COMMAND [EPISODES]
set -euo pipefail
cd "$(dirname "$0")/../.."

ROBOGATE_COMMAND=$(realpath "$1")
export ROBOGATE_COMMAND
episodes=${2:-240}
work=$(mktemp -d /tmp/rgs.XXXX)
mkdir "$work"/{state,spool,munge}
host=$(hostname -s)
PATH=$PATH:/usr/sbin
export SLURM_CONF=$work/slurm.conf
cat > "$SLURM_CONF" << CONF
ClusterName=robogate
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=26817
SlurmdPort=26818
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$work/munge/socket
CredType=cred/munge
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/slurmd.log
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
ReturnToService=2
# A requeued job starts again after its begin time; the scheduler looks every few seconds.
SchedulerParameters=sched_interval=2,bf_interval=2
NodeName=$host NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN
PartitionName=debug Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF
pids=()
trap 'kill "${pids[@]}" 2> /dev/null; wait; rm -rf "$work"' EXIT
dd if=/dev/urandom of="$work/munge/key" bs=128 count=1 status=none
chmod 400 "$work/munge/key"
munged --foreground --force --key-file="$work/munge/key" --socket="$work/munge/socket" --pid-file="$work/munge/pid" \
    --log-file="$work/munge/log" --seed-file="$work/munge/seed" 2> /dev/null &
pids+=($!)
until [ -S "$work/munge/socket" ]; do sleep 0.2; done
slurmctld -D &> /dev/null &
pids+=($!)
slurmd -D &> /dev/null &
pids+=($!)
until sinfo --noheader --format=%T 2> /dev/null | grep -q idle; do sleep 0.5; done
echo "  $(sinfo --version): $(sinfo --noheader --format='%D node, %C CPUs (allocated/idle/other/total), %T')"

options=(-n "$episodes" --seed 15)
"$ROBOGATE_COMMAND" run "${options[@]}" --out "$work/single" > /dev/null 2>&1
echo "  $ deploy/slurm/robogate.sh DIR 8 ${options[*]}"
deploy/slurm/robogate.sh "$work/run" 8 "${options[@]}" 2>&1 | sed "s|$work/run|DIR|g; s/^/  /"

# Requeues the first shard that runs, and kills the process of another one.
until victim=$(squeue --noheader --array --states=RUNNING --format=%i | grep -m1 _); do sleep 0.2; done
scontrol requeue "$victim"
echo "  scontrol requeue $victim"
until restarts=$(scontrol show job "$victim" | grep -o 'Restarts=[1-9]*') && [ -n "${restarts#Restarts=}" ]; do sleep 0.2; done
echo "  job $victim: $restarts"
until pid=$(pgrep -f "run --shard [0-9]*/8 --out $work/run" | head -n 1) && [ -n "$pid" ] && sleep 0.5 && kill -KILL "$pid" 2> /dev/null; do sleep 0.1; done
echo "  SIGKILL of the process of another shard"

until [ -f "$work/run/report.html" ] || ! squeue --noheader | grep -q .; do sleep 0.5; done
until ! squeue --noheader | grep -q .; do sleep 0.5; done
for file in active.json dictionary.parquet plan.json summary.json; do
    cmp "$work/single/$file" "$work/run/$file"
done
echo "  active.json, dictionary.parquet, plan.json, summary.json: same bytes as \`robogate run\`"
