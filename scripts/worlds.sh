#!/usr/bin/env bash
# Compares many worlds in MuJoCo Warp, on its CPU device, with MuJoCo in this process (docs/results/throughput.md). Takes minutes: the first run
# compiles kernels.
#
# Needs ROBOGATE_NEWTON_PYTHON, the Python of the Newton bridge (bridges/newton/README.md), which has mujoco-warp.
set -euo pipefail
cd "$(dirname "$0")/.."
: "${ROBOGATE_NEWTON_PYTHON:?name the Python of the Newton bridge}"
date --iso-8601
ROBOGATE_TESTS_STRICT=1 cargo test --package robogate-tasks --test worlds --locked -- --ignored --nocapture
