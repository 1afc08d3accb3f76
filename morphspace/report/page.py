"""Pages as Jinja2 templates: one environment with autoescape, filters for values, and printable text (ours).

A page is one file that loads nothing but a video beside it. The same values give the same bytes.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from markupsafe import Markup

if TYPE_CHECKING:
    from jinja2 import Environment

DASH, MINUS, TIMES = "\N{EN DASH}", "\N{MINUS SIGN}", "\N{MULTIPLICATION SIGN}"
DIGEST = re.compile(r"[0-9a-f]{17,}")


@dataclass(frozen=True)
class Panel:
    """A picture or plot of a page with its caption: `label`, in bold in some places, then `note`; `kind` its class."""

    picture: Markup
    label: str
    note: str = ""
    kind: str = ""


def render(template: str, page: object) -> str:
    """Return the page as HTML: `templates/<template>` filled with the dataclass `page`."""
    return _environment().get_template(template).render(page=page)


def markup(form: str, **values: object) -> Markup:
    """Return `form`, a piece of HTML or SVG of our own, with the values inserted and escaped."""
    return Markup(form).format(**{name: _printable(value) for name, value in values.items()})


def fixed(value: float | None, decimals: int = 2) -> str:
    """Format a number with fixed decimals, or a dash if it is undefined."""
    return f"{value + 0.0:.{decimals}f}" if value is not None and math.isfinite(value) else DASH


def percent(share: float, decimals: int = 0) -> str:
    """Format a share of 1 in percent, or a dash if it is undefined."""
    return DASH if not math.isfinite(share) else f"{100 * share:.{decimals}f} %"


def p_value(p: float) -> str:
    """Format a probability."""
    return f"p {p:.3f}" if math.isfinite(p) else "p undefined"


def signed(value: float, decimals: int = 0) -> str:
    """Format a number with its sign; an integer 0 has none."""
    return f"{value:+.{decimals}f}".replace("-", MINUS) if value or decimals else "0"


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined  # 0.1 s, which only pages need

    environment = Environment(
        loader=PackageLoader("morphspace.report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_printable,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"fixed": fixed, "percent": percent, "signed": signed, "p_value": p_value}
    environment.tests["digest"] = lambda value: isinstance(value, str) and DIGEST.fullmatch(value) is not None
    return environment


def _printable(value: object) -> object:
    """Replace control characters and broken UTF-8 of a text by spaces; numbers and our own markup stay."""
    if isinstance(value, Markup | int | float) or (words := str(value)).isprintable():
        return value
    return "".join(character if character.isprintable() else " " for character in words)
