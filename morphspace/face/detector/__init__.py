"""Detect a face and its points in an image, offline, with MediaPipe's networks.

`morphspace models fetch` installs the networks once; nothing else here uses the internet. `models` names the files,
`fetch` installs them, `detect` runs them.
"""

from morphspace.face.detector.boxes import Person, person_of
from morphspace.face.detector.detect import Detector, Landmarks, detector_for, load_detector, own_detector
from morphspace.face.detector.models import MissingModels, how_to_get_networks, models_folder, models_present

__all__ = [
    "Detector",
    "Landmarks",
    "MissingModels",
    "Person",
    "detector_for",
    "how_to_get_networks",
    "load_detector",
    "models_folder",
    "models_present",
    "own_detector",
    "person_of",
]
