"""Off-screen drawing of one face whose points move: set up once, then only points change."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from freetalk.viz.appearance import (
    MOUTH_DARK,
    MOUTH_INSIDE,
    NormalField,
    seen_faces,
    shade_colors,
    vertex_colors,
)
from freetalk.viz.cavities import Cavities, Mouth, eye_colors, find_cavities
from freetalk.viz.occlusion import bake_occlusion
from freetalk.viz.sequence import Points, Sequence

if TYPE_CHECKING:
    import pyvista

Image = NDArray[np.uint8]

# The visible face around the mean of the 68 landmarks of the mean face, in metres: (low, high).
FACE_BOX = np.array([[-0.095, -0.090, -0.12], [0.095, 0.105, 0.09]])

_SKIN_SHADING: dict[str, Any] = {
    "ambient": 0.08,
    "diffuse": 0.95,
    "specular": 0.14,
    "specular_power": 16,
    "show_scalar_bar": False,
}
_EYE_SHADING: dict[str, Any] = {
    **_SKIN_SHADING,
    "diffuse": 0.75,
    "specular": 0.7,
    "specular_power": 60,
}


@dataclass(frozen=True)
class View:
    """Where the camera stands and how the picture looks.

    Attributes:
        yaw_deg: Turn around the vertical axis; 0 is frontal, positive shows the subject's left side.
        pitch_deg: Camera above (positive) or below the face.
        view_angle_deg: Vertical opening of the camera.
        zoom: Above 1 comes closer.
        occlusion: Darkens creases and the inside of the mouth; costs half a second at the start.
        fill_openings: Draws eyes and a dark mouth where an aligned mesh is open there.
        smooth_edges: Antialiasing; off is about twice as fast.
        background: Bottom and top colour of the soft background.
    """

    yaw_deg: float = 12.0
    pitch_deg: float = 2.0
    view_angle_deg: float = 22.0
    zoom: float = 1.0
    occlusion: bool = True
    fill_openings: bool = True
    smooth_edges: bool = True
    background: tuple[str, str] = ("#20262e", "#66727f")


class OffScreen:
    """Owns an off-screen plotter; as a context manager it frees it.

    Attributes:
        plotter: The scene.
    """

    plotter: pyvista.Plotter

    def close(self) -> None:
        """Frees the window."""
        self.plotter.close()

    def __enter__(self: _Scene) -> _Scene:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


_Scene = TypeVar("_Scene", bound=OffScreen)


class FaceRenderer(OffScreen):
    """Draws frames of one animation; use it as a context manager.

    Args:
        sequence: The animation; its alignment sets the upright pose.
        size: (width, height) in pixels.
        view: Camera and look.

    Attributes:
        plotter: The scene.

    Raises:
        RuntimeError: No off-screen OpenGL could be started.
    """

    def __init__(
        self,
        sequence: Sequence,
        size: tuple[int, int] = (720, 720),
        view: View | None = None,
    ) -> None:
        self._sequence = sequence
        self._view = view or View()
        rest = sequence.upright(sequence.vertices)
        self._normals = NormalField(sequence.faces, len(rest))
        self.plotter = off_screen_plotter(size)
        try:
            if not self._view.smooth_edges:
                self.plotter.render_window.SetMultiSamples(0)
            self._mesh = self._add_face(rest)
            self._mouth: Mouth | None = None
            if sequence.located and self._view.fill_openings:
                self._fill(find_cavities(rest, sequence.faces), rest)
            aim_camera(self.plotter, rest, sequence.located, size, self._view)
            with _opengl_messages():
                self.plotter.show(auto_close=False, interactive=False)
        except BaseException:
            self.plotter.close()
            raise

    def _add_face(self, rest: Points) -> pyvista.PolyData:
        import pyvista

        faces = self._sequence.faces
        mesh = pyvista.PolyData.from_regular_faces(rest.copy(), seen_faces(rest, faces))
        mesh.point_data.active_normals = self._normals(rest)
        colors = vertex_colors(rest, faces)
        if self._view.occlusion:
            colors = shade_colors(colors, bake_occlusion(mesh))
        mesh.point_data["color"] = colors
        actor = self.plotter.add_mesh(mesh, scalars="color", rgb=True, **_SKIN_SHADING)
        actor.prop.interpolation = "Phong"
        actor.backface_prop = pyvista.Property(color=MOUTH_INSIDE, diffuse=0.5, specular=0.0)
        return mesh

    def _fill(self, cavities: Cavities, rest: Points) -> None:
        """Adds the stand-ins for open eyes and mouth."""
        import pyvista

        for eye in cavities.eyes:
            ball = pyvista.Sphere(
                radius=eye.radius,
                center=tuple(eye.center),
                direction=(0, 0, 1),
                theta_resolution=48,
                phi_resolution=64,
            )
            ball.point_data["color"] = eye_colors(eye, ball.points)
            actor = self.plotter.add_mesh(ball, scalars="color", rgb=True, **_EYE_SHADING)
            actor.prop.interpolation = "Phong"
        if cavities.mouth is not None:
            self._mouth = cavities.mouth
            fan = pyvista.PolyData.from_regular_faces(self._mouth.points(rest), self._mouth.faces())
            self._mouth_mesh = fan
            self.plotter.add_mesh(fan, color=MOUTH_DARK, lighting=False)

    def move(self, points: NDArray[Any]) -> None:
        """Moves the face to (V, 3) ``points`` in the mesh's own unit and axes, in place."""
        moved = self._sequence.upright(points)
        self._mesh.points[:] = moved
        self._mesh.point_data.active_normals[:] = self._normals(moved)
        self._mesh.GetPoints().Modified()
        self._mesh.GetPointData().GetNormals().Modified()
        self._mesh.Modified()
        if self._mouth is not None:
            self._mouth_mesh.points[:] = self._mouth.points(moved)
            self._mouth_mesh.GetPoints().Modified()

    def paint(self, colors: NDArray[Any]) -> None:
        """Gives the vertices (V, 3) colours in [0, 1] in place of skin."""
        self._mesh.point_data["color"][:] = np.clip(255 * colors, 0, 255).astype(np.uint8)
        self._mesh.Modified()

    def image(self, points: NDArray[Any], head: NDArray[np.float64] | None = None) -> Image:
        """Draws the face at (V, 3) ``points`` in the mesh's own unit and axes.

        Args:
            points: of the surface.
            head: (4, 4) pose of the head, upright and in metres, see :meth:`Sequence.head_at`.

        Returns:
            (height, width, 3) uint8.
        """
        self.move(points)
        if head is not None:
            for actor in self.plotter.actors.values():
                actor.user_matrix = head
        self.plotter.render()
        return np.ascontiguousarray(self.plotter.screenshot(None, return_img=True)[..., :3])


def aim_camera(
    plotter: pyvista.Plotter, rest: Points, located: bool, size: tuple[int, int], view: View
) -> None:
    """Frames the face, sets lights and background."""
    low, high = rest.min(0).astype(float), rest.max(0).astype(float)
    if located:
        low, high = np.maximum(low, FACE_BOX[0]), np.minimum(high, FACE_BOX[1])
    center, extent = (low + high) / 2, np.maximum(high - low, 1e-9)
    tangent = np.tan(np.deg2rad(view.view_angle_deg) / 2)
    half = max(extent[1], extent[0] * size[1] / size[0]) / 2
    distance = 1.12 * half / tangent / view.zoom + extent[2] / 2
    yaw, pitch = np.deg2rad(view.yaw_deg), np.deg2rad(view.pitch_deg)
    direction = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    camera = plotter.camera
    camera.position = tuple(center + distance * direction)
    camera.focal_point = tuple(center)
    camera.up = (0.0, 1.0, 0.0)
    camera.view_angle = view.view_angle_deg
    scale = float(extent.max())
    camera.clipping_range = (0.2 * distance, 3 * distance + 10 * scale)
    plotter.set_background(view.background[0], top=view.background[1])
    _add_lights(plotter, center, scale)


def _add_lights(plotter: pyvista.Plotter, center: NDArray[np.float64], scale: float) -> None:
    """Key from the upper left, soft fill from the right, rim from behind."""
    import pyvista

    plotter.remove_all_lights()
    for offset, color, intensity, glossy in (
        ((-1.6, 1.5, 2.2), "#fff1e0", 0.80, True),
        ((2.2, 0.2, 1.6), "#cfe0ff", 0.36, False),
        ((0.9, 1.6, -1.8), "#ffffff", 0.50, False),
    ):
        position = center + 3 * scale * np.asarray(offset)
        light = pyvista.Light(
            position=tuple(position), focal_point=tuple(center), color=color, intensity=intensity
        )
        light.positional = False
        if not glossy:
            light.specular_color = "black"  # highlights of the rim light sparkle where lips meet
        plotter.add_light(light)


def off_screen_plotter(size: tuple[int, int]) -> pyvista.Plotter:
    """An empty scene that is drawn without a display.

    Args:
        size: (width, height) in pixels.

    Raises:
        RuntimeError: No off-screen OpenGL could be started.
    """
    with _opengl_messages():
        plotter = _import_pyvista().Plotter(off_screen=True, window_size=list(size))
        try:
            _check_window(plotter.render_window)
        except BaseException:
            plotter.close()
            raise
    return plotter


def check_off_screen() -> None:
    """Draws a point to make sure that pictures can be made here.

    Raises:
        RuntimeError: No off-screen OpenGL could be started.
    """
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)
    still = np.zeros((1, 3, 3), dtype=np.float32)
    faces = np.array([[0, 1, 2]])
    view = View(occlusion=False, smooth_edges=False)
    with FaceRenderer(Sequence(corners, faces, still, 1.0), (16, 16), view) as renderer:
        renderer.image(corners)


_NO_OPENGL = (
    "cannot draw: no off-screen OpenGL was found; install Mesa"
    " (Debian, Ubuntu: apt-get install libgl1 libegl1 libgl1-mesa-dri)"
)


def _import_pyvista() -> Any:
    try:
        import pyvista
    except ImportError as error:
        raise RuntimeError(f"{_NO_OPENGL} ({error})") from error
    return pyvista


def _check_window(window: Any) -> None:
    """VTK tries X, then EGL, then OSMesa, and crashes if the last is missing too."""
    if window.GetClassName() != "vtkOSOpenGLRenderWindow":
        return
    for name in ("libOSMesa.so", "libOSMesa.so.8", "libOSMesa.so.6", "osmesa.dll"):
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return
    raise RuntimeError(_NO_OPENGL)


@contextmanager
def _opengl_messages() -> Iterator[None]:
    """Keeps VTK's own warnings about missing displays off the terminal during start-up."""
    try:
        from vtkmodules.vtkCommonCore import vtkLogger
    except ImportError as error:
        raise RuntimeError(f"{_NO_OPENGL} ({error})") from error
    level = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        yield
    finally:
        vtkLogger.SetStderrVerbosity(level)
