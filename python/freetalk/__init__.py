"""freetalk: speech and a face mesh of any topology in, a talking face out."""

from __future__ import annotations

import atexit
import importlib
import logging
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if sys.argv and Path(sys.argv[0]).name == "freetalk":
    # The command: until it runs (freetalk.cli.app), Ctrl-C ends the loading of torch without a traceback.
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import torch

try:
    from freetalk import _native
except ImportError as error:
    raise ImportError(
        f"freetalk's native module does not load with torch {torch.__version__}: rebuild it with this torch "
        f"(pip install --no-build-isolation .). The loader said: {error}"
    ) from None

if torch.__version__.split("+")[0] != _native.torch_version.split("+")[0]:
    raise ImportError(
        f"freetalk was built with torch {_native.torch_version} but torch {torch.__version__} is installed: "
        "install that version or rebuild freetalk (pip install --no-build-isolation .)."
    )

__version__: str = _native.__version__

_native.core.set_log_sink(logging.getLogger("freetalk").log)
atexit.register(_native.core.set_log_sink, None)

if TYPE_CHECKING:
    from freetalk import (
        ats,
        diffusion,
        facetalk,
        geometry,
        head,
        mesh,
        metrics,
        nn,
        rig,
        speech,
        stm,
    )
    from freetalk.animation import Animation, load_animation
    from freetalk.audio import Audio, load_audio
    from freetalk.mesh import Mesh, load_mesh
    from freetalk.talker import Face, Talker

_LAZY = {
    "Animation": "animation",
    "Audio": "audio",
    "Face": "talker",
    "Mesh": "mesh",
    "Talker": "talker",
    "load_animation": "animation",
    "load_audio": "audio",
    "load_mesh": "mesh",
}
_ROOMS = (
    "animation",
    "ats",
    "audio",
    "corpus",
    "data",
    "diffusion",
    "evaluate",
    "exports",
    "facetalk",
    "geometry",
    "head",
    "mesh",
    "metrics",
    "nn",
    "page",
    "rig",
    "speech",
    "stm",
    "talker",
    "train",
    "viz",
)

__all__ = [
    "Animation",
    "Audio",
    "Face",
    "Mesh",
    "Talker",
    "__version__",
    "ats",
    "diffusion",
    "facetalk",
    "geometry",
    "head",
    "load_animation",
    "load_audio",
    "load_mesh",
    "mesh",
    "metrics",
    "nn",
    "rig",
    "speech",
    "stm",
]


def __getattr__(name: str) -> Any:
    """Imports rooms and their main names on first use, so that ``import freetalk`` stays quick."""
    if name in _LAZY:
        return getattr(importlib.import_module(f"freetalk.{_LAZY[name]}"), name)
    if name in _ROOMS:
        return importlib.import_module(f"freetalk.{name}")
    raise AttributeError(f"module 'freetalk' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY, *_ROOMS})
