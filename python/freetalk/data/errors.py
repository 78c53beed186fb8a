"""What can be wrong with a dataset, by name; every message says where, what was found and what to do."""

from __future__ import annotations


class DatasetError(ValueError):
    """Something on disk is not as a dataset of this kind has to be."""


class LayoutError(DatasetError):
    """The folder is not laid out as any known dataset, or two files of it contradict each other."""


class MissingFileError(DatasetError, FileNotFoundError):
    """A file that the layout needs is not there."""


class MissingTemplateError(DatasetError):
    """A speaker has motion, but no neutral face."""


class MissingLandmarksError(DatasetError):
    """Nobody has said which vertices of a template are the 68 landmarks."""


class VertexCountError(DatasetError):
    """Motion, template or indices do not belong to the same mesh."""


class ShortAudioError(DatasetError):
    """The sound ends before the motion does."""


class NotFiniteError(DatasetError):
    """A frame holds NaN or infinity."""


class LabelError(DatasetError):
    """An emotion or an intensity that the tables do not know."""
