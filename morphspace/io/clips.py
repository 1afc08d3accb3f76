"""Clips: a folder, a glob pattern, several image files or a video, read as a sequence of frames of one size (ours).

`open_clip` reads names and headers only; images are decoded one at a time. `data_spec/clip-folder.md` describes the
layout of a clip folder.
"""

from __future__ import annotations

import glob
import os
import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from morphspace.arrays import Image
from morphspace.errors import BadInput, SizeMismatch, UnreadableFile
from morphspace.io.images import animation_frames, image_size, read_image
from morphspace.io.names import check_frame_name, check_link, check_name, composed
from morphspace.io.sidecars import Sidecar, read_sidecar
from morphspace.requests import AS_IT_IS, LEAST_RATE_HZ, MOST_RATE_HZ, ClipOptions
from morphspace.storage import digest_of_bytes, digest_of_file

IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".exr", ".bmp", ".webp", ".avif", ".jxl")
# Frames if libav reads them: it does not join the tiles of a phone's picture
PHONE_SUFFIXES = (".heic", ".heif")
VIDEO_SUFFIXES = (
    ".mp4",
    ".mov",
    ".mkv",
    ".avi",
    ".webm",
    ".m4v",
    ".mpg",
    ".mpeg",
    ".mts",
    ".m2ts",
    ".dv",
    ".apng",
)
OTHER_PICTURES = (  # formats of pictures that are counted in a note, never passed over in silence
    *(
        ".heic",
        ".heif",
        ".hif",
        ".gif",
        ".jfif",
        ".jpe",
        ".jp2",
        ".j2k",
        ".psd",
        ".psb",
        ".svg",
        ".ppm",
        ".pgm",
    ),
    *(
        ".pbm",
        ".pnm",
        ".tga",
        ".hdr",
        ".dds",
        ".ico",
        ".dib",
        ".pct",
        ".sgi",
        ".fits",
        ".dng",
        ".cr2",
        ".cr3",
    ),
    *(".nef", ".arw", ".orf", ".raf", ".rw2", ".pef", ".srw", ".raw"),
)
FRAMES_FOLDER = "frames"  # NAME/frames/*.jpg are the images of the clip NAME
SIDECAR_NAME = "clip.json"
LISTED_SIZES = 5  # sizes; a message lists no more


@dataclass(frozen=True, eq=False)
class Clip:
    """A sequence of frames of one size, made by `open_clip`.

    Attributes
    ----------
    name : str
    frame_names : tuple of n str, unique
        File names without suffix. For a video: its name and the frame number, from 0.
    size : (width, height) px
    sidecar : Sidecar
    paths : tuple of n Path
        The file of each frame; for a video the same file n times.
    video_indices : tuple of n int, or None
        The number of each frame in the video. None for images.
    times_s : tuple of n floats, or None
        The time of each frame of a video from its first, s, in rising order; None if it is unknown.
    notes : tuple of str
        Pictures that were passed over, others of which only a part is used, and changes that reading makes.
    is_deinterlaced : bool
        Whether the two fields of interlaced frames are made into whole frames.
    person : "largest", "left", "right", (x, y) px, or None
        The face to be used if frames show several; None for the default.
    """

    name: str
    frame_names: tuple[str, ...]
    size: tuple[int, int]
    sidecar: Sidecar
    paths: tuple[Path, ...]
    video_indices: tuple[int, ...] | None = None
    times_s: tuple[float, ...] | None = None
    notes: tuple[str, ...] = ()
    is_deinterlaced: bool = False
    person: Literal["largest", "left", "right"] | tuple[float, float] | None = None

    def __len__(self) -> int:
        return len(self.frame_names)

    def load(self, index: int) -> Image:
        """Decode one frame, (h, w, 3). A negative index counts from the end. Raises as `images` does."""
        return next(self.images([index]))

    def images(self, indices: Sequence[int] | None = None) -> Iterator[Image]:
        """Yield frames (h, w, 3) one at a time: all, or those at `indices` in that order.

        Raises
        ------
        BadInput
            If an index is beyond the clip.
        UnreadableFile
            As `read_image` and `read_frames` raise it.
        """
        places = self._places(range(len(self)) if indices is None else indices)
        if self.video_indices is None:
            for place in places:
                yield read_image(self.paths[place])
        elif places:
            from morphspace.io.video import read_frames  # loads libav, which stills do not need

            indices = [self.video_indices[place] for place in places]
            yield from read_frames(self.paths[0], indices, deinterlace=self.is_deinterlaced)

    def digests(self) -> tuple[str, ...]:
        """Return one SHA-256 per frame: of the file, or for a video of the file's digest and the frame number."""
        if self.video_indices is None:
            return tuple(map(digest_of_file, self.paths))
        whole = digest_of_file(self.paths[0]) + (" deinterlaced" if self.is_deinterlaced else "")
        return tuple(digest_of_bytes(f"{whole} {index}".encode()) for index in self.video_indices)

    def subset(self, indices: Sequence[int]) -> Clip:
        """Return the clip of these frames, in this order; selected frames are a list, whose times are dropped.

        Raises `BadInput` if they are none or not unique.
        """
        places = self._places(indices)
        if not places or len(set(places)) < len(places):
            raise BadInput(
                f"clip {self.name}: the subset is {list(indices)}; expected at least one frame, each once. "
                "Remove repeated frames"
            )
        return replace(
            self,
            frame_names=tuple(self.frame_names[place] for place in places),
            paths=tuple(self.paths[place] for place in places),
            video_indices=None
            if self.video_indices is None
            else tuple(self.video_indices[p] for p in places),
            times_s=self.times_s if places == list(range(len(self))) else None,
        )

    def _places(self, indices: Sequence[int]) -> list[int]:
        """Convert indices, which may be negative, to indices from 0. Raise `BadInput` if one is beyond the clip."""

        for index in indices:
            if not -len(self) <= index < len(self):
                raise BadInput(
                    f"clip {self.name}: the frame is {index}; expected 0 to {len(self) - 1}. Change it"
                )
        return [int(index) % len(self) for index in indices]


def natural_key(name: str) -> tuple[tuple[tuple[int, int, str], ...], str]:
    """Return a sorting key that puts frame 2 before frame 10; names with equal numbers are ordered as texts.

    Examples
    --------
    >>> sorted(["frame10", "frame2"], key=natural_key)
    ['frame2', 'frame10']
    """
    parts = re.split(r"([0-9]+)", name)
    return tuple(
        (0, int(part), "") if part.isdigit() else (1, 0, part.casefold()) for part in parts if part
    ), name


def open_clip(sources: Sequence[str | Path], options: ClipOptions = AS_IT_IS) -> Clip:
    """Open one folder, one glob pattern, one video or several image files as a clip, in natural order of names.

    Parameters
    ----------
    sources : sequence of str or Path
        A folder gives its images, or those of its folder `frames`; hidden files and other file types are ignored.
        Pictures of types that are not read are counted in `notes`. Files from several folders are prefixed with the
        folder's name if their names clash.
    options : ClipOptions
        Its frame rate replaces that of the sidecar and the file. The sidecar can ask for deinterlacing too.

    Returns
    -------
    Clip
        Its sidecar is the `clip.json` in the folder, or beside a folder called `frames`; for a video
        `<name>.clip.json`.

    Raises
    ------
    BadInput
        If there are no images, no file matches, a file is repeated, videos are mixed with other files, or a file
        name cannot be used; if a video is interlaced, its frame rate is outside the limits, or the place of the
        person is outside the frames.
    SizeMismatch
        If the frames differ in size; the message lists the sizes.
    UnreadableFile
        If a file or folder cannot be read.

    Examples
    --------
    >>> clip = open_clip("anna")
    >>> clip.name, clip.size, len(clip.frame_names)
    ('anna', (60, 72), 12)
    """
    given = [str(source) for source in ([sources] if isinstance(sources, str | Path) else sources)]
    if not given:
        raise BadInput(
            "no clip is given; expected a folder, a video, image files or a pattern. Add one, such as 'face/*.png'"
        )
    found, over = [], []
    for source in given:
        files, others = _expand(source)
        found += files
        over += others
    if len(found) == 1 and found[0].is_dir():
        return _with_person(_clip_of_folder(found[0], options), options)
    folders = [path for path in found if path.is_dir()]
    if folders:
        raise BadInput(
            f"the clip has {len(found)} parts, one of them the folder {folders[0]}; expected one folder or several "
            "files. Select one"
        )
    videos = [path for path in found if path.suffix.lower() in VIDEO_SUFFIXES]
    if videos:
        if len(found) > 1:
            raise BadInput(
                f"the clip has {len(found)} files, one of them the video {videos[0]}; expected one video or several "
                "images. Select one"
            )
        return _with_person(_clip_of_video(found[0], options), options)
    return _with_person(_clip_of_files(found, None, over, options), options)


def _with_person(clip: Clip, options: ClipOptions) -> Clip:
    person, (width, height) = options.person, clip.size
    if isinstance(person, tuple) and not (0 <= person[0] < width and 0 <= person[1] < height):
        raise BadInput(
            f"the person is at {person[0]:g},{person[1]:g} px; expected a place in the frames of {clip.name}, which "
            f"have {width}x{height} px. Correct it"
        )
    return replace(clip, person=person)


def _expand(source: str) -> tuple[list[Path], list[Path]]:
    """Return the path if it exists, or the files that the pattern matches; and matching pictures that are not read."""
    path = Path(source)
    check_name(path)
    check_link(path)
    try:
        if path.exists():
            kinds = (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES)
            if path.is_file() and path.suffix.lower() not in kinds:
                raise BadInput(
                    f"{path} is neither an image nor a video by its suffix; expected {', '.join(kinds)}. Convert it"
                )
            return [path], []
    except OSError as error:
        raise UnreadableFile(f"cannot read {path}: {error.strerror}") from error
    if not glob.has_magic(str(path)):
        raise BadInput(
            f"{path} does not exist; expected a folder of images, an image, a video or a quoted pattern. Check the name"
        )
    # pathlib's glob does not accept absolute patterns
    matches = [Path(match) for match in glob.glob(str(path), recursive=True)]  # noqa: PTH207
    if len(matches) == 1 and matches[0].is_dir():
        return matches, []
    files = [match for match in matches if _is_kind(match, IMAGE_SUFFIXES)] or [
        match for match in matches if _is_kind(match, VIDEO_SUFFIXES)
    ]
    over = [match for match in matches if _is_kind(match, OTHER_PICTURES)]
    if not files:
        raise BadInput(
            f"no image or video matches {source} ({len(matches)} other matches). {_other_remedy(over)}"
        )
    return files, over


def _is_kind(path: Path, suffixes: Collection[str]) -> bool:
    return path.suffix.lower() in suffixes and not path.name.startswith(".") and not path.is_dir()


def _other_remedy(over: Sequence[Path]) -> str:
    counts = Counter(path.suffix for path in over)
    listed = ", ".join(f"{count} {suffix}" for suffix, count in sorted(counts.items()))
    return f"Convert the {listed} pictures to PNG or JPEG" if over else "Check the name"


def _clip_of_folder(folder: Path, options: ClipOptions) -> Clip:
    over: list[Path] = []
    for place in (folder, folder / FRAMES_FOLDER):
        files = _files_in(place)
        images = [path for path in files if _is_kind(path, IMAGE_SUFFIXES)]
        over += [path for path in files if _is_kind(path, OTHER_PICTURES)]
        if images:
            return _clip_of_files(images, place, over, options)
    videos = sum(_is_kind(path, VIDEO_SUFFIXES) for path in folder.iterdir())
    remedy = f"It holds {videos} video(s): enter the name of one" if videos else _other_remedy(over)
    raise BadInput(
        f"{folder} holds no images ({', '.join(IMAGE_SUFFIXES)}), "
        f"nor does a folder {FRAMES_FOLDER} in it. {remedy}"
    )


def _files_in(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir()) if folder.is_dir() else []
    except OSError as error:
        raise UnreadableFile(f"cannot read {folder}: {error.strerror}. Check the permissions") from error


def _clip_of_files(
    files: Sequence[Path], folder: Path | None, over: Sequence[Path], options: ClipOptions
) -> Clip:
    for path in files:
        check_frame_name(path)
    paths = sorted(files, key=lambda path: natural_key(composed(path.as_posix())))
    repeated = [path for path, count in Counter(map(_place_of, paths)).items() if count > 1]
    if repeated:
        raise BadInput(
            f"{repeated[0]} is repeated ({len(repeated)} such files); expected each file once. Remove the repetitions"
        )
    parents = {path.parent.resolve() for path in paths}
    home = folder or (paths[0].parent if len(parents) == 1 else None)
    name = _name_of(home or Path(os.path.commonpath(parents)))
    size = _common_size(paths)
    sidecar = _with_rate(_sidecar_of(home), options.frame_rate_hz)
    return Clip(name, _unique_names(paths), size, sidecar, tuple(paths), notes=_notes_on(paths, over))


def _with_rate(sidecar: Sidecar, rate_hz: float | None) -> Sidecar:
    return sidecar if rate_hz is None else replace(sidecar, frame_rate_hz=rate_hz)


def _place_of(path: Path) -> Path:
    """Return the full path. A link is not followed: git-annex has one content for equal frames."""
    return path.parent.resolve() / path.name


def _notes_on(paths: Sequence[Path], over: Sequence[Path]) -> tuple[str, ...]:
    """Report pictures that were passed over, and animations of which only the default image is used."""
    notes = []
    for suffix, count in sorted(Counter(path.suffix for path in over).items()):
        some = "picture was" if count == 1 else "pictures were"
        notes.append(f"{count} {suffix} {some} passed over, which cannot be read: convert to PNG or JPEG")
    animated = [path for path in paths if animation_frames(path)]
    if animated:
        notes.append(
            f"{len(animated)} of {len(paths)} pictures are animations, such as {animated[0]}: of each its default "
            "image is used. Rename one to .apng to use its frames as a clip"
        )
    return tuple(notes)


def _clip_of_video(path: Path, options: ClipOptions) -> Clip:
    from morphspace.io.video import video_info  # loads libav, which stills do not need

    check_frame_name(path)
    info = video_info(path)
    beside = path.with_suffix("." + SIDECAR_NAME)
    sidecar = read_sidecar(beside) if beside.is_file() else Sidecar()
    sidecar = _with_rate(sidecar, options.frame_rate_hz)
    if info.interlaced and not (options.deinterlace or sidecar.deinterlace):
        raise BadInput(
            f"{path} is interlaced ({info.interlaced} of {info.frame_count} frames); expected whole frames. "
            f'Give --deinterlace, or write "deinterlace": true into {beside.name}'
        )
    times_s = info.times_s
    if sidecar.frame_rate_hz is None and info.frame_rate_hz:
        if not LEAST_RATE_HZ <= info.frame_rate_hz <= MOST_RATE_HZ:
            raise BadInput(
                f"the frame rate of {path} is {info.frame_rate_hz:g} Hz; expected {LEAST_RATE_HZ:g} to "
                f"{MOST_RATE_HZ:g}. Give the true one with --frame-rate, or as frame_rate_hz in {beside.name}"
            )
        sidecar = replace(sidecar, frame_rate_hz=info.frame_rate_hz)
    elif sidecar.frame_rate_hz and info.frame_rate_hz and times_s:
        times_s = tuple(time * info.frame_rate_hz / sidecar.frame_rate_hz for time in times_s)
    notes = info.notes
    if info.interlaced:
        notes += (f"{path.name} is interlaced: its frames were deinterlaced with FFmpeg's bwdif",)
    digits = max(6, len(str(info.frame_count)))
    stem = composed(path.stem)
    names = tuple(f"{stem}_{index:0{digits}d}" for index in range(info.frame_count))
    indices = tuple(range(info.frame_count))
    paths = (path,) * info.frame_count
    return Clip(
        stem,
        names,
        info.size,
        sidecar,
        paths,
        indices,
        times_s,
        notes,
        is_deinterlaced=bool(info.interlaced),
    )


def _name_of(folder: Path) -> str:
    folder = folder.resolve()
    return composed((folder.parent if folder.name == FRAMES_FOLDER else folder).name or "clip")


def _sidecar_of(folder: Path | None) -> Sidecar:
    if folder is None:
        return Sidecar()
    places = [folder, folder.resolve().parent] if folder.resolve().name == FRAMES_FOLDER else [folder]
    for place in places:
        if (place / SIDECAR_NAME).is_file():
            return read_sidecar(place / SIDECAR_NAME)
    return Sidecar()


def _unique_names(paths: Sequence[Path]) -> tuple[str, ...]:
    """Return the file names without suffix; if they clash, with suffix, then with folder names as prefix."""
    names = [composed(path.stem) for path in paths]
    if len(set(names)) == len(names):
        return tuple(names)
    whole = [composed(path.name) for path in paths]
    if len(set(whole)) == len(whole):
        return tuple(whole)
    parts = [_place_of(path).with_suffix("").parts[1:] for path in paths]
    for depth in range(2, max(map(len, parts)) + 1):
        names = [composed("_".join(part[-depth:])) for part in parts]
        if len(set(names)) == len(names):
            return tuple(names)
    return tuple(f"{composed(path.stem)}_{index:06d}" for index, path in enumerate(paths))


def _common_size(paths: Sequence[Path]) -> tuple[int, int]:
    sizes: dict[tuple[int, int], list[Path]] = {}
    for path in paths:
        sizes.setdefault(image_size(path), []).append(path)
    if len(sizes) == 1:
        return next(iter(sizes))
    groups = sorted(sizes.items(), key=lambda item: -len(item[1]))
    listed = "; ".join(f"{w} x {h}: {len(some)}, such as {some[0]}" for (w, h), some in groups[:LISTED_SIZES])
    more = f"; and {len(groups) - LISTED_SIZES} more sizes" if len(groups) > LISTED_SIZES else ""
    raise SizeMismatch(
        f"the frames of the clip have {len(groups)} sizes ({listed}{more}); expected one. Crop or resize them"
    )
