"""The arrays of the OmniSyn authors' example: ``rotations.npy`` and ``translations.npy`` beside the panoramas.

In their renderer a direction d of the reference view is looked up in panorama i along ``rotations[i] · d``, and
``translations[i]`` is the reference seen from panorama i, in the reference's axes: the pose is ``rotationsᵀ`` and
``−translations``, with x right, y up, −z forward as here. Pickled arrays are refused.

Source: AugmentariumLab/omnisyn, ``data_readers/carla_reader.py`` (``calculate_rot_trans``) and
``helpers/my_torch_helpers.py`` (``rotate_equirectangular_image``).
"""

from pathlib import Path

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.poses.entries import checked_rotation
from omnisyn_cli.poses.formats.files import images_in, read_array, usual_folder
from omnisyn_cli.poses.formats.model import ImportedPoses, ImportedView, ImportOptions

ROTATIONS, TRANSLATIONS = "rotations.npy", "translations.npy"


def read_authors(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of a folder with the two arrays, ``(n, 3, 3)`` and ``(n, 3)``; leading axes of length 1 are dropped."""
    folder = source if source.is_dir() else source.parent
    rotations, translations = read_array(folder / ROTATIONS), read_array(folder / TRANSLATIONS)
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
    images, order = _images(usual_folder(folder, options), count)
    views = tuple(ImportedView(path.name, poses[index], path) for index, path in images)
    return ImportedPoses(views, ("distances: metres, as in CARLA", f"images: {order}"))


def _images(folder: Path, count: int) -> tuple[list[tuple[int, Path]], str]:
    """Index into the arrays and file of every panorama: by order, or by number where some are missing."""
    paths = images_in(folder)
    if len(paths) == count:
        return list(enumerate(paths)), "named in the natural order of their file names"
    numbered = {int(path.stem): path for path in paths if path.stem.isdecimal()}
    if paths and len(numbered) == len(paths) and max(numbered) < count:
        return sorted(numbered.items()), f"file names are taken as indices into the arrays ({count} poses)"
    raise PoseError(
        f"{folder}: expected {count} panoramas, one for each pose, got {len(paths)}; name the folder with --images"
    )
