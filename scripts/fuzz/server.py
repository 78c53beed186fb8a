#!/usr/bin/env python3
"""Sends a running ``freetalk serve`` thousands of damaged requests, uploads and stream messages.

    python scripts/fuzz/server.py [--runs 10000] [--seed 0]

The server is a process of its own with a small face. Each case is a request whose bytes were changed, an upload of a
damaged mesh or recording, an order of another kind, or a stream with broken frames. Fails where the server ends, answers
with an error of its own (5xx), keeps a person waiting (10 s), complains in its log, or cannot make a take afterwards.
"""

from __future__ import annotations

import argparse
import collections
import http.client
import json
import os
import random
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import wave
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from mesh_seeds import seeds as mesh_seeds

PATIENCE_S = 10.0
NASTY = (
    b"0",
    b"-1",
    b"4294967295",
    b"1e400",
    b"nan",
    b"",
    b"\x00",
    b"\xff" * 9,
    b"{" * 400,
    b"%2e%2e/",
)
VALUES = (
    None,
    True,
    -1,
    0,
    2**63,
    1e308,
    float("nan"),
    "",
    "x" * 3000,
    [],
    {},
    [[]] * 9,
    "happy;;;",
    "\x00",
    "joy:9",
)


class Server:
    """``freetalk serve`` on a face of some hundred vertices, until the block ends."""

    def __init__(self, folder: Path) -> None:
        import freetalk as ft
        from freetalk.corpus.assets import load_face_model
        from freetalk.corpus.topologies import crop, decimate
        from freetalk.mesh import save_mesh

        model = load_face_model()
        small = decimate(model, crop(model, "face"), 900)
        vertices = small.carry @ model.neutral.astype(np.float64)
        save_mesh(folder / "face.obj", ft.Mesh(vertices, small.faces.tolist(), name="face"))
        self.folder = folder
        self.log = folder / "server.log"

    def __enter__(self) -> Server:
        command = [sys.executable, "-m", "freetalk.cli", "serve", "--no-browser"]
        command += ["--mesh", str(self.folder / "face.obj")]
        environment = os.environ | {"TMPDIR": str(self.folder), "OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=self.log.open("w"), text=True, env=environment
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found = re.search(r"open (http://\S+)", line)
        if found is None:
            raise SystemExit(f"the server does not start: {line}{self.log.read_text()}")
        self.address = urlsplit(found[1])
        for _ in range(100):
            try:
                self.ask("GET", "state")
                break
            except OSError:
                time.sleep(0.1)
        return self

    def __exit__(self, *_: object) -> None:
        self.process.send_signal(signal.SIGINT)
        self.process.wait(timeout=30)

    def ask(self, method: str, path: str, body: bytes | None = None) -> tuple[int, bytes]:
        """A proper request: status and answer."""
        connection = http.client.HTTPConnection(
            str(self.address.hostname), self.address.port, timeout=PATIENCE_S
        )
        try:
            connection.request(method, f"{self.address.path}{path}", body)
            answer = connection.getresponse()
            return answer.status, answer.read()
        finally:
            connection.close()

    def order(self, method: str, path: str, wish: Any = None) -> Any:
        """A proper request that must be granted: the JSON of its answer."""
        body = wish if isinstance(wish, bytes) or wish is None else json.dumps(wish).encode()
        status, answer = self.ask(method, path, body)
        if status >= 300:
            raise SystemExit(f"FINDING: {method} {path}: {status} {answer[:200]!r}")
        return json.loads(answer) if answer else None

    def finished(self, job_id: str, client: str = "fuzz") -> dict[str, Any]:
        """A job when it is over."""
        while True:
            jobs = self.order("GET", f"state?client={client}")["jobs"]
            job: dict[str, Any] = next(job for job in jobs if job["id"] == job_id)
            if job["state"] not in ("waiting", "running"):
                return job
            time.sleep(0.05)

    def open_socket(self) -> socket.socket:
        return socket.create_connection(
            (self.address.hostname, self.address.port), timeout=PATIENCE_S
        )

    def resident_mb(self) -> float:
        """Memory of the server."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.search(r"VmRSS:\s+(\d+)", status)[1]) / 1024  # type: ignore[index]


def speech_wav(seconds: float) -> bytes:
    """A hum as a WAV file."""
    with tempfile.SpooledTemporaryFile() as file:
        with wave.open(file, "wb") as out:  # type: ignore[arg-type]
            out.setnchannels(1)
            out.setsampwidth(2)
            out.setframerate(16000)
            time_s = np.arange(round(16000 * seconds)) / 16000
            samples = 9000 * np.sin(900 * time_s) * (0.6 + 0.4 * np.sin(20 * time_s))
            out.writeframes(samples.astype("<i2").tobytes())
        file.seek(0)
        return file.read()


def damaged(content: bytes, draw: random.Random) -> bytes:
    """Content with a few changes."""
    data = bytearray(content)
    for _ in range(draw.choice((1, 1, 2, 4, 12))):
        at = draw.randrange(len(data) + 1)
        kind = draw.randrange(6)
        if kind == 0 and at < len(data):
            data[at] = draw.randrange(256)
        elif kind == 1:
            del data[at : at + draw.randrange(1, 64)]
        elif kind == 2:
            data[at:at] = draw.choice(NASTY)
        elif kind == 3:
            data[at : at + 4] = struct.pack("<I", draw.choice((0, 1, 0x7FFFFFFF, 0xFFFFFFFF)))
        elif kind == 4:
            del data[at:]
        else:
            start = draw.randrange(len(data) + 1)
            data[at:at] = data[start : start + 64]
    return bytes(data)


class Attacker:
    """One thread's cases; ``statuses`` counts what came back."""

    def __init__(self, server: Server, seed: int) -> None:
        self.server = server
        self.draw = random.Random(seed)
        self.statuses: collections.Counter[str] = collections.Counter()
        self.findings: list[str] = []
        state = server.order("GET", "state?client=fuzz")
        self.mesh = state["meshes"][0]["id"]
        self.sound = state["sounds"][0]["id"]
        self.files = mesh_seeds() | {"a.wav": speech_wav(0.05)}

    def run(self, count: int) -> None:
        """Does so many cases."""
        kinds = (self.request, self.upload, self.upload, self.wish, self.mark, self.stream)
        for _ in range(count):
            kind = self.draw.choice(kinds)
            try:
                outcome = kind()
            except TimeoutError:
                self.findings.append(f"{kind.__name__}: no answer in {PATIENCE_S:.0f} s")
                continue
            except OSError:  # it hung up, which is an answer
                outcome = "closed"
            self.statuses[f"{kind.__name__} {outcome}"] += 1
            if outcome.startswith("5"):
                self.findings.append(f"{kind.__name__}: {outcome}")

    def request(self) -> str:
        """Bytes of a whole request, changed anywhere."""
        path, draw = self.server.address.path, self.draw
        method, where, body = draw.choice(
            (
                ("GET", "", b""),
                ("GET", "state?client=a", b""),
                ("POST", "meshes?name=a.obj", self.files["plain.obj"]),
                ("POST", "sounds?name=a.wav", self.files["a.wav"]),
                ("POST", "takes", json.dumps({"mesh": self.mesh, "sound": self.sound}).encode()),
                ("GET", "takes/abc", b""),
                ("POST", "takes/abc/exports", b'{"format": "glb"}'),
                ("DELETE", "jobs/abc", b""),
                ("DELETE", "meshes/abc", b""),
                ("DELETE", "sounds/abc", b""),
                ("GET", f"meshes/{self.mesh}", b""),
                ("POST", f"meshes/{self.mesh}/marks", b'{"marks": [[0, 0, 0], [1, 0, 0]]}'),
                ("GET", "exports/abc", b""),
                ("GET", "live?mesh=abc", b""),
            )
        )
        head = f"{method} {path}{where} HTTP/1.1\r\nHost: a\r\nContent-Length: {len(body)}\r\n"
        if where.startswith("live"):
            head += "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            head += "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        with self.server.open_socket() as line:
            line.sendall(damaged(head.encode() + b"\r\n" + body, draw))
            line.shutdown(socket.SHUT_WR)
            answer = line.recv(64)
        return answer.split(b" ")[1].decode() if answer.startswith(b"HTTP/1.1 ") else "closed"

    def upload(self) -> str:
        """A damaged file."""
        name = self.draw.choice(list(self.files))
        where = "sounds" if name.endswith("wav") else "meshes"
        content = damaged(self.files[name], self.draw)
        status, answer = self.server.ask("POST", f"{where}?name={name}", content)
        if status >= 400 and not json.loads(answer)["error"]:
            self.findings.append(f"upload: no reason for {name}")
        return str(status)

    def wish(self) -> str:
        """An order for a take with values of another kind."""
        wish: dict[str, Any] = {"mesh": self.mesh, "sound": self.sound, "emotion": "happy"}
        keys = (
            "mesh",
            "sound",
            "emotion",
            "intensity",
            "seed",
            "articulation",
            "mouth_temperature",
        )
        for key in self.draw.sample(keys, self.draw.randrange(1, 4)):
            wish[key] = self.draw.choice(VALUES)
        body = json.dumps(wish).encode()
        if self.draw.random() < 0.3:
            body = damaged(body, self.draw)
        return str(self.server.ask("POST", "takes?client=fuzz", body)[0])

    def mark(self) -> str:
        """Places of a face that lie anywhere, or are no places."""
        marks: Any = [[self.draw.gauss(0, 0.1) for _ in range(3)] for _ in range(8)]
        if self.draw.random() < 0.5:
            marks[self.draw.randrange(8)] = self.draw.choice(VALUES)
        body = json.dumps({"marks": marks}).encode()
        if self.draw.random() < 0.3:
            body = damaged(body, self.draw)
        return str(self.server.ask("POST", f"meshes/{self.mesh}/marks?client=fuzz", body)[0])

    def stream(self) -> str:
        """A stream that begins well and then breaks the rules."""
        draw, path = self.draw, self.server.address.path
        hello = f"GET {path}live?mesh={self.mesh} HTTP/1.1\r\nHost: a\r\nUpgrade: websocket\r\n"
        hello += "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        hello += "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        with self.server.open_socket() as line:
            line.sendall(hello.encode())
            answer = line.recv(4096)
            if b" 101 " not in answer:
                return answer.split(b" ")[1].decode() if b" " in answer else "closed"
            first = b'{"emotion": "happy"}'
            messages = [first if draw.random() < 0.7 else damaged(first, draw)]
            for _ in range(draw.randrange(1, 6)):
                samples = bytes(draw.randrange(256) for _ in range(2 * draw.randrange(400)))
                messages.append(draw.choice((first, samples, samples, samples + b"\x00", b"")))
            for index, message in enumerate(messages):
                opcode = 1 if index == 0 or message[:1] == b"{" else 2
                sent = frame(opcode, message)
                if index and draw.random() < 0.5:
                    sent = damaged(sent, draw)
                line.sendall(sent)
            line.shutdown(socket.SHUT_WR)
            while line.recv(1 << 16):
                pass
        return "ended"


def frame(opcode: int, payload: bytes) -> bytes:
    """A masked frame of a WebSocket."""
    head = bytes([0x80 | opcode])
    if len(payload) < 126:
        head += bytes([0x80 | len(payload)])
    else:
        head += bytes([0x80 | 126]) + struct.pack(">H", len(payload))
    mask = b"\x11\x22\x33\x44"
    return head + mask + bytes(byte ^ mask[i % 4] for i, byte in enumerate(payload))


def take_is_made(server: Server) -> None:
    """What the server is for."""
    state = server.order("GET", "state?client=fuzz")
    for job in state["jobs"]:
        if job["state"] in ("waiting", "running"):
            server.ask("DELETE", f"jobs/{job['id']}")
            server.finished(job["id"])
    for take in state["takes"]:
        server.order("DELETE", f"takes/{take['id']}")
    wish = {"mesh": state["meshes"][0]["id"], "sound": state["sounds"][0]["id"], "emotion": "happy"}
    job = server.finished(server.order("POST", "takes?client=fuzz", wish)["id"])
    if job["state"] != "done":
        raise SystemExit(f"FINDING: a take is not made any more: {job['message']}")


def main() -> None:
    """Attacks, then looks whether the server is well."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--runs", type=int, default=10000, help="cases")
    parser.add_argument("--seed", type=int, default=0, help="of the changes")
    arguments = parser.parse_args()
    threads = 4
    with tempfile.TemporaryDirectory() as folder, Server(Path(folder)) as server:
        server.order("POST", "sounds?name=hum.wav", speech_wav(0.4))
        take_is_made(server)
        before, start = server.resident_mb(), time.monotonic()
        attackers = [Attacker(server, arguments.seed * threads + n) for n in range(threads)]
        at_work = [
            threading.Thread(target=one.run, args=(arguments.runs // threads,)) for one in attackers
        ]
        for thread in at_work:
            thread.start()
        for thread in at_work:
            thread.join()
        findings = [finding for one in attackers for finding in one.findings]
        if server.process.poll() is not None:
            findings.append(f"the server ended with {server.process.returncode}")
        else:
            take_is_made(server)
        took, after = time.monotonic() - start, server.resident_mb()
        complaints = server.log.read_text()
        if "Traceback" in complaints or "ERROR" in complaints:
            findings.append(f"the server's log: {complaints[-3000:]}")
    for name, number in sorted(
        sum((one.statuses for one in attackers), collections.Counter()).items()
    ):
        print(f"{number:6d}  {name}")
    print(f"{arguments.runs} cases in {took:.0f} s, memory {before:.0f} -> {after:.0f} MB")
    for finding in findings[:20]:
        print("FINDING:", finding)
    if findings:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
