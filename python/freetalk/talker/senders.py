"""Weights of a live stream to other programs, as they expect them over UDP.

Live Link Face is what Epic's app of that name sends and Unreal Engine receives (port 11111): all numbers big-endian, a
version (uint8, 6), the sender's id and the subject's name (int32 length, then bytes), the frame of the day (int32), its
fraction (float32), the rate's numerator and denominator (int32 each), the number of values (uint8, 61) and the values
(float32). VMC is what avatars of VRM receive (protocol.vmc.info, port 39539): OSC 1.0 bundles of /VMC/Ext/Blend/Val with
a name and a value each, then /VMC/Ext/Blend/Apply.
"""

from __future__ import annotations

import datetime
import math
import socket
import struct
import uuid
from collections.abc import Mapping
from fractions import Fraction
from typing import Protocol
from urllib.parse import urlsplit

__all__ = ["LIVE_LINK_NAMES", "LiveLinkSender", "Sender", "VmcSender", "open_sender"]

_SIDES = ("Left", "Right")
_EYE = ("eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp", "eyeSquint", "eyeWide")
_MOUTH_PAIRS = ("mouthSmile", "mouthFrown", "mouthDimple", "mouthStretch")
_LIP_PAIRS = ("mouthPress", "mouthLowerDown", "mouthUpperUp")


def _pairs(names: tuple[str, ...]) -> list[str]:
    return [name + side for name in names for side in _SIDES]


#: ARKit's shapes in the order of Live Link Face's packets. Its files differ: there jawRight is before jawLeft.
LIVE_LINK_NAMES: tuple[str, ...] = (
    *(name + side for side in _SIDES for name in _EYE),
    *("jawForward", "jawLeft", "jawRight", "jawOpen"),
    *("mouthClose", "mouthFunnel", "mouthPucker", "mouthLeft", "mouthRight"),
    *_pairs(_MOUTH_PAIRS),
    *("mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper"),
    *_pairs(_LIP_PAIRS),
    *("browDownLeft", "browDownRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight"),
    *("cheekPuff", "cheekSquintLeft", "cheekSquintRight", "noseSneerLeft", "noseSneerRight"),
    "tongueOut",
)
#: After the shapes: yaw, pitch and roll of the head and of both eyes, which stay still.
_ROTATIONS = 9
_VALUES = len(LIVE_LINK_NAMES) + _ROTATIONS
_LONGEST_DATAGRAM = 1400  # stays whole on Ethernet


class Sender(Protocol):
    """Sends frames to another program."""

    def send(self, weights: Mapping[str, float], time_s: float) -> None:
        """Sends one frame: ARKit's weights by name, those that are missing are zero; and its moment of the stream."""

    def close(self) -> None:
        """Lets go of the socket."""


class LiveLinkSender:
    """To Unreal Engine and whatever else listens to Live Link Face.

    Args:
        host: name or address.
        port: where it listens.
        subject: what it is called there.
        fps: frames per second of the stream.

    Raises:
        OSError: an unknown host.
    """

    def __init__(
        self, host: str, port: int = 11111, *, subject: str = "freetalk", fps: float = 30.0
    ) -> None:
        self._socket, self._to = _connect(host, port)
        self._subject = subject.encode()
        self._id = str(uuid.uuid4()).upper().encode()
        self._rate = Fraction(fps).limit_denominator(1001)

    def packet(self, weights: Mapping[str, float], second_of_day: float) -> bytes:
        """One frame.

        Args:
            weights: by ARKit's names.
            second_of_day: its timecode.
        """
        fraction, frame = math.modf(second_of_day * float(self._rate))
        values = [float(weights.get(name, 0.0)) for name in LIVE_LINK_NAMES] + [0.0] * _ROTATIONS
        return b"".join(
            [
                struct.pack(">Bi", 6, len(self._id)),
                self._id,
                struct.pack(">i", len(self._subject)),
                self._subject,
                struct.pack(">if", int(frame), fraction),
                struct.pack(">ii", self._rate.numerator, self._rate.denominator),
                struct.pack(f">B{_VALUES}f", _VALUES, *values),
            ]
        )

    def send(self, weights: Mapping[str, float], time_s: float) -> None:
        """See :class:`Sender`; the timecode is the time of the day."""
        now = datetime.datetime.now()
        midnight = now.replace(hour=0, minute=0, second=0, microsecond=0)
        _send(self._socket, self.packet(weights, (now - midnight).total_seconds()), self._to)

    def close(self) -> None:
        """See :class:`Sender`."""
        self._socket.close()


class VmcSender:
    """To VRM avatars in programs that speak VMC.

    Args:
        host: name or address.
        port: where it listens.

    Raises:
        OSError: an unknown host.
    """

    def __init__(self, host: str, port: int = 39539) -> None:
        self._socket, self._to = _connect(host, port)

    def packets(self, weights: Mapping[str, float], time_s: float) -> list[bytes]:
        """One frame: bundles that fit a datagram each, the last with what makes it seen."""
        values = [
            osc_message(
                "/VMC/Ext/Blend/Val", name[0].upper() + name[1:], float(weights.get(name, 0.0))
            )
            for name in LIVE_LINK_NAMES
        ]
        end = [
            osc_message("/VMC/Ext/Blend/Apply"),
            osc_message("/VMC/Ext/OK", 1),
            osc_message("/VMC/Ext/T", float(time_s)),
        ]
        bundles: list[list[bytes]] = [[]]
        for message in [*values, *end]:
            if len(osc_bundle([*bundles[-1], message])) > _LONGEST_DATAGRAM:
                bundles.append([])
            bundles[-1].append(message)
        return [osc_bundle(messages) for messages in bundles]

    def send(self, weights: Mapping[str, float], time_s: float) -> None:
        """See :class:`Sender`."""
        for packet in self.packets(weights, time_s):
            _send(self._socket, packet, self._to)

    def close(self) -> None:
        """See :class:`Sender`."""
        self._socket.close()


def open_sender(address: str, *, fps: float = 30.0) -> Sender:
    """A sender for ``livelink://HOST[:PORT][/SUBJECT]`` or ``vmc://HOST[:PORT]``.

    Raises:
        ValueError: another address.
        OSError: an unknown host.
    """
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = None
    if not host or parts.scheme not in ("livelink", "vmc"):
        raise ValueError(
            f"'{address}' says not where to send: livelink://HOST:11111 (Unreal's Live Link Face) or vmc://HOST:39539"
        )
    if parts.scheme == "vmc":
        return VmcSender(host, port or 39539)
    subject = parts.path.strip("/") or "freetalk"
    return LiveLinkSender(host, port or 11111, subject=subject, fps=fps)


def osc_message(address: str, *values: str | int | float) -> bytes:
    """An OSC 1.0 message of strings, int32 and float32."""
    tags, parts = ",", []
    for value in values:
        if isinstance(value, str):
            tags, part = tags + "s", _osc_string(value)
        elif isinstance(value, int):
            tags, part = tags + "i", struct.pack(">i", value)
        else:
            tags, part = tags + "f", struct.pack(">f", value)
        parts.append(part)
    return b"".join([_osc_string(address), _osc_string(tags), *parts])


def osc_bundle(messages: list[bytes]) -> bytes:
    """An OSC 1.0 bundle to be taken at once."""
    parts = [struct.pack(">i", len(message)) + message for message in messages]
    return b"".join([_osc_string("#bundle"), struct.pack(">Q", 1), *parts])


def _osc_string(text: str) -> bytes:
    """Ends in one to four zeros, its length a multiple of 4."""
    content = text.encode()
    return content.ljust(len(content) // 4 * 4 + 4, b"\0")


def _connect(host: str, port: int) -> tuple[socket.socket, tuple[str, int]]:
    try:
        family, kind, _, _, to = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except socket.gaierror as error:
        raise OSError(f"there is no host '{host}': {error.strerror}") from None
    return socket.socket(family, kind), (str(to[0]), int(to[1]))


def _send(on: socket.socket, packet: bytes, to: tuple[str, int]) -> None:
    """Sends a datagram; a listener that is not there yet refuses none of the next."""
    try:
        on.sendto(packet, to)
    except ConnectionRefusedError:
        return
