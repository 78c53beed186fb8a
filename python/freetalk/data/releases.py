"""The public releases of speech and facial motion as they really lie on disk, take by take.

============  =============================================================================================
``vocaset``   VOCAset (Cudeiro et al. 2019) as released: ``data_verts.npy`` of all frames at 60 fps,
              ``subj_seq_to_idx.pkl``, ``raw_audio_fixed.pkl``, ``templates.pkl``; or as FaceFormer's script leaves
              it, ``vertices_npy/SPEAKER_sentenceNN.npy`` and ``wav``, where a few sounds are missing
``biwi``      BIWI_6 of ScanTalk or BIWI of FaceFormer and CodeTalker, 25 fps: ``F1_01`` to ``F1_40`` are neutral,
              ``F1_e01`` to ``F1_e40`` emotional (copies hold both, or only the latter), which emotion nobody says
``multiface`` Multiface in ScanTalk's layout, 30 fps
``emovoca``   EmoVOCA (Nocentini et al. 2025): ``sequences/SPEAKER_sentenceNN_EMOTION_LEVEL.npy``, ``wav``,
              ``label``, ``intensity``; templates there or in a ``vocaset`` beside it
``mead``      MEAD (Wang et al. 2020) as EMOTE (Danecek et al. 2023) releases it, FLAME's parameters at 25 fps in
              ``reconstructions/METHOD/ACTOR/front/EMOTION/level_N/NNN/shape_pose_cam.hdf5``, sound in ``audio``; or
              vertices in pairs of ``vertices/ACTOR_EMOTION_level_N_NNN.npy`` and ``wav``
``folder``    one's own: ``motion/NAME.npy`` (vertices, or the 68 landmarks), ``wav``, ``templates``,
              ``labels.csv`` (name and any of speaker, emotion, intensity, text, split), ``dataset.json``
              (``fps``, ``unit``, ``name``); landmarks may come with ``scans``, see :mod:`freetalk.data.scans`
============  =============================================================================================

Motion is (T, V, 3) or (T, 3 V) floating numbers. Neutral faces are ``templates.pkl`` or a mesh a speaker in
``templates``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from freetalk.data.emotions import LABELS, emotion_of, intensity_of
from freetalk.data.errors import DatasetError, LabelError, LayoutError, MissingFileError
from freetalk.data.flame import Flame, find_flame
from freetalk.data.landmarks import NUM_LANDMARKS
from freetalk.data.pack import Array, FloatArray
from freetalk.data.release_files import (
    check_labels,
    common_size,
    faces_and_template,
    mesh_template,
    neutral_faces,
    parameters,
    pickled_sound,
    positions,
    read_hdf5,
    read_labels,
    read_settings,
    read_sound,
    sequence_rows,
    sparse_template,
)
from freetalk.data.safe_pickle import load_pickle
from freetalk.data.scans import Mesh, neutral_scans, scan_files
from freetalk.data.splits import SPLITS
from freetalk.data.templates import Template, find_template, speaker_of

KINDS = ("vocaset", "biwi", "multiface", "emovoca", "mead", "folder")

_MEAD = "|".join(LABELS["mead"])
#: What a file's name says, for each release.
_NAMES = {
    "vocaset": re.compile(r"(?P<speaker>.+)_sentence(?P<sentence>\d+)"),
    "biwi": re.compile(r"(?P<speaker>[FM]\d+)_(?P<variant>e?)(?P<sentence>\d+)"),
    "multiface": re.compile(r"(?P<speaker>\d{8})(?:[_-].*)?"),
    "emovoca": re.compile(
        r"(?P<speaker>.+)_sentence(?P<sentence>\d+)_(?P<emotion>[A-Za-z]+\d?)_(?P<level>\d+)"
    ),
    "mead": re.compile(
        rf"(?P<speaker>[MW]\d{{3}})_(?:front_)?(?P<emotion>{_MEAD})_(?:level_)?(?P<level>\d)_\d+"
    ),
}
#: Frame rates that copies of a release are known to have, the published one first.
_RATES = {
    "vocaset": (60.0, 30.0),
    "biwi": (25.0,),
    "multiface": (30.0,),
    "emovoca": (60.0, 30.0),
    "mead": (25.0, 30.0),
    "folder": (30.0, 25.0, 60.0, 24.0, 29.97, 50.0, 100.0, 120.0),
}
_RELEASED = ("data_verts.npy", "raw_audio_fixed.pkl", "subj_seq_to_idx.pkl", "templates.pkl")
_MOTION_FOLDERS = ("vertices_npy", "vertices", "sequences", "motion")
_SOUND_SUFFIXES = (".wav", ".flac", ".ogg", ".mp3")
_EMOTE_FILE = "shape_pose_cam.hdf5"


@dataclass(frozen=True)
class Take:
    """One take as it lies on disk.

    Attributes:
        id: unique name.
        speaker: whose face and voice it is.
        motion: reads (T, V, 3) positions in the file's unit, or (T, E + 3) of FLAME's parameters.
        sound: reads (S,) samples at 16 kHz; ``None`` where the take has none.
        paths: its files.
        sentence: number of the sentence, where splits need it.
        variant: of the release's takes.
        emotion: our name of the emotion.
        intensity: 1 to 3.
        text: transcript.
        split: split that the data itself names.
        scans: the mesh of each frame, where they are of different meshings.
    """

    id: str
    speaker: str
    motion: Callable[[], Array]
    sound: Callable[[], FloatArray] | None
    paths: tuple[Path, ...]
    sentence: int | None = None
    variant: str = ""
    emotion: str = "neutral"
    intensity: float = 1.0
    text: str | None = None
    split: str | None = None
    scans: tuple[Path, ...] = ()


@dataclass
class Release:
    """What was found in a folder.

    Attributes:
        kind: one of ``KINDS``.
        directory: the folder.
        takes: in order of their names.
        neutral: neutral face (V, 3) of each speaker, the file's unit.
        template: the meshing.
        rates: frames per second that the files may have, the likeliest first.
        unit: length unit that the folder states, or ``auto``.
        name: that the folder states.
        flame: the model, where motion is its parameters.
        excluded: what is no usable take, and why.
        notes: what results say of the source.
        scans: neutral scan of each speaker, where frames are scans.
    """

    kind: str
    directory: Path
    takes: list[Take]
    neutral: dict[str, FloatArray]
    template: Template
    rates: tuple[float, ...]
    unit: str = "auto"
    name: str = ""
    flame: Flame | None = None
    excluded: dict[str, str] = field(default_factory=dict)
    notes: dict[str, Any] = field(default_factory=dict)
    scans: dict[str, Mesh] = field(default_factory=dict)


def kind_of(directory: Path) -> str:
    """The release that a folder holds, by its files.

    Raises:
        MissingFileError, LayoutError: no folder; none that is known, with what was looked for.
    """
    if not directory.is_dir():
        raise MissingFileError(f"{directory} is no folder")
    if any((directory / _RELEASED[at]).is_file() for at in (0, 2)):
        return "vocaset"
    if _processed(directory) is not None:
        return "mead"
    motion = _motion_folder(directory)
    if motion is None:
        raise LayoutError(
            f"{directory} is no known dataset. Looked for manifest.json (packed), data_verts.npy (VOCAset), "
            f"reconstructions (MEAD-EMOTE), or one of the folders {', '.join(_MOTION_FOLDERS)} beside wav "
            "(VOCAset of FaceFormer, BIWI, Multiface, EmoVOCA, your own)"
        )
    stem = next((path.stem for path in sorted(motion.iterdir())), "")
    if (directory / "labels.csv").is_file():
        return "folder"
    fitting = [kind for kind, pattern in _NAMES.items() if pattern.fullmatch(stem)]
    if "vocaset" in fitting and not stem.startswith("FaceTalk_"):
        fitting.remove("vocaset")
    return fitting[0] if fitting else "folder"


def open_release(kind: str, directory: str | Path) -> Release:
    """Lists the takes of a release.

    Args:
        kind: one of ``KINDS``, in any case; ``auto`` finds out.
        directory: its folder.

    Raises:
        DatasetError: a file that all takes need is missing or wrong, by name.
        ValueError: no such kind.
    """
    path = Path(directory).resolve()
    kind = {"mead-emote": "mead", "biwi_6": "biwi"}.get(kind.lower(), kind.lower())
    kind = kind_of(path) if kind == "auto" else kind
    if kind not in KINDS:
        raise ValueError(f"no release {kind!r}; known: {', '.join(KINDS)}, auto")
    if not path.is_dir():
        raise MissingFileError(f"{path} is no folder")
    if kind == "vocaset" and _motion_folder(path) is None:
        release = _released_vocaset(path)
    elif kind == "mead" and _processed(path) is not None:
        release = _emote(path)
    elif kind == "folder":
        release = _folder(path)
    else:
        release = _paired(kind, path)
    if not release.takes:
        found = "; ".join(list(release.excluded.values())[:3])
        raise LayoutError(f"{path} holds no take of {kind}" + (f": {found}" if found else ""))
    release.takes.sort(key=lambda take: take.id)
    return release


def _released_vocaset(directory: Path) -> Release:
    """VOCAset as released: rows of one array, sounds of one pickle."""
    for name in _RELEASED:
        if not (directory / name).is_file():
            raise MissingFileError(f"{directory} lacks {name} of VOCAset's release")
    neutral, template = faces_and_template("vocaset", directory)
    vertices = positions(directory / "data_verts.npy", template.num_vertices)
    sounds = load_pickle(directory / "raw_audio_fixed.pkl")
    takes, excluded = [], {}
    for speaker, sentences in load_pickle(directory / "subj_seq_to_idx.pkl").items():
        for sentence, frames in sentences.items():
            name = f"{speaker}_{sentence}"
            number = _NAMES["vocaset"].fullmatch(name)
            try:
                rows = sequence_rows(
                    frames, len(vertices), f"{directory}/subj_seq_to_idx.pkl: {name}"
                )
                entry = sounds.get(speaker, {}).get(sentence)
                if entry is None:
                    raise MissingFileError("raw_audio_fixed.pkl has no sound of it")
            except DatasetError as error:
                excluded[name] = str(error)
                continue
            takes.append(
                Take(
                    name,
                    str(speaker),
                    partial(vertices.__getitem__, rows),
                    partial(pickled_sound, entry, f"{directory}/raw_audio_fixed.pkl: {name}"),
                    (directory / "data_verts.npy", directory / "raw_audio_fixed.pkl"),
                    int(number["sentence"]) if number else None,
                )
            )
    return Release(
        "vocaset", directory, takes, neutral, template, _RATES["vocaset"], excluded=excluded,
        notes={"layout": "released"},
    )  # fmt: skip


def _paired(kind: str, directory: Path) -> Release:
    """A ``.npy`` and a sound a take, whose name says what it is."""
    beside = [directory / "vocaset", *(directory.parent / n for n in ("vocaset", "VOCASET"))]
    neutral, template = faces_and_template(kind, directory, beside if kind == "emovoca" else ())
    release = Release(
        kind, directory, [], neutral, template, _RATES[kind], notes={"layout": "files in pairs"}
    )
    if kind == "biwi":
        release.notes["emotion_labels"] = (
            "the release does not say which emotion its takes eNN show: they count as neutral"
        )

    def parse(stem: str) -> dict[str, Any]:
        match = _NAMES[kind].fullmatch(stem)
        if match is None:
            raise LayoutError(f"{stem} is no name of {kind}")
        said = match.groupdict()
        parsed: dict[str, Any] = {"speaker": said["speaker"], "variant": said.get("variant", "")}
        if "sentence" in said:
            parsed["sentence"] = int(said["sentence"])
        if "emotion" in said:
            parsed["emotion"] = emotion_of(said["emotion"], kind, stem)
            parsed["intensity"] = intensity_of(said["level"], stem)
        if kind == "emovoca":
            check_labels(directory, stem, said["emotion"], int(said["level"]))
        return parsed

    _add_pairs(release, template.num_vertices, parse)
    return release


def _folder(directory: Path) -> Release:
    """One's own recordings."""
    settings = read_settings(directory)
    labels = read_labels(directory / "labels.csv")
    neutral, faces = neutral_faces([directory])
    sparse = common_size(neutral) == NUM_LANDMARKS and not faces
    template = sparse_template() if sparse else mesh_template("folder", directory, neutral, faces)
    heard = (directory / "wav").is_dir()
    if not heard and "fps" not in settings:
        raise LayoutError(
            f"{directory} has no wav folder, so nothing tells the frame rate of its motion: state it "
            'as {"fps": 30} in dataset.json'
        )
    rates = (float(settings["fps"]),) if "fps" in settings else _RATES["folder"]
    release = Release(
        "folder", directory, [], neutral, template, rates, str(settings.get("unit", "auto")),
        str(settings.get("name", "")), notes={"layout": "folder"},
        scans=neutral_scans(directory / "scans") if sparse else {},
    )  # fmt: skip

    def parse(stem: str) -> dict[str, Any]:
        row, where = labels.get(stem, {}), f"{directory}/labels.csv: {stem}"
        split = row.get("split") or None
        if split not in (None, *SPLITS):
            raise LabelError(f"{where} has the split {split!r}; known: {', '.join(SPLITS)}")
        return {
            "speaker": row.get("speaker") or speaker_of(stem, neutral) or stem.rpartition("_")[0],
            "emotion": emotion_of(row.get("emotion") or "neutral", None, where),
            "intensity": intensity_of(row.get("intensity") or 1, where),
            "text": row.get("text") or None,
            "split": split,
            "scans": scan_files(directory / "scans" / stem) if release.scans else (),
        }

    _add_pairs(release, template.num_vertices, parse, heard)
    return release


def _emote(directory: Path) -> Release:
    """EMOTE's reconstructions; an actor's neutral face has the mean shape of the actor's first readable take."""
    root = _processed(directory)
    assert root is not None
    flame = find_flame(directory)
    template = find_template(directory, flame.faces, len(flame.template), "FLAME")
    release = Release(
        "mead", directory, [], {}, template, (25.0,), "m", flame=flame,
        notes={"layout": "EMOTE", "flame": flame.source},
    )  # fmt: skip
    methods = sorted(p for p in (root / "reconstructions").iterdir() if p.is_dir())
    for path in sorted(methods[0].glob(f"*/front/*/*/*/{_EMOTE_FILE}")) if methods else []:
        speaker, _, label, level, number = path.relative_to(methods[0]).parts[:5]
        name = f"{speaker}_{label}_{level}_{number}"
        wav = root / "audio" / speaker / "front" / label / level / f"{number}.wav"
        try:
            emotion = emotion_of(label, "mead", str(path))
            intensity = intensity_of(level.removeprefix("level_"), str(path))
            if speaker not in release.neutral:
                (shape,) = read_hdf5(path, ("shape",))
                release.neutral[speaker] = flame.neutral(shape.mean(axis=0))
        except DatasetError as error:
            release.excluded[name] = str(error)
            continue
        release.takes.append(
            Take(
                name, speaker, partial(parameters, path), partial(read_sound, wav), (path, wav),
                emotion=emotion, intensity=intensity,
            )
        )  # fmt: skip
    release.notes["method"] = methods[0].name if methods else ""
    return release


def _add_pairs(
    release: Release,
    num_points: int,
    parse: Callable[[str], dict[str, Any]],
    with_sound: bool = True,
) -> None:
    """A take for each ``.npy`` of the motion folder, with the sound of its name."""
    motion = _motion_folder(release.directory)
    if motion is None:
        raise LayoutError(
            f"{release.directory} has none of the folders {', '.join(_MOTION_FOLDERS)}"
        )
    folder = release.directory / "wav"
    listed = sorted(folder.iterdir()) if folder.is_dir() else []
    sounds = {p.stem: p for p in listed if p.suffix.lower() in _SOUND_SUFFIXES}
    for path in sorted(motion.iterdir()):
        if path.suffix.lower() != ".npy":
            continue
        sound = sounds.get(path.stem, folder / f"{path.stem}.wav")
        try:
            parsed = parse(path.stem)
        except DatasetError as error:
            release.excluded[path.stem] = str(error)
            continue
        release.takes.append(
            Take(
                id=path.stem,
                motion=partial(positions, path, num_points),
                sound=partial(read_sound, sound) if with_sound else None,
                paths=(path, sound),
                **parsed,
            )
        )


def _motion_folder(directory: Path) -> Path | None:
    return next((directory / n for n in _MOTION_FOLDERS if (directory / n).is_dir()), None)


def _processed(directory: Path) -> Path | None:
    """The root of EMOTE's processed MEAD."""
    roots = (directory, directory / "processed")
    return next((root for root in roots if (root / "reconstructions").is_dir()), None)
