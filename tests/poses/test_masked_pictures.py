"""The roof of a car looks as if nobody had moved: what may not be used must not be looked at."""

import math

import cv2
import numpy as np
import pytest
from registration_samples import street_image, street_truth

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import rotation_angle
from omnisyn_cli.io import write_image
from omnisyn_cli.io.images import outside_nadir
from omnisyn_cli.poses.estimation import PictureOptions, check_poses, estimate_poses
from omnisyn_cli.poses.file import PosedPanorama, PoseFile
from omnisyn_cli.poses.registration.scan import scan_panorama

SIZE = (512, 1024)
ROOF = math.radians(60)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Two panoramas of a street with one roof below both cameras, and its mask."""
    folder = tmp_path_factory.mktemp("roof")
    texture = np.random.default_rng(0).random((128, 256, 3), np.float32)
    roof = cv2.resize(texture, SIZE[::-1], interpolation=cv2.INTER_CUBIC).clip(0.0, 1.0)
    is_street = outside_nadir(SIZE, ROOF)[..., None]
    paths = [folder / name for name in ("a.png", "b.png", "mask.png")]
    for index, path in enumerate(paths[:2]):
        write_image(path, np.where(is_street, street_image(index, SIZE), roof).astype(np.float32))
    write_image(paths[2], np.repeat(is_street, 3, axis=2).astype(np.float32))
    return paths


def relative_pose(found):
    first, second = (found.panoramas[name].pose for name in ("a.png", "b.png"))
    return first.inverse() @ second


def test_without_a_mask_the_roof_says_that_nobody_has_moved(photographs):
    first, second, _ = photographs
    assert not relative_pose(estimate_poses((first, second), (1.0,), PictureOptions(threads=1))).position.any()


@pytest.mark.parametrize("how", ["nadir", "masks"])
def test_what_may_not_be_used_is_not_looked_at(photographs, how):
    first, second, mask = photographs
    options = PictureOptions(threads=1, **({"nadir": ROOF} if how == "nadir" else {"masks": (mask, mask)}))
    found, truth = relative_pose(estimate_poses((first, second), (1.0,), options)), street_truth()
    direction = truth.position / np.linalg.norm(truth.position)
    assert np.degrees(np.arccos(min(1.0, found.position @ direction))) < 2.0
    assert np.degrees(rotation_angle(found.rotation.T @ truth.rotation)) < 0.2


def test_masks_and_the_cap_reach_poses_that_are_checked(photographs, monkeypatch):
    first, second, mask = photographs
    looked_at = []

    def find_features(image, usable, threads):
        looked_at.append(usable)
        raise InterruptedError

    monkeypatch.setattr("omnisyn_cli.poses.estimation.find_features", find_features)
    poses = PoseFile(first.parent / "poses.json", dict.fromkeys(("a.png", "b.png"), PosedPanorama(street_truth())))
    with pytest.raises(InterruptedError):
        next(check_poses((first, second), poses, PictureOptions(masks=(mask, mask), nadir=ROOF / 2)))
    np.testing.assert_array_equal(looked_at[0], outside_nadir(SIZE, ROOF))


def test_another_number_of_masks_is_refused(photographs):
    first, second, mask = photographs
    with pytest.raises(InputError, match="expected one mask for each of 2 panoramas, got 1"):
        estimate_poses((first, second), (1.0,), PictureOptions(masks=(mask,)))


@pytest.mark.parametrize(
    ("columns", "is_masked", "meets"), [(512, False, True), (300, False, False), (300, True, True)]
)
def test_edges_that_do_not_meet_tell_a_part_of_the_sphere(columns, is_masked, meets):
    """Unless those that may not be used are among them."""
    image = street_image(0)[: columns // 2, :columns]
    usable = np.arange(columns) > 0 if is_masked else np.ones(columns, bool)
    assert scan_panorama(image, np.tile(usable, (len(image), 1)), threads=1).meets_at_seam == meets
