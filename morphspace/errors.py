"""What can go wrong, as types.

Every message is one line that names the thing, the two values that disagree, and what to do next. `BadInput` and its
children are the user's to mend (the command line exits 2); a plain `MorphspaceError` is ours (exit 1).
"""


class MorphspaceError(Exception):
    """A failure that morphspace itself describes; the root of every error it raises on purpose."""


class BadInput(MorphspaceError):
    """Something the user gave cannot be used as it is."""


class UnreadableFile(BadInput):
    """A file is missing, empty, cut short or not of the kind its name says."""


class UnwritableFile(BadInput):
    """An output cannot be written: no permission, no space, or a file is in the way."""


class SizeMismatch(BadInput):
    """Images that must agree in size do not."""


class ReferenceMismatch(BadInput):
    """Two objects live on different reference or mean faces, so that their numbers do not compare."""


class ModelFileError(BadInput):
    """A `.morph` file is cut short, of a future version, or not one of ours."""
