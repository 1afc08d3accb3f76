"""Drawn actors with exact ground truth: faces without a person, whose every movement is known.

Real faces have no ground truth, and nobody's face may ship with a package. An actor here is painted from
identity parameters, or made of a public-domain photograph, and moved by expression parameters; each frame
comes with the exact displacement field from the neutral face, visibility, keypoints and parameters. Ours.
"""

from morphspace.synthetic.actor import Actor, ActorFrame
from morphspace.synthetic.clips import ClipPiece, Truth, actor_names, make_actors, read_truth
from morphspace.synthetic.drawn import DEFAULT_SIZE, draw_actor_frame, drawn_actor
from morphspace.synthetic.painting import LABELS
from morphspace.synthetic.parameters import ACTIONS, Capture, Expression, Identity
from morphspace.synthetic.performance import capture_sequence, expression_sequence
from morphspace.synthetic.portrait import (
    PortraitMarks,
    actor_of_photograph,
    draw_portrait_frame,
    portrait_actor,
)
from morphspace.synthetic.warped import FaceMarks, FlowPair, astronaut_face, flow_pair

__all__ = [
    "ACTIONS",
    "DEFAULT_SIZE",
    "LABELS",
    "Actor",
    "ActorFrame",
    "Capture",
    "ClipPiece",
    "Expression",
    "FaceMarks",
    "FlowPair",
    "Identity",
    "PortraitMarks",
    "Truth",
    "actor_names",
    "actor_of_photograph",
    "astronaut_face",
    "capture_sequence",
    "draw_actor_frame",
    "draw_portrait_frame",
    "drawn_actor",
    "expression_sequence",
    "flow_pair",
    "make_actors",
    "portrait_actor",
    "read_truth",
]
