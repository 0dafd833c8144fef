"""Runs the unittest suite in a folder and records skipped tests, as the Rust tests do.

Usage: run_unittests.py FOLDER [ARGUMENTS OF UNITTEST DISCOVERY...]

Each skipped test is appended to the file that ROBOGATE_SKIPPED_FILE names. With ROBOGATE_TESTS_STRICT=1 a skipped test is an
error. It is always an error if no test was found.
"""

import os
import sys
import unittest

folder, arguments = sys.argv[1], sys.argv[2:]
discover = ["unittest", "discover", "--start-directory", folder]
program = unittest.main(module=None, argv=[*discover, *arguments], exit=False)
result = program.result
lines = [f"skipped: {test.id()}: {reason}\n" for test, reason in result.skipped]
if path := os.environ.get("ROBOGATE_SKIPPED_FILE"):
    with open(path, "a", encoding="utf-8") as file:
        file.write("".join(lines))
strict = bool(lines) and os.environ.get("ROBOGATE_TESTS_STRICT") == "1"
if strict:
    sys.stderr.write("error: ROBOGATE_TESTS_STRICT=1 forbids skipped tests:\n" + "".join(lines))
# A class whose setup was skipped counts no test.
found = result.testsRun > 0 or bool(result.skipped)
if not found:
    sys.stderr.write(f"error: {' '.join([folder, *arguments])}: no tests were found\n")
sys.exit(0 if result.wasSuccessful() and found and not strict else 1)
