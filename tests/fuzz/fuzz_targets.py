"""What reads files that others wrote: for each reader a folder of good files, the ones to break, and the call."""

import hashlib
import json
import math
import struct
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

MAX_PIXELS = 1 << 20  # What readers of images are told; with it an image cannot take more than :data:`MEMORY`.
MEMORY = 256 << 20  # Bytes by which a hostile file may raise the peak of the process.


@dataclass(frozen=True)
class Target:
    files: Mapping[str, bytes]  # a folder of files that are read without complaint, by name
    broken: tuple[str, ...]  # names of those that are made hostile, one at a time
    read: Callable[[Path], object]  # called with the folder; ends regularly or raises an error of the package


def targets() -> dict[str, Callable[[], Target]]:
    """Makers of all targets by name."""
    images = {f"image {suffix}": partial(_image, suffix) for suffix in ("png", "jpg", "tif", "exr", "webp", "gif")}
    meshes = {f"mesh {suffix}": partial(_mesh, suffix) for suffix in ("obj", "glb", "ply")}
    foreign = {f"poses {name}": partial(_foreign, name) for name in FOREIGN}
    return {
        "poses.json": _poses, **images, "depth exr": partial(_depth, "a.exr", "float32"),
        "depth png": partial(_depth, "a.png", "uint16"), "onnx": _onnx, "models manifest": _models,
        "batch jsonl": partial(_batch, "jsonl"), "batch csv": partial(_batch, "csv"), "batch results": _batch_results,
        "eval results": _eval_results, "image avif": _avif, "request of serve": _request, "spherical mp4": _spherical,
        "recipe toml": _recipe, "table of costs": _costs, **meshes, **foreign,
    }  # fmt: skip


def _json(value: Any) -> bytes:
    return json.dumps(value).encode()


def _bytes_of(write: Callable[[Path], object], name: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / name)
        return (Path(folder) / name).read_bytes()


def _picture(name: str, dtype: str = "uint8", channels: int = 3, **tags: Any) -> bytes:
    import OpenImageIO

    rng = np.random.default_rng(0)
    samples = rng.uniform(0, 200, (16, 32, channels)).astype(dtype)

    def write(path: Path) -> None:
        spec = OpenImageIO.ImageSpec(32, 16, channels, {"float32": "float"}.get(dtype, dtype))
        for key, value in tags.items():
            spec.attribute(key, *value) if isinstance(value, tuple) else spec.attribute(key, value)
        if channels == 1:
            spec.channelnames = ("Z",)
        writer = OpenImageIO.ImageOutput.create(str(path))
        writer.open(str(path), spec)
        writer.write_image(np.ascontiguousarray(samples))
        writer.close()
        writer.geterror()

    return _bytes_of(write, name)


GPANO = {
    "GPano:FullPanoWidthPixels": 64, "GPano:FullPanoHeightPixels": 32, "GPano:CroppedAreaImageWidthPixels": 32,
    "GPano:CroppedAreaImageHeightPixels": 16, "GPano:CroppedAreaLeftPixels": 4, "GPano:CroppedAreaTopPixels": 3,
    "GPano:ProjectionType": "equirectangular",
}  # fmt: skip
GPS = {
    "GPS:Latitude": ("float[3]", (48.0, 7.0, 30.0)), "GPS:LatitudeRef": "N",
    "GPS:Longitude": ("float[3]", (11.0, 34.0, 2.0)), "GPS:LongitudeRef": "E",
    "GPS:Altitude": 520.0, "GPano:PoseHeadingDegrees": 93.5,
}  # fmt: skip


def _image(suffix: str) -> Target:
    from omnisyn_cli.interpolation.describe import geographic_place
    from omnisyn_cli.io import read_panorama
    from omnisyn_cli.io.decode import read_header

    name = f"a.{suffix}"
    data = _picture(name, "float32" if suffix == "exr" else "uint8", **GPANO, **GPS)
    if suffix == "webp":
        data = _with_xmp(data)

    def read(folder: Path) -> None:
        geographic_place(read_header(folder / name))
        read_panorama(folder / name, max_pixels=MAX_PIXELS)

    return Target({name: data}, (name,), read)


def _with_xmp(webp: bytes) -> bytes:
    """A simple WebP of 32×16 in the extended format, with the tags that OpenImageIO does not write there."""
    packet = " ".join(("<rdf:Description", *(f"{name}='{value}'" for name, value in GPANO.items()), "/>")).encode()
    extended = b"VP8X" + struct.pack("<IIHBHB", 10, 0x04, 31, 0, 15, 0)
    body = b"WEBP" + extended + webp[12:] + b"XMP " + struct.pack("<I", len(packet)) + packet + bytes(len(packet) % 2)
    return b"RIFF" + struct.pack("<I", len(body)) + body


def _depth(name: str, dtype: str) -> Target:
    from omnisyn_cli.io import read_inverse_depth

    data = _picture(name, dtype, channels=1)
    return Target({name: data}, (name,), lambda folder: read_inverse_depth(folder / name, max_pixels=MAX_PIXELS))


POSES = {
    "version": 1,
    "panoramas": {
        "a.png": {"position": [0, 0.5, 0], "rotation": [1, 0, 0, 0], "depth": "a.exr"},
        "b.png": {"matrix": [[1, 0, 0, 1.5], [0, 1, 0, 0], [0, 0, 1, -5.0], [0, 0, 0, 1]], "mask": "m/b.png"},
    },
}
PLACES = {
    "version": 1,
    "panoramas": {
        "a.png": {"latitude": 48.1, "longitude": 11.5, "altitude": 520.0, "heading": 93.0, "pitch": 1, "roll": -1},
        "b.png": {"latitude": 48.2, "longitude": 11.5, "altitude": 521.0, "heading": 9.0},
    },
}


def _poses() -> Target:
    from omnisyn_cli.errors import PoseError
    from omnisyn_cli.poses.file import read_poses

    def read(folder: Path) -> None:
        problems = []
        for name in ("poses.json", "places.json"):
            try:
                read_poses(folder / name).of("a.png")
            except PoseError as error:
                problems.append(error)
        if problems:
            raise problems[0]

    files = {"poses.json": _json(POSES), "places.json": _json(PLACES)}
    return Target(files, tuple(files), read)


def small_network(channels: int = 3) -> bytes:
    """An ONNX file with the inputs and outputs of a completion network."""
    from onnx import TensorProto, helper, numpy_helper

    shape = [1, channels, "height", "width"]
    planes = helper.make_tensor_value_info("planes", TensorProto.FLOAT, shape)
    outputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1, "height", "width"]) for name in ("rho", "trust")
    ]
    weights = numpy_helper.from_array(np.full((1, channels, 3, 3), 0.02, np.float32), "weights")
    nodes = [
        helper.make_node("Conv", ["planes", "weights"], ["sum"], pads=[1, 1, 1, 1]),
        helper.make_node("Relu", ["sum"], ["rho"]),
        helper.make_node("Sigmoid", ["sum"], ["trust"]),
    ]
    graph = helper.make_graph(nodes, "small", [planes], outputs, [weights])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    return bytes(model.SerializeToString())


def _onnx() -> Target:
    from omnisyn_cli.runtime.image_networks import CompletionSession
    from omnisyn_cli.runtime.session import open_session

    planes = np.zeros((3, 32, 64), np.float32)

    def read(folder: Path) -> None:
        inverse_depth, confidence = CompletionSession(open_session(folder / "a.onnx", device="cpu", threads=1))(planes)
        assert np.isfinite(inverse_depth).all()
        assert ((confidence >= 0) & (confidence <= 1)).all()

    return Target({"a.onnx": small_network()}, ("a.onnx",), read)


def _models() -> Target:
    from omnisyn_cli.runtime.models import find_model, read_manifest

    model = b"weights"
    text = (
        'version = 1\n\n[[models]]\nname = "fast"\nrole = "depth"\nvariant = "fast"\nfile = "fast.onnx"\n'
        f'sha256 = "{hashlib.sha256(model).hexdigest()}"\nsize = [256, 512]\nparameters = 12345\ntraining = "none"\n'
        'licence = "Apache-2.0"\n\n[models.metrics]\ndelta_25 = 0.9\n'
    )

    def read(folder: Path) -> None:
        for name in read_manifest(folder):
            found = find_model(name, folder)
            if found.is_file() and found.read_bytes() != model and not name.endswith(".onnx"):
                raise AssertionError("a file was accepted that is not the one that was hashed")

    return Target({"manifest.toml": text.encode(), "fast.onnx": model}, ("manifest.toml", "fast.onnx"), read)


def _batch(kind: str) -> Target:
    from omnisyn_cli.batch.manifest import read_manifest
    from omnisyn_cli.errors import InputError

    common = {"inputs": ["a.png", "b.png"], "poses": "poses.json"}
    lines = [
        {"id": "one", **common, "frames": 60, "size": "2048x1024", "fps": 24.0},
        {"id": "two", **common, "output": "two/f_%03d.png", "cut": 0.1},
    ]
    if kind == "jsonl":
        text = b"\n".join(_json(line) for line in lines) + b"\n"
    else:
        text = b"id,inputs,poses,frames,size\none,a.png;b.png,poses.json,60,2048x1024\ntwo,a.png; b.png,poses.json,,\n"
    name = f"jobs.{kind}"
    files = {name: text, "poses.json": _json(POSES), "a.png": b"", "b.png": b""}

    def read(folder: Path) -> None:
        manifest = read_manifest(folder / name)
        for job in manifest.jobs:
            job.interpolation(folder)
        if manifest.problems:
            raise InputError("expected no problems, got " + max(manifest.problems, key=len))

    return Target(files, (name, name, name, "poses.json"), read)


def _batch_results() -> Target:
    from omnisyn_cli.batch.folder import Records

    line = {"status": "done", "key": "0" * 64, "outputs": {"output": "a.mp4"}}
    data = b"".join(_json({"id": f"job{index}", **line}) + b"\n" for index in range(4))

    def read(folder: Path) -> None:
        with Records(folder / "results.jsonl") as records:
            for index in range(4):
                records.last(f"job{index}")
            records.append({"id": "new", "status": "done"})

    return Target({"results.jsonl": data}, ("results.jsonl",), read)


def _eval_results() -> Target:
    from omnisyn_cli.evaluation import results
    from omnisyn_cli.evaluation.report import write_report

    frames = tuple(
        results.FrameRecord(f"{i}.png", i / 4, 0.25, {"ws_psnr": 30.0 + i, "psnr": math.inf}) for i in (1, 2, 3)
    )
    record = results.UnitRecord(
        "k" * 64, "hall", "a.png", "b.png", "matching", "done", baseline=1.0, size=(512, 1024), frames=frames,
        depths=(results.DepthRecord("a.png", {"mae": 0.1}, {"mae": 0.2}),), temporal={"flicker": 0.1},
        seconds={"total": 2.0},
    )  # fmt: skip
    data = b"".join(_json(record.to_json()) + b"\n" for _ in range(3))

    def read(folder: Path) -> None:
        write_report(folder, results.read_records(folder))

    return Target({"results.jsonl": data}, ("results.jsonl",), read)


def _avif() -> Target:
    from io import BytesIO

    from PIL import Image

    from omnisyn_cli.io import read_panorama

    data = BytesIO()
    Image.fromarray(np.arange(32 * 16 * 3, dtype=np.uint8).reshape(16, 32, 3)).save(data, "avif")
    read = partial(read_panorama, max_pixels=MAX_PIXELS)
    return Target({"a.avif": data.getvalue()}, ("a.avif",), lambda folder: read(folder / "a.avif"))


def _request() -> Target:
    """Bytes that a client sends; what is answered is of the walk, and no exception is printed by the server."""
    from io import BytesIO
    from types import SimpleNamespace

    from omnisyn_cli.interpolation.viewer import serve

    request = (
        b"GET /index.html?x=%00 HTTP/1.1\r\nHost: localhost:8000\r\nAccept: */*\r\n\r\n"
        b"GET /0000.bin HTTP/1.1\r\nHost: 127.0.0.1\r\nRange: bytes=0-1\r\n\r\n"
    )

    def read(folder: Path) -> None:
        answer = BytesIO()
        connection = SimpleNamespace(
            makefile=lambda *_: BytesIO((folder / "request").read_bytes()),
            sendall=answer.write, settimeout=lambda _: None,
        )  # fmt: skip
        serve._Handler(connection, ("127.0.0.1", 1), None, folder=folder)
        assert b"secret" not in answer.getvalue()
        assert b"Python" not in answer.getvalue()

    files = {"request": request, "index.html": b"<p>", "0000.bin": b"\x00", "secret.bin": b"secret"}
    return Target(files, ("request",), read)


def _spherical() -> Target:
    from omnisyn_cli.io import open_video, read_spherical

    def write(path: Path) -> None:
        with open_video(path, size=(16, 32), fps=10) as sink:
            sink.write(np.zeros((16, 32, 3), np.uint8))

    return Target({"a.mp4": _bytes_of(write, "a.mp4")}, ("a.mp4",), lambda folder: read_spherical(folder / "a.mp4"))


def _recipe() -> Target:
    from omnisyn_cli.training.recipe import read_recipe

    shipped = sorted((Path(__file__).parents[2] / "models" / "recipes").glob("*.toml"))[0]
    return Target({"a.toml": shipped.read_bytes()}, ("a.toml",), lambda folder: read_recipe(folder / "a.toml"))


def _costs() -> Target:
    from omnisyn_cli.interpolation.planning import figures

    data = Path(figures.__file__).with_name("pareto.json").read_bytes()
    return Target({"a.json": data}, ("a.json",), lambda folder: figures.read_table(folder / "a.json"))


def _mesh(suffix: str) -> Target:
    import trimesh

    from omnisyn_cli.io.meshes import read_mesh

    box = trimesh.creation.box((4.0, 3.0, 5.0))
    colours = np.full((len(box.vertices), 4), 200, np.uint8)
    box.visual = trimesh.visual.ColorVisuals(box, vertex_colors=colours)
    data = box.export(file_type=suffix)
    name = f"a.{suffix}"
    content = data.encode() if isinstance(data, str) else bytes(data)
    return Target({name: content}, (name,), lambda folder: read_mesh(folder / name))


def _foreign(name: str) -> Target:
    from omnisyn_cli.poses.formats import import_poses
    from omnisyn_cli.poses.formats.files import ImportOptions

    source, content = FOREIGN[name]
    files = content() if callable(content) else content
    broken = tuple(file for file in files if not file.endswith(".png"))

    def read(folder: Path) -> None:
        import_poses([folder / source], "auto", ImportOptions())

    return Target(files, broken, read)


CAMERAS_BIN = struct.pack("<QIiQQddd", 1, 1, 11, 64, 32, 10.0, 32.0, 16.0)  # One camera of SphereSfM.


def _images_bin() -> bytes:
    images = (
        struct.pack("<I7dI", n, 1, 0, 0, 0, 0.5 * n, 0, 1, 1) + name + b"\0" + struct.pack("<Qddq", 1, 3.0, 4.0, -1)
        for n, name in ((1, b"a.png"), (2, b"b.png"))
    )
    return struct.pack("<Q", 2) + b"".join(images)


def _authors() -> dict[str, bytes]:
    rotations = _bytes_of(lambda path: np.save(path, np.stack([np.eye(3)] * 2)), "r.npy")
    translations = _bytes_of(lambda path: np.save(path, np.zeros((2, 3))), "t.npy")
    return {"rotations.npy": rotations, "translations.npy": translations, **PICTURES}


PICTURES = {"0.png": b"", "1.png": b""}
NAMED = {"a.png": b"", "b.png": b""}
ROWS = [{"pano_id": f"{n}", "location": {"lat": 48.1, "lng": 11.5}, "heading": 20 * n, "pitch": 0} for n in range(3)]
SHOT = {"camera": "c", "rotation": [0.1, 0.2, 0.3], "translation": [1, 2, 3.5]}
RECONSTRUCTION = {
    "cameras": {"c": {"projection_type": "spherical", "width": 64, "height": 32}},
    "shots": {"a.png": SHOT, "b.png": SHOT},
    "reference_lla": {"latitude": 48.0, "longitude": 11.0, "altitude": 500.0},
}
MATRIX = [[1, 0, 0, 0.5], [0, 1, 0, 2], [0, 0, 1, -3], [0, 0, 0, 1]]
TRANSFORMS = {
    "camera_model": "EQUIRECTANGULAR", "applied_scale": 2.0, "applied_transform": MATRIX[:3],
    "frames": [{"file_path": f"./images/{n}.png", "transform_matrix": MATRIX} for n in range(2)],
}  # fmt: skip
SIMILARITY = {"translation": [1.0, 2.0], "rotation": 30.0, "scale": 0.5}
ROOM = {
    f"p{n}": {"image_path": f"p/{n}.jpg", "camera_height": 1.0, "floor_plan_transformation": SIMILARITY} for n in "12"
}
HOUSE = {"merger": {"f1": {"r1": {"q1": ROOM}}}, "scale_meters_per_coordinate": {"f1": 3.5}}
PLACE = {"rot.txt": b"1 0 0\n0 1 0\n0 0 1\n", "tran.txt": b"0.5\n1\n-2\n", "rgb.png": b""}

# By format: the name of the source below the folder, and its files, or what makes them.
FOREIGN: dict[str, tuple[str, dict[str, bytes] | Callable[[], dict[str, bytes]]]] = {
    "csv": ("places.csv", {
        "places.csv": b"image,lat,lng,heading,altitude\na.png,48.1,11.5,93,520\nb.png,48.2,11.6,9.5,521\n",
    }),
    "table json": ("places.json", {"places.json": _json({"images": ROWS})}),
    "colmap": (".", {
        "cameras.txt": b"1 EQUIRECTANGULAR 64 32 64 32\n", "a.png": b"",
        "images.txt": b"# list\n1 1 0 0 0 0.5 0 0 1 a.png\n\n2 0.6 0.8 0 0 1.5 0 -2 1 b.png\n1 2 -1\n",
    }),
    "colmap binary": (".", lambda: {"cameras.bin": CAMERAS_BIN, "images.bin": _images_bin(), **NAMED}),
    "opensfm": ("reconstruction.json", {"reconstruction.json": _json([RECONSTRUCTION])}),
    "nerfstudio": ("transforms.json", {"transforms.json": _json(TRANSFORMS)}),
    "tum": ("track.tum", {
        "track.tum": b"# image 0 a.png\n0 0 0 0 0 0 0 1\n# image 1.5 b.png\n1.5 1 2 3 0.6 0 0 0.8\n", **NAMED,
    }),
    "kitti": ("00.txt", {"00.txt": b"1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1.5 0 1 0 2 0 0 1 -3\n", **NAMED}),
    "habitat": (".", {f"{n}/{name}": data for n in range(2) for name, data in PLACE.items()}),
    "zind": ("zind_data.json", {"zind_data.json": _json(HOUSE)}),
    "authors": (".", _authors),
    "exif": ("a.jpg", lambda: {"a.jpg": _picture("a.jpg", **GPS)}),
}  # fmt: skip
