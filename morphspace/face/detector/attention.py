"""The attention mesh: 478 points of a face in a crop, by a network whose heads look again at lips and eyes.

MediaPipe's file is one network with operators of its own, which OpenCV cannot run. It is cut into a base and three
heads of plain operators. What lies between them is computed here: each head reads the base's features in a rotated
box around its points, and its answers are carried back to the crop.

References
----------
Grishchenko et al., Attention mesh: high-fidelity face mesh prediction in real-time, CVPR workshop on computer vision
for AR/VR (2020).
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import Affine, AnyArray, Image, Points
from morphspace.errors import UnreadableFile
from morphspace.face.detector.networks import Network, read_network
from morphspace.face.mesh import LEFT_IRIS, MESH_COUNT, POINT_COUNT, RIGHT_IRIS

SIDE = 192  # px, of the square input
MAP_SIDE = 48  # px, of the base's features
HEAD_SIDE = 16  # px, of the features that a head reads
ENLARGED = 1.5  # extent of a head's box, in extents of its points
PER_MAP_PX = SIDE / MAP_SIDE
FEATURES, MESH, PRESENCE = "p_re_lu_3", "output_mesh", "conv_faceflag"

# fmt: off
LIP_POINTS = (
    61, 146, 91, 181, 84, 17, 314, 405, 321, 375, 291, 185, 40, 39, 37, 0, 267, 269, 270, 409, 78, 95, 88, 178, 87, 14,
    317, 402, 318, 324, 308, 191, 80, 81, 82, 13, 312, 311, 310, 415, 76, 77, 90, 180, 85, 16, 315, 404, 320, 307, 306,
    184, 74, 73, 72, 11, 302, 303, 304, 408, 62, 96, 89, 179, 86, 15, 316, 403, 319, 325, 292, 183, 42, 41, 38, 12, 268,
    271, 272, 407)
RIGHT_EYE_POINTS = (
    33, 7, 163, 144, 145, 153, 154, 155, 133, 246, 161, 160, 159, 158, 157, 173, 130, 25, 110, 24, 23, 22, 26, 112, 243,
    247, 30, 29, 27, 28, 56, 190, 226, 31, 228, 229, 230, 231, 232, 233, 244, 113, 225, 224, 223, 222, 221, 189, 35,
    124, 46, 53, 52, 65, 143, 111, 117, 118, 119, 120, 121, 128, 245, 156, 70, 63, 105, 66, 107, 55, 193)
LEFT_EYE_POINTS = (
    263, 249, 390, 373, 374, 380, 381, 382, 362, 466, 388, 387, 386, 385, 384, 398, 359, 255, 339, 254, 253, 252, 256,
    341, 463, 467, 260, 259, 257, 258, 286, 414, 446, 261, 448, 449, 450, 451, 452, 453, 464, 342, 445, 444, 443, 442,
    441, 413, 265, 353, 276, 283, 282, 295, 372, 340, 346, 347, 348, 349, 350, 357, 465, 383, 300, 293, 334, 296, 336,
    285, 417)
# fmt: on
LID_RING = 16  # the first points of an eye are its lid ring


@dataclass(frozen=True)
class Part:
    """A part of the network.

    Attributes
    ----------
    inputs, outputs : tuple of int
        Numbers of its tensors in the file.
    names : tuple of str
        Of the outputs, in the order of `answer`.
    points : tuple of int
        Those that a head refines.
    along : (int, int)
        Mesh points that give the x axis of a head's box.
    iris : tuple of int
        Those that a head adds: centre, and the rim from the image's right over the top.
    """

    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    names: tuple[str, ...]
    points: tuple[int, ...] = ()
    along: tuple[int, int] = (0, 0)
    iris: tuple[int, ...] = ()


BASE = Part((0,), (35, 186, 710), (FEATURES, MESH, PRESENCE))
HEADS = (
    Part((199,), (684,), ("conv_lips",), LIP_POINTS, (61, 291)),
    Part((200,), (687, 690), ("conv_left_eye", "conv_left_iris"), RIGHT_EYE_POINTS, (33, 133), RIGHT_IRIS),
    Part((201,), (693, 696), ("conv_right_eye", "conv_right_iris"), LEFT_EYE_POINTS, (362, 263), LEFT_IRIS),
)


@dataclass(frozen=True, eq=False)
class AttentionMesh:
    """The base and the heads in memory. One thread may use them at a time."""

    base: Network
    heads: tuple[Network, ...]

    @classmethod
    def read(cls, path: Path) -> AttentionMesh:
        """Read MediaPipe's file. Raises `UnreadableFile` or `MissingModels` if it is another file."""
        whole = path.read_bytes()
        with tempfile.TemporaryDirectory(prefix="morphspace-mesh-") as folder:
            # OpenCV ignores the engine for networks in memory, so each part is a file.
            file = Path(folder) / "part.tflite"
            networks = []
            for part in (BASE, *HEADS):
                file.write_bytes(cut(whole, part.inputs, part.outputs))
                networks.append(read_network(file, part.names))
        return cls(networks[0], tuple(networks[1:]))

    def rough(self, picture: Image) -> tuple[AnyArray, float]:
        """Return the mesh of the base alone (468, 3), and the logit of a face's presence, as `points`."""
        _, mesh, presence = self.base.answer(picture)
        return mesh.astype(np.float64).reshape(MESH_COUNT, 3), float(presence[0])

    def points(self, picture: Image) -> tuple[AnyArray, float]:
        """Find the points of the face in a crop.

        Parameters
        ----------
        picture : array (192, 192, 3) float32, in [0, 1]

        Returns
        -------
        points : array (478, 3) px
            x, y and depth, pixel centres at integers. The depth is the base's; that of an iris is its lids' mean.
        presence : float
            Logit.
        """
        features, mesh, presence = self.base.answer(picture)
        found = np.zeros((POINT_COUNT, 3))
        found[:MESH_COUNT] = mesh.reshape(MESH_COUNT, 3)
        rough = found[:, :2].copy()
        planes = features.reshape(-1, MAP_SIDE, MAP_SIDE)
        for part, network in zip(HEADS, self.heads, strict=True):
            box = head_box(rough / PER_MAP_PX, part)
            answers = network.answer_planes(read_box(planes, box))
            for places, answer in zip((part.points, part.iris), answers, strict=False):
                found[list(places), :2] = PER_MAP_PX * (
                    answer.astype(np.float64).reshape(-1, 2) / PER_MAP_PX @ box[:, :2].T + box[:, 2]
                )
            if part.iris:
                found[list(part.iris), 2] = found[list(part.points[:LID_RING]), 2].mean()
        return found, float(presence[0])


def head_box(points: Points, part: Part) -> Affine:
    """Return the box of a head: the affine (2, 3) from its 16 x 16 px, edges at integers, to the map's px.

    Its axes follow the line through two points; its sides are the extents of the head's points (n, 2) along these axes,
    enlarged. The scales of both axes differ.
    """
    first, last = points[list(part.along)]
    turn = np.arctan2(*(last - first)[::-1])
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    turned = points[list(part.points)] @ axes.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    linear = axes.T * (ENLARGED * (high - low) / HEAD_SIDE)
    middle = axes.T @ ((low + high) / 2)
    return np.column_stack([linear, middle - linear @ np.full(2, HEAD_SIDE / 2)])


def read_box(planes: AnyArray, box: Affine) -> AnyArray:
    """Read features (c, 48, 48) in a box, linearly: (c, 16, 16); 0 where the point lies outside the map."""
    rows, columns = np.mgrid[:HEAD_SIDE, :HEAD_SIDE] + 0.5
    x, y = (box[axis, 0] * columns + box[axis, 1] * rows + box[axis, 2] - 0.5 for axis in (0, 1))
    inside = (x >= 0) & (x <= MAP_SIDE - 1) & (y >= 0) & (y <= MAP_SIDE - 1)
    left, top = (np.clip(np.floor(at), 0, MAP_SIDE - 2).astype(int) for at in (x, y))
    right_share, lower_share = x - left, y - top
    out: AnyArray = (
        planes[:, top, left] * (1 - right_share) * (1 - lower_share)
        + planes[:, top, left + 1] * right_share * (1 - lower_share)
        + planes[:, top + 1, left] * (1 - right_share) * lower_share
        + planes[:, top + 1, left + 1] * right_share * lower_share
    )
    return np.where(inside, out, 0).astype(np.float32)


def cut(whole: bytes, inputs: Iterable[int], outputs: Iterable[int]) -> bytes:
    """Cut the part between two sets of tensors out of a TFLite file with one subgraph.

    In a copy, the lists of inputs, outputs and operators are rewritten and shortened. Nothing moves, so all other
    references stay valid. The format is a FlatBuffer (schema version 3 of TensorFlow Lite).

    Raises
    ------
    UnreadableFile
        If the file has another layout.
    """
    data = bytearray(whole)
    try:
        graph = _item(data, _vector(data, _follow(data, 0), 2), 0)
        makers = {}
        operators = _vector(data, graph, 3)
        for place in range(_number(data, operators)):
            operator = _item(data, operators, place)
            for tensor in _numbers(data, _vector(data, operator, 2)):
                makers[tensor] = (place, operator)
        needed: dict[int, int] = {}
        given, asked = list(inputs), list(outputs)
        waiting = list(asked)
        while waiting:
            tensor = waiting.pop()
            if tensor in given or tensor not in makers or makers[tensor][0] in needed:
                continue
            place, operator = makers[tensor]
            needed[place] = operator
            waiting += _numbers(data, _vector(data, operator, 1))
        _write_numbers(data, _vector(data, graph, 1), given)
        _write_numbers(data, _vector(data, graph, 2), asked)
        places = [operators + 4 + 4 * index for index in range(len(needed))]
        steps = [needed[place] - at for place, at in zip(sorted(needed), places, strict=True)]
        _write_numbers(data, operators, steps)
    except (struct.error, IndexError, ValueError) as error:
        raise UnreadableFile(
            f"the face mesh cannot be cut into its parts ({error!s:.80}); expected MediaPipe's file. Fetch it again"
        ) from error
    return bytes(data)


def _number(data: bytearray, at: int) -> int:
    return int(struct.unpack_from("<I", data, at)[0])


def _follow(data: bytearray, at: int) -> int:
    return at + _number(data, at)


def _vector(data: bytearray, table: int, field: int) -> int:
    """Return the position of a vector, which begins with its length, in a field of a table."""
    places = table - struct.unpack_from("<i", data, table)[0]
    size = struct.unpack_from("<H", data, places)[0]
    slot = 4 + 2 * field
    step = struct.unpack_from("<H", data, places + slot)[0] if slot < size else 0
    if not step:
        raise ValueError(f"a table has no field {field}")
    return _follow(data, table + step)


def _item(data: bytearray, vector: int, index: int) -> int:
    return _follow(data, vector + 4 + 4 * index)


def _numbers(data: bytearray, vector: int) -> list[int]:
    return list(struct.unpack_from(f"<{_number(data, vector)}i", data, vector + 4))


def _write_numbers(data: bytearray, vector: int, values: list[int]) -> None:
    if len(values) > _number(data, vector):
        raise ValueError(f"{len(values)} entries do not fit in {_number(data, vector)}")
    struct.pack_into(f"<I{len(values)}i", data, vector, len(values), *values)
