"""Masks given on the command line, and those of public code, recognised by vertices, count and hash."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.data import DatasetError, Mask, index_hash, parse_spec, read_mask
from freetalk.data.landmarks import INNER_LIP_PAIRS, LIPS, UPPER_FACE

#: Vertices of the upper lip, and those of the lower that face them.
Pairs = tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]

#: (vertices, indices, hash) of the masks that public code ships: whose they are.
KNOWN_MASKS: dict[tuple[int, int, str], str] = {
    (5023, 371, "712e477499f9e26f"): "FLAME lips, FLAME_lips_idx.mat of ScanTalk",
    (5023, 2511, "e4b62b85d0bdd5b1"): "FLAME upper face, upper_mask.npy of ScanTalk",
    (3895, 731, "2565741f97edbc5f"): "BIWI_6 lips, mouth_indices.npy of ScanTalk",
    (3895, 402, "551c0db3a6521254"): "BIWI_6 upper face, upper_indices.npy of ScanTalk",
    (5471, 567, "544a3e8172a5ab33"): "Multiface lips, mouth_indices.npy of ScanTalk",
    (5471, 328, "b97bf8979d7ebae4"): "Multiface upper face, upper_indices.npy of ScanTalk",
    (23370, 4996, "bf030dc9cf393bb9"): "BIWI lips, lve.txt of CodeTalker",
    (23370, 7784, "8e311af01cc6777f"): "BIWI upper face, fdd.txt of CodeTalker",
}

#: Words in a file's name, and regions in a file of several, that say which mask it is.
_WORDS = {"lips": ("lip", "mouth", "lve"), "upper": ("upper", "fdd", "forehead")}
_REGIONS = {"lips": ("lips", "lip_mask"), "upper": ("upper", "upper_face", "upper_face_mask")}


def landmark_masks() -> dict[str, Mask]:
    """Lips and upper face of the 68 landmarks."""
    return {
        "lips": Mask(np.array(LIPS, dtype=np.int64), "landmarks 49-68 (iBUG)"),
        "upper": Mask(np.unique(np.array(UPPER_FACE, dtype=np.int64)), "brows and eyes (iBUG)"),
    }


def landmark_pairs() -> Pairs:
    """Inner-lip landmarks that face one another: of the upper lip, of the lower."""
    upper, lower = INNER_LIP_PAIRS
    return np.array(upper, dtype=np.int64), np.array(lower, dtype=np.int64)


def read_masks(given: Sequence[str], num_vertices: int) -> dict[str, Mask]:
    """Masks by name.

    Args:
        given: ``FILE`` or ``NAME=FILE``: lists of vertices or flags as ``.npy``, ``.txt``, ``.json``,
            ``.mat`` or ``.pkl``. Without a name it is ``lips`` or ``upper`` by the file's name; a
            file of several regions gives both.
        num_vertices: V.

    Raises:
        ValueError: a file is not readable, names other vertices, or does not say which mask it is.
    """
    masks: dict[str, Mask] = {}
    for text in given:
        name, _, file = parse_spec(text)
        path = Path(file)
        if not path.is_file():
            raise FileNotFoundError(f"there is no mask {path}")
        names = [name] if name else _names_of(path)
        for each in names:
            if each in masks:
                raise ValueError(f"two masks are called {each}; give them names: NAME=FILE")
            masks[each] = read_mask(path, num_vertices, (*_REGIONS.get(each, ()), each))
    return masks


def read_lip_pairs(path: Path, num_vertices: int) -> Pairs:
    """Vertices of the upper lip and those of the lower that face them, from (P, 2) indices.

    Args:
        path: ``.json``, ``.txt`` (two columns) or ``.npy``.
        num_vertices: V.

    Raises:
        ValueError: not (P, 2), or an index beyond V.
    """
    values: Sequence[Any] | npt.NDArray[Any]
    if path.suffix.lower() == ".json":
        values = json.loads(path.read_text())
    elif path.suffix.lower() == ".npy":
        values = np.load(path, allow_pickle=False)
    else:
        values = np.loadtxt(path, delimiter="," if "," in path.read_text() else None, ndmin=2)
    pairs = np.asarray(values)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or len(pairs) == 0:
        raise DatasetError(f"{path} is {pairs.shape}; expected (P, 2): upper lip, lower lip")
    if not 0 <= pairs.min() <= pairs.max() < num_vertices:
        raise DatasetError(f"{path} names a vertex beyond the {num_vertices} of the ground truth")
    whole = pairs.astype(np.int64)
    return whole[:, 0], whole[:, 1]


def describe_masks(masks: Mapping[str, Mask], num_vertices: int) -> dict[str, dict[str, Any]]:
    """File, count, hash, and whose mask it is where that is known."""
    result: dict[str, dict[str, Any]] = {}
    for name, mask in masks.items():
        key = (num_vertices, len(mask.indices), index_hash(mask.indices))
        result[name] = {
            **mask.describe(),
            "vertices": num_vertices,
            "known_as": KNOWN_MASKS.get(key),
        }
    return result


def _names_of(path: Path) -> list[str]:
    stem = path.stem.lower()
    found = [name for name, words in _WORDS.items() if any(word in stem for word in words)]
    if len(found) == 1:
        return found
    if path.suffix.lower() in (".json", ".npz", ".pkl") and not found:
        return list(_REGIONS)
    raise ValueError(f"which mask is {path}? Say so: lips={path} or upper={path}")
