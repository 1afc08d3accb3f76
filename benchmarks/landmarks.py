"""Whether mouth, brows and lids of a reconstruction do what the frame does, by a landmark detector of another make.

The detector runs in its own interpreter (benchmarks/judges/mesh.py); nothing of it is used in a build.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from clips import remembered_flow, trial
from judges import mesh, reading
from tables import at_least, print_table, tell

from morphspace.io.images import write_image

COMPONENTS = 40
JUDGED = ("mouth_opening_px", "mouth_width_px", "brow_height_px", "eye_aperture_px")
LEAST_R, SLOPES = 0.95, (0.85, 1.15)
HARDER = {"lp_d6": (0.9, (0.75, 1.15))}


def landmarks(data: Path, clips: tuple[str, ...], work: Path, judge: str) -> None:
    """Print correlation and slope of each measure of reconstructions from 40 components against the frames."""
    print(
        "Correlation r and least-squares slope of the reconstruction (`encode_aligned`, rendered) on the aligned "
        "frame; sd is that of the frames, in px. Detector: " + mesh.DETECTOR + ".\n"
    )
    rows = []
    for name in clips:
        folder, held_out = _written(data, name, work)
        true, made = (_read_faces(judge, folder / kind) for kind in ("aligned", "reconstructed"))
        rows += _rows_of(name, true, made, held_out)
    heads = ["clip", "measure", "sd", "n", "r held out", "slope held out", "n", "r all", "slope all"]
    print_table([*heads, "target", "held out", "all"], rows)
    _jitter(clips, work, judge)


def _written(data: Path, name: str, work: Path) -> tuple[Path, frozenset[str]]:
    """Write aligned frames and their reconstructions as PNG; give the folder and the names of held-out frames."""
    folder = work / "landmarks" / name
    with remembered_flow(work / "flow"):
        one = trial(data, name, work)
        model = one.model.truncate(min(COMPONENTS, one.model.rank))
        for number, frame in enumerate(one.frames):
            tell(f"{name}: encoding frame {number + 1} of {len(one.frames)}")
            made = model.render(model.encode_aligned(frame).values[0])
            write_image(folder / "aligned" / f"{frame.name}.png", frame.image)
            write_image(folder / "reconstructed" / f"{frame.name}.png", made)
    return folder, frozenset(one.frames[index].name for index in one.held_out)


def _read_faces(judge: str, folder: Path) -> dict[str, np.ndarray]:
    table = folder.with_suffix(".csv")
    tell(f"reading landmarks of {folder.parent.name}/{folder.name}")
    reading.run(judge, reading.MESH, [str(folder), "-o", str(table)])
    return mesh.read_measures(table)


def _rows_of(
    name: str, true: dict[str, np.ndarray], made: dict[str, np.ndarray], held_out: frozenset[str]
) -> list[list[object]]:
    shared = [frame for frame in true if frame in made]
    unseen = [frame for frame in shared if frame in held_out]
    least_r, slopes = HARDER.get(name, (LEAST_R, SLOPES))
    rows: list[list[object]] = []
    for measure in JUDGED:
        column = mesh.MEASURES.index(measure)
        row: list[object] = [name, measure.removesuffix("_px").replace("_", " ")]
        row.append(f"{np.std([true[frame][column] for frame in shared], ddof=1):.2f}")
        verdicts = []
        for frames in (unseen, shared):
            r, slope = agreement([true[f][column] for f in frames], [made[f][column] for f in frames])
            row += [len(frames), f"{r:.3f}", f"{slope:.2f}"]
            met = r >= least_r and slopes[0] <= slope <= slopes[1]
            verdicts.append("met" if met else "MISSED")
        rows.append([*row, f"r {least_r}, {slopes[0]}-{slopes[1]}", *verdicts])
    return rows


def agreement(true: list[float], made: list[float]) -> tuple[float, float]:
    """Give Pearson's r and the least-squares slope of `made` on `true`."""
    x, y = np.array(true) - np.mean(true), np.array(made) - np.mean(made)
    return float(x @ y / np.sqrt((x @ x) * (y @ y))), float(x @ y / (x @ x))


def _jitter(clips: tuple[str, ...], work: Path, judge: str) -> None:
    """Print how well the detector agrees with itself on the same faces: the limit of every r above."""
    print("## Jitter of the judge\n")
    print(
        "A perfect reconstruction is expected to reach r = slope = ceiling (`mesh.py jitter`): the sd of the "
        "frames against that of repeated readings of one face, in px.\n"
    )
    rows: list[list[object]] = []
    for name in clips:
        folder = work / "landmarks" / name / "aligned"
        tell(f"repeated readings of {name}")
        printed = [
            line.split()
            for line in reading.run(judge, reading.MESH, ["jitter", str(folder)]).splitlines()[2:]
        ]
        found = {words[0]: [float(word) for word in words[1:]] for words in printed}
        for measure in JUDGED:
            sd, jitter, top = found[measure]
            shown = measure.removesuffix("_px").replace("_", " ")
            rows.append([name, shown, f"{sd:.2f}", f"{jitter:.2f}", f"{top:.3f}", at_least(top, LEAST_R)])
    print_table(["clip", "measure", "sd", "jitter", "ceiling", "can r reach .95"], rows)
