"""Which Isaac Sim this is written to."""

from robogate_bridge import Problem

WANTED = (5, 1)


def check(version):
    """The version, where it is one that the server was written to; `version` is what Isaac Sim says, such as `5.1.0-rc.19`."""
    try:
        major, minor = (int(part) for part in version.split(".")[:2])
    except ValueError:
        raise Problem("setup", f"{version!r} is no version of Isaac Sim") from None
    if (major, minor) != WANTED:
        wanted = ".".join(map(str, WANTED))
        raise Problem("setup", f"this server is written to Isaac Sim {wanted}, and this is {version}: its API has changed between")
    return version
