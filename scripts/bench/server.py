#!/usr/bin/env python3
"""Many pages at one ``freetalk serve``: what it answers, and whether its memory stays flat.

    python scripts/bench/server.py [--clients 50] [--minutes 10]

Each client looks at the state, sends recordings, orders takes and stops or leaves them, fetches, exports and removes
takes, tries a wrong token and speaks live. Prints the server's memory as time goes by and how answers were spread; fails
on an error of the server (5xx but 503, which is "too many at once") or where memory grows by more than a tenth after the
first third.
"""

from __future__ import annotations

import argparse
import collections
import json
import random
import sys
import tempfile
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "fuzz"))
from server import Server, frame, speech_wav, take_is_made


class Client:
    """A page that does what people do, faster."""

    def __init__(self, server: Server, number: int) -> None:
        self.server, self.name, self.draw = server, f"client{number}", random.Random(number)
        self.answers: collections.Counter[str] = collections.Counter()

    def run(self, until: float) -> None:
        """Goes on until a moment of the monotonic clock."""
        acts = (
            self.look,
            self.look,
            self.look,
            self.send,
            self.order,
            self.use,
            self.guess,
            self.speak,
        )
        while time.monotonic() < until:
            act = self.draw.choice(acts)
            try:
                outcome = act()
            except TimeoutError:
                outcome = "late"
            except OSError:
                outcome = "closed"
            self.answers[f"{act.__name__} {outcome}"] += 1
            time.sleep(self.draw.random())

    def ask(self, method: str, path: str, body: bytes | None = None) -> tuple[int, bytes]:
        return self.server.ask(method, f"{path}?client={self.name}", body)

    def state(self) -> dict:
        status, answer = self.ask("GET", "state")
        return json.loads(answer) if status == 200 else {"meshes": [], "sounds": [], "takes": []}

    def look(self) -> str:
        """What every page does each second."""
        return str(self.ask("GET", "state")[0])

    def send(self) -> str:
        """A recording."""
        return str(self.server.ask("POST", "sounds?name=a.wav", speech_wav(0.3))[0])

    def order(self) -> str:
        """A take, that is stopped, waited for, or left behind with the page."""
        state = self.state()
        if not state["sounds"]:
            return "busy"
        wish = {"mesh": state["meshes"][0]["id"], "sound": self.draw.choice(state["sounds"])["id"]}
        status, answer = self.ask("POST", "takes", json.dumps(wish).encode())
        if status == 202 and self.draw.random() < 0.3:
            self.ask("DELETE", f"jobs/{json.loads(answer)['id']}")
        elif self.draw.random() < 0.3:
            self.name += "'"  # another page; the old one is not seen again
        return str(status)

    def use(self) -> str:
        """Plays, exports or removes a take."""
        takes = self.state()["takes"]
        if not takes:
            return "none"
        path, kind = f"takes/{self.draw.choice(takes)['id']}", self.draw.randrange(3)
        if kind == 0:
            return str(self.ask("GET", path)[0])
        if kind == 1:
            wish = {"format": self.draw.choice(("glb", "npz", "html", "csv", "pc2"))}
            return str(self.ask("POST", f"{path}/exports", json.dumps(wish).encode())[0])
        return str(self.ask("DELETE", path)[0])

    def guess(self) -> str:
        """A wrong token, which must find nothing."""
        wrong = self.server.address.path[1:-2] + "."  # the last letter is another
        with self.server.open_socket() as line:
            request = f"GET /{wrong}/state HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n"
            line.sendall(request.encode())
            status = line.recv(64).split(b" ")[1].decode()
        return "let in!" if status == "200" else status

    def speak(self) -> str:
        """A second of live speech."""
        mesh = self.state()["meshes"]
        if not mesh:
            return "busy"
        hello = f"GET {self.server.address.path}live?mesh={mesh[0]['id']} HTTP/1.1\r\nHost: a\r\n"
        hello += "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        hello += "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        sound = speech_wav(1.0)[44:]
        with self.server.open_socket() as line:
            line.sendall(hello.encode())
            if b" 101 " not in line.recv(4096):
                return "refused"
            line.sendall(frame(1, b'{"emotion": "happy"}'))
            for start in range(0, len(sound), 3200):
                line.sendall(frame(2, sound[start : start + 3200]))
            line.sendall(frame(8, b""))
            received = 0
            while part := line.recv(1 << 16):
                received += len(part)
        return "frames" if received > 10000 else "turned away"


def main() -> None:
    """Prints memory by time, then the answers."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--clients", type=int, default=50, help="at a time")
    parser.add_argument("--minutes", type=float, default=10.0, help="they stay")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, Server(Path(folder)) as server:
        server.order("POST", "sounds?name=hum.wav", speech_wav(0.4))
        take_is_made(server)
        start = time.monotonic()
        end = start + 60 * arguments.minutes
        clients = [Client(server, number) for number in range(arguments.clients)]
        threads = [threading.Thread(target=client.run, args=(end,)) for client in clients]
        for thread in threads:
            thread.start()
        memory = []
        while any(thread.is_alive() for thread in threads):
            memory.append(server.resident_mb())
            if len(memory) % 6 == 1:
                print(f"{time.monotonic() - start:5.0f} s  {memory[-1]:.0f} MB", flush=True)
            time.sleep(5)
        take_is_made(server)
        complaints = server.log.read_text()
    answers = sum((client.answers for client in clients), collections.Counter())
    for name, number in sorted(answers.items()):
        print(f"{number:6d}  {name}")
    third = len(memory) // 3
    early, late = max(memory[third : 2 * third] or memory), max(memory[2 * third :])
    print(
        f"memory: first {memory[0]:.0f} MB, most of the second third {early:.0f}, of the last {late:.0f}"
    )
    wrong = [name for name in answers if (" 5" in name and "503" not in name) or "let in" in name]
    if wrong or "Traceback" in complaints or late > 1.1 * early:
        raise SystemExit(f"FINDING: {wrong} {complaints[-2000:]}")


if __name__ == "__main__":
    main()
