"""`robogate-ray`: runs a campaign in shards on a Ray cluster.

    robogate-ray run --preset paper --address auto --out DIR

Each Ray task runs `robogate run --shard` for a few shards, in a process that dies with its worker. A shard is committed
at once or not at all, so any worker, node or driver may be killed at any time: the same command continues, and the merged files
have the bytes of a run on one machine.
"""

import argparse
import json
import os
import signal
import socket
import sys
import time
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from robogate_eval import CommandNotFoundError
from robogate_eval.cluster import batches, shards
from robogate_eval.cluster.batches import Batch
from robogate_eval.cluster.progress import Progress, grouped
from robogate_eval.cluster.shards import DONE, FAIL, INCONCLUSIVE, INFRASTRUCTURE, INTERRUPTED, INVALID, USAGE, CommandError, Item

# `ray start` turns token authentication on. A driver sends the token to a cluster that is named by its address only if it is told to,
# before Ray is imported. A cluster without authentication ignores it.
if os.path.exists(os.path.expanduser("~/.ray/auth_token")):
    os.environ.setdefault("RAY_AUTH_MODE", "token")

try:
    import ray

    from robogate_eval.cluster.lanes import Lane, Lanes, Resources, ServerPlan, beside
    from robogate_eval.cluster.tasks import Attempt, Servers, run
except ImportError as error:
    # An exit with a message would have code 1, which means that a gate has failed.
    sys.stderr.write(f"error: {error}\nHint: pip install 'robogate-eval[ray]'\n")
    raise SystemExit(USAGE) from error

# How many shards each slot of the cluster gets in a round. More shards balance the load better, and each takes less time to repeat.
SHARDS_PER_SLOT = 16
# The largest number of tasks that wait in Ray at the same time.
MOST_TASKS = 1000
# How often the driver looks for new nodes, in seconds.
NODES_S = 5.0
# How long a cluster may take to accept a connection, in seconds. Ray itself waits for minutes.
CONNECT_S = 5.0
# Ray's options that slow it down or print too much for this use.
QUIET = {"include_dashboard": False, "log_to_driver": False, "logging_level": "error"}


def note(text: str) -> None:
    """Print a message on stderr."""
    sys.stderr.write(text + "\n")
    sys.stderr.flush()


# The verbs of `robogate` that can be divided into shards.
VERBS = {"run": "Run a campaign", "gate": "Run a gate", "matrix": "Run a sweep"}


def reason(error: Exception) -> str:
    """What went wrong in a task or in Ray, without tracebacks."""
    if isinstance(error, ray.exceptions.RayTaskError) and error.cause is not None:
        return str(error.cause) or type(error.cause).__name__
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


class CampaignError(Exception):
    """The campaign cannot continue. `code` is the exit code."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass
class Campaign:
    """The way the shards of a campaign run, and what they have done."""

    resources: "Resources"
    threads: int
    retries: int
    lanes: "Lanes"
    # How many shards each node has committed.
    nodes: "Counter[str]" = field(default_factory=Counter)
    repeated: int = 0
    _begin: float = field(default_factory=time.monotonic)

    def count(self) -> str:
        """The number of shards, in one line."""
        parts = [f"{count} on {node}" for node, count in sorted(self.nodes.items())]
        seconds = time.monotonic() - self._begin
        return f"{self.nodes.total()} shards ({', '.join(parts) or 'none'}), {self.repeated} repeated, {seconds:.1f} s"

    def once(self, arguments: "list[str]", beside_servers: bool) -> "Attempt":
        """Run `robogate` once."""
        lane = self._wait_for_lane() if beside_servers else None
        return ray.get(self._submit(arguments, lane))

    def _wait_for_lane(self) -> "Lane":
        self.lanes.update()
        lane = self.lanes.free()
        if lane is None:
            raise CampaignError(
                USAGE,
                "no node has room for the servers\nHint: check the GPUs of the nodes with `ray status`, or start servers "
                "with --policies-per-node or --simulators-per-node",
            )
        return lane

    def _submit(self, arguments: "list[str]", lane: "Lane | None") -> Any:
        options = self.resources.options()
        if lane is not None:
            options["scheduling_strategy"] = beside(lane.node)
        servers = lane.servers if lane is not None else Servers()
        return run.options(**options).remote(arguments, servers, os.getcwd())

    def run_round(self, items: "list[Item]", progress: Progress) -> None:
        """Run shards until all of them are committed. Each may fail `retries` times."""
        waiting = deque(items)
        failures: "Counter[Item]" = Counter()
        running: "dict[Any, tuple[Batch, Lane | None]]" = {}
        looked = -NODES_S
        try:
            while waiting or running:
                if self.lanes.needed and time.monotonic() - looked > NODES_S:
                    self.lanes.update()
                    looked = time.monotonic()
                self._start(waiting, running, failures)
                if self.lanes.needed and not running:
                    self._wait_for_lane()
                done, _ = ray.wait(list(running), num_returns=1, timeout=NODES_S)
                for reference in done:
                    batch, lane = running.pop(reference)
                    if lane is not None:
                        lane.busy = False
                    left, problem = self._finished(batch, reference, progress)
                    if left:
                        failures.update(left)
                        self._failed(Batch(left), problem, failures, progress)
                        waiting.extend(left)
        finally:
            for reference in running:
                ray.cancel(reference, force=True)

    def slots(self) -> int:
        """How many tasks can run at once."""
        return len(self.lanes) or max(1, int(ray.cluster_resources().get("CPU", 1) / max(self.resources.cpus, 0.01)))

    def _start(self, waiting: "deque[Item]", running: "dict[Any, tuple[Batch, Lane | None]]", failures: "Counter[Item]") -> None:
        slots = self.slots() if waiting else 0
        while waiting and len(running) < MOST_TASKS:
            lane = self.lanes.free() if self.lanes.needed else None
            if self.lanes.needed and lane is None:
                return
            if lane is not None:
                lane.busy = True
            # A shard that has failed runs alone, so that it is known which one fails.
            batch = batches.take(waiting, slots, failures)
            arguments = [*batch.arguments, "--json", "--threads", str(self.threads)]
            running[self._submit(arguments, lane)] = (batch, lane)

    def _finished(self, batch: Batch, reference: Any, progress: Progress) -> "tuple[tuple[Item, ...], str]":
        """Count the shards of a task that has ended. Returns those that must run again, and the problem."""
        try:
            attempt: Attempt = ray.get(reference)
        except ray.exceptions.RayTaskError as error:
            # An error of this package or of a server's start. Another node may be set up correctly.
            return batch.items, reason(error)
        except ray.exceptions.RayError as error:
            return self._lost(batch, progress), reason(error)
        problem = f"on node {attempt.node}: {attempt.reason}"
        if attempt.code == USAGE:
            raise CampaignError(USAGE, problem)
        if any(document.get("state") == "conflict" for document in attempt.documents):
            raise CampaignError(INFRASTRUCTURE, problem)
        for document in attempt.documents:
            self.nodes[attempt.node] += 1
            progress.add(document)
        committed = {document.get("shard") for document in attempt.documents}
        return tuple(item for item in batch.items if item.shard not in committed), problem

    def _lost(self, batch: Batch, progress: Progress) -> "tuple[Item, ...]":
        """The shards of a killed task that it has not committed. The others are counted."""
        missing = {(item.round, item.shard) for item in shards.next_round(batch.items[0].folder).items}
        left = tuple(item for item in batch.items if (item.round, item.shard) in missing)
        for item in batch.items:
            if item not in left:
                progress.add_unseen(item.episodes)
        return left

    def _failed(self, left: Batch, problem: str, failures: "Counter[Item]", progress: Progress) -> None:
        most = max(failures[item] for item in left.items)
        if most > self.retries:
            raise CampaignError(
                INFRASTRUCTURE,
                f"{left.name} failed {most} times, the last time because: {problem}\n"
                "Hint: committed shards are kept; the same command continues the campaign",
            )
        self.repeated += len(left.items)
        again = "runs again" if len(left.items) == 1 else "run again"
        progress.note(f"{left.name} {again} ({most} of at most {self.retries} times): {problem}")

    def run(self, folder: str) -> None:
        """Run all rounds of the campaign in `folder`."""
        round = shards.next_round(folder)
        while round.name is not None:
            progress = Progress(shards.open_status(folder))
            if progress.committed:
                note(f"{grouped(progress.committed)} of {grouped(progress.shards)} shards are committed already")
            try:
                self.run_round(round.items, progress)
            finally:
                progress.end()
            after = shards.next_round(folder)
            left = set(round.items) & set(after.items)
            if left:
                raise CampaignError(
                    INFRASTRUCTURE,
                    f"{len(left)} shards were committed on another node, but {folder} does not contain them here\n"
                    "Hint: DIR must be the same folder on all nodes, on a shared file system or in an object store",
                )
            round = after


def arguments() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(prog="robogate-ray", description="Run campaigns of RoboGate on a Ray cluster.")
    verbs = parser.add_subparsers(required=True, dest="verb", metavar="VERB")
    for verb, what in VERBS.items():
        _add_options(
            verbs.add_parser(
                verb,
                allow_abbrev=False,
                help=f"{what[0].lower()}{what[1:]} in shards, and merge them",
                description=f"{what} in shards, and merge them to the files of one machine. All options that are not listed here are "
                f"those of `robogate {verb}`. The same command continues an interrupted campaign; its options may then be left out.",
            )
        )
    return parser


def _add_options(verb: argparse.ArgumentParser) -> None:
    add = verb.add_argument
    add("--out", required=True, metavar="DIR", help="folder of the campaign; all nodes must see it under this path")
    add("--merged", metavar="FOLDER", help="write the merged files to this folder; default: DIR; required if DIR is an object store")
    add("--address", default="local", help="address of the Ray cluster: auto, HOST:PORT, or local to start Ray for this run (default)")
    add("--shards", type=int, metavar="N", help=f"shards of each round; default: {SHARDS_PER_SLOT} for each shard that can run at once")
    add("--threads", type=int, default=1, metavar="T", help="threads of each shard; default: 1")
    add("--cpus-per-shard", type=float, metavar="CPUS", help="CPUs that Ray reserves for a shard; default: its threads")
    add("--gpus-per-shard", type=float, default=0.0, metavar="GPUS", help="GPUs that Ray reserves for a shard; default: 0")
    add("--retries", type=int, default=20, metavar="N", help="how often a shard may fail before the campaign stops; default: 20")
    add("--json", action="store_true", help="print the result as one JSON document")
    servers = verb.add_argument_group(
        "servers",
        "Servers run as Ray actors, one on each node or as many as the GPUs of a node allow. {port} in a command is the port on "
        "127.0.0.1 where the server must listen. Shards use the servers of their own node.",
    )
    add = servers.add_argument
    add("--simulator-server", metavar="COMMAND", help="command that serves environments over the bridge protocol; each shard has its own")
    add("--simulators-per-node", type=int, metavar="N", help="default: GPUs of the node / --gpus-per-simulator, or 1")
    add("--gpus-per-simulator", type=float, default=0.0, metavar="GPUS", help="default: 0")
    add("--cpus-per-simulator", type=float, default=0.0, metavar="CPUS", help="default: 0, because its shard waits for it")
    add("--policy-server", metavar="COMMAND", help="command that serves the policy of --policy")
    add("--policies-per-node", type=int, metavar="N", help="default: GPUs of the node / --gpus-per-policy, or 1")
    add("--gpus-per-policy", type=float, default=0.0, metavar="GPUS", help="default: 0")
    add("--cpus-per-policy", type=float, default=0.0, metavar="CPUS", help="default: 0")
    add("--shards-per-policy", type=int, default=1, metavar="N", help="shards that use one policy server at once; default: 1")


def _plan(given: argparse.Namespace, policy: str) -> "Lanes":
    def servers(name: str, per_node: "int | None") -> "ServerPlan | None":
        command = getattr(given, f"{name}_server")
        if command is None:
            return None
        if "{port}" not in command:
            raise CampaignError(USAGE, f"--{name}-server: expected {{port}} in the command `{command}`")
        resources = Resources(getattr(given, f"cpus_per_{name}"), getattr(given, f"gpus_per_{name}"))
        return ServerPlan(command, resources, per_node)

    policies = servers("policy", given.policies_per_node)
    if policies is not None and "://" not in policy:
        # The plan in a folder is read here; that in an object store is not.
        hint = "\nHint: repeat all options of a campaign in an object store" if "://" in given.out else ""
        raise CampaignError(
            USAGE, f"--policy-server needs --policy with the address that the plan records, such as ws://127.0.0.1:8000{hint}"
        )
    return Lanes(servers("simulator", given.simulators_per_node), policies, policy, given.shards_per_policy)


def _value(options: "list[str]", name: str) -> "str | None":
    """The value of an option of `robogate run`, given as two words or as one."""
    for i, word in enumerate(options):
        if word == name and i + 1 < len(options):
            return options[i + 1]
        if word.startswith(f"{name}="):
            return word[len(name) + 1 :]
    return None


def _recorded_policy(folder: str) -> str:
    """The address of the policy in the plan of an existing campaign."""
    try:
        with open(os.path.join(folder, "plan.json"), encoding="utf-8") as file:
            return str(json.load(file)["provenance"]["world"]["policy"]["server"])
    except (OSError, ValueError, KeyError, TypeError):
        return ""


def _endpoint(address: str) -> "tuple[str, int] | None":
    """Host and port of `HOST:PORT` and `ray://HOST:PORT`. Other addresses are left to Ray."""
    try:
        parts = urlsplit(address if "://" in address else f"ray://{address}")
        host, port = parts.hostname, parts.port
    except ValueError:
        return None
    return (host, port) if parts.scheme == "ray" and host and port else None


def _no_cluster(address: str, problem: object) -> CampaignError:
    hint = "start one with `ray start --head`, check the host and port in --address or RAY_ADDRESS, or use --address local"
    return CampaignError(INFRASTRUCTURE, f"no Ray cluster at {address}: {problem}\nHint: {hint}")


def _connect(address: str) -> None:
    # Ray reads this variable in the same case.
    named = (os.environ.get("RAY_ADDRESS") if address == "auto" else None) or address
    endpoint = _endpoint(named)
    if endpoint is not None:
        try:
            socket.create_connection(endpoint, CONNECT_S).close()
        except OSError as error:
            raise _no_cluster(named, error.strerror or error) from error
    try:
        ray.init(address=address, **QUIET)
    except ConnectionError as error:
        raise _no_cluster(named, error) from error
    except ValueError as error:
        raise CampaignError(USAGE, f"--address {address}: {error}") from error
    except Exception as error:
        # Ray has no common class for these errors, such as timeouts and wrong tokens.
        raise CampaignError(INFRASTRUCTURE, f"--address {address}: Ray does not start: {reason(error)}") from error


def _divide(campaign: Campaign, folder: str, given: argparse.Namespace, options: "list[str]") -> None:
    """Write the plan, or check that the options describe the plan that exists."""
    try:
        existing = shards.next_round(folder).shards
    except CommandError as error:
        # There is no campaign yet, or the command below reports what is wrong with the folder.
        if error.code != USAGE:
            raise
        existing = None
    if existing is not None and not options:
        if given.shards not in (None, existing):
            raise CampaignError(USAGE, f"{folder} is divided into {existing} shards, and --shards is {given.shards}")
        return
    slots = campaign.slots()
    count = given.shards or existing or SHARDS_PER_SLOT * slots
    attempt = campaign.once([given.verb, "--divide", str(count), "--out", folder, "--json", *options], campaign.lanes.needed)
    if attempt.code != DONE:
        raise CampaignError(attempt.code, attempt.reason)
    document = attempt.documents[0]
    note(f"{grouped(document.get('episodes', 0))} episodes in {count} shards on {slots} slots, into {folder}")


def execute(given: argparse.Namespace, options: "list[str]") -> int:
    """Run a campaign. Returns the exit code."""
    folder = given.out if "://" in given.out else os.path.abspath(given.out)
    if "://" in folder and given.merged is None:
        raise CampaignError(USAGE, f"--merged is missing: the merged files of {folder} are written to a folder")
    policy = _value(options, "--policy") or _recorded_policy(folder)
    lanes = _plan(given, policy)
    cpus = given.threads if given.cpus_per_shard is None else given.cpus_per_shard
    campaign = Campaign(Resources(cpus, given.gpus_per_shard), given.threads, given.retries, lanes)
    _connect(given.address)
    lanes.update()
    _divide(campaign, folder, given, options)
    campaign.run(folder)
    note(campaign.count())
    code, document = shards.merge(folder, given.merged, given.json)
    # The merge ends without a result in all other cases.
    arms = shards.open_arms(folder) if code in (DONE, FAIL, INCONCLUSIVE, INVALID) else []
    for arm in arms:
        note(f"nominal twins: the campaign in {arm}")
        campaign.run(arm)
    if arms:
        note(campaign.count())
        code, document = shards.merge(folder, given.merged, given.json)
    sys.stdout.write(document)
    return code


def main() -> None:
    """The console script `robogate-ray`."""
    # Where the caller ignores this signal, Python sees no exit code of its processes.
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    given, options = arguments().parse_known_args()
    try:
        code = execute(given, options)
    except ray.exceptions.RayError as error:
        # First, because the error of a task is also an instance of its cause's class.
        note(f"error: {reason(error)}\nHint: committed shards are kept; the same command continues the campaign")
        code = INFRASTRUCTURE
    except (CampaignError, CommandError) as error:
        note(f"error: {error}")
        code = error.code
    except CommandNotFoundError as error:
        note(f"error: {error}")
        code = USAGE
    except OSError as error:
        note(f"error: {error}")
        code = INFRASTRUCTURE
    except KeyboardInterrupt:
        note("\ninterrupted. Committed shards are kept; the same command continues the campaign.")
        code = INTERRUPTED
    finally:
        ray.shutdown()
    sys.exit(code)


if __name__ == "__main__":
    main()
