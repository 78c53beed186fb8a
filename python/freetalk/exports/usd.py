"""Binary USD, packages and point caches through usd-core (``pip install 'freetalk[usd]'``), and USD back as animations."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from freetalk._files import beside, flush
from freetalk.audio import Audio, load_audio
from freetalk.mesh import Mesh

if TYPE_CHECKING:
    from freetalk.animation import Animation, BlendShapes, SaveReport

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
_Y_UP_OF_Z_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def save_usd(
    animation: Animation,
    path: str | os.PathLike[str],
    *,
    shapes: BlendShapes | None = None,
    cache: bool = False,
    **options: Any,
) -> SaveReport:
    """Writes an animation as USD, atomically.

    Args:
        animation: what to write.
        path: ``.usdc`` or ``.usd`` (binary), ``.usda`` (text) or ``.usdz`` (a package with sound and textures inside).
        shapes: named targets, as ``Face.blend_shapes`` makes them.
        cache: the points of every frame instead of blend shapes: exact, and larger.
        options: fields of ``SaveOptions``.

    Raises:
        ValueError: another extension or option.
        RuntimeError: usd-core is missing, or the path cannot be written.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in USD_SUFFIXES:
        raise ValueError(f"'{path}' is no USD file: end it in {', '.join(USD_SUFFIXES)}")
    modules = _pxr()
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".freetalk_usd_", dir=target.parent) as folder:
        text = Path(folder) / f"{target.stem}.usda"
        written = _one_frame(animation) if cache else animation
        report = written._save(text, shapes if not cache else None, **options)
        stage = modules.Usd.Stage.Open(str(text))
        if cache:
            _cache_points(modules, stage, animation)
        binary = Path(folder) / f"{target.stem}.usdc"
        made = text if suffix == ".usda" else binary
        if not stage.GetRootLayer().Export(str(made)):
            raise RuntimeError(f"{path}: USD could not write it")
        if suffix == ".usdz":
            made = Path(folder) / f"{target.stem}.usdz"
            if not modules.UsdUtils.CreateNewUsdzPackage(str(binary), str(made)):
                raise RuntimeError(f"{path}: USD could not make the package")
        else:
            for other in Path(folder).iterdir():
                if other.suffix not in USD_SUFFIXES:
                    _move(other, target.parent / other.name)
        _move(made, target)
    report.format = suffix[1:]
    if suffix == ".usdz":
        report.num_files = 1
    return report


def load_usd(path: str | os.PathLike[str]) -> Animation:
    """Reads the first moving mesh of a USD file: blend shapes or points over time.

    Returns:
        An animation in metres, +Y up; of our own files with sound and metadata.

    Raises:
        RuntimeError: usd-core is missing, or the file is missing, broken or holds no moving mesh.
    """
    from freetalk.animation import Animation

    modules = _pxr()
    if not Path(path).is_file():
        raise RuntimeError(f"{path} does not exist; check the path")
    try:
        stage = modules.Usd.Stage.Open(os.fspath(path))
    except modules.Tf.ErrorException as error:
        raise RuntimeError(f"{path} is damaged or no USD file") from error
    for prim in stage.Traverse():
        if not prim.IsA(modules.UsdGeom.Mesh):
            continue
        surface = modules.UsdGeom.Mesh(prim)
        rest, motion = _motion(modules, stage, surface)
        if motion is None:
            continue
        linear, shift = _to_metres(modules, stage, prim)
        head = _head(modules, stage, surface)
        counts = np.asarray(surface.GetFaceVertexCountsAttr().Get())
        indices = np.split(
            np.asarray(surface.GetFaceVertexIndicesAttr().Get()), np.cumsum(counts)[:-1]
        )
        mesh = Mesh(
            rest @ linear + shift,
            [list(map(int, polygon)) for polygon in indices],
            name=Path(path).stem,
            **_texcoords(modules, surface, counts),
        )
        facts = stage.GetRootLayer().customLayerData.get("freetalk", "{}")
        return Animation(
            mesh,
            torch.from_numpy(motion @ linear.astype(np.float32)),
            fps=stage.GetTimeCodesPerSecond(),
            audio=_sound(modules, stage),
            metadata=json.loads(facts),
            head=None if head is None else _in_world(head, linear, shift),
        )
    raise RuntimeError(f"{path} holds no mesh that moves")


def check_usd_support() -> None:
    """Makes sure that usd-core is installed.

    Raises:
        RuntimeError: it is not.
    """
    _pxr()


def _pxr() -> Any:
    try:
        import pxr
        from pxr import Ar, Tf, Usd, UsdGeom, UsdMedia, UsdSkel, UsdUtils  # noqa: F401
    except ImportError as error:
        raise RuntimeError(
            "USD needs usd-core beside freetalk: pip install 'freetalk[usd]'"
        ) from error
    return pxr


def _one_frame(animation: Animation) -> Animation:
    from freetalk.animation import Animation

    return Animation(
        animation.mesh,
        torch.zeros(1, len(animation.vertices), 3),
        fps=animation.fps,
        audio=animation.audio,
        metadata=animation.metadata,
        metres_per_unit=animation.frame.metres_per_unit,
        to_y_up=animation.frame.to_y_up,
    )


def _cache_points(modules: Any, stage: Any, animation: Animation) -> None:
    stage.SetEndTimeCode(animation.num_frames - 1)
    stage.GetPrimAtPath("/Face").SetTypeName("Xform")
    surface = modules.UsdGeom.Mesh(stage.GetPrimAtPath("/Face/Surface"))
    points = surface.GetPointsAttr()
    for index in range(animation.num_frames):
        vertices = animation.vertices_at(index).astype(np.float32)
        points.Set(modules.Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(vertices)), index)
    surface.GetPrim().RemoveProperty("normals")


def _move(made: Path, target: Path) -> None:
    """Replaces a file, or the files of a folder, whole."""
    if made.is_dir():
        target.mkdir(exist_ok=True)
        for file in made.iterdir():
            _move(file, target / file.name)
        return
    temporary = beside(target)
    shutil.move(made, temporary)
    flush(temporary)
    temporary.replace(target)


def _motion(
    modules: Any, stage: Any, surface: Any
) -> tuple[NDArray[np.float64], NDArray[np.float32] | None]:
    """(V, 3) points at rest and (T, V, 3) displacements, the mesh's own axes; None for a mesh that is still."""
    first, last = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    codes = np.arange(first, last + 1)
    points = surface.GetPointsAttr()
    rest = np.asarray(points.Get(modules.Usd.TimeCode(first)), np.float64)
    if points.ValueMightBeTimeVarying():
        frames = [np.asarray(points.Get(float(code)), np.float32) for code in codes]
        return rest, np.stack(frames) - rest.astype(np.float32)
    talk = _talk(modules, surface)
    if talk is None:
        return rest, None
    motion = np.zeros((len(codes), *rest.shape), np.float32)
    binding = modules.UsdSkel.BindingAPI(surface.GetPrim())
    names = list(binding.GetBlendShapesAttr().Get() or [])
    order = list(talk.GetBlendShapesAttr().Get() or [])
    if not names or not order:
        return rest, motion if _head(modules, stage, surface) is not None else None
    weights = np.stack(
        [np.asarray(talk.GetBlendShapeWeightsAttr().Get(float(code)), np.float32) for code in codes]
    )
    for name, path in zip(names, binding.GetBlendShapeTargetsRel().GetTargets()):
        if name not in order:
            continue
        shape = modules.UsdSkel.BlendShape(stage.GetPrimAtPath(path))
        offsets = np.zeros(rest.shape, np.float32)
        rows = shape.GetPointIndicesAttr().Get()
        where = slice(None) if rows is None or len(rows) == 0 else np.asarray(rows)
        offsets[where] = np.asarray(shape.GetOffsetsAttr().Get(), np.float32)
        for frame, weight in zip(motion, weights[:, order.index(name)]):
            if weight:
                frame += weight * offsets
    return rest, motion


def _talk(modules: Any, surface: Any) -> Any:
    """The animation of the skeleton that a mesh is bound to; None without."""
    skeleton = modules.UsdSkel.BindingAPI(surface.GetPrim()).GetInheritedSkeleton()
    if not skeleton:
        return None
    source = modules.UsdSkel.BindingAPI(skeleton.GetPrim()).GetInheritedAnimationSource()
    return modules.UsdSkel.Animation(source) if source else None


def _head(modules: Any, stage: Any, surface: Any) -> NDArray[np.float64] | None:
    """(T, 4, 4), the mesh's own axes: what the only joint does that the mesh is bound to; None where it is still."""
    talk = _talk(modules, surface)
    if talk is None or len(talk.GetJointsAttr().Get() or []) != 1:
        return None
    turns, shifts = talk.GetRotationsAttr(), talk.GetTranslationsAttr()
    if not (turns.ValueMightBeTimeVarying() or shifts.ValueMightBeTimeVarying()):
        return None
    codes = np.arange(stage.GetStartTimeCode(), stage.GetEndTimeCode() + 1)
    poses = [np.asarray(talk.GetTransforms(float(code))[0]).T for code in codes]
    return np.stack(poses)


def _in_world(
    poses: NDArray[np.float64], linear: NDArray[Any], shift: NDArray[Any]
) -> NDArray[np.float64]:
    """Rigid motions (T, 4, 4) below a placement, that is applied to rows, as they are seen above it."""
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = linear.T, shift
    return place @ poses @ np.linalg.inv(place)


def _to_metres(modules: Any, stage: Any, prim: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """(3, 3) and (3,), applied to rows."""
    matrix = np.asarray(modules.UsdGeom.XformCache().GetLocalToWorldTransform(prim))
    metres = modules.UsdGeom.GetStageMetersPerUnit(stage)
    turn = (
        np.eye(3)
        if modules.UsdGeom.GetStageUpAxis(stage) == modules.UsdGeom.Tokens.y
        else _Y_UP_OF_Z_UP.T
    )
    return metres * matrix[:3, :3] @ turn, metres * matrix[3, :3] @ turn


def _texcoords(modules: Any, surface: Any, counts: NDArray[Any]) -> dict[str, Any]:
    st = modules.UsdGeom.PrimvarsAPI(surface.GetPrim()).GetPrimvar("st")
    if not st or not st.HasValue() or st.GetInterpolation() != modules.UsdGeom.Tokens.faceVarying:
        return {}
    values = np.asarray(st.Get(), np.float64)
    rows = np.asarray(st.GetIndices()) if st.IsIndexed() else np.arange(len(values))
    corners = np.split(rows, np.cumsum(counts)[:-1])
    return {
        "texcoords": values,
        "polygon_texcoords": [list(map(int, corner)) for corner in corners],
    }


def _sound(modules: Any, stage: Any) -> Audio | None:
    import soundfile

    for prim in stage.Traverse():
        if not prim.IsA(modules.UsdMedia.SpatialAudio):
            continue
        asset = modules.UsdMedia.SpatialAudio(prim).GetFilePathAttr().Get()
        opened = asset and modules.Ar.GetResolver().OpenAsset(
            modules.Ar.ResolvedPath(asset.resolvedPath)
        )
        if not opened:
            continue
        suffix = Path(asset.path).suffix
        with tempfile.TemporaryDirectory(prefix="freetalk_sound_") as folder:
            file = Path(folder) / f"sound{suffix}"
            file.write_bytes(bytes(opened.GetBuffer()))
            return load_audio(file, soundfile.info(str(file)).samplerate)
    return None
