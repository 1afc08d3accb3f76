"""Finding a face and its points in an image, offline, with MediaPipe's three networks.

`morphspace models fetch` brings them once; nothing here goes to the network otherwise. `models` says which files they
are and where they lie, `fetch` brings them, `detect` runs them.
"""

from morphspace.face.detector.detect import Detector, Landmarks, detector_for, load_detector, own_detector
from morphspace.face.detector.models import MissingModels, how_to_get_networks, models_folder, models_present

__all__ = [
    "Detector",
    "Landmarks",
    "MissingModels",
    "detector_for",
    "how_to_get_networks",
    "load_detector",
    "models_folder",
    "models_present",
    "own_detector",
]
