"""Limits on the size of inputs: a small file can ask for all memory, so its header is compared first (ours).

Each limit can be raised with an environment variable, which the message names.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

from morphspace.errors import BadInput


@dataclass(frozen=True)
class Limit:
    """The largest size of an input.

    Attributes
    ----------
    variable : str
        The environment variable that replaces it.
    usual : int
    unit : str
    """

    variable: str
    usual: int
    unit: str


PICTURE_PX = Limit("MORPHSPACE_LARGEST_PICTURE_PX", 120_000_000, "px")  # 2 GB while read; phones have 108 Mpx
TABLE_BYTES = Limit("MORPHSPACE_LARGEST_TABLE_BYTES", 500_000_000, "bytes")  # a million rows of a manifest
RECIPE_BYTES = Limit("MORPHSPACE_LARGEST_RECIPE_BYTES", 2_000_000, "bytes")  # YAML: 15 s and 200 MB to read
POINTS_BYTES = Limit("MORPHSPACE_LARGEST_POINTS_BYTES", 20_000_000, "bytes")  # a million landmarks


def check_limit(what: str, found: int, limit: Limit, remedy: str) -> None:
    """Raise `BadInput` if `what` is larger than the limit; `remedy` says what to do before raising it.

    Examples
    --------
    >>> check_limit("a.csv", 10, TABLE_BYTES, "Split it")
    """
    given = os.environ.get(limit.variable, "")
    if given and not (given.isascii() and given.isdigit()):
        raise BadInput(
            f"the environment variable {limit.variable} is {given!r}; expected a whole number of {limit.unit}. "
            "Correct it"
        )
    most = int(given or limit.usual)
    if found > most:
        raise BadInput(
            f"{what} has {found} {limit.unit}; expected at most {most}. {remedy}, or set {limit.variable}={found}"
        )
