"""Display a model and loadings in a notebook: HTML cards, and figures by matplotlib (ours).

`model` is a `MorphModel` and `loadings` are `Loadings`, both of which import this module. matplotlib is imported for
a figure only; nothing else in the package needs it. Text is escaped by its type: what is not `Markup` is escaped when
it is inserted, as in the templates of pages. This room lies below those templates.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge
from markupsafe import Markup

from morphspace.arrays import Image
from morphspace.errors import BadInput, optional
from morphspace.io.images import jpeg_bytes
from morphspace.settings import converted, field_of

CARD_COMPONENTS, CARD_SD = 3, 2.0  # number; SD, as in the figures of Nagle et al.
CARD_WIDTH_PX = 90  # px, a face on a card
FIGURE_STEPS = 5  # faces of a component, from minus to plus
UNIT_NAMES = {"sd": "SD of each component", "raw": "raw, of the model's inner product"}
DRAWN, AMOUNT = field_of("components", Annotated[int, Ge(1)]), field_of("amount_sd", float)
LEGEND_AT_MOST = 10  # lines; a longer legend covers the figure


def picture_tag(image: Image, title: str, width_px: int = CARD_WIDTH_PX) -> Markup:
    """Return an HTML `img` of a picture (h, w, 3) in [0, 1] with embedded data."""
    data = base64.b64encode(jpeg_bytes(np.clip(image, 0, 1))).decode("ascii")
    form = Markup('<img width="{width}" title="{title}" alt="{title}" src="data:image/jpeg;base64,{data}">')
    return form.format(width=width_px, title=title, data=data)


def card(heading: str, facts: Mapping[str, Any], rows: Sequence[Sequence[Markup]] = ()) -> str:
    """Return an HTML card: a heading, a table of facts without those that are None, and rows of `picture_tag`.

    Examples
    --------
    >>> print(card("Faces of <anna>", {"consent": None}))
    <div><b>Faces of &lt;anna&gt;</b><table></table></div>
    """
    fact = Markup("<tr><th style='text-align:left'>{}</th><td style='text-align:left'>{}</td></tr>")
    line, join = Markup("<div style='white-space:nowrap'>{}</div>"), Markup("").join
    return Markup("<div><b>{}</b><table>{}</table>{}</div>").format(
        heading,
        join(fact.format(name, value) for name, value in facts.items() if value is not None),
        join(line.format(join(row)) for row in rows),
    )


def model_card(model: Any) -> str:
    """Return a model's HTML card: identity, size, consent; the mean face and the first components at +/- 2 SD."""
    facts = {
        "frames": len(model.training.frame_names),
        "size": f"{model.size[0]} x {model.size[1]} px",
        "components": f"{model.rank}, {model.basis.variance_explained:.1%} of the variance",
        "keypoints": "set" if model.faceframe is not None else "none: `morphspace keypoints MODEL --auto`",
        "consent": model.provenance.get("consent"),
        "licence": model.provenance.get("licence"),
        "model id": model.model_id,
    }
    rows = [[picture_tag(model.mean.render(), "mean face")]]
    for place in range(min(CARD_COMPONENTS, model.rank)):
        rows[0] += [
            picture_tag(_along(model, place, amount), f"component {place + 1} at {amount:+g} SD")
            for amount in (-CARD_SD, CARD_SD)
        ]
    return card(f"MorphModel of {model.identity}", facts, rows)


def loadings_card(loadings: Any) -> str:
    """Return the HTML card of loadings: size, unit and first frames."""
    count, components = loadings.values.shape
    facts = {
        "frames": count,
        "components": components,
        "unit": UNIT_NAMES[loadings.unit],
        "model id": loadings.model_id,
        "first frames": ", ".join(loadings.frame_names[:3]) + (" ..." if count > 3 else ""),
    }
    return card("Loadings", facts)


def plot_components(model: Any, components: int = 3, amount_sd: float = 2.0) -> Any:
    """Draw each of the first components from minus to plus `amount_sd`, one row a component.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    BadInput
        If the model has no component, or fewer than 1 is requested.
    """
    count = min(converted(DRAWN, components), model.rank)
    amount_sd = converted(AMOUNT, amount_sd)
    if count < 1:
        raise BadInput(
            f"the model of {model.identity} has 0 components; expected at least 1 to draw. Build it from more frames"
        )
    amounts = np.linspace(-amount_sd, amount_sd, FIGURE_STEPS)
    figure = optional("matplotlib.figure").Figure(
        figsize=(1.4 * FIGURE_STEPS, 1.8 * count), layout="constrained"
    )
    axes = figure.subplots(count, FIGURE_STEPS, squeeze=False)
    for place in range(count):
        for axis, amount in zip(axes[place], amounts, strict=True):
            axis.imshow(np.clip(_along(model, place, float(amount)), 0, 1))
            axis.set_axis_off()
            axis.set_title(f"{place + 1}: {amount:+g} SD", fontsize=8)
    return figure


def plot_loadings(loadings: Any, components: int = 6) -> Any:
    """Draw the first loadings over the frames, one line a component; return the matplotlib figure."""
    count = min(converted(DRAWN, components), loadings.values.shape[1])
    figure = optional("matplotlib.figure").Figure(figsize=(7, 3), layout="constrained")
    axis = figure.subplots()
    for place in range(count):
        axis.plot(loadings.values[:, place], label=f"component {place + 1}")
    axis.set_xlabel("frame")
    axis.set_ylabel(f"loading ({UNIT_NAMES[loadings.unit]})")
    if 0 < count <= LEGEND_AT_MOST:
        axis.legend(fontsize=8)
    return figure


def _along(model: Any, place: int, amount_sd: float) -> Image:
    loadings = np.zeros(model.rank)
    loadings[place] = amount_sd * model.sd[place]
    return model.render(loadings)
