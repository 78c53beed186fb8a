"""Frames to other programs: the bytes of Live Link Face and VMC as documented, and when they are sent."""

from __future__ import annotations

import shutil
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from test_cli_live import hum
from test_stm_ablations import SHIPPED
from test_talker import write_weights

import freetalk as ft
from freetalk.audio import save_wav
from freetalk.cli import main
from freetalk.cli.live_out import PacedFrames
from freetalk.corpus.assets import load_expression_take
from freetalk.talker.senders import (
    LIVE_LINK_NAMES,
    LiveLinkSender,
    VmcSender,
    open_sender,
    osc_bundle,
    osc_message,
)


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.settimeout(5)
        yield listening


def test_a_live_link_packet_is_byte_for_byte_that_of_the_format() -> None:
    sender = LiveLinkSender("127.0.0.1", subject="Anna", fps=30)
    packet = sender.packet({"jawOpen": 0.5, "tongueOut": 1.0, "corrective": 3.0}, 10.35)
    assert packet[:5] == b"\x06\x00\x00\x00\x24"  # version 6, an id of 36 signs
    assert packet[5:41].count(b"-") == 4
    assert packet[41:49] == b"\x00\x00\x00\x04Anna"
    frame, fraction, rate, base, count = struct.unpack(">ifiiB", packet[49:66])
    assert (frame, rate, base, count) == (310, 30, 1, 61)
    assert fraction == pytest.approx(0.5, abs=1e-5)
    values = struct.unpack(">61f", packet[66:])
    assert len(packet) == 66 + 244
    assert {index: value for index, value in enumerate(values) if value} == {17: 0.5, 51: 1.0}


def test_live_link_names_are_arkits_in_the_order_of_the_wire() -> None:
    assert len(LIVE_LINK_NAMES) == len(set(LIVE_LINK_NAMES)) == 52
    known = {name[0].lower() + name[1:] for name in load_expression_take()[1]}
    assert set(LIVE_LINK_NAMES) == known
    at = LIVE_LINK_NAMES.index
    assert at("eyeBlinkLeft") == 0 and at("eyeBlinkRight") == 7 and at("eyeWideRight") == 13
    assert (at("jawForward"), at("jawLeft"), at("jawRight"), at("jawOpen")) == (14, 15, 16, 17)
    assert at("mouthClose") == 18 and at("mouthSmileLeft") == 23 and at("mouthRollLower") == 31
    assert at("mouthUpperUpRight") == 40 and at("browInnerUp") == 43 and at("noseSneerRight") == 50


def test_a_rate_that_is_no_whole_number_is_a_fraction() -> None:
    packet = LiveLinkSender("127.0.0.1", subject="x", fps=30000 / 1001).packet({}, 0.0)
    assert struct.unpack(">ii", packet[54:62]) == (30000, 1001)


def test_osc_messages_are_byte_for_byte_those_of_the_specification() -> None:
    # The two examples of the OSC 1.0 specification.
    assert osc_message("/oscillator/4/frequency", 440.0) == (
        b"/oscillator/4/frequency\0,f\0\0\x43\xdc\0\0"
    )
    assert osc_message("/foo", 1000, -1, "hello", 1.234, 5.678) == (
        b"/foo\0\0\0\0,iisff\0\0\0\0\x03\xe8\xff\xff\xff\xffhello\0\0\0\x3f\x9d\xf3\xb6\x40\xb5\xb2\x2d"
    )
    bundle = osc_bundle([osc_message("/a")])
    assert bundle == b"#bundle\0\0\0\0\0\0\0\0\x01\0\0\0\x08/a\0\0,\0\0\0"


def messages_of(bundle: bytes) -> list[tuple[str, tuple[Any, ...]]]:
    """Address and values of a bundle's messages."""
    assert bundle[:16] == b"#bundle\0" + bytes(7) + b"\x01"
    found, at = [], 16
    while at < len(bundle):
        size = struct.unpack_from(">i", bundle, at)[0]
        assert size % 4 == 0
        content, at = bundle[at + 4 : at + 4 + size], at + 4 + size
        texts = []
        place = 0
        for _ in range(2):
            end = content.index(b"\0", place)
            texts.append(content[place:end].decode())
            place = end // 4 * 4 + 4
        values: list[Any] = []
        for tag in texts[1][1:]:
            if tag == "s":
                end = content.index(b"\0", place)
                values.append(content[place:end].decode())
                place = end // 4 * 4 + 4
            else:
                values.append(struct.unpack_from(f">{tag}", content, place)[0])
                place += 4
        found.append((texts[0], tuple(values)))
    return found


def test_a_vmc_frame_is_values_then_apply_in_datagrams_that_stay_whole() -> None:
    packets = VmcSender("127.0.0.1").packets({"jawOpen": 0.25}, 1.5)
    assert all(len(packet) <= 1400 for packet in packets)
    messages = [message for packet in packets for message in messages_of(packet)]
    assert [address for address, _ in messages[:-3]] == ["/VMC/Ext/Blend/Val"] * 52
    assert dict(values for _, values in messages[:-3])["JawOpen"] == 0.25
    assert messages[-3:] == [
        ("/VMC/Ext/Blend/Apply", ()),
        ("/VMC/Ext/OK", (1,)),
        ("/VMC/Ext/T", (1.5,)),
    ]


@pytest.mark.parametrize(
    "address",
    ["", "host", "http://host:80", "livelink://", "vmc://host:port", "livelink://h:99999"],
)
def test_other_addresses_are_refused(address: str) -> None:
    with pytest.raises(ValueError, match="livelink://HOST:11111"):
        open_sender(address)


def test_an_unknown_host_is_named() -> None:
    with pytest.raises(OSError, match=r"no host 'nowhere\.invalid'"):
        open_sender("vmc://nowhere.invalid")


def test_frames_are_sent_as_far_apart_as_they_were_spoken(listener: socket.socket) -> None:
    rig = SimpleNamespace(names=["jawOpen", "corrective_00_plus"])
    sender = open_sender(f"livelink://127.0.0.1:{listener.getsockname()[1]}/Anna", fps=25)
    out = PacedFrames([sender], rig, latency_s=0.1)  # type: ignore[arg-type]
    out.heard(0.0)
    frames = [
        SimpleNamespace(time_s=0.06 * k, weights=torch.tensor([0.2 * k, 1.0])) for k in range(5)
    ]
    out.add(frames)  # type: ignore[arg-type]
    times, values = [], []
    for _ in range(5):
        packet = listener.recv(2000)
        times.append(time.perf_counter())
        values.append(struct.unpack_from(">f", packet, 66 + 4 * 17)[0])
    out.close()
    np.testing.assert_allclose(values, [0, 0.2, 0.4, 0.6, 0.8], atol=1e-6)
    assert times[-1] - times[0] == pytest.approx(0.24, abs=0.1)


def test_live_speech_is_sent(
    tmp_path: Path, listener: socket.socket, capsys: pytest.CaptureFixture[str]
) -> None:
    weights = write_weights(tmp_path)
    shutil.copy(Path(SHIPPED).parent / "rig_poses.safetensors", weights)
    save_wav(tmp_path / "a.wav", ft.Audio(hum(0.6), 16000))
    to = f"livelink://127.0.0.1:{listener.getsockname()[1]}"
    command = ["live", "--pretrained", weights, "--audio", tmp_path / "a.wav", "--to", to]
    assert main([str(word) for word in command]) == 0
    packets = [listener.recv(2000) for _ in range(18)]
    assert all(packet[45:53] == b"freetalk" and len(packet) == 314 for packet in packets)
    assert "18 frames of 0.6 s" in capsys.readouterr().out


def test_a_wrong_address_ends_before_the_work(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["live", "--mic", "--audio", "a.wav"]) == 2
    assert "not allowed with" in capsys.readouterr().err
