"""What can go wrong, by kind."""

KINDS = ("setup", "not_applied", "bad_action", "diverged", "unsupported", "bad_request", "internal")

# After these no episode is under way.
FATAL = ("setup", "not_applied", "diverged", "internal")


class Problem(Exception):
    """An error with a kind of the protocol and one line for people. Simulators raise it; the server sends it."""

    def __init__(self, kind, detail):
        if kind not in KINDS:
            raise ValueError(f"{kind!r} is no kind of problem; there are {', '.join(KINDS)}")
        super().__init__(f"{kind}: {detail}")
        self.kind = kind
        self.detail = detail
