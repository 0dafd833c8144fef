"""The first start of an environment, before its seeds and knobs are known."""

from __future__ import annotations

from typing import Any

from .knobs import DeclarationError

# Starts that are tried until one works: an environment may raise in some.
STARTS = 12


def first_reset(env: Any) -> Any:
    """The result of the first reset that does not raise. If all raise, the error of the first one."""
    first: Exception | None = None
    for seed in range(STARTS):
        try:
            return env.reset(seed=seed)
        except Exception as error:
            if isinstance(error, TypeError) and "seed" in str(error):
                raise DeclarationError(
                    "reset takes no seed. Expected Gymnasium's reset(seed=..., options=...), from which all randomness of an episode "
                    "follows. The package shimmy translates environments of the older gym"
                ) from None
            first = first or error
    raise first
