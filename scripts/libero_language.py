"""Compare the instructions of all LIBERO suites with those of LIBERO's own benchmark class.

Run it with the interpreter of an installation of LIBERO, whose benchmark class needs PyTorch:
    PYTHONPATH=python/src:LIBERO python scripts/libero_language.py
LIBERO asks a question at its first start: answer n.
Exit code 1: an instruction differs.
"""

import sys

from libero.libero import benchmark

from robogate_eval.libero import installation
from robogate_eval.libero.suites import SUITES, wording


def main() -> int:
    order, differences, compared = installation.task_order(), 0, 0
    for suite in SUITES.values():
        theirs = benchmark.get_benchmark_dict()[suite.folder]()
        by_name = {task.name: task.language for task in map(theirs.get_task, range(theirs.get_num_tasks()))}
        for name in order[suite.folder]:
            compared += 1
            if wording(name) != by_name.get(name):
                differences += 1
                print(f"{suite.folder}/{name}: {wording(name)!r}, LIBERO has {by_name.get(name)!r}")
    print(f"{compared} instructions compared, {differences} differ")
    return 1 if differences else 0


if __name__ == "__main__":
    sys.exit(main())
