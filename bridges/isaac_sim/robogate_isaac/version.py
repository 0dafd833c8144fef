"""The supported version of Isaac Sim."""

from robogate_bridge import Problem

WANTED = (5, 1)


def check(version):
    """Returns the version if it is supported. `version` is the string of Isaac Sim, such as `5.1.0-rc.19`."""
    try:
        major, minor = (int(part) for part in version.split(".")[:2])
    except ValueError:
        raise Problem("setup", f"{version!r} is not a version of Isaac Sim") from None
    if (major, minor) != WANTED:
        wanted = ".".join(map(str, WANTED))
        raise Problem("setup", f"unsupported Isaac Sim {version}. Expected {wanted}: the API changed between")
    return version
