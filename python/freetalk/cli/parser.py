"""The grammar of the command line. Imports nothing that the package does not, so that ``--help`` is quick."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from freetalk.cli import head
from freetalk.cli import motion_options as motion
from freetalk.cli.corpus_options import add_of_heads
from freetalk.cli.numbers import at_least_one, frame_rate, positive, seed
from freetalk.cli.score_options import add_evaluate, add_predict
from freetalk.cli.weights import shipped_emotions

UNITS = ("auto", "m", "cm", "mm", "in")  # core.UNITS; help is shown without loading the library
AXES = ("auto", "+x", "-x", "+y", "-y", "+z", "-z")
_INTENSITY_HELP = (
    "from 1 (slight) to the weights' strongest, 3 of the shipped; by default the middle"
)


class UsageError(Exception):
    """Arguments that the command does not understand."""


class HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Help that mentions defaults where there is one to mention."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default is None or action.default is False or action.required:
            return action.help
        return super()._get_help_string(action)


class Parser(argparse.ArgumentParser):
    """A parser that raises instead of leaving the process."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(formatter_class=HelpFormatter, **settings)

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """Also takes ``--up -y``, in which argparse sees two options."""
        return super().parse_known_args(
            _joined_axes(sys.argv[1:] if args is None else args), namespace
        )

    def error(self, message: str) -> NoReturn:
        """Raises :class:`UsageError` with the command's name and where to find help."""
        raise UsageError(f"{message} (see '{self.prog} --help')")


def _joined_axes(args: Sequence[str]) -> list[str]:
    joined: list[str] = []
    for argument in args:
        if argument in AXES and joined and joined[-1] in ("--up", "--forward"):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def make_parser() -> Parser:
    """Builds the whole grammar; each command names its handler as ``module:function``."""
    parser = Parser(prog="freetalk", description="Speech and a face mesh in, a talking face out.")
    parser.add_argument("--version", action=_Version, help="print the version and leave")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    _add_animate(commands)
    _add_live(commands)
    _add_convert(commands)
    _add_train(commands)
    predict = _command(commands, "predict", "predict:run", "write the motion that weights predict")
    add_predict(predict)
    add_evaluate(
        _command(commands, "evaluate", "evaluate:run", "score weights, or any system's predictions")
    )
    _add_corpus(commands)
    _add_data(commands)
    _add_table(commands)
    _add_mesh(commands)
    head.add_commands(_group(commands, "head", head.HELP)[1], _command)
    _add_speech(commands)
    _add_pages(commands)
    _add_models(commands)
    return parser


class _Version(argparse.Action):
    def __init__(self, option_strings: list[str], dest: str, **settings: Any) -> None:
        help_text = settings.get("help")
        super().__init__(option_strings, dest, nargs=0, default=None, help=help_text)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        import freetalk

        print(f"freetalk {freetalk.__version__}")
        parser.exit()


def _command(commands: Any, name: str, handler: str, help_text: str, **settings: Any) -> Parser:
    parser: Parser = commands.add_parser(
        name, help=help_text, description=settings.pop("description", help_text), **settings
    )
    parser.add_argument("--debug", action="store_true", help="show the whole traceback of errors")
    parser.set_defaults(handler=handler)
    return parser


def _group(commands: Any, name: str, help_text: str, required: bool = True) -> tuple[Parser, Any]:
    parser: Parser = commands.add_parser(name, help=help_text, description=help_text)
    nested = parser.add_subparsers(title="commands", metavar="COMMAND", required=required)
    return parser, nested


def _add_where(parser: Parser) -> None:
    from freetalk.cli.mesh_options import add_where

    _add_pose(parser)
    add_where(parser)


def _add_pose(parser: Parser) -> None:
    parser.add_argument("--unit", choices=UNITS, default="auto", help="length unit of the mesh")
    parser.add_argument("--up", choices=AXES, default="auto", help="axis to the top of the head")
    parser.add_argument("--forward", choices=AXES, default="auto", help="axis out of the face")


def _add_pretrained(parser: Parser) -> None:
    text = "weights: a name (see 'freetalk models'), a folder, or OWNER/NAME on huggingface.co"
    parser.add_argument("--pretrained", default=motion.DEFAULT_WEIGHTS, metavar="NAME", help=text)


def _add_animate(commands: Any) -> None:
    from freetalk.cli.convert import add_writing

    parser = _command(
        commands,
        "animate",
        "animate:run",
        "animate a face mesh with speech",
        description=(
            "Animates a face mesh of any topology with recorded speech. Outputs by name: talk.glb or "
            "talk.gltf (morph targets), talk.usda, talk.usdc or talk.usdz (blend shapes), talk.html (a page that plays "
            "it in any browser), talk.npz (arrays), talk.mp4 or talk.webm (rendered, with sound), talk.pc2 (a cache "
            "for Blender), talk.csv or talk.json (ARKit's weights, as Live Link Face and Audio2Face write them), and "
            "for one mesh a frame a folder: 'frames/' or 'frames/*.obj' (OBJ), 'frames/*.ply' (PLY). "
            "An emotion is a name, a mixture 'happy:0.7,surprise:0.3', or keyframes "
            "'0=neutral; 2.5=happy:0.7,surprise:0.3@2.5' (SECONDS=EMOTION@INTENSITY, the intensity "
            "optional), between which it changes evenly. --audio and --mesh may be folders: every mesh speaks "
            "every recording, into --out 'talks/{name}.glb', where {name} is RECORDING, MESH or RECORDING_MESH."
        ),
    )
    parser.add_argument(
        "--audio",
        required=True,
        metavar="PATH",
        help="speech: WAV, FLAC, OGG, MP3, M4A, the sound of a video, or their folder",
    )
    mesh_help = "face: OBJ, PLY, OFF, STL, glTF, or a folder; without it the built-in mean face"
    parser.add_argument("--mesh", metavar="PATH", help=mesh_help)
    emotion_help = (
        f"{', '.join(shipped_emotions())}, or whatever other weights name; a mixture, in which weights below 1 "
        "leave the rest neutral; keyframes (see above); or auto: that of the voice"
    )
    parser.add_argument("--emotion", default="neutral", help=emotion_help)
    parser.add_argument("--intensity", type=at_least_one, metavar="X", help=_INTENSITY_HELP)
    parser.add_argument("--fps", type=frame_rate, default=30.0, help="frames per second")
    motion.add_performance(parser)
    motion.add_diffusion(parser)
    motion.add_decoding(parser)
    _add_where(parser)
    _add_pretrained(parser)
    motion.add_device(parser)
    out_help = "where to write; repeatable; for folders with {name} in it: 'talks/{name}.glb'"
    parser.add_argument("--out", action="append", required=True, metavar="PATH", help=out_help)
    add_writing(parser)


def _add_convert(commands: Any) -> None:
    from freetalk.cli.convert import add_convert, add_writing

    help_text = "turn an animation into other formats"
    parser = _command(commands, "convert", "convert:run", help_text)
    add_convert(parser)
    _add_pretrained(parser)
    add_writing(parser)


def _add_live(commands: Any) -> None:
    from freetalk.cli.live_options import add_live

    help_text = "animate a face mesh while the speech is being spoken"
    parser = _command(commands, "live", "live:run", help_text)
    add_live(parser)
    _add_where(parser)
    _add_pretrained(parser)


def _add_train(commands: Any) -> None:
    _, kinds = _group(commands, "train", "train a model on a corpus; continues where it stopped")
    for kind, what in (
        ("ats", "audio to sparse: speech to the motion of 68 landmarks"),
        ("stm", "sparse to mesh: landmark motion to the motion of any mesh"),
        ("speech", "the speech encoder"),
        ("facetalk", "FaceTalk: speech to expression weights or codes of a parametric head"),
        ("head", "a neural parametric head, on heads of the built-in face"),
    ):
        parser = _command(kinds, kind, "train:run", f"train {what}")
        parser.set_defaults(kind=kind)
        parser.add_argument(
            "--config", required=True, metavar="YAML", help="a file, or a name in configs/"
        )
        parser.add_argument(
            "--data",
            required=True,
            action="append",
            metavar="[NAME[:SPLIT]=]DIR",
            help="a corpus or packed dataset ('freetalk data import'); repeat it to train on several",
        )
        parser.add_argument("--out", required=True, metavar="DIR", help="weights and checkpoints")
        parser.add_argument(
            "overrides", nargs="*", metavar="section.key=value", help="wins over the configuration"
        )


def _add_corpus(commands: Any) -> None:
    _, nested = _group(commands, "corpus", "the open corpus that the shipped weights come from")
    parser = _command(
        nested,
        "build",
        "data:build",
        "build the open corpus",
        description=(
            "Builds the open corpus in the packed layout that 'freetalk data import' makes of other data: "
            "manifest.json, landmarks.npy (N, 68, 3) in metres, motion.npy (N, E) weights of expressions, "
            "audio.npy at 16 kHz, identities.npy, phones.json and topologies/*.npz."
        ),
    )
    parser.add_argument("--out", required=True, metavar="DIR", help="folder to make")
    parser.add_argument("--size", choices=("tiny", "small", "full"), default="small", help="size")
    parser.add_argument("--seed", type=seed, default=0, help="same seed, same corpus")
    add_of_heads(nested, _command)


def _add_data(commands: Any) -> None:
    _, nested = _group(commands, "data", "datasets of speech and facial motion")
    parser = _command(
        nested,
        "import",
        "data:import_release",
        "pack a public release, or recordings of your own, for training and evaluation",
        description=(
            "Reads a release as it really lies on disk and packs it once: sound at 16 kHz, landmarks, vertices "
            "or their factors, labels, splits by name. A take that is wrong is left out and listed; a call that "
            "was stopped goes on when it is made again."
        ),
    )
    parser.add_argument(
        "name",
        metavar="NAME",
        help="vocaset, biwi, multiface, emovoca, mead, folder (your own), or auto",
    )
    parser.add_argument("source", metavar="SOURCE", help="the release's folder")
    parser.add_argument("--out", required=True, metavar="DIR", help="the folder to make")
    parser.add_argument("--called", default="", metavar="NAME", help="what results call the data")
    parser.add_argument(
        "--fps", type=float, default=0.0, help="bring motion to this rate; by default the release's"
    )
    parser.add_argument("--unit", choices=UNITS, default="auto", help="length unit of its files")
    parser = _command(
        nested,
        "check",
        "data:check",
        "tell what is missing or wrong with a dataset",
        description=(
            "Reads all of a packed dataset against what was written, or all of a release and tells what it is "
            "and which takes an import would leave out, and why."
        ),
    )
    parser.add_argument("data", metavar="[NAME[:SPLIT]=]DIR", help="the dataset's folder")
    parser.add_argument(
        "--kind", default="auto", metavar="KIND", help="a release's kind, as 'data import' names it"
    )
    parser.add_argument("--unit", choices=UNITS, default="auto", help="length unit of its files")
    parser.add_argument("--quick", action="store_true", help="do not read sound and motion")
    parser.add_argument("--json", metavar="FILE", help="also write the report to this file")

    parser = _command(
        nested, "from-video", "data:from_video", "make a dataset of videos of talking faces"
    )
    from freetalk.cli.corpus_options import add_video_options

    add_video_options(parser)


def _add_table(commands: Any) -> None:
    from freetalk.cli.table import add_table

    add_table(_command(commands, "table", "table:run", "make a table of the papers"))


def _add_mesh(commands: Any) -> None:
    from freetalk.cli.mesh_options import add_landmarks, add_prepare

    _, nested = _group(commands, "mesh", "look into mesh files, find faces on them")
    parser = _command(nested, "check", "mesh:check", "report counts, size, unit and pose of a mesh")
    parser.add_argument("file", metavar="FILE", help="OBJ, PLY, OFF, STL or glTF")
    _add_pose(parser)
    _add_pretrained(parser)
    parser = _command(nested, "landmarks", "mesh:landmarks", "find the 68 landmarks of a mesh")
    add_landmarks(parser)
    _add_pose(parser)
    _add_pretrained(parser)
    parser = _command(nested, "prepare", "mesh:prepare", "make a scan ready to speak")
    add_prepare(parser)
    _add_pose(parser)
    _add_pretrained(parser)


def _add_speech(commands: Any) -> None:
    _, nested = _group(commands, "speech", "the speech encoder")
    parser = _command(nested, "encode", "speech:encode", "write speech features as a NumPy array")
    parser.add_argument(
        "--audio", required=True, metavar="FILE", help="speech: WAV, FLAC, OGG, MP3"
    )
    parser.add_argument("--fps", type=positive, default=30.0, help="feature frames per second")
    encoder_help = "folder of another encoder: config.json and model.safetensors"
    parser.add_argument("--encoder", metavar="DIR", help=encoder_help)
    _add_pretrained(parser)
    parser.add_argument("--out", required=True, metavar="NPY", help="where to write (T, C) float32")
    convert_help = "turn a pytorch_model.bin into model.safetensors"
    parser = _command(nested, "convert", "speech:convert", convert_help)
    parser.add_argument("source", metavar="SOURCE", help="pytorch_model.bin, or its folder")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder to write")
    parser.add_argument("--half", action="store_true", help="store float16")
    from freetalk.cli.speech_options import add_align, add_probe

    add_align(_command(nested, "align", "speech:align", "phone timings of recorded English"))
    probe_help = "how well an encoder tells viseme classes apart"
    parser = _command(nested, "probe", "speech:probe", probe_help)
    add_probe(parser)
    _add_pretrained(parser)


def _add_pages(commands: Any) -> None:
    from freetalk.cli.live_options import add_serve, add_view

    view_help = "play animations in the browser, or render one to files"
    add_view(_command(commands, "view", "view:run", view_help))
    serve_help = "a page to animate faces with: speech and mesh in, takes to compare and download"
    parser = _command(commands, "serve", "serve:run", serve_help)
    add_serve(parser)
    _add_pretrained(parser)


def _add_models(commands: Any) -> None:
    parser, nested = _group(commands, "models", "the weights that are installed", required=False)
    parser.set_defaults(handler="models:list_models", debug=False)
    _command(nested, "list", "models:list_models", "list the weights that are installed")
    help_text = "fetch a published speech encoder, such as hubert-base-ls960"
    parser = _command(nested, "download", "models:download", help_text)
    parser.add_argument("name", metavar="NAME", help="name, or OWNER/NAME on huggingface.co")
    parser.add_argument("--out", metavar="DIR", help="folder to write; by default in the cache")
    from freetalk.cli.models import add_push
    from freetalk.cli.pack import add_pack

    add_pack(_command(nested, "pack", "pack:run", "make weights of models trained apart"))
    add_push(_command(nested, "push", "models:push", "publish weights on huggingface.co"))
