"""What the server works with: meshes, recordings and takes, and the jobs that make more of them."""

from __future__ import annotations

import secrets
import shutil
import tempfile
import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freetalk.animation import Animation
from freetalk.audio import Audio
from freetalk.faces import marked_landmarks
from freetalk.mesh import Mesh
from freetalk.page import arkit_curves, find_landmarks, pack_take
from freetalk.page.save import listed_facts
from freetalk.serve.jobs import Job, JobQueue, Report
from freetalk.serve.uploads import Limits, Refused, plain_name, read_mesh, read_sound
from freetalk.talker import Face, Talker
from freetalk.viz.sequence import Sequence, as_sequence

#: Endings of downloads; of those that are several files, one archive.
FORMATS = ("glb", "usda", "pc2", "npz", "html", "mp4", "csv", "json", "obj", "ply")
_PREPARED = 3
_LONGEST_EMOTION = 2000


@dataclass
class Item:
    """A mesh, a recording or a take that is kept, and its folder if it has one."""

    name: str
    content: Any
    facts: dict[str, Any] = field(default_factory=dict)
    folder: Path | None = None
    id: str = field(default_factory=lambda: secrets.token_hex(8))

    def summary(self) -> dict[str, Any]:
        """For the page."""
        return {"id": self.id, "name": self.name} | self.facts


class Shelf:
    """So many items at most; safe between threads."""

    def __init__(self, what: str, most: int) -> None:
        self._what, self._most = what, most
        self._items: OrderedDict[str, Item] = OrderedDict()
        self._lock = threading.Lock()

    def add(self, item: Item) -> Item:
        """Raises ``Refused`` where the shelf is full."""
        with self._lock:
            if len(self._items) >= self._most:
                raise Refused(f"{self._most} {self._what} are kept at most: remove one first", 409)
            self._items[item.id] = item
        return item

    def get(self, item_id: Any) -> Item:
        """Raises ``Refused`` where there is no such item."""
        with self._lock:
            if not isinstance(item_id, str) or item_id not in self._items:
                raise Refused(f"there is no such thing among the {self._what}", 404)
            return self._items[item_id]

    def remove(self, item_id: str) -> Item:
        """Raises ``Refused`` where there is no such item."""
        item = self.get(item_id)
        with self._lock:
            self._items.pop(item_id, None)
        return item

    def summaries(self) -> list[dict[str, Any]]:
        """For the page, oldest first."""
        with self._lock:
            return [item.summary() for item in self._items.values()]


class Studio:
    """Everything that one server keeps; its folder is removed when it closes.

    Args:
        talker: the weights.
        mesh: the face to begin with.
        limits: how much it takes on.
    """

    def __init__(self, talker: Talker, mesh: Mesh, limits: Limits | None = None) -> None:
        self.talker = talker
        self.limits = limits or Limits()
        self.meshes = Shelf("meshes", self.limits.kept)
        self.sounds = Shelf("recordings", self.limits.kept)
        self.takes = Shelf("takes", self.limits.kept)
        self.jobs = JobQueue(self.limits.waiting, self.limits.patience_s)
        self._folder = Path(tempfile.mkdtemp(prefix="freetalk_serve_"))
        self._faces: OrderedDict[str, Face] = OrderedDict()
        self._landmarks: dict[str, NDArray[np.float64]] = {}
        self._faces_lock = threading.Lock()
        self._exports: list[Path] = []
        self._count = 0
        self._keep_mesh(mesh, mesh.name or "face")

    def close(self) -> None:
        """Stops the jobs and removes every file."""
        self.jobs.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    # ---- what is kept ----

    def add_mesh(self, name: str, content: bytes) -> Item:
        """Raises ``Refused``, see :func:`read_mesh`."""
        folder = Path(tempfile.mkdtemp(dir=self._folder))
        try:
            mesh = read_mesh(name, content, self.limits, folder)
            return self._keep_mesh(mesh, plain_name(name), folder)
        except Refused:
            shutil.rmtree(folder, ignore_errors=True)
            raise

    def _keep_mesh(self, mesh: Mesh, name: str, folder: Path | None = None) -> Item:
        facts = {"vertices": len(mesh.vertices), "marked": False}
        return self.meshes.add(Item(name, mesh, facts, folder))

    def remove_mesh(self, mesh_id: str) -> None:
        """Forgets a mesh and its file.

        Raises:
            Refused: it is the only one, or takes on it are kept.
        """
        item = self.meshes.get(mesh_id)
        if len(self.meshes.summaries()) == 1:
            raise Refused("this is the only face: add another first", 409)
        if any(take["mesh"] == mesh_id for take in self.takes.summaries()):
            raise Refused(f"takes on {item.name} are kept: remove them first", 409)
        self.meshes.remove(mesh_id)
        with self._faces_lock:
            self._faces.pop(mesh_id, None)
            self._landmarks.pop(mesh_id, None)
        if item.folder is not None:
            shutil.rmtree(item.folder, ignore_errors=True)

    def still(self, mesh_id: Any) -> bytes:
        """A mesh at rest as the page shows it, for marking its face."""
        mesh = self.meshes.get(mesh_id)
        return pack_take(self._at_rest(mesh.content), name=mesh.name)

    def mark_face(self, mesh_id: Any, marks: Any) -> NDArray[np.float32]:
        """Takes the places of ``freetalk.faces.MARKS`` for where the face of a mesh is.

        Args:
            mesh_id: of the mesh.
            marks: (M, 3) as the page shows the mesh: of :meth:`still`.

        Returns:
            (68, 3) landmarks, as the page shows the mesh.

        Raises:
            Refused: they are no such points, or do not lie as those of a face do.
        """
        item = self.meshes.get(mesh_id)
        sequence = self._at_rest(item.content)
        to_mesh = np.linalg.inv(sequence.upright_matrix)
        try:
            points = np.asarray(marks, np.float64) @ to_mesh[:3, :3].T + to_mesh[:3, 3]
            landmarks = marked_landmarks(
                np.asarray(sequence.vertices, np.float64), sequence.faces, points
            )
        except (TypeError, ValueError) as error:
            raise Refused(str(error)) from None
        with self._faces_lock:
            self._landmarks[mesh_id] = landmarks
            self._faces.pop(mesh_id, None)
        item.facts |= {"marked": True}
        item.facts.pop("marks", None)
        return sequence.upright(landmarks)

    def _at_rest(self, mesh: Mesh) -> Sequence:
        """A mesh as it lies, upright if its shape tells how."""
        return Sequence.at_rest(mesh, self.talker.align(mesh).to_canonical)

    def add_sound(self, name: str, content: bytes) -> Item:
        """Raises ``Refused``, see :func:`read_sound`."""
        return self.keep_sound(plain_name(name), read_sound(name, content, self.limits))

    def keep_sound(self, name: str, audio: Audio) -> Item:
        """Keeps a recording."""
        return self.sounds.add(Item(name, audio, {"seconds": round(audio.duration_s, 3)}))

    def remove_take(self, take_id: str) -> None:
        """Forgets a take and its file."""
        self.takes.remove(take_id)
        self._file_of(take_id).unlink(missing_ok=True)

    def state(self) -> dict[str, Any]:
        """Everything the page shows, without the takes' content."""
        return {
            "meshes": self.meshes.summaries(),
            "sounds": self.sounds.summaries(),
            "takes": self.takes.summaries(),
            "jobs": [job.summary() for job in self.jobs.list()],
        }

    def face(self, mesh_id: Any, report: Report | None = None) -> Face:
        """A prepared mesh; few are kept. One thread at a time prepares."""
        mesh = self.meshes.get(mesh_id).content
        with self._faces_lock:
            if mesh_id not in self._faces:
                self._faces[mesh_id] = self.talker.prepare(
                    mesh, landmarks=self._landmarks.get(mesh_id), progress=report
                )
                while len(self._faces) > _PREPARED:
                    self._faces.popitem(last=False)
            self._faces.move_to_end(mesh_id)
            return self._faces[mesh_id]

    # ---- jobs ----

    def perform(self, wish: dict[str, Any], client: str) -> Job:
        """Queues a take.

        Args:
            wish: ``mesh`` and ``sound`` (ids), ``emotion`` (a text as of ``freetalk animate``), and optionally
                ``intensity``, ``seed``, ``mouth_temperature``, ``articulation``.
            client: whose page asks.

        Raises:
            Refused: an unknown id, or a value of another kind.
        """
        sound, mesh = self.sounds.get(wish.get("sound")), self.meshes.get(wish.get("mesh"))
        options = performance_options(wish)
        if len(self.takes.summaries()) >= self.limits.kept:
            raise Refused(f"{self.limits.kept} takes are kept at most: remove one first", 409)

        def work(report: Report) -> str:
            face = self.face(mesh.id, lambda done, total: report(0.3 * done, total))
            animation, found = face.animate_with_report(
                sound.content,
                progress=lambda done, total: report(0.3 + 0.6 * done / total, 1),
                **options,
            )
            return self._keep_take(animation, mesh, sound, list(found.notices), report)

        return self.jobs.submit(Job(f"{sound.name} on {mesh.name}", client, work))

    def _keep_take(
        self, animation: Animation, mesh: Item, sound: Item, notices: list[str], report: Report
    ) -> str:
        sequence = as_sequence(animation)
        if "marks" not in mesh.facts:
            mesh.facts["marks"] = None
            marks = find_landmarks(sequence)
            mesh.facts["marks"] = None if marks is None else marks.tolist()
        report(0.93, 1)
        marks = mesh.facts["marks"]
        self._count += 1
        name = f"{self._count} · {animation.metadata['options']['emotion'].split(':')[0].split('=')[-1]}"
        facts = {"Recording": sound.name, "Face": mesh.name} | listed_facts(animation.metadata)
        packed = pack_take(
            animation,
            name=name,
            landmarks=marks,
            curves=None if marks is None else arkit_curves(sequence, marks),
            facts=facts | ({"Notes": "; ".join(notices)} if notices else {}),
        )
        item = self.takes.add(Item(name, packed, {"mesh": mesh.id, "sound": sound.id}))
        animation.save(self._file_of(item.id))
        return item.id

    def export(self, take_id: str, format_name: str, client: str) -> Job:
        """Queues a file for download; its path is the job's result for :meth:`exported`.

        Raises:
            Refused: no such take or format.
        """
        take = self.takes.get(take_id)
        if format_name not in FORMATS:
            raise Refused(f"there is no format '{format_name}': use one of {', '.join(FORMATS)}")

        mesh: Mesh = self.meshes.get(take.facts["mesh"]).content  # knows its file

        def work(report: Report) -> str:
            folder = Path(tempfile.mkdtemp(dir=self._folder))
            animation = Animation.load(self._file_of(take_id)).on(mesh)
            report(0.2, 1)
            path = write_export(animation, folder, format_name, take.name)
            self._exports.append(path)
            while len(self._exports) > self.limits.exports:
                shutil.rmtree(self._exports.pop(0).parent, ignore_errors=True)
            return path.name

        job = Job(f"{take.name} as {format_name.upper()}", client, work)
        return self.jobs.submit(job)

    def exported(self, job_id: str) -> Path:
        """The file that a job of :meth:`export` made.

        Raises:
            Refused: it is not there (any more).
        """
        job = self.jobs.get(job_id)
        for path in self._exports:
            if job.state == "done" and path.name == job.result and path.is_file():
                return path
        raise Refused("this file is not there any more", 404)

    def _file_of(self, take_id: str) -> Path:
        return self._folder / f"{take_id}.npz"


def performance_options(wish: dict[str, Any]) -> dict[str, Any]:
    """Options of ``Face.animate`` from what a page sent.

    Raises:
        Refused: a value of another kind; ranges are the talker's to judge.
    """
    emotion = wish.get("emotion", "neutral")
    if not isinstance(emotion, str) or len(emotion) > _LONGEST_EMOTION:
        raise Refused("emotion must be a text")
    options: dict[str, Any] = {"emotion": emotion}
    for name in ("intensity", "mouth_temperature", "articulation"):
        value = wish.get(name)
        if value is not None:
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise Refused(f"{name} must be a number")
            options[name] = float(value)
    seed = wish.get("seed", 0)
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**53:
        raise Refused("seed must be a whole number from 0 to 2^53 - 1")
    return options | {"seed": seed}


def write_export(animation: Animation, folder: Path, format_name: str, name: str) -> Path:
    """Writes an animation into a folder of its own; several files become one archive."""
    stem = "".join(sign if sign.isalnum() else "_" for sign in name).strip("_")
    stem = f"{'_'.join(part for part in stem.split('_') if part) or 'take'}_{secrets.token_hex(3)}"
    if format_name in ("obj", "ply", "usda"):
        (folder / stem).mkdir()
        animation.save(folder / stem / f"{stem if format_name == 'usda' else '*'}.{format_name}")
        return Path(shutil.make_archive(str(folder / stem), "zip", folder / stem))
    path = folder / f"{stem}.{format_name}"
    animation.save(path)
    return path
