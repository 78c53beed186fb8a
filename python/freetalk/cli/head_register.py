"""``freetalk head register``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from freetalk.cli.outputs import check_readable, check_writable

if TYPE_CHECKING:
    from freetalk.data.expressive_faces import ExpressiveFace

Array = npt.NDArray[Any]
_RESULT = "registration.npz"
_TEMPLATE_POINTS = 2000


def run(arguments: argparse.Namespace) -> None:
    """Registers scans and writes what was found."""
    out = Path(arguments.out)
    if out.exists() and any(out.iterdir()):
        raise ValueError(f"{out} is not empty: choose another folder")
    files = [Path(check_readable(path, "a mesh or points")) for path in arguments.files]
    names = _names(files)
    if len(arguments.landmarks) not in (0, 1, len(files)):
        raise ValueError(
            f"--landmarks: {len(arguments.landmarks)} files for {len(files)} scans; give one for all or one each"
        )
    check_writable(out / _RESULT)
    from freetalk._progress import progress_bar
    from freetalk.data.pose import find_pose
    from freetalk.data.registration import RegisterOptions, Scan, register
    from freetalk.mesh import Mesh, save_mesh, vertex_normals

    face = _face(arguments.flame)
    surfaces = [_surface(file) for file in files]
    landmarks = _landmarks(arguments, files, surfaces)
    known = [own for own in landmarks if own is not None]
    pose = find_pose([surface[0] for surface in surfaces], known, arguments.unit)
    print(f"unit: {pose.unit} ({pose.reason})")
    scans = [
        Scan(
            pose.scale * points,
            None if faces is None else vertex_normals(points, faces),
            None if own is None else pose.scale * own,
        )
        for (points, faces), own in zip(surfaces, landmarks, strict=True)
    ]
    options = RegisterOptions(points=arguments.points)
    if arguments.still:
        options = replace(options, smooth_expression=0.0, smooth_pose=0.0)
    with progress_bar(True, "register") as bar:
        found = register(
            scans,
            face,
            options=options,
            identity=_identity(arguments.identity, face),
            seed=arguments.seed,
            on_step=None if bar is None else lambda done, steps: bar(done / steps),
        )
    out.mkdir(parents=True, exist_ok=True)
    (out / "aligned").mkdir()
    for t, (file, name) in enumerate(zip(files, names, strict=True)):
        _, faces = surfaces[t]
        save_mesh(out / f"{name}.ply", Mesh(found.vertices[t], face.faces.tolist()))
        placed = found.canonical(scans[t].points, t)
        if faces is None:
            np.save(out / "aligned" / f"{name}.npy", placed.astype(np.float32))
        else:
            save_mesh(out / "aligned" / f"{name}.ply", Mesh(placed, faces.tolist()))
        print(
            f"{file}: {found.error_mm[t]:.2f} mm from the model where it is within 4 mm, "
            f"{found.explained[t]:.0%} of the scan"
        )
    np.savez_compressed(
        out / _RESULT,
        identity=found.identity,
        weights=found.weights,
        names=np.array(face.names),
        rotation=found.rotation,
        shift_m=found.shift,
        metres_per_unit=pose.scale,
        error_mm=found.error_mm,
        explained=found.explained,
        files=np.array(names),
        fps=arguments.fps,
    )
    print(f"wrote {out}: {len(files)} registered meshes and {_RESULT}")


def _names(files: Sequence[Path]) -> list[str]:
    """Their stems; with a number where two are alike."""
    stems = [file.stem for file in files]
    if len(set(stems)) == len(stems):
        return stems
    return [f"{stem}_{number:05d}" for number, stem in enumerate(stems)]


def _face(flame: str | None) -> ExpressiveFace:
    if flame is None:
        from freetalk.corpus.linear_face import built_in_head

        return built_in_head()
    from freetalk.data.expressive_faces import FlameFace
    from freetalk.data.flame import read_flame
    from freetalk.data.templates import find_template

    path = Path(check_readable(flame, "FLAME's arrays (docs/datasets.md)"))
    model = read_flame(path)
    template = find_template(path.parent, model.faces, len(model.template), "FLAME")
    return FlameFace.of(model, template.needed_landmarks().indices)


def _identity(path: str | None, face: ExpressiveFace) -> Array | None:
    if path is None:
        return None
    with np.load(check_readable(path, "a registration.npz")) as archive:
        if "identity" not in archive or archive["identity"].shape != (len(face.identity_basis),):
            raise ValueError(f"{path} holds no identity of this model")
        return np.asarray(archive["identity"], np.float64)


def _surface(file: Path) -> tuple[Array, Array | None]:
    """Points (P, 3) in the file's unit, and its triangles where it has some."""
    if file.suffix.lower() == ".npy":
        points = np.load(file, allow_pickle=False)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"{file} is {points.shape}; expected points (P, 3)")
        return points.astype(np.float64), None
    import freetalk

    mesh = freetalk.load_mesh(file)
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)


def _landmarks(
    arguments: argparse.Namespace,
    files: Sequence[Path],
    surfaces: Sequence[tuple[Array, Array | None]],
) -> list[Array | None]:
    """(68, 3) of each scan in its own unit; found once for scans of one meshing."""
    found: list[Array | None] = []
    corners: Array = np.zeros((68, 3), np.int64)
    weights: Array = np.zeros((68, 3))
    looked_at = np.zeros((0, 3), np.int64)  # triangles of the meshing that they are on
    for number, (file, (points, faces)) in enumerate(zip(files, surfaces, strict=True)):
        given = arguments.landmarks
        path = None if not given else given[number if len(given) > 1 else 0]
        if path is not None and Path(path).suffix.lower() == ".npy":
            own = np.load(check_readable(path, "landmarks"), allow_pickle=False)
            if own.shape != (68, 3):
                raise ValueError(f"{path} is {own.shape}; expected landmarks (68, 3)")
            found.append(own.astype(np.float64) if len(given) > 1 or number == 0 else None)
            continue
        if faces is None:
            if number == 0:
                raise ValueError(f"{file} has no surface to look at: give --landmarks as .npy")
            found.append(None)
            continue
        if path is not None:
            from freetalk.data import read_landmarks

            told = read_landmarks(Path(check_readable(path, "landmarks")), faces, len(points))
            corners, weights = told.vertices, told.weights
        elif not np.array_equal(faces, looked_at):
            corners, weights = _looked_for(file, points, faces, arguments.unit)
            looked_at = faces
        found.append(np.einsum("kcd,kc->kd", points[corners], weights))
    return found


def _looked_for(file: Path, points: Array, faces: Array, unit: str) -> tuple[Array, Array]:
    """Corners (68, 3) and weights (68, 3) of the landmarks of a mesh."""
    from freetalk.corpus.linear_face import built_in_face
    from freetalk.faces import find_landmarks
    from freetalk.geometry import align_to_template, sample_template

    model = built_in_face()
    samples = sample_template(model.neutral, model.faces, _TEMPLATE_POINTS)
    alignment = align_to_template(points, faces, *samples, unit=unit)
    found = find_landmarks(points, faces, alignment, name=str(file))
    print(f"{file}: {found.summary}")
    return faces[found.triangles].astype(np.int64), found.weights
