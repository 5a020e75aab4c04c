"""Bare numbers: TUM (time stamp, position, quaternion), KITTI (3×4 matrices), the authors' two arrays, Habitat.

TUM lines are ``timestamp tx ty tz qx qy qz qw``, KITTI lines the twelve numbers of ``[R | t]`` row by row, both
camera-to-world. Neither says what the axes are: usually OpenCV's (x right, y down, z forward) in the world of the first
camera, which ``--camera-axes`` and ``--up`` overrule. Panoramas are matched by time stamp or by the order of names.

Renders of Habitat (Matterport3D, Replica) lie as PanoGRF and PanSplat keep them, a folder per panorama:
``NN/{rgb.png, depth.png, rot.txt, tran.txt}``, a 3×3 camera-to-world rotation, the position of the camera in metres, in
Habitat's frame: x right, y up, −z forward, which is ours. ``depth.png`` holds 16-bit millimetres along the ray.

Source: TUM RGB-D benchmark, "File Formats"; KITTI odometry benchmark, development kit; PanSplat,
``src/dataset/dataset_mp3d.py`` (``convert_poses``); PanoGRF's data preparation.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, quaternion_from_rotation, rotation_angle
from omnisyn_cli.io.documents import read_text
from omnisyn_cli.poses.entries import checked_quaternion, checked_rotation
from omnisyn_cli.poses.formats import files
from omnisyn_cli.poses.formats.files import ImportedPoses, ImportedView, ImportOptions

# How :func:`tum_text` keeps names, which the format has no place for: ``# image TIMESTAMP NAME``.
NAME_COMMENT = "# image "


def read_tum(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of a TUM trajectory."""
    stamped: dict[float, Pose] = {}
    for number, line in files.data_lines(source):
        where = f"{source}:{number}"
        values = files.numbers(where, line.replace(",", " ").split(), 8, "timestamp tx ty tz qx qy qz qw")
        if values[0] in stamped:
            raise PoseError(f"{where}: expected every time stamp once, got {values[0]!r} again; remove one line")
        foreign = Pose(checked_quaternion(where, values[[7, 4, 5, 6]]), values[1:4])
        stamped[float(values[0])] = options.pose(foreign, camera="opencv", up="-y")
    _check_any(source, stamped)
    return _named_by_time(source, stamped, options)


def read_kitti(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of a KITTI trajectory, for the panoramas of a folder in natural order of their names."""
    poses = []
    for number, line in files.data_lines(source):
        where = f"{source}:{number}"
        matrix = files.numbers(where, line.split(), 12, "the rows of a 3×4 matrix").reshape(3, 4)
        foreign = Pose(checked_rotation(where, matrix[:, :3]), matrix[:, 3])
        poses.append(options.pose(foreign, camera="opencv", up="-y"))
    _check_any(source, poses)
    return _named_in_order(source, poses, options)


def tum_text(poses: Mapping[str, Pose]) -> str:
    """A TUM trajectory in OpenCV axes with the numbers of the panoramas as time stamps, their names in comments."""
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for number, (name, pose) in enumerate(poses.items()):
        foreign = files.foreign_from_pose(pose, camera="opencv", up="-y")
        w, x, y, z = quaternion_from_rotation(foreign.rotation).tolist()
        values = [*foreign.position.tolist(), x, y, z, w]
        lines += [f"{NAME_COMMENT}{number} {name}", " ".join([str(number), *map(repr, values)])]
    return "\n".join(lines) + "\n"


def _check_any(source: Path, poses: Sequence[Pose] | Mapping[float, Pose]) -> None:
    if not poses:
        raise PoseError(f"{source}: expected at least one pose, got none; check the file")


def _named_by_time(source: Path, stamped: Mapping[float, Pose], options: ImportOptions) -> ImportedPoses:
    """Names by what the file or a ``rgb.txt`` beside it says, by file names that are time stamps, or by order."""
    association, folder = _associations(source), files.default_folder(source.parent, options)
    if association:
        note = "images: named by the time stamps that the trajectory, or rgb.txt beside it, lists"
    else:
        stamps = {path.name: _stamp(path.stem) for path in files.images_in(folder)}
        association = {stamp: name for name, stamp in stamps.items() if stamp is not None}
        note = f"images: named by time stamp, within {options.time_tolerance:g} s"
    pairs = _matched(stamped, association, options.time_tolerance)
    if pairs is None:
        return _named_in_order(source, list(stamped.values()), options)
    folders = [source.parent, folder]
    views = tuple(files.find_view(str(source), name, stamped[stamp], folders, options) for stamp, name in pairs)
    without = len(stamped) - len(views)
    left_out = f"left out: {without} poses without a panorama" if without else ""
    return ImportedPoses(views, _notes(options, note, left_out))


def _associations(source: Path) -> dict[float, str]:
    """Time stamps and names from comments of the trajectory, or from the benchmark's ``rgb.txt``."""
    lines = enumerate(read_text(source).splitlines(), start=1)
    pairs = [(f"{source}:{at}", line[len(NAME_COMMENT) :]) for at, line in lines if line.startswith(NAME_COMMENT)]
    table = source.parent / "rgb.txt"
    if not pairs and table.is_file() and table != source:
        pairs = [(f"{table}:{at}", line) for at, line in files.data_lines(table)]
    found = {}
    for where, pair in pairs:
        first, _, name = pair.partition(" ")
        stamp = _stamp(first)
        if stamp is None or not name.strip():
            raise PoseError(f"{where}: expected a time stamp and a file name, got '{pair:.60}'; correct the line")
        found[stamp] = name.strip()
    return found


def _stamp(text: str) -> float | None:
    try:
        stamp = float(text)
    except ValueError:
        return None
    return stamp if math.isfinite(stamp) else None


def _matched(
    stamped: Mapping[float, Pose], association: Mapping[float, str], tolerance: float
) -> list[tuple[float, str]] | None:
    """Pairs of the nearest time stamps, if all poses or all images find a partner of their own; else None."""
    if not association:
        return None
    stamps, pairs = np.array(list(stamped)), {}
    for stamp, name in association.items():
        nearest = float(stamps[np.argmin(np.abs(stamps - stamp))])
        if abs(nearest - stamp) <= tolerance and nearest not in pairs:
            pairs[nearest] = name
    is_whole = len(pairs) in (len(stamped), len(association))
    return [(stamp, pairs[stamp]) for stamp in stamped if stamp in pairs] if is_whole else None


def _named_in_order(source: Path, poses: Sequence[Pose], options: ImportOptions) -> ImportedPoses:
    folder = files.default_folder(source.parent, options)
    paths = files.images_in(folder)
    if len(paths) != len(poses):
        raise PoseError(
            f"{source}: expected as many panoramas as poses ({len(poses)}), got {len(paths)} in '{folder}'; "
            "name the folder with --images, or name the panoramas by their time stamps"
        )
    views = tuple(ImportedView(path.name, pose, path) for path, pose in zip(paths, poses, strict=True))
    return ImportedPoses(views, _notes(options, "images: named in the natural order of their file names"))


def _notes(options: ImportOptions, *of_names: str) -> tuple[str, ...]:
    axes = "cameras: taken to have x right, y down, z forward (OpenCV); --camera-axes says otherwise"
    up = "world: y is taken to point down, as in the world of a first camera; --up says otherwise"
    distances = "distances: as the trajectory has them, taken as metres"
    told = {distances: True, axes: options.camera is None, up: options.up is None}
    return files.noted({**told, **{n: n for n in of_names}})


ROTATIONS, TRANSLATIONS = "rotations.npy", "translations.npy"


def read_authors(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of a folder with the two arrays, ``(n, 3, 3)`` and ``(n, 3)``; leading axes of length 1 are dropped.

    In the renderer of OmniSyn's authors a direction d of the reference view is looked up in panorama i along
    ``rotations[i] · d``, and ``translations[i]`` is the reference seen from panorama i, in the reference's axes: the
    pose is ``rotationsᵀ`` and ``−translations``, with axes as here. Pickled arrays are refused. Source:
    AugmentariumLab/omnisyn, ``carla_reader.py`` (``calculate_rot_trans``), ``my_torch_helpers.py``
    (``rotate_equirectangular_image``).
    """
    folder = source if source.is_dir() else source.parent
    rotations, translations = files.read_array(folder / ROTATIONS), files.read_array(folder / TRANSLATIONS)
    count = translations.size // 3
    if rotations.shape[-3:] != (count, 3, 3) or rotations.size != 9 * count or translations.shape[-2:] != (count, 3):
        raise PoseError(
            f"{folder}: expected {ROTATIONS} (n, 3, 3) and {TRANSLATIONS} (n, 3), got {rotations.shape} and "
            f"{translations.shape}; check that they belong together"
        )
    pairs = zip(rotations.reshape(count, 3, 3), translations.reshape(count, 3), strict=True)
    poses = [
        options.pose(
            Pose(checked_rotation(f"{folder / ROTATIONS}[{index}]", rotation).T, -translation), camera="opengl", up="y"
        )
        for index, (rotation, translation) in enumerate(pairs)
    ]
    images, order = _images(files.default_folder(folder, options), count)
    views = tuple(ImportedView(path.name, poses[index], path) for index, path in images)
    return ImportedPoses(views, ("distances: metres, as in CARLA", f"images: {order}"))


def _images(folder: Path, count: int) -> tuple[list[tuple[int, Path]], str]:
    """Index into the arrays and file of every panorama: by order, or by number where some are missing."""
    paths = files.images_in(folder)
    if len(paths) == count:
        return list(enumerate(paths)), "named in the natural order of their file names"
    numbered = {int(path.stem): path for path in paths if path.stem.isdecimal()}
    if paths and len(numbered) == len(paths) and max(numbered) < count:
        return sorted(numbered.items()), f"file names are taken as indices into the arrays ({count} poses)"
    raise PoseError(f"{folder}: expected {count} panoramas, one per pose, got {len(paths)}; give --images")


MIN_NOTED_ROTATION = 1e-6  # Radians; smaller rotations are rounding and get no note


def habitat_folders(folder: Path) -> list[Path]:
    """The folders of the single panoramas, in natural order."""
    found = [path for path in files.entries(folder) if (path / "rot.txt").is_file() and (path / "tran.txt").is_file()]
    return sorted(found, key=lambda path: files.natural_key(path.name))


def read_habitat(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of a scene: a folder with a folder per panorama."""
    folders = habitat_folders(source) if source.is_dir() else []
    if not folders:
        raise PoseError(f"{source}: expected folders with rot.txt and tran.txt, got none; give the folder of one scene")
    views = []
    for folder in folders:
        image, depth = _panorama(folder), folder / "depth.png"
        pose, name = habitat_pose(folder, options), f"{folder.name}/{image.name}"
        views.append(ImportedView(name, pose, image, depth if depth.is_file() else None))
    are_turned = any(float(rotation_angle(view.pose.rotation)) > MIN_NOTED_ROTATION for view in views)
    notes = {
        "distances: metres": True,
        "depth: 16-bit millimetres along the ray, where there is a depth.png": True,
        "rotations: rot.txt is read as camera-to-world, as PanSplat does": are_turned,
    }
    return ImportedPoses(tuple(views), files.noted(notes))


def habitat_pose(folder: Path, options: ImportOptions | None = None) -> Pose:
    """Where the panorama of a folder with ``rot.txt`` and ``tran.txt`` was taken; PoseError: missing or malformed."""
    rotation = checked_rotation(f"{folder / 'rot.txt'}", _values(folder / "rot.txt", 9, "a 3×3 rotation").reshape(3, 3))
    position = _values(folder / "tran.txt", 3, "a position")
    return (options or ImportOptions()).pose(Pose(rotation, position), camera="opengl", up="y")


def _values(path: Path, count: int, what: str) -> np.ndarray:
    fields = [field for _, line in files.data_lines(path) for field in line.replace(",", " ").split()]
    return files.numbers(str(path), fields, count, what)


def _panorama(folder: Path) -> Path:
    """``rgb.*``, or the only image that is not a depth map."""
    images = [path for path in files.images_in(folder) if not path.stem.startswith("depth")]
    named = [path for path in images if path.stem == "rgb"] or images
    if len(named) != 1:
        raise PoseError(f"{folder}: expected one panorama (rgb.png), got {len(named)} images; name it rgb.png")
    return named[0]
