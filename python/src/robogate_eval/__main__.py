"""`python -m robogate_eval` runs the command `robogate`."""

import os
import sys

from robogate_eval import CommandNotFoundError, command


def main() -> None:
    """Replace this process by the command."""
    try:
        path = str(command())
    except CommandNotFoundError as error:
        sys.exit(f"error: {error}")
    os.execv(path, [path, *sys.argv[1:]])


if __name__ == "__main__":
    main()
