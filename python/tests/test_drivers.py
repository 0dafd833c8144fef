"""The drivers of campaigns in shards, with a false `robogate`: robogate_eval.ray without Ray, and the scripts for Slurm and Kubernetes."""

import contextlib
import importlib
import io
import json
import os
import socket
import subprocess
import sys
import tempfile
import types
import unittest
from pathlib import Path
from typing import Any
from unittest import mock

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"

# A gate with one shard and nominal twins, whose verdict is inconclusive (exit code 3). It is divided with --divide, and --policy must be
# a file.
ROBOGATE = r"""#!/bin/sh
echo "$*" >> "$CALLS"
verb=$1 dir=$2 divide= json= arguments=$*
shift
while [ $# -gt 0 ]; do
    case $1 in
        --out) dir=$2 ;;
        --divide) divide=1 ;;
        --json) json=1 ;;
        --policy) [ -f "$2" ] || { echo "error: cannot read $2" >&2; exit 2; } ;;
    esac
    shift
done
divided() { mkdir -p "$1/shards" && touch "$1/plan.json" "$1/shards/layout.json"; }
case $verb in
    run | gate)
        if [ -n "$divide" ]; then
            divided "$dir"
            echo '{"episodes": 5}'
        else
            touch "$dir/shards/done"
            echo '{"shard": "0/1", "outcomes": {"success": 5}}'
        fi
        ;;
    plan)
        [ ! -f "$dir/damaged" ] || { echo "error: shard 0 is damaged" >&2; exit 5; }
        [ -f "$dir/shards/layout.json" ] || { echo "error: $dir is not in shards" >&2; exit 2; }
        case " $arguments " in
            *" --next "*) ;;
            *)
                echo '{"rounds": [{"round": "suite-0", "state": "open", "episodes": 5, "done": 0, "committed": 0, "missing": [0], "outcomes": {}}]}'
                exit 0
                ;;
        esac
        command="robogate run --shard 0/1 --out $dir"
        words=$(echo "\"$command\"" | sed 's/ /", "/g')
        item="{\"shard\": \"0/1\", \"round\": \"suite-0\", \"dir\": \"$dir\", \"episodes\": 5, \"command\": [$words]}"
        if [ -f "$dir/shards/done" ]; then
            [ -z "$json" ] || echo '{"shards": 1, "round": null, "items": []}'
        elif [ -n "$json" ]; then
            echo "{\"shards\": 1, \"round\": \"suite-0\", \"items\": [$item]}"
        else
            echo "$command"
        fi
        ;;
    merge)
        divided "$dir/nominal"
        divided "$dir/families"
        [ -f "$dir/nominal/shards/done" ] && [ -f "$dir/families/shards/done" ] && twins=true || twins=false
        echo "{\"twins\": $twins}"
        exit 3
        ;;
esac
"""


class RayError(Exception):
    """As in Ray."""


class RayTaskError(RayError):
    """As in Ray."""

    def __init__(self, cause: Exception) -> None:
        super().__init__("Traceback (most recent call last):\n  ...")
        self.cause = cause


class Reference:
    """The result of a remote function."""

    def __init__(self, result: Any) -> None:
        self.result = result


class Remote:
    """A remote function, which runs at once in a folder of its own, like a worker."""

    def __init__(self, function: Any, worker: Path) -> None:
        self._function = function
        self._worker = worker

    def options(self, **_: Any) -> "Remote":
        return self

    def remote(self, *arguments: Any) -> Reference:
        driver = os.open(".", os.O_RDONLY)
        os.chdir(self._worker)
        try:
            return Reference(self._function(*arguments))
        except Exception as error:
            return Reference(RayTaskError(error))
        finally:
            os.fchdir(driver)
            os.close(driver)


def get(reference: Reference) -> Any:
    if isinstance(reference.result, RayError):
        raise reference.result
    return reference.result


def ray_of_one_process(worker: Path) -> "dict[str, Any]":
    """The modules of a Ray with one CPU that runs each task when it is submitted."""
    ray = types.SimpleNamespace(
        remote=lambda **_: lambda what: Remote(what, worker),
        get=get,
        wait=lambda running, **_: (running[:1], running[1:]),
        init=lambda **_: None,
        shutdown=lambda: None,
        cancel=lambda *_, **__: None,
        nodes=list,
        cluster_resources=lambda: {"CPU": 1},
        exceptions=types.SimpleNamespace(RayError=RayError, RayTaskError=RayTaskError),
        util=types.SimpleNamespace(get_node_ip_address=lambda: "node"),
    )
    strategies = types.SimpleNamespace(NodeAffinitySchedulingStrategy=object)
    return {"ray": ray, "ray.util": ray.util, "ray.util.scheduling_strategies": strategies}


class Driver(unittest.TestCase):
    """A driver in a folder of its own."""

    def setUp(self) -> None:
        work = tempfile.TemporaryDirectory()
        self.addCleanup(work.cleanup)
        self.work = Path(work.name).resolve()
        self.calls = self.work / "calls"
        self.command = self.program("robogate", ROBOGATE)
        environment = mock.patch.dict(os.environ, {"ROBOGATE_COMMAND": str(self.command), "CALLS": str(self.calls)})
        environment.start()
        self.addCleanup(environment.stop)
        self.addCleanup(os.chdir, os.getcwd())
        os.chdir(self.work)

    def program(self, name: str, text: str) -> Path:
        path = self.work / name
        path.write_text(text)
        path.chmod(0o755)
        return path

    def called(self, verb: str) -> int:
        """How often a verb of `robogate` ran."""
        return sum(line.startswith(f"{verb} ") for line in self.calls.read_text().splitlines())


@unittest.skipUnless(sys.platform == "linux", "the leash needs Linux")
class OnRay(Driver):
    def setUp(self) -> None:
        super().setUp()
        worker = self.work / "worker"
        worker.mkdir()
        self.modules = ray_of_one_process(worker)
        forgotten = ("robogate_eval.ray", "robogate_eval.cluster.tasks", "robogate_eval.cluster.lanes")
        modules = mock.patch.dict(sys.modules, self.modules)
        modules.start()
        self.addCleanup(modules.stop)
        for name in forgotten:
            sys.modules.pop(name, None)
        self.driver = importlib.import_module("robogate_eval.ray")

    def run_driver(self, *arguments: str) -> "tuple[int, str, str]":
        """Exit code, stdout and stderr of the driver."""
        out, errors = io.StringIO(), io.StringIO()
        with mock.patch.object(sys, "argv", ["robogate-ray", *arguments]), contextlib.redirect_stdout(out):
            with contextlib.redirect_stderr(errors), self.assertRaises(SystemExit) as ended:
                self.driver.main()
        return int(ended.exception.code or 0), out.getvalue(), errors.getvalue()

    def test_nominal_twins_run_before_the_last_merge(self) -> None:
        code, output, errors = self.run_driver("gate", "--out", "d", "--json")
        self.assertEqual((code, json.loads(output)), (3, {"twins": True}), errors)
        self.assertEqual((self.called("merge"), self.called("run")), (2, 3))

    def test_relative_paths_are_those_of_the_driver(self) -> None:
        (self.work / "x.onnx").touch()
        self.assertEqual(self.run_driver("gate", "--out", "d", "--json", "--policy", "x.onnx")[0], 3)
        # A node without the folder of the driver.
        with mock.patch.object(self.driver.os, "getcwd", return_value="/nowhere/driver"):
            code, _, errors = self.run_driver("gate", "--out", str(self.work / "e"), "--policy", "y.onnx")
        self.assertEqual(code, 2)
        self.assertIn("error: cannot read y.onnx\nHint: this node cannot use /nowhere/driver", errors)

    def test_errors_of_ray_are_infrastructure(self) -> None:
        self.command.unlink()
        code, _, errors = self.run_driver("run", "--out", "d")
        self.assertEqual(code, 2, errors)
        self.program("robogate", ROBOGATE)
        with mock.patch.object(self.driver, "run", Remote(self.missing, self.work)):
            code, _, errors = self.run_driver("run", "--out", "d")
        self.assertEqual(code, 5)
        self.assertTrue(errors.startswith("error: no command on this node\nHint: "), errors)

    @staticmethod
    def missing(*_: Any) -> None:
        raise FileNotFoundError("no command on this node")

    def test_errors_of_the_address_have_codes(self) -> None:
        for raised, code, message in [
            (ValueError("Malformed address here."), 2, "error: --address here: Malformed address here.\n"),
            (ConnectionError("refused"), 5, "error: no Ray cluster at here: refused\nHint: "),
            (RuntimeError("wrong version\nof Ray"), 5, "error: --address here: Ray does not start: wrong version\n"),
        ]:
            with mock.patch.object(self.modules["ray"], "init", side_effect=raised):
                got, _, errors = self.run_driver("run", "--out", "d", "--address", "here")
            self.assertEqual(got, code)
            self.assertTrue(errors.startswith(message), errors)

    def test_an_address_without_a_server_is_refused(self) -> None:
        # A bound socket that does not listen refuses all connections.
        with socket.socket() as closed, mock.patch.object(self.modules["ray"], "init") as init:
            closed.bind(("127.0.0.1", 0))
            port = closed.getsockname()[1]
            for address in (f"127.0.0.1:{port}", f"ray://localhost:{port}", f"[::1]:{port}"):
                for option, variable in [(address, ""), ("auto", address)]:
                    with mock.patch.dict(os.environ, {"RAY_ADDRESS": variable}):
                        code, _, errors = self.run_driver("run", "--out", "d", "--address", option)
                    self.assertEqual(code, 5, errors)
                    self.assertTrue(errors.startswith(f"error: no Ray cluster at {address}: "), errors)
                    self.assertIn("\nHint: start one with `ray start --head`", errors)
        init.assert_not_called()

    def test_other_addresses_are_left_to_ray(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            listening = f"127.0.0.1:{server.getsockname()[1]}"
            for option, variable in [("auto", ""), ("local", "127.0.0.1:1"), ("here", ""), ("::1:1", ""), (listening, ""), ("auto", listening)]:
                with mock.patch.dict(os.environ, {"RAY_ADDRESS": variable}):
                    with mock.patch.object(self.modules["ray"], "init", side_effect=ValueError("of Ray")) as init:
                        code, _, errors = self.run_driver("run", "--out", "d", "--address", option)
                self.assertEqual((code, errors), (2, f"error: --address {option}: of Ray\n"))
                self.assertEqual(init.call_args.kwargs["address"], option)

    def test_damaged_shards_are_not_wrong_options(self) -> None:
        (self.work / "d").mkdir()
        (self.work / "d" / "damaged").touch()
        code, _, errors = self.run_driver("gate", "--out", "d", "--rounds", "2")
        self.assertEqual((code, errors), (5, "error: shard 0 is damaged\n"))
        self.assertEqual(self.called("gate"), 0)


class OnSlurm(Driver):
    # Runs each job at once, as the first of its array.
    SBATCH = r"""#!/bin/bash
while [[ $1 == --* ]]; do
    [[ $1 != --export=* ]] || export "${1##*,}"
    [[ $1 != --dependency=* ]] || echo "dependency ${1#*=}" >> "$CALLS"
    shift
done
number=$(($(cat "$CALLS.jobs" 2> /dev/null || echo 0) + 1))
echo "$number" > "$CALLS.jobs"
SLURM_ARRAY_TASK_ID=0 SLURM_JOB_ID=$number "$@" >> "$CALLS.log" 2>&1 || echo "ended with $?" >> "$CALLS"
echo "$number;cluster"
"""

    def setUp(self) -> None:
        super().setUp()
        self.program("sbatch", self.SBATCH)

    def submit(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        path = f"{self.work}:{os.environ['PATH']}"
        return subprocess.run([DEPLOY / "slurm" / "robogate.sh", *arguments], env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False)

    def test_nominal_twins_run_before_the_last_merge(self) -> None:
        done = self.submit("d", "1", "--seed", "1")
        self.assertEqual(done.returncode, 0, done.stderr)
        lines = self.calls.read_text().splitlines()
        self.assertTrue(all((self.work / "d" / arm / "shards" / "done").exists() for arm in ("", "nominal")), lines)
        # The false array has one task, so the two arms need one array each. The last merge has the exit code of the gate.
        self.assertEqual((self.called("merge"), lines.count("ended with 3")), (2, 1), lines)
        # The name of the cluster is not a part of the number of a job.
        dependencies = [line for line in lines if line.startswith("dependency")]
        self.assertTrue(dependencies and not any(";" in line for line in dependencies), lines)

    def test_folders_without_campaigns_are_refused(self) -> None:
        for arguments, message in [(["new"], "contains no campaign"), (["s3://b/x", "8"], "expected a folder")]:
            done = self.submit(*arguments)
            self.assertEqual(done.returncode, 2)
            self.assertIn(message, done.stderr)
        self.assertEqual(sorted(path.name for path in self.work.iterdir()), ["robogate", "sbatch"])


class OnKubernetes(Driver):
    # All Jobs complete at once, but that of FAILS. The third Job of a round finds nothing to do.
    KUBECTL = r"""#!/bin/sh
echo "$*" >> "$CALLS"
case $1 in
    create)
        number=$(grep -c "^create.*round" "$CALLS")
        case $2 in *round*) echo "job.batch/round-$number" ;; *) echo job.batch/merge ;; esac
        ;;
    get) case $2 in $FAILS) echo FailureTarget Failed ;; *) echo SuccessCriteriaMet Complete ;; esac ;;
    logs) case $2 in *round-3) echo "nothing to do: all rounds are complete" ;; *) echo "the log of $2" ;; esac ;;
esac
"""

    def rounds(self, fails: str) -> "subprocess.CompletedProcess[str]":
        self.program("kubectl", self.KUBECTL)
        environment = {**os.environ, "PATH": f"{self.work}:{os.environ['PATH']}", "FAILS": fails}
        return subprocess.run([DEPLOY / "kubernetes" / "run.sh"], env=environment, capture_output=True, text=True, check=False)

    def test_rounds_end_with_the_campaign(self) -> None:
        done = self.rounds("none")
        self.assertEqual(done.returncode, 0, done.stderr)
        created = [line.split()[1] for line in self.calls.read_text().splitlines() if line.startswith("create")]
        self.assertEqual(created, ["--filename=round.yaml"] * 3 + ["--filename=merge.yaml"])
        self.assertTrue(done.stdout.endswith("the log of job.batch/merge\n"), done.stdout)

    def test_failed_jobs_end_the_campaign(self) -> None:
        done = self.rounds("job.batch/round-2")
        self.assertEqual(done.returncode, 5)
        self.assertIn("the log of job.batch/round-2\nerror: job.batch/round-2 has failed", done.stderr)
        self.assertEqual(self.called("create"), 2)


if __name__ == "__main__":
    unittest.main()
