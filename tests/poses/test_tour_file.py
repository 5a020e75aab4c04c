"""A tour file says what a tour shows, or what is wrong with it; links follow from positions unless they are written."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.interpolation.inputs import NamedTour, along_path, named_tour
from omnisyn_cli.poses.file import PosedPanorama, read_poses, write_poses
from omnisyn_cli.poses.tour import Tour, chain_links, links_between
from omnisyn_cli.poses.tour_file import read_tour
from synthesis_samples import posed

PLACES = {"a": (0, 0, 0), "b": (2, 0, 0), "c": (4, 0, 0), "d": (2, 0, 2), "e": (2, 0, -2.5)}  # A crossing at b.


def tour_of(folder: Path, document: dict[str, Any] | None = None, names: str = "abcde", **options: Any) -> Tour:
    write_poses(folder / "poses.json", {f"{name}.jpg": PosedPanorama(posed(at)) for name, at in PLACES.items()})
    (folder / "clock.jpg").write_bytes(b"")
    path = None
    if document is not None:
        path = folder / "tour.json"
        path.write_text(json.dumps({"version": 1, **document}))
    images = [folder / f"{name}.jpg" for name in names]
    return read_tour(path, images, read_poses(folder / "poses.json"), "a tour", **options)


def link_names(tour: Tour) -> set[str]:
    return {first[0] + second[0] for first, second in tour.links}


def test_links_follow_from_positions_and_lead_everywhere(tmp_path: Path) -> None:
    tour = tour_of(tmp_path)
    assert link_names(tour) == {"ab", "bc", "bd", "be"}
    assert tour.shortest_path("a.jpg", "e.jpg") == ("a.jpg", "b.jpg", "e.jpg")
    assert tour.path_through(["a.jpg", "c.jpg", "d.jpg"]) == ("a.jpg", "b.jpg", "c.jpg", "b.jpg", "d.jpg")


@pytest.mark.parametrize("seed", range(3))
def test_links_of_random_places_connect_all_and_follow_the_definition(seed: int) -> None:
    places = np.random.default_rng(seed).uniform(0, 9, (12, 3))
    names = [str(k) for k in range(12)]
    distance = np.linalg.norm(places[:, None] - places[None], axis=-1)
    brute = {
        (names[a], names[b])
        for a in range(12) for b in range(a + 1, 12)
        if not any(max(distance[a, c], distance[b, c]) < distance[a, b] for c in range(12) if c not in (a, b))
    }  # fmt: skip
    found = links_between(names, places)
    assert set(found) == brute
    reached = {names[0]}
    for _ in names:
        reached |= {name for link in found if reached & set(link) for name in link}
    assert reached == set(names)


def test_panoramas_that_do_not_match_are_not_linked() -> None:
    """A wall between a and b: the way leads around it, over c and d."""
    places = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 3], [1, 0, 3]], float)
    assert links_between("abcd", places) == (("a", "b"), ("a", "c"), ("b", "d"), ("c", "d"))
    around = [("a", "c"), ("c", "d"), ("d", "b"), ("a", "d")]
    assert links_between("abcd", places, around) == (("a", "c"), ("b", "d"), ("c", "d"))


def test_a_pair_that_matches_from_afar_is_not_linked_where_a_chain_leads_there() -> None:
    places = np.array([(0.1 * (k % 2), 0, -k) for k in range(5)])
    assert links_between("abcde", places, ["ab", "bc", "cd", "de", "ae"]) == chain_links("abcde")


def test_a_square_grid_has_no_links_across() -> None:
    places = np.array([(x, 0, z) for x in range(3) for z in range(3)], float) * 0.7
    assert len(links_between([str(k) for k in range(9)], places)) == 12


def test_a_chain_links_each_to_the_next_once() -> None:
    assert chain_links("abcba") == (("a", "b"), ("b", "c"))
    assert chain_links("aab") == (("a", "b"),)


def test_all_that_may_be_written_is_read(tmp_path: Path) -> None:
    tour = tour_of(tmp_path, {
        "title": "Town hall",
        "start": {"panorama": "b.jpg", "yaw": 90, "pitch": -5, "fov": 75},
        "links": [["b.jpg", "a.jpg"], ["a.jpg", "b.jpg"], ["b.jpg", "c.jpg"]],
        "panoramas": {"a.jpg": {"title": "Door <b>", "caption": "Built\nin 1905.", "hotspots": [
            {"text": "Right", "yaw": 90, "link": "https://example.org/?a=1&b=2"},
            {"text": "Clock", "point": [0, 3, -3], "image": "clock.jpg"},
        ]}},
        "hotspots": [{"text": "Tower", "point": [0, 9, 0]}],
        "plan": {"image": "clock.jpg", "points": [{"pixel": [10, 10], "panorama": "a.jpg"},
                                                  {"pixel": [10, 50], "position": [4, 0, 0]}]},
    })  # fmt: skip
    assert (tour.title, link_names(tour), tour.start.panorama) == ("Town hall", {"ab", "bc"}, "b.jpg")
    np.testing.assert_allclose([tour.start.yaw, tour.start.pitch, tour.start.fov], np.radians([90, -5, 75]))
    door = tour.by_name["a.jpg"]
    assert (door.title, door.caption, tour.by_name["b.jpg"].title) == ("Door <b>", "Built\nin 1905.", "b")
    right, clock = door.hotspots
    np.testing.assert_allclose(right.direction_from(door.pose), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(clock.direction_from(door.pose), [0, 0.5**0.5, -(0.5**0.5)], atol=1e-12)
    assert clock.image == tmp_path / "clock.jpg"
    np.testing.assert_allclose(tour.plan.position_of(0.0, 30.0), [2, 1], atol=1e-9)


def test_the_pose_file_may_say_it_too_and_is_written_with_it(tmp_path: Path) -> None:
    entries = {
        "a.jpg": PosedPanorama(posed((0, 0, 0)), title="Door", caption="Here."),
        "b.jpg": PosedPanorama(posed((1, 0, 0))),
    }
    write_poses(tmp_path / "poses.json", entries, links=[("b.jpg", "a.jpg")])
    poses = read_poses(tmp_path / "poses.json")
    tour = read_tour(None, [tmp_path / "a.jpg", tmp_path / "b.jpg"], poses, "t")
    assert (tour.links, tour.panoramas[0].title, tour.panoramas[0].caption) == ((("a.jpg", "b.jpg"),), "Door", "Here.")


def spot(**values: Any) -> dict[str, Any]:
    return {"panoramas": {"a.jpg": {"hotspots": [{"text": "x", **values}]}}}


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"titel": "x"}, "did you mean 'title'"),
        ({"title": "a\u0007b"}, "without control characters"),
        ({"links": [["a.jpg", "a.jpg"]]}, "two different panoramas"),
        ({"links": [["a.jpg", "z.jpg"]]}, "links: expected the name of a panorama, got 'z.jpg'"),
        ({"start": {"panorama": "z.jpg"}}, "start.panorama: expected the name"),
        (spot(link="javascript:alert(1)", yaw=0), "begins with https"),
        (spot(link="https://a.org/\">", yaw=0), "begins with https"),
        (spot(link="data:text/html,x", yaw=0), "begins with https"),
        (spot(), "either yaw and pitch, or a point, got neither"),
        (spot(yaw=0, point=[0, 0, 0]), "got both"),
        (spot(yaw=0, image="../secret.jpg"), "leading out of the folder"),
        (spot(yaw=0, image="none.jpg"), "got no file 'none.jpg'"),
        ({"hotspots": [{"text": "x", "yaw": 0}]}, "expected a point, got a direction"),
        ({"plan": {"image": "clock.jpg", "points": [{"pixel": [0, 0], "panorama": "a.jpg"}] * 2}}, "different pixels"),
        ({"plan": {"image": "clock.jpg", "points": [{"pixel": [0, 0]}] * 2}}, "a panorama or a position"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, document: dict[str, Any], words: str) -> None:
    with pytest.raises(PoseError, match=words) as error:
        tour_of(tmp_path, document)
    assert "\n" not in str(error.value)


def test_a_picture_behind_a_link_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "secret.jpg").write_bytes(b"")
    folder = tmp_path / "tour"
    folder.mkdir()
    (folder / "plan.jpg").symlink_to(tmp_path / "secret.jpg")
    document = {"hotspots": [{"text": "x", "point": [0, 0, 0], "image": "plan.jpg"}]}
    with pytest.raises(PoseError, match="leads out of it"):
        tour_of(folder, document)
    assert tour_of(folder, document, allow_outside=True).hotspots[0].image == folder / "plan.jpg"


def test_links_of_the_pose_file_name_its_panoramas(tmp_path: Path) -> None:
    tour_of(tmp_path)
    document = json.loads((tmp_path / "poses.json").read_text())
    (tmp_path / "poses.json").write_text(json.dumps({**document, "links": [["a.jpg", "z.jpg"]]}))
    with pytest.raises(PoseError, match="they have no entry"):
        read_poses(tmp_path / "poses.json")


def path_in(folder: Path, path: str) -> NamedTour:
    tour_of(folder)
    for name in PLACES:
        (folder / f"{name}.jpg").write_bytes(b"")
    return along_path(named_tour([folder]), path)


@pytest.mark.parametrize(
    ("path", "names"), [("a,e", "abe"), ("a.jpg, c,d", "abcbd"), ("c,b", "cb")], ids=["two ends", "through", "a link"]
)
def test_a_path_goes_along_links(tmp_path: Path, path: str, names: str) -> None:
    tour = path_in(tmp_path, path)
    assert ("".join(image.stem for image in tour.images), tour.is_chain) == (names, True)
    assert tour.output(".mp4") == Path(f"{names[0]}-{names[-1]}.mp4")


@pytest.mark.parametrize(("path", "words"), [("a,z", "got 'z'; choose from"), ("a", "two or more"), ("", "got ''")])
def test_a_path_that_is_none_is_refused(tmp_path: Path, path: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        path_in(tmp_path, path)
