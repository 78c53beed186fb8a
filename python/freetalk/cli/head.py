"""``freetalk head``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from freetalk.cli.numbers import natural, seed
from freetalk.cli.outputs import check_readable, check_writable

HELP = "neural parametric heads: sample, extract, fit, register, score"
_HEAD = "folder of a head, such as 'freetalk train head' or 'freetalk head import' wrote"
_MESHES = (".obj", ".ply")


def add_commands(nested: Any, command: Callable[..., Any]) -> None:
    """Adds those of ``freetalk head``; ``command`` makes one of a name, a handler and a help."""
    add_import(
        command(nested, "import", "head:import_nphm", "read a checkpoint of the public NPHM")
    )
    add_sample(command(nested, "sample", "head:sample", "write the mesh of a new identity"))
    add_frames(command(nested, "extract", "head:extract", "write the meshes of codes"))
    add_fit(command(nested, "fit", "head:fit", "fit codes to meshes or scans"))
    add_register(
        command(nested, "register", "head_register:run", "fit a linear face model to scans")
    )
    add_score(command(nested, "score", "head:score", "score a head on faces that it has not seen"))


def add_import(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``freetalk head import``."""
    parser.description = (
        "Reads checkpoints of the public NPHM code (checkpoint_epoch_*.tar of the identity and of the expression "
        "network, the mean anchors as .npy) by their own parameter names and writes a folder of this library."
    )
    parser.add_argument("--identity", required=True, metavar="TAR", help="the identity network")
    parser.add_argument(
        "--deformation", required=True, metavar="TAR", help="the expression network"
    )
    parser.add_argument("--anchors", required=True, metavar="NPY", help="mean anchors, 39 x 3")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder to write")


def add_extract(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``freetalk head sample`` and ``extract``."""
    parser.add_argument("--head", required=True, metavar="DIR", help=_HEAD)
    parser.add_argument("--out", required=True, metavar="FILE", help="a mesh: OBJ or PLY")
    parser.add_argument("--resolution", type=int, default=256, help="cells along each axis")


def add_sample(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``freetalk head sample``."""
    parser.description = "Writes the surface of a new identity at rest, or canonical."
    add_extract(parser)
    parser.add_argument("--seed", type=seed, default=0, help="another seed, another identity")
    parser.add_argument("--canonical", action="store_true", help="with the mouth open: z_exp = 0")


def add_frames(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``freetalk head extract``."""
    parser.description = "Writes surfaces of codes as meshes, FILE for one frame or FILE's name with numbers for several."
    add_extract(parser)
    codes_help = "codes, such as 'freetalk head fit' wrote"
    parser.add_argument("--codes", required=True, metavar="NPZ", help=codes_help)
    parser.add_argument("--frame", type=int, metavar="N", help="this frame alone")


def add_fit(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``freetalk head fit``."""
    parser.description = (
        "Fits the identity of meshes or scans in the head's frame (metres, FLAME's axes) and the expression of "
        "each, and writes their codes. With --identity, expressions alone."
    )
    parser.add_argument(
        "files", nargs="+", metavar="FILE", help="OBJ, PLY, OFF, STL or glTF, one a frame"
    )
    parser.add_argument("--head", required=True, metavar="DIR", help=_HEAD)
    parser.add_argument("--out", required=True, metavar="NPZ", help="codes to write")
    parser.add_argument("--identity", metavar="NPZ", help="codes whose identity is known")
    parser.add_argument(
        "--method", choices=("gauss_newton", "adam"), default="gauss_newton", help="how"
    )
    parser.add_argument("--points", type=int, default=2000, help="drawn from each file; 0: all")
    parser.add_argument("--fps", type=float, default=24.0, help="frames per second of the files")
    parser.add_argument("--seed", type=seed, default=0, help="of the points drawn")


def add_register(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``freetalk head register``."""
    parser.description = (
        "Fits the built-in face, or FLAME, to scans of one face in any pose: one identity, and an expression and a pose a "
        "frame. Writes registration.npz, the registered meshes (NAME.ply) and the scans in the same frame "
        "(aligned/NAME.ply), which is that of 'freetalk head fit'."
    )
    parser.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="scans in the order of time: meshes, or .npy of points (P, 3)",
    )
    parser.add_argument("--out", required=True, metavar="DIR", help="folder to write, new or empty")
    parser.add_argument(
        "--landmarks",
        nargs="+",
        default=[],
        metavar="FILE",
        help="one for all scans of one meshing, or one a scan: as 'freetalk mesh landmarks' writes them, or .npy of "
        "points (68, 3); by default they are looked for",
    )
    parser.add_argument(
        "--flame", metavar="NPZ", help="your FLAME (docs/datasets.md) instead of the built-in face"
    )
    parser.add_argument(
        "--identity", metavar="NPZ", help="a registration.npz whose identity is kept"
    )
    parser.add_argument("--unit", default="auto", help="of the scans: auto, m, cm, mm or in")
    parser.add_argument(
        "--points", type=int, default=2000, help="drawn from a scan in each step; 0: all"
    )
    parser.add_argument("--still", action="store_true", help="the scans are no sequence in time")
    parser.add_argument("--fps", type=float, default=24.0, help="frames per second, for the record")
    parser.add_argument("--seed", type=seed, default=0, help="of the points drawn")


def add_score(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``freetalk head score``."""
    parser.description = (
        "Compares a head with the built-in face's held-out identities, canonical and under expressions of a corpus's "
        "test split: distances and F-scores by region, beside what sampling alone costs."
    )
    parser.add_argument("--head", required=True, metavar="DIR", help=_HEAD)
    parser.add_argument("--data", required=True, metavar="DIR", help="a corpus with expressions")
    parser.add_argument("--identities", type=natural, default=8, help="held-out ones, at most 32")
    parser.add_argument("--expressions", type=natural, default=2, help="of each")
    parser.add_argument(
        "--points",
        type=natural,
        default=50_000,
        help="sampled on each surface; NPHM's scores: 250000",
    )
    parser.add_argument(
        "--one-view",
        action="store_true",
        help="also fit the head to 2500 noisy points of one side of each",
    )


def import_nphm(arguments: argparse.Namespace) -> None:
    """Converts checkpoints of the public NPHM code."""
    files = [
        check_readable(path, "a file of the public NPHM")
        for path in (arguments.identity, arguments.deformation, arguments.anchors)
    ]
    check_writable(Path(arguments.out) / "config.json")
    from freetalk.head import load_nphm

    head = load_nphm(*files)
    head.save_pretrained(arguments.out)
    count = sum(parameter.numel() for parameter in head.parameters())
    print(f"wrote {arguments.out}: {count / 1e6:.1f} million weights")


def sample(arguments: argparse.Namespace) -> None:
    """Writes a new identity's mesh."""
    out = _mesh_file(arguments.out)
    head = _load(arguments.head)
    import torch

    with torch.no_grad():
        z_id = head.sample_identity(1, seed=arguments.seed)[0]
    rest = head.state_dict()["rest_expression"]
    extractor = _extractor(head, z_id, arguments.resolution)
    _save(out, extractor.extract(torch.zeros_like(rest) if arguments.canonical else rest))


def extract(arguments: argparse.Namespace) -> None:
    """Writes the meshes of codes."""
    out = _mesh_file(arguments.out)
    check_readable(arguments.codes, "codes")
    head = _load(arguments.head)
    from freetalk.head import load_codes

    codes = load_codes(arguments.codes, head)
    frames = range(len(codes.z_exp))
    if arguments.frame is not None:
        if arguments.frame not in frames:
            raise ValueError(f"--frame {arguments.frame}: the codes have {len(frames)} frames")
        frames = range(arguments.frame, arguments.frame + 1)
    extractor = _extractor(head, codes.z_id, arguments.resolution)
    for frame in frames:
        path = out if len(frames) == 1 else out.with_stem(f"{out.stem}_{frame:05d}")
        _save(path, extractor.next(codes.z_exp[frame]))


def fit(arguments: argparse.Namespace) -> None:
    """Fits codes to meshes or scans."""
    files = [check_readable(path, "a mesh or scan") for path in arguments.files]
    check_writable(Path(arguments.out))
    head = _load(arguments.head)
    import numpy as np

    import freetalk
    from freetalk.head import (
        Codes,
        FitOptions,
        fit_expressions,
        fit_identity,
        load_codes,
        save_codes,
    )

    points = [np.asarray(freetalk.load_mesh(file).vertices, np.float32) for file in files]
    options = FitOptions(method=arguments.method, points=arguments.points)
    if arguments.identity:
        z_id = load_codes(arguments.identity, head).z_id
        found = fit_expressions(head, z_id, points, options=options, seed=arguments.seed)
    else:
        found = fit_identity(head, points, options=options, seed=arguments.seed)
    for file, error in zip(files, found.error_mm.tolist(), strict=True):
        print(f"{file}: {error:.2f} mm from the head's surface")
    save_codes(arguments.out, head, Codes(found.z_id, found.z_exp, arguments.fps))
    print(f"wrote {arguments.out}: {len(files)} frames")


def score(arguments: argparse.Namespace) -> None:
    """Prints the scores of a head."""
    check_readable(str(Path(arguments.data) / "manifest.json"), "the manifest of a packed corpus")
    head = _load(arguments.head)
    from freetalk.data import open_dataset
    from freetalk.evaluate.heads import evaluate_head, table

    found = evaluate_head(
        head,
        open_dataset(arguments.data),
        identities=arguments.identities,
        expressions=arguments.expressions,
        num_points=arguments.points,
        one_view=arguments.one_view,
    )
    print(table(found))


def _load(folder: str) -> Any:
    check_readable(str(Path(folder) / "config.json"), "a head's configuration")
    from freetalk.head import ParametricHead

    return ParametricHead.from_pretrained(folder).eval()


def _extractor(head: Any, z_id: Any, resolution: int) -> Any:
    from freetalk.head import PreparedHead, SurfaceExtractor, SurfaceOptions

    return SurfaceExtractor(PreparedHead(head, z_id), SurfaceOptions(resolution=resolution))


def _mesh_file(text: str) -> Path:
    path = Path(text)
    if path.suffix.lower() not in _MESHES:
        raise ValueError(f"--out {text}: a mesh is written as {' or '.join(_MESHES)}")
    check_writable(path)
    return path


def _save(path: Path, surface: Any) -> None:
    from freetalk.mesh import Mesh, save_mesh

    save_mesh(path, Mesh(surface.vertices, surface.faces))
    print(f"wrote {path}: {len(surface.vertices)} vertices, {len(surface.faces)} triangles")
