"""info: describe a model and its origin, and check its file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.requests import Model, declared
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

LISTED_COMPONENTS = 10  # components whose variance is printed
_FACEFRAMES = {"mean": "that is the mean of all", "source": "of whose expression it is"}


@declared
class InfoRequest:
    """Describe MODEL and its origin, and check that its file is undamaged."""

    model: Model
    loadings: Annotated[
        Path | None,
        Option(metavar="TABLE.csv"),
        Help("Also write the loadings of the frames that the model was built from, in SD."),
    ] = None


def _faceframe_words(model: MorphModel) -> str:
    if model.faceframe is None:
        return "not marked. Mark it with `morphspace keypoints MODEL --auto`, or --set or --from"
    from morphspace.model.keypoints import point_names

    points = ", ".join(
        f"{name} {x:.1f},{y:.1f}"
        for name, (x, y) in zip(point_names(model), model.faceframe.points.tolist(), strict=True)
    )
    return f"{points} (px of the mean face)"


def _registration_words(model: MorphModel) -> str:
    """Describe the alignment of the frames; blended pictures are drawn aligned."""
    if "blend" not in model.provenance:
        return f"registration {model.registration}"
    return "blended onto one faceframe"


def _blend_lines(model: MorphModel) -> tuple[str, ...]:
    """Describe a blend: the identities, their weights, and the method."""
    blend = model.provenance.get("blend")
    if blend is None:
        return ()
    shares = zip(blend["identities"], blend["weights"], strict=True)
    surround = "nobody (flat grey)" if blend["surround"] is None else blend["surround"]
    return (
        "sources    " + ", ".join(f"{name} {weight:.2g}" for name, weight in shares),
        f"surround   hair, ears, neck and background of {surround}",
        f"method     {blend['method']}, bounded to {blend['max_sd']:g} SD; warped to {blend['reference']}"
        f"{', mouths matched in each expression' if blend['correspondence'] == 'expression' else ''}, aligned onto "
        f"the faceframe {_FACEFRAMES.get(blend['faceframe'], 'of ' + blend['faceframe'])}; sharpened by "
        f"{blend['sharpen']:.2f}",
    )


def run(request: InfoRequest) -> Steps[Outcome]:
    """Read the model, check its digest, and describe it."""
    from morphspace.face.track import turn_words
    from morphspace.model.carried import held_words, quality_lines
    from morphspace.model.keypoints import how_to_learn
    from morphspace.model.landmarks import error_summary
    from morphspace.model.model import load_model, points_document
    from morphspace.outcome import Outcome
    from morphspace.sets.outputs import Output, check_file
    from morphspace.sets.protect import writing
    from morphspace.steps import Step
    from morphspace.verbs.encode import write_loadings

    yield Step("check", 0, 1)
    model = load_model(request.model)
    yield Step("check", 1, 1)
    total = max(float(model.basis.variances.sum()) / max(model.basis.variance_explained, 1e-12), 1e-30)
    shares = (model.basis.variances / total).tolist()
    origin = model.provenance
    lines = [
        f"{request.model}: a morph model of {model.identity} (id {model.model_id}, digest checked)",
        f"frames     {len(model.training.frame_names)} of {model.size[0]}x{model.size[1]}, reference "
        f"{origin['reference']['frame']}, {_registration_words(model)}, flow {model.flow}",
        *_blend_lines(model),
        f"components {model.rank}, {model.basis.variance_explained:.1%} of the variance, warp weight "
        f"{model.warp_weight:.4g} colour/px",
        "shares     "
        + (
            ", ".join(f"{share:.1%}" for share in shares[:LISTED_COMPONENTS])
            or "none: the frames do not differ"
        ),
        f"hold       {held_words(origin)}",
        *(f"quality    {line}" for line in quality_lines(origin)),
        f"consent    {origin.get('consent') or 'not recorded'}",
        f"licence    {origin.get('licence') or 'not recorded'}",
        "faceframe  " + _faceframe_words(model),
        *(f"turn       {words}" for words in (turn_words(origin.get("landmarks")),) if words),
        "landmarks  "
        + (
            f"not learned; `mimic --method guided` needs them: {how_to_learn(model, 'MODEL')}"
            if model.landmarks is None
            else f"{model.landmarks.faces} faces, {error_summary(model.landmarks)}"
        ),
        "versions   "
        + ", ".join(f"{name} {version}" for name, version in sorted(origin["versions"].items())),
    ]
    document = {
        "model_id": model.model_id,
        "identity": model.identity,
        "size": list(model.size),
        "components": model.rank,
        "variance_explained": model.basis.variance_explained,
        "variance_shares": shares,
        "sd": model.sd.tolist(),
        "warp_weight": model.warp_weight,
        "registration": model.registration,
        "flow": model.flow,
        "faceframe": points_document(model.faceframe),
        "landmarks": None if model.landmarks is None else model.landmarks.document(),
        "training_frames": list(model.training.frame_names),
        "provenance": dict(origin),
    }
    if request.loadings is None:
        return Outcome(tuple(lines), document)
    table = request.loadings
    check_file(table, ".csv")
    with writing(
        Output(
            "info",
            table,
            (table, table.with_suffix(".json")),
            inputs=(request.model,),
            identity=model.identity,
        )
    ):
        inputs = dict(origin.get("inputs") or {})
        written = write_loadings(
            table, model.training, model, request.model, inputs, times_s=model.training_times_s
        )
    lines.append(f"{table}: the loadings of {len(model.training.frame_names)} frames, in SD")
    return Outcome(tuple(lines), {**document, "table": str(table)}, written=written)
