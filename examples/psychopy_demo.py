"""Show a stimulus set with PsychoPy: every frame loaded before the first trial, right way up, -1 (black) to 1 (white).

    python examples/psychopy_demo.py SET [--check] [--full-screen] [--seconds S] [--select COLUMN=VALUE ...]

SET is the folder of a stimulus set (it holds manifest.csv). Needs morphspace to read, and PsychoPy to show; with
--check everything is loaded and checked and nothing is shown. Copy what you need: `load_set` gives the frames as
arrays, `textures` makes them what PsychoPy draws, `play` draws them in time with the screen.

What PsychoPy makes of an array: row 0 is drawn at the bottom (pictures read from files are turned over by PsychoPy
itself, arrays are not), and textures go from -1 to 1. Its GratingStim takes colours so in all releases; its ImageStim
takes the colours of an array from 0 to 1 in some, whatever its message says. So the frames are drawn by a GratingStim
of one cycle, laid in a square whose side is a power of two, as that one wants; the border is grey as the background.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.errors import BadInput, MorphspaceError
from morphspace.io.images import read_image
from morphspace.io.texts import number_remedy, read_table
from morphspace.io.video import read_frames
from morphspace.storage import digest_of_file

MOST_BYTES = 4_000_000_000  # held in memory; a larger set is shown in parts, see --select
NUMBERS = {
    "frames": r"[1-9]\d*",
    "width_px": r"[1-9]\d*",
    "height_px": r"[1-9]\d*",
    "frame_rate_hz": r"(\d+(\.\d+)?)?",
}  # columns and what their cells are; a picture has no rate
NEEDED = ("file", "sha256", *NUMBERS)
GREY = 0.0  # PsychoPy's middle grey, and the background of its windows


@dataclass(frozen=True, eq=False)
class Stimulus:
    """A stimulus ready to be shown: `row` of the manifest | `frames` (n, h, w, 3) float32, -1 to 1, row 0 at the
    bottom | `frame_rate_hz`, None for a picture.
    """

    row: Mapping[str, str]
    frames: np.ndarray
    frame_rate_hz: float | None


def psychopy_frame(image: np.ndarray) -> np.ndarray:
    """Turn a picture (h, w, 3), 0 to 1, row 0 at the top, into what PsychoPy draws: -1 to 1, row 0 at the bottom."""
    return np.ascontiguousarray(2 * image[::-1] - 1, np.float32)


def load_set(folder: Path, wanted: Mapping[str, str] | None = None) -> list[Stimulus]:
    """Load all stimuli of a set, or those whose columns have the wanted values, in the manifest's order.

    Each file must be the one the manifest describes: a changed stimulus is refused. Raises `BadInput`.
    """
    rows = chosen(read_manifest(folder), wanted or {})
    size = sum(4 * 3 * int(row["frames"]) * int(row["width_px"]) * int(row["height_px"]) for row in rows)
    if size > MOST_BYTES:
        raise BadInput(
            f"{len(rows)} stimuli need {size / 1e9:.1f} GB, at most {MOST_BYTES / 1e9:.0f} are loaded: choose "
            "some with --select"
        )
    return [load(folder, row) for row in rows]


def read_manifest(folder: Path) -> list[dict[str, str]]:
    """Give the rows of a set's manifest. Raises `BadInput` where there is none."""
    path = folder / "manifest.csv"
    if not path.is_file():
        raise BadInput(f"{path} is not there: give the folder of a stimulus set")
    table = read_table(path)
    for column in NEEDED:
        if column not in table.headings:
            raise BadInput(f"{path} has no column {column!r}: give the manifest as the set was made with it")
    rows = [dict(zip(table.headings, row, strict=True)) for row in table.rows]
    for line, row in zip(table.lines, rows, strict=True):
        for column, kind in NUMBERS.items():
            cell = row[column]
            if not re.fullmatch(kind, cell):
                raise BadInput(f"{path} line {line}: {column} is {cell!r}: {number_remedy(cell)}")
    return rows


def chosen(rows: list[dict[str, str]], wanted: Mapping[str, str]) -> list[dict[str, str]]:
    """Give the rows with these values; numbers are compared as numbers, so that 1 is 1.0. Raises `BadInput`."""
    for column in wanted:
        if rows and column not in rows[0]:
            raise BadInput(f"the manifest has no column {column!r}: it has {', '.join(rows[0])}")
    found = [row for row in rows if all(same(row[column], value) for column, value in wanted.items())]
    if not found:
        raise BadInput(f"no stimulus of {len(rows)} has {', '.join(f'{c}={v}' for c, v in wanted.items())}")
    return found


def same(one: str, other: str) -> bool:
    """Tell whether two cells say the same."""
    try:
        return float(one) == float(other)
    except ValueError:
        return one == other


def load(folder: Path, row: Mapping[str, str]) -> Stimulus:
    """Load one stimulus. Raises `BadInput` where its file is not the one of the manifest."""
    path = folder / row["file"]
    if digest_of_file(path) != row["sha256"]:
        raise BadInput(
            f"{path} was changed after the set was made: its digest is not the manifest's; make it again"
        )
    rate = float(row["frame_rate_hz"]) if row["frame_rate_hz"] else None
    images = [read_image(path)] if rate is None else read_frames(path)
    frames = np.stack([psychopy_frame(image) for image in images])
    if len(frames) != int(row["frames"]):
        raise BadInput(
            f"{path} has {len(frames)} frames, the manifest says {row['frames']}: make the set again"
        )
    return Stimulus(row, frames, rate)


def texture(frame: np.ndarray) -> np.ndarray:
    """Lay a frame (h, w, 3) in the middle of a grey square whose side is a power of two; one pixel stays one pixel."""
    height, width = frame.shape[:2]
    side = 1 << (max(height, width) - 1).bit_length()
    square = np.full((side, side, 3), GREY, np.float32)
    top, left = (side - height) // 2, (side - width) // 2
    square[top : top + height, left : left + width] = frame
    return square


def frame_at(stimulus: Stimulus, time_s: float) -> int:
    """Give which frame is to be seen so long after the start; the last one stays."""
    if stimulus.frame_rate_hz is None:
        return 0
    # Half a microsecond early, so that rounding never shows a frame one screen refresh late.
    return min(int(time_s * stimulus.frame_rate_hz + 5e-7), len(stimulus.frames) - 1)


def textures(visual: Any, window: Any, stimulus: Stimulus) -> list[Any]:
    """Give one PsychoPy stimulus a frame, its texture on the graphics card already. `visual` is `psychopy.visual`."""
    drawn = []
    for frame in stimulus.frames:
        square = texture(frame)
        side = len(square)
        drawn.append(
            visual.GratingStim(
                window, tex=square, mask=None, units="pix", size=(side, side), sf=1 / side, phase=0
            )
        )
    return drawn


def play(window: Any, drawn: Sequence[Any], stimulus: Stimulus, refresh_hz: float, seconds: float) -> None:
    """Show a picture for so many seconds, or a motion once, in time with the screen."""
    last_s = seconds if stimulus.frame_rate_hz is None else len(stimulus.frames) / stimulus.frame_rate_hz
    for flip in range(round(last_s * refresh_hz)):
        drawn[frame_at(stimulus, flip / refresh_hz)].draw()
        window.flip()
    window.flip()


def show(stimuli: Sequence[Stimulus], full_screen: bool, seconds: float) -> None:
    """Open a window and show the stimuli one after the other; any key stops."""
    from psychopy import event, visual

    window = visual.Window(fullscr=full_screen, units="pix", color=(GREY, GREY, GREY), colorSpace="rgb")
    refresh_hz = window.getActualFrameRate() or 60.0
    try:
        loaded = [
            textures(visual, window, stimulus) for stimulus in stimuli
        ]  # all of them before the first trial
        for stimulus, drawn in zip(stimuli, loaded, strict=True):
            play(window, drawn, stimulus, refresh_hz, seconds)
            if event.getKeys():
                break
    finally:
        window.close()


def main(words: Sequence[str]) -> int:
    """Load a set and show it; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="psychopy_demo.py", description="Show a stimulus set with PsychoPy."
    )
    parser.add_argument("folder", type=Path, metavar="SET")
    parser.add_argument("--check", action="store_true", help="load and check everything, show nothing")
    parser.add_argument("--full-screen", action="store_true")
    parser.add_argument("--seconds", type=float, default=1.0, help="how long a picture stays (default 1)")
    parser.add_argument(
        "--select", nargs="+", default=[], metavar="COLUMN=VALUE", help="only stimuli with these values"
    )
    arguments = parser.parse_args(words)
    unread = [word for word in arguments.select if "=" not in word]
    if unread:
        parser.error(f"--select takes COLUMN=VALUE, {unread[0]!r} has no =")
    try:
        wanted = dict(word.split("=", 1) for word in arguments.select)
        stimuli = load_set(arguments.folder, wanted)
    except MorphspaceError as error:
        print(f"psychopy_demo.py: {error}", file=sys.stderr)
        return 2
    frames = sum(len(stimulus.frames) for stimulus in stimuli)
    held = sum(stimulus.frames.nbytes for stimulus in stimuli)
    print(f"{len(stimuli)} stimuli, {frames} frames, {held / 1e6:.0f} MB, all as the manifest says")
    if arguments.check:
        return 0
    try:
        show(stimuli, arguments.full_screen, arguments.seconds)
    except ImportError as error:
        print(f"psychopy_demo.py: {error}: install PsychoPy, or check the set with --check", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
