"""The surfaces of a tour: those that frames are made of, pair by pair, and one for each panorama."""

from pathlib import Path

import numpy as np
import pytest

from interpolation_samples import CHAIN, Hall, job_of
from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.interpolation.loading import PanoramaSurface, panorama_surfaces, tour_surfaces
from omnisyn_cli.interpolation.plan import TourPlan, plan_tour
from omnisyn_cli.io import write_image
from omnisyn_cli.types import DepthEstimate, View
from synthesis_samples import SIZE, as_bytes, distance_to_wall, hall_image, write_hall, write_mask


def surfaces_of(plan: TourPlan, **options: object) -> list[PanoramaSurface]:
    return list(panorama_surfaces(tour_surfaces(plan, **options)))


def test_every_pair_has_both_views_with_their_depth_and_mesh(tmp_path: Path) -> None:
    plan = plan_tour(job_of(tmp_path, write_hall(tmp_path, CHAIN)))
    pairs = list(tour_surfaces(plan))
    assert [[surface.index for surface in pair.surfaces] for pair in pairs] == [[0, 1], [1, 2]]
    for pair in pairs:
        assert pair.cross_check.confidence.score > 0.9
        for surface in pair.surfaces:
            pose = CHAIN[surface.index]
            np.testing.assert_allclose(surface.view.pose.position, pose.position)
            np.testing.assert_allclose(1 / surface.mesh.inverse_depth, distance_to_wall(pose, SIZE), rtol=1e-5)
            np.testing.assert_array_equal(surface.texture(), as_bytes(hall_image(pose)))


def test_every_panorama_has_one_surface_of_what_both_its_pairs_found(tmp_path: Path) -> None:
    plan = plan_tour(job_of(tmp_path, write_hall(tmp_path, CHAIN, with_depth=False), fallback="none"))
    left = np.arange(SIZE[1]) < SIZE[1] // 2
    knows = iter([left, ~left])

    def estimator(first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        known = np.broadcast_to(next(knows), SIZE).astype(np.float32)
        estimate = DepthEstimate(np.where(known > 0, np.float32(0.25), np.float32(0.7)), known)
        return estimate, estimate

    first, middle, last = surfaces_of(plan, estimator=estimator)
    assert [first.index, middle.index, last.index] == [0, 1, 2]
    np.testing.assert_array_equal(middle.mesh.inverse_depth, np.float32(0.25))
    for end, known in ((first, left), (last, ~left)):
        np.testing.assert_array_equal(end.mesh.inverse_depth == np.float32(0.25), np.broadcast_to(known, SIZE))


def test_a_panorama_that_one_neighbour_shares_its_place_with_has_the_surface_of_the_other_pair(tmp_path: Path) -> None:
    poses = [CHAIN[0], CHAIN[1], CHAIN[1]]
    plan = plan_tour(job_of(tmp_path, write_hall(tmp_path, poses, with_depth=False)))
    found = DepthEstimate(np.full(SIZE, 0.25, np.float32), np.ones(SIZE, np.float32))
    middle = surfaces_of(plan, estimator=lambda *_: (found, found))[1]
    assert middle.depth is found


def test_masked_pixels_have_no_surface_and_no_colour_of_their_own(tmp_path: Path, pair: Hall) -> None:
    painted = as_bytes(hall_image(CHAIN[0]))
    painted[48:] = 255
    write_image(pair.images[0], painted)
    masks = write_mask(tmp_path / "mask 0.png", 48), write_mask(tmp_path / "mask 1.png", SIZE[0])
    first, second = surfaces_of(plan_tour(pair.job(masks=masks)))
    assert (first.mesh.inverse_depth[48:] < 0).all()
    assert (first.mesh.inverse_depth[:48] > 0).all()
    assert (second.mesh.inverse_depth > 0).all()
    assert first.texture().max() <= painted[:48].max() / 255 + 1e-6


def test_panoramas_of_one_place_are_as_far_as_the_sky(tmp_path: Path) -> None:
    plan = plan_tour(job_of(tmp_path, write_hall(tmp_path, [CHAIN[0]] * 2, with_depth=False)))
    for surface in surfaces_of(plan):
        assert not surface.depth.inverse_depth.any()


def test_a_tour_is_refused_as_a_video_is_but_for_its_place(tmp_path: Path, chain: Hall) -> None:
    with pytest.raises(InputError, match="two or more panoramas, got 1"):
        plan_tour(job_of(tmp_path, chain.images[:1]))
    (tmp_path / "other.png").write_bytes(chain.images[0].read_bytes())
    with pytest.raises(PoseError, match=r"other\.png"):
        plan_tour(job_of(tmp_path, [*chain.images, tmp_path / "other.png"]))
    plan_tour(chain.job(output=tmp_path / "no such folder" / "model.glb"))
