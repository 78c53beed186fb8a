"""``freetalk serve``."""

from __future__ import annotations

import argparse
import logging
import secrets
import socket
import webbrowser
from pathlib import Path

from freetalk._pretrained import find_weights
from freetalk.cli.animate import built_in_face
from freetalk.cli.outputs import check_readable
from freetalk.cli.view import has_display

_LOCAL = ("127.0.0.1", "localhost", "::1")


def run(arguments: argparse.Namespace) -> None:
    """Shows the page and does what it asks for until Ctrl-C."""
    weights = find_weights(arguments.pretrained)
    mesh_file = sound_file = None
    if arguments.mesh is not None:
        mesh_file = check_readable(arguments.mesh, "a mesh (OBJ, PLY, OFF, STL or glTF)")
    if arguments.audio is not None:
        sound_file = check_readable(arguments.audio, "a recording of speech")
    try:
        import uvicorn

        from freetalk.serve import Limits, Studio, make_app
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"'{error.name}' is missing: pip install 'freetalk[serve]'"
        ) from None
    import freetalk

    mesh = freetalk.load_mesh(mesh_file) if mesh_file is not None else built_in_face()
    talker = freetalk.Talker.from_pretrained(weights)
    studio = Studio(talker, mesh, Limits(upload_bytes=arguments.max_upload_mb << 20))
    if sound_file is not None:
        studio.keep_sound(Path(sound_file).name, freetalk.load_audio(sound_file))
    token = secrets.token_urlsafe(16)
    with _listen(arguments.host, arguments.port or 0) as listening:
        host = f"[{arguments.host}]" if ":" in arguments.host else arguments.host
        address = f"http://{host}:{listening.getsockname()[1]}/{token}/"
        print(f"open {address} (Ctrl-C ends it)", flush=True)
        if arguments.host not in _LOCAL:
            print(
                "note: others on this network can reach it, and whoever has the address may use it; browsers give "
                "a microphone to https and this machine alone",
                flush=True,
            )
        if has_display() and not arguments.no_browser:
            webbrowser.open(address)
        logging.getLogger("uvicorn.error").addFilter(_of_ours)
        config = uvicorn.Config(
            make_app(studio, token),
            log_level="warning",
            access_log=False,  # the address is a secret
            ws_max_size=1 << 17,
            limit_concurrency=64,
            timeout_graceful_shutdown=3,
        )
        uvicorn.Server(config).run(sockets=[listening])
    print("closed")


def _of_ours(record: logging.LogRecord) -> bool:
    """Not what strangers send that is no HTTP or no text: it is refused, and nothing for this terminal."""
    return not record.getMessage().startswith(("Invalid HTTP request", "Invalid UTF-8 sequence"))


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
    except OSError as error:
        listening.close()
        raise OSError(f"cannot listen on {host}, port {port}: {error.strerror}") from None
    return listening
