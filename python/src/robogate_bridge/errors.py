"""Errors of the protocol, by kind."""

KINDS = ("setup", "not_applied", "bad_action", "diverged", "unsupported", "bad_request", "internal")

# After these errors no episode is running.
FATAL = ("setup", "not_applied", "diverged", "internal")


class Problem(Exception):
    """An error with a kind of the protocol and a description of one line. Simulators raise it, and the server sends it."""

    def __init__(self, kind, detail):
        if kind not in KINDS:
            raise ValueError(f"unknown kind of problem {kind!r}. Expected one of: {', '.join(KINDS)}")
        super().__init__(f"{kind}: {detail}")
        self.kind = kind
        self.detail = detail
