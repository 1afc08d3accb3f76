"""demo: run the whole path on drawn faces in under a minute, ending with a page to open.

Two drawn people and one animated photograph (scikit-image's `astronaut`, public domain) are made into models. The
faces of each model are encoded, reconstructed, exaggerated, swept and drawn at random.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.requests import declared
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

SEED = 1  # of the actors
IDENTITIES, PORTRAITS, FRAMES = 2, 1, 30
COMPONENTS = 15  # components, of 30 frames


@declared
class DemoRequest:
    """Draw actors, build their models, render faces, and write a page to open: the whole path in a minute."""

    output: Annotated[Path, Option("-o", "--output"), Help("The folder to write into.")] = Path(
        "morphspace-demo"
    )


def run(request: DemoRequest) -> Steps[Outcome]:
    """Draw actors, build models, render, and write index.html."""
    from morphspace import synthetic
    from morphspace.model.model import load_model
    from morphspace.outcome import RECORD_NAME, Outcome, write_record
    from morphspace.report.demo_page import demo_pictures, write_demo_page
    from morphspace.sets.outputs import Output
    from morphspace.sets.protect import writing
    from morphspace.verbs import build_model, make_actors

    folder = request.output
    names = synthetic.actor_names(IDENTITIES, PORTRAITS)
    page = folder / "index.html"
    own = [page, *(folder / name for name in names), folder / RECORD_NAME]
    with writing(Output("demo", folder, own)):
        yield from make_actors.run(
            make_actors.MakeActorsRequest(
                folder / "actors", identities=IDENTITIES, portraits=PORTRAITS, frames=FRAMES, seed=SEED
            )
        )
        models, written = {}, [page]
        for name in names:
            clip, output = folder / "actors" / name, folder / f"{name}.morph"
            built = yield from build_model.run(
                build_model.BuildModelRequest(
                    sources=(str(clip),),
                    output=output,
                    components=COMPONENTS,
                    landmarks="none",  # drawn faces are aligned and cropped; the demo is the same on every machine
                )
            )
            written += built.written
            yield from demo_pictures(load_model(output), clip, folder / name)
            written += sorted((folder / name).iterdir())
            models[name] = built.document
        write_demo_page(page, models)
        record = write_record(folder, "demo", {}, {}, written)
    lines = (f"{page}: open it in a browser",)
    return Outcome(lines, {"page": str(page), "actors": list(names)}, (), (*written, record))
