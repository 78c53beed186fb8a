"""The server: Starlette's routes over a :class:`Studio`, all below a secret part of the address."""

from __future__ import annotations

import asyncio
import hmac
import json
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import anyio
import numpy as np
import torch
from anyio.to_thread import run_sync
from numpy.typing import NDArray
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from freetalk.animation import Parts
from freetalk.corpus.assets import load_face_model
from freetalk.faces import MARKS
from freetalk.page import render_studio
from freetalk.page.take import pack_rig
from freetalk.page.viewing import PAGE_HEADERS
from freetalk.rig import FaceRig
from freetalk.serve.jobs import give_memory_back
from freetalk.serve.studio import FORMATS, Studio, performance_options
from freetalk.serve.uploads import MESH_SUFFIXES, Refused
from freetalk.talker import Face, LiveFrame
from freetalk.viz.sequence import Sequence

RATE_HZ = 16000
#: Longest message with samples: one second.
MOST_BYTES = 2 * RATE_HZ


def whole_mesh_targets(face: Face, rig: FaceRig) -> NDArray[np.float32]:
    """(W, V, 3) metres, canonical frame: the rig's targets with teeth, tongue and eyes that go with the skin."""
    pose = face.report.alignment.to_canonical
    model = load_face_model()
    rest = model.neutral[model.landmarks68].astype(np.float64)
    parts = Parts(pose.apply(np.asarray(face.mesh.vertices)), face.mesh.faces, rest)
    # Landmarks of a target: those of the skin's vertices nearest to them.
    skin = np.asarray(parts.face_vertices)
    nearest = [int(np.square(skin - mark).sum(axis=1).argmin()) for mark in rest]
    targets = rig.targets
    return parts.move(targets, targets[:, nearest].contiguous()).numpy()


def rig_take(face: Face, rig: FaceRig, name: str) -> bytes:
    """The surface of a live stream as the page reads it."""
    still = Sequence.at_rest(face.mesh, face.report.alignment.to_canonical, located=True)
    return pack_rig(still, whole_mesh_targets(face, rig), rig.names, name)


def samples_of(message: bytes) -> NDArray[np.float32]:
    """Samples of a message.

    Raises:
        ValueError: half a sample, or more than a second.
    """
    if len(message) % 2 or len(message) > MOST_BYTES:
        raise ValueError(f"send whole 16-bit samples, at most {RATE_HZ} at a time")
    return np.frombuffer(message, "<i2").astype(np.float32) / np.float32(32768)


def frame_message(frames: list[LiveFrame]) -> bytes:
    """Frames as the page reads them."""
    parts = []
    for frame in frames:
        weights: torch.Tensor | None = frame.weights
        assert weights is not None
        parts.append(struct.pack("<If", frame.index, frame.time_s))
        parts.append(np.rint(weights.numpy().clip(0, 1) * 65535).astype("<u2").tobytes())
    return b"".join(parts)


def stream_facts(live: Any, rig: FaceRig) -> dict[str, Any]:
    """What the page needs to know of a stream."""
    return {
        "fps": live.fps,
        "latency_s": live.latency_s,
        "weights": len(rig.names),
        "rate_hz": RATE_HZ,
    }


_UPLOAD_S = 120.0
_JSON_BYTES = 16384
#: Longest that a page waits between two blocks of samples before its stream is closed.
_SILENT_S = 30.0
#: Messages of a stream that may wait while frames are made.
_INBOX = 64

Handler = Callable[[Request], Awaitable[Response]]


def make_app(studio: Studio, token: str) -> Starlette:
    """The application.

    Args:
        studio: what it works with; closed with the application.
        token: first part of every address; whoever does not know it finds nothing.
    """
    server = _Server(studio, token)
    routes = [
        Route(f"/{{token}}/{path}", server.guarded(handler), methods=[method])
        for path, method, handler in (
            ("", "GET", server.page),
            ("state", "GET", server.state),
            ("meshes", "POST", server.add_mesh),
            ("meshes/{id}", "GET", server.still),
            ("meshes/{id}", "DELETE", server.removes(studio.remove_mesh)),
            ("meshes/{id}/marks", "POST", server.mark_face),
            ("sounds", "POST", server.add_sound),
            ("sounds/{id}", "DELETE", server.removes(studio.sounds.remove)),
            ("takes", "POST", server.perform),
            ("takes/{id}", "GET", server.take),
            ("takes/{id}", "DELETE", server.removes(studio.remove_take)),
            ("takes/{id}/exports", "POST", server.export),
            ("jobs/{id}", "DELETE", server.stop_job),
            ("exports/{id}", "GET", server.exported),
        )
    ]

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        yield
        await run_sync(studio.close)

    return Starlette(
        routes=[*routes, WebSocketRoute("/{token}/live", server.live)], lifespan=lifespan
    )


class _Server:
    def __init__(self, studio: Studio, token: str) -> None:
        self._studio = studio
        self._token = token
        self._streams = 0
        self._page = render_studio("freetalk")

    def _knows(self, token: str) -> bool:
        return hmac.compare_digest(token.encode("utf-8", "replace"), self._token.encode())

    def guarded(self, handler: Handler) -> Handler:
        """Lets those in who know the token, and turns refusals into answers."""

        async def answer(request: Request) -> Response:
            if not self._knows(request.path_params["token"]):
                return Response("not found", 404, PAGE_HEADERS | {"Content-Type": "text/plain"})
            try:
                response = await handler(request)
            except Refused as refusal:
                response = JSONResponse({"error": str(refusal)}, refusal.status)
            except ClientDisconnect:
                response = Response(status_code=400)
            for name, value in PAGE_HEADERS.items():
                if name != "Content-Type":
                    response.headers[name] = value
            return response

        return answer

    # ---- the page and what it asks ----

    async def page(self, _: Request) -> Response:
        return HTMLResponse(self._page)

    async def state(self, request: Request) -> Response:
        self._studio.jobs.see(_client(request))
        talker = self._studio.talker
        facts = {
            "emotions": list(talker.emotions),
            "max_intensity": talker.max_intensity,
            "formats": FORMATS,
            "marks": [name for _, name in MARKS],
            "mesh_suffixes": MESH_SUFFIXES,
            "limits": {
                "upload_bytes": self._studio.limits.upload_bytes,
                "sound_s": self._studio.limits.sound_s,
            },
        }
        return JSONResponse(facts | self._studio.state())

    async def add_mesh(self, request: Request) -> Response:
        content = await self._body(request, self._studio.limits.upload_bytes)
        item = await run_sync(self._studio.add_mesh, request.query_params.get("name", ""), content)
        return JSONResponse(item.summary(), 201)

    async def still(self, request: Request) -> Response:
        take = await run_sync(self._studio.still, request.path_params["id"])
        return Response(take, media_type="application/octet-stream")

    async def mark_face(self, request: Request) -> Response:
        marks = _object(await self._body(request, _JSON_BYTES)).get("marks")
        found = await run_sync(self._studio.mark_face, request.path_params["id"], marks)
        return JSONResponse({"landmarks": found.reshape(-1).tolist()})

    async def add_sound(self, request: Request) -> Response:
        content = await self._body(request, self._studio.limits.upload_bytes)
        item = await run_sync(self._studio.add_sound, request.query_params.get("name", ""), content)
        return JSONResponse(item.summary(), 201)

    async def perform(self, request: Request) -> Response:
        wish = _object(await self._body(request, _JSON_BYTES))
        job = await run_sync(self._studio.perform, wish, _client(request))
        return JSONResponse(job.summary(), 202)

    async def take(self, request: Request) -> Response:
        take = self._studio.takes.get(request.path_params["id"])
        return Response(take.content, media_type="application/octet-stream")

    def removes(self, remove: Callable[[str], object]) -> Handler:
        """A handler that forgets what the address names."""

        async def handler(request: Request) -> Response:
            await run_sync(remove, request.path_params["id"])
            return Response(status_code=204)

        return handler

    async def export(self, request: Request) -> Response:
        wish = _object(await self._body(request, _JSON_BYTES))
        job = await run_sync(
            self._studio.export,
            request.path_params["id"],
            str(wish.get("format", "")),
            _client(request),
        )
        return JSONResponse(job.summary(), 202)

    async def stop_job(self, request: Request) -> Response:
        self._studio.jobs.stop(request.path_params["id"])
        return Response(status_code=204)

    async def exported(self, request: Request) -> Response:
        path = self._studio.exported(request.path_params["id"])
        return FileResponse(path, filename=path.name, content_disposition_type="attachment")

    async def _body(self, request: Request, most: int) -> bytes:
        """The body, refused as soon as it is larger than it may be."""
        declared = request.headers.get("content-length", "0")
        if not declared.isdecimal() or int(declared) > most:
            raise Refused(f"this is too large: at most {_size(most)} are taken", 413)
        parts, length = [], 0
        with anyio.move_on_after(_UPLOAD_S) as patience:
            async for part in request.stream():
                length += len(part)
                if length > most:
                    raise Refused(f"this is too large: at most {_size(most)} are taken", 413)
                parts.append(part)
        if patience.cancelled_caught:
            raise Refused("this took too long to send", 408)
        return b"".join(parts)

    # ---- live ----

    async def live(self, socket: WebSocket) -> None:
        """A stream, see :mod:`freetalk.serve.app`."""
        if not self._knows(socket.path_params["token"]):
            await _close(socket, 4404, "")
            return
        await socket.accept()
        if self._streams >= self._studio.limits.live:
            await _close(socket, 1013, "as many streams as there may be are running")
            return
        self._streams += 1
        try:
            await self._stream(socket)
        except (Refused, ValueError, RuntimeError) as error:
            await _close(socket, 1008, " ".join(str(error).split()))
        except (WebSocketDisconnect, TimeoutError):
            await _close(socket, 1001, "nothing was heard for long")
        finally:
            self._streams -= 1
            await run_sync(give_memory_back)

    async def _stream(self, socket: WebSocket) -> None:
        options = performance_options(_object((await socket.receive_text()).encode()))
        options.pop("mouth_temperature", None)
        mesh = self._studio.meshes.get(socket.query_params.get("mesh"))
        face = await run_sync(self._studio.face, mesh.id)
        rig = await run_sync(face.rig)
        stream = face.live(**options)
        await socket.send_text(json.dumps(stream_facts(stream, rig)))
        await socket.send_bytes(await run_sync(rig_take, face, rig, mesh.name))
        inbox: asyncio.Queue[Any] = asyncio.Queue(_INBOX)
        listening = asyncio.create_task(_listen(socket, inbox))
        try:
            while (messages := await _arrived(inbox)) is not None:
                blocks = [samples_of(part) for part in messages if isinstance(part, bytes)]
                if blocks:
                    frames = await run_sync(stream.push, np.concatenate(blocks))
                    if frames:
                        await socket.send_bytes(frame_message(frames))
                for text in (part for part in messages if isinstance(part, str)):
                    chosen = performance_options(_object(text.encode()))
                    stream.set_emotion(chosen["emotion"], chosen.get("intensity"))
        finally:
            listening.cancel()


async def _listen(socket: WebSocket, inbox: asyncio.Queue[Any]) -> None:
    """Puts messages into the inbox; None when the other side is gone. A full inbox keeps the sender waiting."""
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            await inbox.put(None)
            return
        content = message.get("bytes")
        await inbox.put(message.get("text", "") if content is None else content)


async def _arrived(inbox: asyncio.Queue[Any]) -> list[bytes | str] | None:
    """What arrived since, at least one message; None when no more will come.

    Raises:
        TimeoutError: nothing came for long.
    """
    with anyio.fail_after(_SILENT_S):
        messages = [await inbox.get()]
    while not inbox.empty():
        messages.append(inbox.get_nowait())
    return None if None in messages else messages


def _client(request: Request) -> str:
    return request.query_params.get("client", "")[:32]


def _object(content: bytes) -> dict[str, Any]:
    try:
        value = json.loads(content)
    except (ValueError, RecursionError):
        raise Refused("this is no JSON") from None
    if not isinstance(value, dict):
        raise Refused("this is no JSON object")
    return value


def _size(count: int) -> str:
    return f"{count >> 20} MB" if count >= 1 << 20 else f"{count} bytes"


async def _close(socket: WebSocket, code: int, reason: str) -> None:
    """Closes a socket that the other side may have closed already."""
    try:
        await socket.close(code, reason[:120])
    except (RuntimeError, WebSocketDisconnect):
        return
