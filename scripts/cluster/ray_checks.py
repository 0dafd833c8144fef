"""Checks of campaigns in shards that take minutes: kills, two nodes, servers, speed, workers. scripts/cluster.sh runs them.

Each check compares the merged files with those of `robogate run`, byte for byte, and looks for orphaned processes.
"""

import argparse
import contextlib
import os
import random
import resource
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import robogate_eval
from robogate_eval.cluster import shards

# As in robogate_eval.ray.
os.environ.setdefault("RAY_AUTH_MODE", "token")
# The token of the clusters of these checks. Without it Ray expects one in the user's home folder.
os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))

# The files of a run that do not name their folder.
FILES = ("active.json", "dictionary.parquet", "plan.json", "summary.json")
RAY = [sys.executable, "-m", "ray.scripts.scripts"]
PORT = 6391


def say(text: str) -> None:
    print(text, flush=True)


def robogate(*arguments: str) -> "subprocess.CompletedProcess[bytes]":
    return robogate_eval.run_command(*arguments, check=True, capture_output=True)


def driver(out: Path, options: "list[str]", address: str, prefix: "tuple[str, ...]" = ()) -> "subprocess.Popen[bytes]":
    command = [*prefix, sys.executable, "-m", "robogate_eval.ray", "run", "--address", address, "--out", str(out), "--json", *options]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def finish(process: "subprocess.Popen[bytes]") -> "list[str]":
    _, errors = process.communicate()
    lines = errors.decode().splitlines()
    if process.returncode != 0:
        raise SystemExit("\n".join(["the driver failed:", *lines]))
    return lines


def counted(lines: "list[str]") -> str:
    """The line of the driver that counts its shards. The lines of the merge follow it."""
    return next(line for line in lines if " repeated, " in line)


@contextlib.contextmanager
def cluster(cpus: int, temporary: Path, *, prefix: "tuple[str, ...]" = (), ip: str = "127.0.0.1", head: str = ""):
    """A Ray node in a process group of its own. `head` is the address of the head node; without it, this is the head."""
    where = ["--address", head] if head else ["--head", "--port", str(PORT), "--include-dashboard", "false"]
    if not head:
        where += ["--temp-dir", str(temporary)]
    command = [*prefix, *RAY, "start", "--block", "--num-cpus", str(cpus), "--node-ip-address", ip, "--disable-usage-stats", *where]
    log = tempfile.TemporaryFile()
    node = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
    deadline = time.monotonic() + 240
    while b"Ray runtime started" not in (log.seek(0), log.read())[1]:
        if node.poll() is not None or time.monotonic() > deadline:
            raise SystemExit(f"Ray did not start: {(log.seek(0), log.read())[1].decode()}")
        time.sleep(0.5)
    try:
        yield node
    finally:
        node.terminate()
        try:
            node.wait(60)
        except subprocess.TimeoutExpired:
            os.killpg(node.pid, signal.SIGKILL)
            node.wait()


def processes() -> "dict[int, tuple[int, str]]":
    """Parent and command line of each process."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError):
                command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
                fields = (entry / "stat").read_text(errors="replace").rpartition(")")[2].split()
                if command and fields[0] != "Z":
                    found[int(entry.name)] = (int(fields[1]), command)
    return found


def orphans(mark: str) -> "list[str]":
    """The processes of a campaign that still run after 15 s. `mark` is a part of their command lines."""
    for _ in range(30):
        left = [f"{pid}: {command}" for pid, (_, command) in processes().items() if mark in command and pid != os.getpid()]
        if not left:
            return []
        time.sleep(0.5)
    return left


def compare(single: Path, merged: Path) -> None:
    for name in FILES:
        if (single / name).read_bytes() != (merged / name).read_bytes():
            raise SystemExit(f"{name} differs")
    say(f"  {', '.join(FILES)}: same bytes as `robogate run`")


def kills(work: Path, count: int, episodes: int, seed: int) -> None:
    """Kills processes of a campaign with SIGKILL at random times."""
    chance = random.Random(seed)
    options = ["-n", str(episodes), "--seed", "11", "--shards", "24"]
    single, out = work / "single", work / "killed"
    robogate("run", *options[:4], "--out", str(single))
    killed: "dict[str, int]" = {}
    drivers, repeated = 1, 0
    with cluster(2, work / "ray"):
        process = driver(out, options, f"127.0.0.1:{PORT}")
        while sum(killed.values()) < count:
            time.sleep(chance.uniform(0.2, 2.0))
            if process.poll() is not None:
                raise SystemExit(f"the campaign ended after {killed}: use more episodes\n{process.stderr.read().decode()}")
            table = processes()
            leashes = [pid for pid, (_, command) in table.items() if "leash_program.py" in command and str(out) in command and "--shard" in command]
            # A leash is two processes, of which the inner one starts the shard.
            inner = [pid for pid in leashes if table[pid][0] in leashes]
            if not inner:
                continue
            inside = chance.choice(inner)
            leash = table[inside][0]
            kind = chance.choice(["worker", "worker", "driver", "shard", "leash"])
            if kind == "driver":
                process.kill()
                repeated += sum(" again (" in line for line in process.communicate()[1].decode().splitlines())
                # A new driver starts at once, while the shards of the old one may still run.
                process = driver(out, options, f"127.0.0.1:{PORT}")
                drivers += 1
            else:
                shard = [pid for pid, (parent, _) in table.items() if parent == inside]
                victim = {"worker": table[leash][0], "shard": (shard or [inside])[0], "leash": chance.choice([leash, inside])}[kind]
                try:
                    os.kill(victim, signal.SIGKILL)
                except ProcessLookupError:
                    continue
            killed[kind] = killed.get(kind, 0) + 1
        lines = finish(process)
        repeated += sum(" again (" in line for line in lines)
        say(f"  {sum(killed.values())} SIGKILL: {killed}; {drivers} drivers, {repeated} repeats by them")
        say(f"  {counted(lines)}")
        left = orphans(str(out))
        if left:
            raise SystemExit("\n".join(["orphaned processes:", *left]))
        say("  no process of the campaign is left")
    compare(single, out)


def nodes(work: Path, episodes: int) -> None:
    """Two nodes in separate network namespaces. The second one is killed on the way and starts again."""
    options = ["-n", str(episodes), "--seed", "12", "--shards", "16"]
    single, out = work / "single", work / "two-nodes"
    robogate("run", *options[:4], "--out", str(single))
    names, addresses = ("robogate-a", "robogate-b"), ("10.77.0.1", "10.77.0.2")

    def ip(*words: str) -> None:
        subprocess.run(["ip", *words], check=True)

    a, b = (("ip", "netns", "exec", name) for name in names)
    try:
        for name in names:
            ip("netns", "add", name)
        ip("link", "add", "rg0", "netns", names[0], "type", "veth", "peer", "name", "rg0", "netns", names[1])
        for name, address in zip(names, addresses):
            ip("-n", name, "addr", "add", f"{address}/24", "dev", "rg0")
            ip("-n", name, "link", "set", "rg0", "up")
            ip("-n", name, "link", "set", "lo", "up")
        head = f"{addresses[0]}:{PORT}"
        with cluster(1, work / "ray", prefix=a, ip=addresses[0]):
            with cluster(1, work / "ray", prefix=b, ip=addresses[1], head=head) as second:
                process = driver(out, options, head, a)
                while len(list(out.glob("shards/*.rgs"))) < 8:
                    time.sleep(0.1)
                # The whole node: raylet, workers and shards.
                os.killpg(second.pid, signal.SIGKILL)
                say(f"  node {addresses[1]} killed after {len(list(out.glob('shards/*.rgs')))} shards")
            time.sleep(3)
            with cluster(1, work / "ray", prefix=b, ip=addresses[1], head=head):
                lines = finish(process)
                for line in lines:
                    if " again (" in line or " on 10." in line:
                        say(f"  {line}")
                left = orphans(str(out))
                if left:
                    raise SystemExit("\n".join(["orphaned processes:", *left]))
        if not all(address in counted(lines) for address in addresses):
            raise SystemExit("not all nodes ran shards")
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "delete", name], check=False)
    compare(single, out)


def servers(work: Path, episodes: int) -> None:
    """Environments and a policy in servers that actors start; both are killed on the way."""
    serve = f"{robogate_eval.command()} serve --task pendulum --bind tcp://127.0.0.1:{{port}}"
    options = ["--policy", "random", "-n", str(episodes), "--seed", "13"]
    single, out = work / "single", work / "servers"
    with subprocess.Popen(serve.replace("{port}", "6393").split(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        while socket.socket().connect_ex(("127.0.0.1", 6393)) != 0:
            if server.poll() is not None:
                raise SystemExit(f"`{serve}` ended")
            time.sleep(0.1)
        robogate("run", *options, "--simulator", "tcp://127.0.0.1:6393", "--out", str(single))
        server.kill()
    with cluster(2, work / "ray"):
        process = driver(out, [*options, "--shards", "20", "--simulator-server", serve, "--simulators-per-node", "2"], f"127.0.0.1:{PORT}")
        killed = 0
        while killed < 5 and process.poll() is None:
            time.sleep(1)
            found = [pid for pid, (parent, command) in processes().items() if command.startswith(serve.split(" --bind")[0])]
            if found and list(out.glob("shards/*.rgs")):
                os.kill(random.choice(found), signal.SIGKILL)
                killed += 1
        lines = finish(process)
        say(f"  {killed} servers killed, {sum(' again (' in line for line in lines)} repeats; {counted(lines)}")
    left = orphans("serve --task pendulum")
    if left:
        raise SystemExit("\n".join(["orphaned processes:", *left]))
    say("  no server is left")
    compare(single, out)


def speed(work: Path, episodes: int, repeats: int) -> None:
    """Wall and CPU time of threads and of Ray, alternating."""
    options = ["-n", str(episodes), "--seed", "14"]
    walls: "dict[str, list[float]]" = {"threads": [], "ray": []}
    with cluster(2, work / "ray"):
        for repeat in range(repeats):
            begin = time.monotonic()
            robogate("run", *options, "--threads", "2", "--out", str(work / f"threads-{repeat}"))
            middle = time.monotonic()
            lines = finish(driver(work / f"ray-{repeat}", options, f"127.0.0.1:{PORT}"))
            end = time.monotonic()
            walls["threads"].append(middle - begin)
            walls["ray"].append(end - middle)
            say(f"  {episodes} episodes: threads {middle - begin:.1f} s, Ray {end - middle:.1f} s ({counted(lines)}); load {os.getloadavg()[0]:.1f}")
    medians = {name: sorted(times)[len(times) // 2] for name, times in walls.items()}
    say(f"  median: threads {medians['threads']:.1f} s, Ray {medians['ray']:.1f} s, ratio of speeds {medians['threads'] / medians['ray']:.2f}")


def workers(work: Path, episodes: int) -> None:
    """Wall and CPU time of a campaign in 16 shards for different numbers of processes that run shards at once."""
    say("  workers  wall s  CPU s  episodes/s")
    for count in (1, 2, 4, 8):
        out = str(work / f"workers-{count}")
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        robogate("run", "--divide", "16", "--out", out, "-n", str(episodes), "--seed", "16")
        while items := shards.next_round(out).items:
            with ThreadPoolExecutor(count) as pool:
                list(pool.map(lambda item: robogate(*item.arguments, "--threads", "1"), items))
        robogate("merge", out)
        wall, after = time.monotonic() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        say(f"  {count:>7}  {wall:>6.1f}  {cpu:>5.1f}  {episodes / wall:>10.1f}   load {os.getloadavg()[0]:.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("check", choices=["kills", "nodes", "servers", "speed", "workers"])
    parser.add_argument("--episodes", type=int, default=0)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    # Ray's sockets need a short path.
    with tempfile.TemporaryDirectory(prefix="rg", dir="/tmp") as name:
        work = Path(name)
        if given.check == "kills":
            kills(work, given.count, given.episodes or 400, given.seed)
        elif given.check == "nodes":
            nodes(work, given.episodes or 160)
        elif given.check == "servers":
            servers(work, given.episodes or 600)
        elif given.check == "workers":
            workers(work, given.episodes or 240)
        else:
            speed(work, given.episodes or 600, 3)


if __name__ == "__main__":
    main()
