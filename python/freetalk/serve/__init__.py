"""The page with a server behind it: drop in speech and a face, direct the emotion, compare takes, speak live."""

from __future__ import annotations

from freetalk.serve.app import make_app
from freetalk.serve.studio import Studio
from freetalk.serve.uploads import Limits, Refused

__all__ = ["Limits", "Refused", "Studio", "make_app"]
