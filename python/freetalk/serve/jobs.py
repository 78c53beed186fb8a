"""One queue, one worker: jobs with progress that can be given up."""

from __future__ import annotations

import ctypes
import queue
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from freetalk.serve.uploads import Refused

_REMEMBERED = 50

Report = Callable[[float, float], None]
"""Is given (done, total); raises where the job was given up."""


def give_memory_back() -> None:
    """Returns what was freed to the system: glibc keeps it otherwise, for each thread that worked."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


class GivenUp(Exception):
    """The job's page was closed, or its person stopped it."""


@dataclass
class Job:
    """Something that takes a while.

    Attributes:
        title: for people.
        client: whose page asked for it.
        state: "waiting", "running", "done", "failed" or "stopped".
        share: of the work that is done.
        message: why it failed.
        result: what it made.
    """

    title: str
    client: str
    work: Callable[[Report], Any]
    id: str = field(default_factory=lambda: secrets.token_hex(8))
    state: str = "waiting"
    share: float = 0.0
    message: str = ""
    result: Any = None
    stopped: threading.Event = field(default_factory=threading.Event)

    @property
    def is_open(self) -> bool:
        """Whether it still takes or will take time."""
        return self.state in ("waiting", "running")

    def summary(self) -> dict[str, Any]:
        """For the page."""
        shown = {"id": self.id, "title": self.title, "state": self.state, "share": self.share}
        return shown | {"message": self.message, "client": self.client, "result": self.result}


class JobQueue:
    """Does jobs one after the other on a thread of its own.

    Args:
        waiting: most jobs that may wait.
        patience_s: a job whose client was not seen for so long is given up.
    """

    def __init__(self, waiting: int, patience_s: float) -> None:
        self._waiting = waiting
        self._patience_s = patience_s
        self._queue: queue.Queue[Job | None] = queue.Queue()
        self._lock = threading.Lock()
        self._jobs: dict[str, Job] = {}
        self._seen: dict[str, float] = {}
        self._worker = threading.Thread(target=self._run, name="freetalk-jobs", daemon=True)
        self._worker.start()

    def submit(self, job: Job) -> Job:
        """Puts a job at the end.

        Raises:
            Refused: too many are waiting.
        """
        with self._lock:
            if sum(other.is_open for other in self._jobs.values()) > self._waiting:
                raise Refused("too much is waiting already: try again in a moment", 429)
            self._jobs[job.id] = job
            closed = [old.id for old in self._jobs.values() if not old.is_open]
            for old in closed[: max(0, len(self._jobs) - _REMEMBERED)]:
                del self._jobs[old]
        self.see(job.client)
        self._queue.put(job)
        return job

    def see(self, client: str) -> None:
        """Notes that a page is there."""
        with self._lock:
            self._seen[client] = time.monotonic()
            for old in [name for name, at in self._seen.items() if time.monotonic() - at > 3600]:
                del self._seen[old]

    def get(self, job_id: str) -> Job:
        """A job by its id.

        Raises:
            Refused: there is none.
        """
        with self._lock:
            if job_id not in self._jobs:
                raise Refused("there is no such job", 404)
            return self._jobs[job_id]

    def stop(self, job_id: str) -> None:
        """Gives a job up: at once where it waits, at its next step where it runs."""
        job = self.get(job_id)
        job.stopped.set()
        if job.state == "waiting":
            job.state = "stopped"

    def list(self) -> list[Job]:
        """The jobs that are remembered, oldest first."""
        with self._lock:
            return list(self._jobs.values())

    def close(self) -> None:
        """Gives everything up and ends the thread."""
        for job in self.list():
            job.stopped.set()
        self._queue.put(None)
        self._worker.join(timeout=10)

    def _is_gone(self, job: Job) -> bool:
        with self._lock:
            return time.monotonic() - self._seen.get(job.client, 0.0) > self._patience_s

    def _run(self) -> None:
        while (job := self._queue.get()) is not None:
            if job.stopped.is_set() or self._is_gone(job):
                job.state = "stopped"
                continue
            job.state = "running"
            self._do(job)
            give_memory_back()

    def _do(self, job: Job) -> None:
        def report(done: float, total: float) -> None:
            if job.stopped.is_set() or self._is_gone(job):
                raise GivenUp
            job.share = done / total

        try:
            report(0, 1)
            job.result = job.work(report)
            job.share, job.state = 1.0, "done"
        except GivenUp:
            job.state = "stopped"
        except MemoryError:
            job.state, job.message = "failed", "not enough memory for this"
        except Exception as error:  # whatever it was, the next job is none the worse
            job.message = " ".join(str(error).split("\n")[0].split()) or type(error).__name__
            job.state = "stopped" if job.stopped.is_set() else "failed"
