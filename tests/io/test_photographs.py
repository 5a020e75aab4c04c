import numpy as np
import pytest
from io_samples import smooth_image, write_with

from omnisyn_cli.errors import ImageError, InputError
from omnisyn_cli.geometry.sphere import pixel_directions, solid_angles
from omnisyn_cli.io import list_photographs, read_photographs
from omnisyn_cli.io.images import MAX_PHOTOGRAPH_SIDE, outside_nadir


def test_photographs_of_any_kind_are_read_in_the_order_of_their_names(tmp_path):
    """Subfolders, grey, 16 bits, turned by a tag, alpha: upright RGB of 8 bits."""
    (tmp_path / "below").mkdir()
    plain = smooth_image(20, 30)
    write_with(tmp_path / "b.png", plain)
    write_with(tmp_path / "a.png", smooth_image(20, 30, 1))
    write_with(tmp_path / "below" / "c.tif", plain.astype(np.uint16) * 257)
    write_with(tmp_path / "d.tif", plain, Orientation=6)
    write_with(tmp_path / "e.png", smooth_image(20, 30, 4))
    (tmp_path / "read.me").write_text("text")
    names = [path.relative_to(tmp_path).as_posix() for path in list_photographs(tmp_path)]
    assert names == ["a.png", "b.png", "below/c.tif", "d.tif", "e.png"]
    grey, colour, deep, turned, opaque = read_photographs(tmp_path)
    np.testing.assert_array_equal(colour, plain)
    np.testing.assert_array_equal(deep, plain)
    np.testing.assert_array_equal(grey, np.repeat(smooth_image(20, 30, 1), 3, axis=2))
    np.testing.assert_array_equal(turned, np.rot90(plain, -1))
    assert opaque.shape == (20, 30, 3)
    assert all(image.dtype == np.uint8 for image in (grey, colour, deep, turned, opaque))


def test_large_photographs_are_reduced(tmp_path):
    write_with(tmp_path / "wide.png", np.full((300, 2 * MAX_PHOTOGRAPH_SIDE, 3), 80, np.uint8))
    (image,) = read_photographs(tmp_path)
    assert image.shape == (150, MAX_PHOTOGRAPH_SIDE, 3)
    assert (image == 80).all()


def test_what_cannot_be_used_is_named(tmp_path):
    with pytest.raises(InputError, match="expected a folder of photographs"):
        list_photographs(tmp_path / "missing")
    with pytest.raises(InputError, match="put some into it"):
        list_photographs(tmp_path)
    write_with(tmp_path / "good.png", smooth_image())
    (tmp_path / "bad.jpg").write_bytes(b"")
    with pytest.raises(ImageError, match=r"bad\.jpg"):
        read_photographs(tmp_path)


@pytest.mark.parametrize("degrees", [5.0, 20.0, 45.0, 89.0])
@pytest.mark.parametrize("size", [(64, 128), (33, 66)])
def test_it_holds_the_pixels_within_the_angle(degrees, size):
    down = np.array([0.0, -1.0, 0.0])
    angle = np.degrees(np.arccos(np.clip(pixel_directions(*size) @ down, -1, 1)))
    np.testing.assert_array_equal(outside_nadir(size, np.radians(degrees)), angle >= degrees)


def test_its_share_of_the_sphere_is_that_of_a_cap():
    inside = ~outside_nadir((512, 1024), np.radians(30.0))
    share = solid_angles(512, 1024)[inside].sum() / (4 * np.pi)
    np.testing.assert_allclose(share, (1 - np.cos(np.radians(30.0))) / 2, rtol=0.01)
    assert inside[-1].all()


def test_an_angle_of_zero_leaves_everything():
    assert outside_nadir((8, 16), 0.0).all()
