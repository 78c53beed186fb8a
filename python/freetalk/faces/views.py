"""Pictures of a bare surface from any side, and the surface point behind each of their pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freetalk.viz.occlusion import depth_map
from freetalk.viz.renderer import Image, OffScreen, off_screen_plotter

Points = NDArray[np.float64]

#: Light from the camera, then from above it on the left and on the right: (right, up, towards the camera).
LIGHTS: tuple[tuple[tuple[float, float, float], float], ...] = (
    ((0.0, 0.3, 1.0), 0.85),
    ((-0.9, 0.9, 1.0), 0.9),
    ((0.9, 0.5, 0.8), 0.9),
)
_SKIN, _INSIDE, _BACKGROUND = "#c9b3a6", "#3a2623", "#e9ebee"


@dataclass(frozen=True)
class Camera:
    """A camera without perspective.

    Attributes:
        target: (3,) the point in the middle of the picture, in the mesh's own unit and axes.
        rotation: (3, 3) rows: the picture's right, its up, and the direction towards the camera.
        half: half of the picture's side, mesh unit.
    """

    target: Points
    rotation: Points
    half: float

    def turned(self, quarter_turns: int) -> Camera:
        """The camera whose picture is this one's after ``np.rot90(picture, quarter_turns)``."""
        right, up, toward = self.rotation
        for _ in range(quarter_turns % 4):
            right, up = -up, right
        return Camera(self.target, np.stack([right, up, toward]), self.half)

    def project(self, points: Points) -> Points:
        """(N, 3) of points (N, 3): right and up in [-1, 1] across the picture, and nearness in mesh units."""
        local: Points = (np.asarray(points, dtype=np.float64) - self.target) @ self.rotation.T
        local[:, :2] /= self.half
        return local

    def unproject(self, local: Points) -> Points:
        """Points (N, 3) of what :meth:`project` gives."""
        scaled = np.array(local, dtype=np.float64)
        scaled[:, :2] *= self.half
        return scaled @ self.rotation + self.target


@dataclass(frozen=True)
class Shot:
    """A picture.

    Attributes:
        camera: what it was taken with.
        image: (S, S, 3) uint8.
        nearness: (S, S) float64, how far before the camera's target the surface is; NaN where there is none.
    """

    camera: Camera
    image: Image
    nearness: Points


class SurfaceViews(OffScreen):
    """Draws one surface without texture; use it as a context manager.

    Args:
        vertices: (V, 3) any unit.
        faces: (F, 3) triangles; those that are wound inside out as a whole are turned for the picture.
        side: pixels of a picture's side.

    Raises:
        RuntimeError: no off-screen OpenGL.
    """

    def __init__(self, vertices: NDArray[Any], faces: NDArray[Any], side: int = 320) -> None:
        import pyvista

        points = np.asarray(vertices, dtype=np.float64)
        triangles = np.asarray(faces, dtype=np.int64)
        used = points[np.unique(triangles)]
        self.low, self.high = used.min(axis=0), used.max(axis=0)
        self._middle = (self.low + self.high) / 2
        self._reach = float(np.linalg.norm(self.high - self.low)) or 1.0
        corners = points[triangles] - used.mean(axis=0)
        if np.einsum("fd,fd->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0:
            triangles = triangles[:, ::-1]
        # In a box of side one: single precision is what is drawn.
        self.surface = pyvista.PolyData.from_regular_faces(
            (points - self._middle) / self._reach, triangles
        )
        self.surface.compute_normals(
            cell_normals=False,
            split_vertices=False,
            consistent_normals=False,
            auto_orient_normals=False,
            inplace=True,
        )
        self.side = side
        self.plotter = off_screen_plotter((side, side))
        try:
            self._fill_scene(pyvista)
        except BaseException:
            self.plotter.close()
            raise

    def _fill_scene(self, pyvista: Any) -> None:
        self.plotter.render_window.SetMultiSamples(0)
        actor = self.plotter.add_mesh(
            self.surface, color=_SKIN, ambient=0.15, diffuse=0.85, specular=0.05, lighting=True
        )
        actor.prop.interpolation = "Gouraud"
        actor.backface_prop = pyvista.Property(color=_INSIDE, diffuse=0.4, specular=0.0)
        self.plotter.set_background(_BACKGROUND)
        self.plotter.remove_all_lights()
        self._light = pyvista.Light(light_type="scene light")
        self._light.positional = False
        fill = pyvista.Light(light_type="headlight", intensity=0.25)
        self.plotter.add_light(self._light)
        self.plotter.add_light(fill)
        self.plotter.camera.parallel_projection = True
        self.plotter.show(auto_close=False, interactive=False)

    def shoot(self, camera: Camera, light: int = 0) -> Shot:
        """Takes a picture, lit by ``LIGHTS[light]``."""
        aim = (camera.target - self._middle) / self._reach
        _, up, toward = camera.rotation
        lens = self.plotter.camera
        lens.focal_point = tuple(aim)
        lens.position = tuple(aim + 2.0 * toward)
        lens.up = tuple(up)
        lens.parallel_scale = camera.half / self._reach
        near, far = 0.05, 4.0
        lens.clipping_range = (near, far)
        offset, intensity = LIGHTS[light]
        self._light.focal_point = tuple(aim)
        self._light.position = tuple(aim + np.asarray(offset) @ camera.rotation)
        self._light.intensity = intensity
        self.plotter.render()
        image = np.ascontiguousarray(self.plotter.screenshot(None, return_img=True)[..., :3])
        depth = depth_map(self.plotter)[::-1]  # upper row first
        nearness = np.where(depth < 1.0, (2.0 - near - depth * (far - near)) * self._reach, np.nan)
        return Shot(camera, image, nearness)

    def nearest(self, points: Points) -> tuple[Points, NDArray[np.int64]]:
        """The surface points (N, 3) nearest to points (N, 3), mesh unit, and their triangles (N,)."""
        cells, nearest = self.surface.find_closest_cell(
            (np.asarray(points, dtype=np.float64) - self._middle) / self._reach,
            return_closest_point=True,
        )
        return np.asarray(nearest) * self._reach + self._middle, np.asarray(cells, dtype=np.int64)

    def surface_points(self) -> Points:
        """(N, 3) the surface's vertices, mesh unit; of very many, some."""
        points = np.asarray(self.surface.points, dtype=np.float64)
        return points[:: max(1, len(points) // 20000)] * self._reach + self._middle


def facing(toward: Points, up: Points | None = None) -> Points:
    """(3, 3) a camera's rotation that looks along ``-toward``, its up as near to ``up`` as can be."""
    toward = np.asarray(toward, dtype=np.float64) / np.linalg.norm(toward)
    if up is None:
        up = np.eye(3)[1] if abs(toward[1]) < 0.9 else np.eye(3)[2]
    right = np.cross(up, toward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(toward, right), toward])
