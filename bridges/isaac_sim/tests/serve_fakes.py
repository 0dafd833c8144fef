"""Serves the fakes for `robogate check bridge`. Only the results on the protocol are meaningful, not those on physics."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from fakes import Fakes  # noqa: E402

Fakes().install()

from robogate_isaac.__main__ import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
