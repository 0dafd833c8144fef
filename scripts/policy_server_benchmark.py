"""Measures how well a campaign keeps a policy server busy.

A stub of an OpenVLA-OFT server computes for 100 ms per request, one request after the other, like a model on one GPU. Each reply has
eight actions without motion, as plain JSON lists, so every episode ends at its time limit and all runs send the same requests. The
server's own time is the number of requests times 100 ms. The ratio of the duration of a campaign to that time is 1 if the server never
waits for the simulator.

Usage: scripts/policy_server_benchmark.py ROBOGATE [--episodes N]
"""

import argparse
import json
import os
import subprocess
import tempfile
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

COMPUTE_S = 0.1
LIMIT = 1.3
ACTIONS = json.dumps([[0.0] * 6 + [1.0]] * 8).encode()


class Server(ThreadingHTTPServer):
    """Counts its requests and answers one after the other."""

    daemon_threads = True
    request_queue_size = 64

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.lock = threading.Lock()
        self.requests = 0


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def log_message(self, *_):
        pass

    def reply(self, body):
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def do_GET(self):
        self.reply(json.dumps({"paths": {"/act": {}}}).encode())

    def do_POST(self):
        self.rfile.read(int(self.headers["Content-Length"]))
        with self.server.lock:
            time.sleep(COMPUTE_S)
            self.server.requests += 1
        self.reply(ACTIONS)


def measure(robogate, episodes, threads):
    """Runs a campaign. Returns its duration and the number of requests."""
    server = Server()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with tempfile.TemporaryDirectory() as folder:
        command = [
            robogate, "run", "--policy", f"http://127.0.0.1:{server.server_port}", "--profile", "openvla-oft", "--plan",
            os.path.join(folder, "plan.toml"), "--space", "learned", "--out", os.path.join(folder, "run"),
        ] + ([] if threads is None else ["--threads", str(threads)])
        with open(os.path.join(folder, "plan.toml"), "w") as plan:
            plan.write(f"[uniform]\nepisodes = {episodes}\n")
        begin = time.monotonic()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        duration = time.monotonic() - begin
    server.shutdown()
    return duration, server.requests


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robogate")
    parser.add_argument("--episodes", type=int, default=8)
    arguments = parser.parse_args()
    print(f"{arguments.episodes} episodes, {COMPUTE_S * 1e3:.0f} ms per request, {os.cpu_count()} cores")
    print("| threads | requests | server's own time | duration | ratio |")
    print("|---|---|---|---|---|")
    ratio = 0.0
    for threads in (1, os.cpu_count(), None):
        duration, requests = measure(arguments.robogate, arguments.episodes, threads)
        own = requests * COMPUTE_S
        ratio = duration / own
        print(f"| {threads or 'default'} | {requests} | {own:.1f} s | {duration:.1f} s | {ratio:.2f} |", flush=True)
    if ratio > LIMIT:
        raise SystemExit(f"with the default number of threads the ratio is {ratio:.2f}. Expected at most {LIMIT}")


if __name__ == "__main__":
    main()
