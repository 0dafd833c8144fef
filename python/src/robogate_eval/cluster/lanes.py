"""Where shards run: anywhere in the cluster, or beside the servers of a node."""

import os
from dataclasses import dataclass, field
from typing import Any

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from robogate_eval.cluster.tasks import Server, Servers


@dataclass(frozen=True)
class Resources:
    """What one process needs."""

    cpus: float
    gpus: float

    def options(self) -> "dict[str, Any]":
        """The options of a Ray task or actor."""
        return {"num_cpus": self.cpus, "num_gpus": self.gpus}


@dataclass(frozen=True)
class ServerPlan:
    """The servers of one kind on each node."""

    command: str
    resources: Resources
    # `None`: as many as the GPUs of the node allow, or one if a server needs no GPU.
    per_node: "int | None"

    def count(self, node_gpus: float) -> int:
        """The number of servers on a node with this number of GPUs."""
        if self.per_node is not None:
            return self.per_node
        return int(node_gpus / self.resources.gpus + 1e-9) if self.resources.gpus > 0 else 1

    def start(self, node: str) -> Any:
        """Create the actor of one server on a node. Ray starts its process later."""
        options = {**self.resources.options(), "scheduling_strategy": beside(node)}
        return Server.options(**options).remote(self.command, os.getcwd())


@dataclass(eq=False)
class Lane:
    """Servers of a node that one shard at a time uses."""

    node: str
    servers: Servers
    busy: bool = False


def beside(node: str) -> NodeAffinitySchedulingStrategy:
    """Schedules a task on this node only."""
    return NodeAffinitySchedulingStrategy(node, soft=False)


@dataclass
class Lanes:
    """The lanes of all nodes, if shards need servers."""

    simulators: "ServerPlan | None"
    policies: "ServerPlan | None"
    policy_address: str
    shards_per_policy: int
    _lanes: "dict[str, list[Lane]]" = field(default_factory=dict)

    @property
    def needed(self) -> bool:
        """Whether shards need servers of their node. Otherwise they run anywhere."""
        return self.simulators is not None or self.policies is not None

    def update(self) -> None:
        """Start the servers of nodes that have joined the cluster, and forget nodes that have left it."""
        alive = {node["NodeID"]: node["Resources"].get("GPU", 0.0) for node in ray.nodes() if node["Alive"]}
        for node in [node for node in self._lanes if node not in alive]:
            del self._lanes[node]
        for node, gpus in alive.items():
            if node not in self._lanes:
                self._lanes[node] = self._of(node, gpus)

    def _of(self, node: str, gpus: float) -> "list[Lane]":
        policies = [self.policies.start(node) for _ in range(self.policies.count(gpus))] if self.policies else []
        if self.simulators is None:
            uses = [Servers(None, policy, self.policy_address) for policy in policies for _ in range(self.shards_per_policy)]
        else:
            simulators = [self.simulators.start(node) for _ in range(self.simulators.count(gpus))]
            if self.policies is None:
                uses = [Servers(simulator) for simulator in simulators]
            else:
                # Simulators of a node without a policy server have nothing to do.
                uses = [
                    Servers(simulator, policies[i % len(policies)], self.policy_address)
                    for i, simulator in enumerate(simulators)
                    if policies
                ]
        return [Lane(node, servers) for servers in uses]

    def free(self) -> "Lane | None":
        """A lane without a shard. Nodes with more free lanes come first, so that shards spread over the nodes."""
        idle = [[lane for lane in lanes if not lane.busy] for lanes in self._lanes.values()]
        idle = [lanes for lanes in idle if lanes]
        return max(idle, key=len)[0] if idle else None

    def __len__(self) -> int:
        return sum(len(lanes) for lanes in self._lanes.values())
