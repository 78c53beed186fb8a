"""
Native rooms of freetalk.
"""

from __future__ import annotations
from . import core
from . import audio
from . import mesh
from . import geometry
from . import nn
from . import speech
from . import diffusion
from . import ats
from . import facetalk
from . import stm
from . import head
from . import rig
from . import metrics
from . import animation
from . import talker

__all__: list[str] = [
    "animation",
    "ats",
    "audio",
    "core",
    "diffusion",
    "facetalk",
    "geometry",
    "head",
    "mesh",
    "metrics",
    "nn",
    "rig",
    "speech",
    "stm",
    "talker",
    "torch_version",
]
__version__: str = "0.1.0"
torch_version: str = "2.13.0"
