"""Runs a campaign in shards in an S3 bucket of a real server (moto), with several processes for each shard at the same time.

Usage: object_store.py COMMAND; the command needs the feature `object-store`. Needs the package moto[server].
"""

import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import boto3
from botocore.exceptions import ClientError, EndpointConnectionError

PORT = 5095
ENDPOINT = f"http://127.0.0.1:{PORT}"
BUCKET, ADDRESS = "campaigns", "s3://campaigns/2026/franka"
os.environ.update(AWS_ACCESS_KEY_ID="test", AWS_SECRET_ACCESS_KEY="test", AWS_REGION="us-east-1", AWS_ENDPOINT=ENDPOINT, AWS_ALLOW_HTTP="true")
FILES = ("active.json", "dictionary.parquet", "plan.json", "summary.json")
OPTIONS = ["-n", "60", "--seed", "17"]


def robogate(*arguments: str, code: int = 0) -> str:
    done = subprocess.run([sys.argv[1], *arguments], capture_output=True, text=True, check=False)
    if done.returncode != code:
        raise SystemExit(f"robogate {' '.join(arguments)}: exit code {done.returncode}, expected {code}\n{done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def wait(client: object) -> None:
    for _ in range(120):
        try:
            client.create_bucket(Bucket=BUCKET)  # type: ignore[attr-defined]
            return
        except EndpointConnectionError:
            time.sleep(0.5)
    raise SystemExit("the server does not start")


def main() -> None:
    client = boto3.client("s3", endpoint_url=ENDPOINT, region_name="us-east-1")
    server = [str(Path(sys.executable).with_name("moto_server")), "-H", "127.0.0.1", "-p", str(PORT)]
    with tempfile.TemporaryDirectory() as name, subprocess.Popen(server, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            wait(client)
            check(client, Path(name))
        finally:
            process.terminate()


def check(client: object, work: Path) -> None:
    put = client.put_object  # type: ignore[attr-defined]
    put(Bucket=BUCKET, Key="probe", Body=b"1", IfNoneMatch="*")
    try:
        put(Bucket=BUCKET, Key="probe", Body=b"2", IfNoneMatch="*")
        raise SystemExit("the server ignores conditional requests")
    except ClientError as error:
        print(f"  second writer of one object: {error.response['Error']['Code']}")
    robogate("run", *OPTIONS, "--out", str(work / "single"))
    robogate("run", *OPTIONS, "--out", ADDRESS, code=2)
    robogate("run", "--shard", "0/4", "--out", ADDRESS, code=2)
    robogate("run", "--divide", "4", *OPTIONS, "--out", ADDRESS)
    runs = []
    while commands := [line.split()[1:] for line in robogate("plan", ADDRESS, "--next").splitlines() if line.startswith("robogate run")]:
        # Each shard by two processes at the same time.
        with ThreadPoolExecutor(8) as pool:
            runs += pool.map(lambda command: robogate(*command, "--threads", "1", "--json"), [command for command in commands for _ in range(2)])
    states = [state for state in ("committed", "duplicate", "already_committed") for run in runs if f'"state":"{state}"' in run]
    print(f"  {len(runs)} processes for 8 shards: {', '.join(f'{states.count(state)} {state}' for state in sorted(set(states)))}")
    print(f"  {robogate('status', ADDRESS).splitlines()[0]}")
    robogate("merge", ADDRESS, code=2)
    robogate("merge", ADDRESS, "--out", str(work / "merged"))
    for file in FILES:
        if (work / "single" / file).read_bytes() != (work / "merged" / file).read_bytes():
            raise SystemExit(f"{file} differs")
    print(f"  {', '.join(FILES)}: same bytes as `robogate run`")
    key = "2026/franka/shards/uniform-1-of-4.rgs"
    content = bytearray(client.get_object(Bucket=BUCKET, Key=key)["Body"].read())  # type: ignore[attr-defined]
    content[1000] ^= 1
    put(Bucket=BUCKET, Key=key, Body=bytes(content))
    print(f"  one changed byte: {robogate('status', ADDRESS, code=5).strip().splitlines()[0]}")


main()
