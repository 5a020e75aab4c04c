"""Copies, brackets and turned pictures of one place count once, and do not stretch a tour."""

import shutil
from itertools import pairwise

import numpy as np
import OpenImageIO
import pytest
from registration_samples import street_image

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import distance_between
from omnisyn_cli.poses.estimation import PictureOptions, estimate_poses

SIZE, OPTIONS = (256, 512), PictureOptions(threads=1)


def write(path, picture, quality=95):
    """A JPEG of a picture, in [0, 1]."""
    spec = OpenImageIO.ImageSpec(SIZE[1], SIZE[0], 3, "uint8")
    spec.attribute("Compression", f"jpeg:{quality}")
    writer = OpenImageIO.ImageOutput.create(str(path))
    assert writer.open(str(path), spec)
    assert writer.write_image(np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8))
    assert writer.close()
    return path


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("places")
    first, second = (street_image(index, SIZE) for index in range(2))
    paths = {"a": write(folder / "a.jpg", first), "b": write(folder / "b.jpg", second)}
    paths["copy"] = shutil.copy(paths["a"], folder / "copy.jpg")
    paths["small"] = write(folder / "small.jpg", first, quality=40)
    paths["dark"] = write(folder / "dark.jpg", (first**2.2 / 4) ** (1 / 2.2))
    paths["bright"] = write(folder / "bright.jpg", (first**2.2 * 4) ** (1 / 2.2))
    paths["turned"] = write(folder / "turned.jpg", np.roll(first, 60, axis=1))
    return paths


def test_a_place_counts_once(photographs):
    """The neighbours are two metres apart on average, whatever other files there are of the first place."""
    repeats = ("copy", "small", "dark", "bright", "turned")
    found = estimate_poses([photographs[name] for name in ("a", *repeats, "b")], (2.0,), OPTIONS)
    assert list(found.panoramas) == ["a.jpg", "b.jpg"]
    assert [distance_between(p.pose, q.pose) for p, q in pairwise(found.panoramas.values())] == pytest.approx([2.0])
    places = " and ".join(f"{name}.jpg" for name in ("a", *repeats))
    assert f"{places} were taken from one place; only a.jpg is used" in found.notes


def test_one_place_alone_is_no_tour_unless_the_camera_was_turned(photographs):
    with pytest.raises(PoseError, match=r"copy\.jpg: expected pictures from two places, got one place \(copies"):
        estimate_poses([photographs["a"], photographs["copy"]], (), OPTIONS)
    turned = estimate_poses([photographs["a"], photographs["turned"]], (), OPTIONS)
    assert not turned.panoramas["turned.jpg"].pose.position.any()
