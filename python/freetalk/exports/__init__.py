"""Files for other programs beyond those that the C++ library writes: binary USD, ARKit's weights, Blender.

``Animation.save`` calls these by extension.
"""

from freetalk.exports.blender import blender_script
from freetalk.exports.curves import arkit_weights, load_curves, save_curves
from freetalk.exports.usd import load_usd, save_usd

__all__ = [
    "arkit_weights",
    "blender_script",
    "load_curves",
    "load_usd",
    "save_curves",
    "save_usd",
]
