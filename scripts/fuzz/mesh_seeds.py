#!/usr/bin/env python3
"""Writes small meshes in every form the mesh doors read, one file a form, into a folder."""

from __future__ import annotations

import base64
import json
import struct
import sys
from pathlib import Path

POINTS = [(x / 3, y / 3, 0.1 * x * y) for y in range(4) for x in range(4)]
QUADS = [
    (4 * y + x, 4 * y + x + 1, 4 * y + x + 5, 4 * y + x + 4) for y in range(3) for x in range(3)
]
TRIANGLES = [t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))]
UV = [(x, y) for x, y, _ in POINTS]


def pack(kind: str, rows: list) -> bytes:
    """Rows of numbers one after the other: byte order and type as in ``struct``."""
    numbers = [number for row in rows for number in row]
    return struct.pack(f"{kind[0]}{len(numbers)}{kind[1]}", *numbers)


def lines(rows: list, *before: object) -> str:
    """One line a row, each beginning with ``before``."""
    return "".join(" ".join(map(str, (*before, *row))) + "\n" for row in rows)


def obj() -> dict[str, bytes]:
    """Triangles; polygons with texture corners, lines, continued lines and relative indices."""
    corners = [[f"{i + 1}/{i + 1}/1" for i in quad] for quad in QUADS]
    rich = f"mtllib none.mtl\n{lines(POINTS, 'v')}{lines(UV, 'vt')}vn 0 0 1\n{lines(corners, 'f')}"
    rich += "l 1 2 3\np 4\nf -1 \\\n -2 -3\n# end\n"
    plain = lines(POINTS, "v") + lines([[i + 1 for i in t] for t in TRIANGLES], "f")
    return {"plain.obj": plain.encode(), "rich.obj": rich.encode()}


def ply() -> dict[str, bytes]:
    """Text and both byte orders, texture coordinates at vertices and at corners, other elements."""
    files = {}
    header = f"ply\nformat %s 1.0\ncomment made for fuzzing\nelement vertex {len(POINTS)}\n"
    header += "".join(f"property %s {axis}\n" for axis in "xyz")
    text = header % ("ascii", "float", "float", "float") + "property uchar red\n"
    text += f"element face {len(QUADS)}\nproperty list uchar int vertex_indices\nend_header\n"
    text += lines([(*p, 7) for p in POINTS]) + lines([(4, *q) for q in QUADS])
    files["text.ply"] = text.encode()
    for name, order in (("little", "<"), ("big", ">")):
        start = header % (f"binary_{name}_endian", "double", "double", "double")
        start += f"property float u\nproperty float v\nelement face {len(TRIANGLES)}\n"
        start += "property list uchar uint vertex_indices\nproperty list uchar float texcoord\n"
        start += "element edge 1\nproperty int a\nproperty short b\nend_header\n"
        body = b"".join(
            pack(f"{order}d", [p]) + pack(f"{order}f", [uv]) for p, uv in zip(POINTS, UV)
        )
        for triangle in TRIANGLES:
            corners = [number for i in triangle for number in UV[i]]
            body += bytes([3]) + pack(f"{order}I", [triangle])
            body += bytes([6]) + pack(f"{order}f", [corners])
        files[f"{name}.ply"] = start.encode() + body + struct.pack(f"{order}ih", 1, 2)
    return files


def off() -> dict[str, bytes]:
    """Text, with colours, binary, binary with normals."""
    counts = f"{len(POINTS)} {len(TRIANGLES)} 0\n"
    faces = lines([(3, *t) for t in TRIANGLES])
    files = {"text.off": f"OFF\n{counts}{lines(POINTS)}{faces}".encode()}
    coloured = lines([(*p, 1, 0, 0, 1) for p in POINTS])
    files["coloured.off"] = f"COFF # coloured\n\n{counts}{coloured}{faces}".encode()
    for name, prefix, extra in (("binary", "", ()), ("normals", "N", (0.0, 0.0, 1.0))):
        body = struct.pack(">3i", len(POINTS), len(TRIANGLES), 0)
        body += pack(">f", [(*p, *extra) for p in POINTS])
        body += b"".join(struct.pack(">5i", 3, *t, 0) for t in TRIANGLES)
        files[f"{name}.off"] = f"{prefix}OFF BINARY\n".encode() + body
    return files


def stl() -> dict[str, bytes]:
    """Text and binary."""
    text, body = "solid s\n", b""
    for triangle in TRIANGLES:
        corners = [POINTS[i] for i in triangle]
        text += f"facet normal 0 0 1\nouter loop\n{lines(corners, 'vertex')}endloop\nendfacet\n"
        body += struct.pack("<12fH", 0, 0, 1, *(x for p in corners for x in p), 0)
    header = b" " * 80 + struct.pack("<I", len(TRIANGLES))
    return {"text.stl": (text + "endsolid s\n").encode(), "binary.stl": header + body}


def gltf() -> dict[str, bytes]:
    """Text with its data in it, GLB; nodes, strips, a fan, sparse and quantised accessors."""
    strip = [[0, 4, 1, 5, 2, 6, 3, 7]]
    chunks = [
        pack("<f", POINTS),
        pack("<H", TRIANGLES),
        pack("<f", UV),
        pack("<B", strip),
        pack("<h", [[int(32767 * x) for x in p] + [0] for p in POINTS]),
        struct.pack("<H", 3) + bytes(2) + struct.pack("<3f", 0.5, 0.5, 0.5),
    ]
    views, blob = [], b""
    for chunk in chunks:
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(chunk)})
        blob += chunk + bytes(-len(chunk) % 4)
    views[4]["byteStride"] = 8
    sparse = {
        "count": 1,
        "indices": {"bufferView": 5, "componentType": 5123},
        "values": {"bufferView": 5, "byteOffset": 4},
    }

    def accessor(view: int, kind: int, count: int, shape: str, **more: object) -> dict:
        entry = {"bufferView": view, "componentType": kind, "count": count, "type": shape}
        return {**entry, **more}

    count = len(POINTS)
    accessors = [
        accessor(0, 5126, count, "VEC3"),
        accessor(1, 5123, 3 * len(TRIANGLES), "SCALAR"),
        accessor(2, 5126, count, "VEC2"),
        accessor(3, 5121, len(strip[0]), "SCALAR"),
        accessor(4, 5122, count, "VEC3", normalized=True),
        accessor(0, 5126, count, "VEC3", sparse=sparse),
    ]
    textured = {"POSITION": 0, "TEXCOORD_0": 2}
    meshes = [
        {
            "primitives": [
                {"attributes": textured, "indices": 1},
                {"attributes": textured, "indices": 3, "mode": 5},
            ]
        },
        {
            "primitives": [
                {"attributes": {"POSITION": 4}, "indices": 3, "mode": 6},
                {"attributes": {"POSITION": 5}},
                {"attributes": {"POSITION": 0}, "mode": 1},
            ]
        },
    ]
    nodes = [
        {"mesh": 0, "translation": [1, 2, 3], "rotation": [0, 0.6, 0, 0.8], "children": [1]},
        {"mesh": 1, "scale": [-1, 2, 1]},
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]},
    ]
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 2]}],
        "nodes": nodes,
        "meshes": meshes,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(blob)
    glb = struct.pack("<4s2I", b"glTF", 2, size) + struct.pack("<I4s", len(text), b"JSON") + text
    glb += struct.pack("<I4s", len(blob), b"BIN\0") + blob
    uri = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
    document["buffers"] = [{"byteLength": len(blob), "uri": uri}]
    return {"scene.glb": glb, "scene.gltf": json.dumps(document, indent=1).encode()}


def seeds() -> dict[str, bytes]:
    """Content by file name."""
    return {**obj(), **ply(), **off(), **stl(), **gltf()}


if __name__ == "__main__":
    for file_name, content in seeds().items():
        (Path(sys.argv[1]) / file_name).write_bytes(content)
