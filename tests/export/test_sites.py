"""Sites for viewers: what their files say, read back. ``viewer/test_exported_sites.py`` opens them in the viewers."""

import json
import shlex
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from cli.cli_samples import Omnisyn
from export.export_samples import job_in, off_wall
from export.site_samples import LANDMARKS, LINKS, NEIGHBOUR, PLACES, direction_of, pose_of, write_tour
from interpolation_samples import CHAIN
from omnisyn_cli.errors import ImageError, InputError
from omnisyn_cli.geometry.sampling import sample_bilinear
from omnisyn_cli.geometry.sphere import normalize
from omnisyn_cli.interpolation import loading
from omnisyn_cli.interpolation.export import run as writers
from omnisyn_cli.interpolation.export.formats import ExportJob, plan_export
from omnisyn_cli.interpolation.export.run import run_export
from omnisyn_cli.interpolation.export.viewers import VIEWERS
from omnisyn_cli.interpolation.plan import InterpolationPlan
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.interpolation.summary import Summary
from omnisyn_cli.io import read_panorama, write_image
from omnisyn_cli.io.ffmpeg_process import read_frames
from omnisyn_cli.types import DepthEstimate, View

# krpano, "Coordinate Systems": x right, y down, z into the screen; 0/0 is the centre of the picture; 1 is 1 cm.
KRPANO_AXES = np.array([1.0, -1.0, -1.0])


def job_of_tour(tour: Path, output: Path) -> ExportJob:
    images = tuple(tour / f"{name}.png" for name in PLACES)
    return ExportJob(
        images, tour / "poses.json", output, format="krpano", threads=1, tour=tour / "tour.json", is_chain=False
    )


def flat(first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
    """Everything is two metres away."""
    far = np.full((32, 64), 0.5, np.float32)
    return (DepthEstimate(far, np.ones_like(far)),) * 2


@pytest.fixture
def tour(tmp_path: Path) -> Path:
    return write_tour(tmp_path / "tour")


@pytest.mark.parametrize("viewer", VIEWERS)
def test_a_site_is_complete_and_says_how_to_get_its_viewer(viewer, tour, tmp_path, omnisyn) -> None:
    site = tmp_path / "it's a site"
    depth = ["--preset", "fast", "--threads", 1] if VIEWERS[viewer].has_depth else []
    made = omnisyn.made("export", tour, "--format", viewer, "-o", site, *depth)
    assert f"{site}: 3 links of 4 panoramas" in made.out
    assert shlex.quote(f"{site}/vendor") in made.err
    files = {file.relative_to(site).as_posix() for file in site.rglob("*") if file.is_file()}
    names = [f"{index:04d}_{name}" for index, name in enumerate(("hall", "a_b____c_", "stairs", "garden"))]
    expected = {f"panoramas/{name}.jpg" for name in names} | {f"depth/{name}.depth" for name in names if depth}
    document, _ = VIEWERS[viewer].document
    assert files == expected | {"index.html", document, "vendor/package.json", "hotspots/0000.jpg"}
    page = (site / "index.html").read_text()
    assert "://" not in page
    assert "<title>A tour &lt;script&gt;alert(1)&lt;/script&gt;</title>" in page
    packages = json.loads((site / "vendor" / "package.json").read_text())["dependencies"]
    assert all(f"vendor/node_modules/{package}/" in page for package in packages)
    (site / "mine.txt").write_text("mine")
    assert "expected a new or empty folder" in omnisyn.refused("export", tour, "--format", viewer, "-o", site)


def test_another_site_in_its_place_leaves_nothing_of_the_former_one(tour: Path, tmp_path: Path, monkeypatch) -> None:
    """But files that others have put there stay."""
    site, shorter = tmp_path / "site", tuple(tour / f"{name}.png" for name in ("hall", "garden"))
    first = replace(job_of_tour(tour, site), overwrite=True)
    monkeypatch.setattr(loading, "make_estimator", lambda *_, **__: flat)
    run_export(plan_export(first))
    for name in ("mine.txt", "panoramas/mine.jpg"):
        (site / name).write_text("mine")
    (tour / "tour.json").write_text('{"version": 1}')
    run_export(plan_export(replace(first, images=shorter, format="photo-sphere-viewer")))
    files = {file.relative_to(site).as_posix() for file in site.rglob("*") if file.is_file()}
    panoramas = {"panoramas/0000_hall.jpg", "panoramas/0001_garden.jpg"}
    assert files == panoramas | {"index.html", "tour.json", "vendor/package.json", "mine.txt", "panoramas/mine.jpg"}


@pytest.mark.parametrize("end", [4, -20])
def test_a_damaged_picture_is_found_before_depth_is(tour: Path, tmp_path: Path, monkeypatch, end: int) -> None:
    """Without a header, and without an end."""
    picture = tour / "picture.png"
    picture.write_bytes(picture.read_bytes()[:end])

    def estimator(first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        raise AssertionError("expected no depth")

    monkeypatch.setattr(loading, "make_estimator", lambda *_, **__: estimator)
    with pytest.raises(ImageError, match=r"picture\.png"):
        run_export(plan_export(job_of_tour(tour, tmp_path / "site")))


def test_panoramas_are_level_and_look_north(tour: Path, tmp_path: Path, omnisyn: Omnisyn) -> None:
    omnisyn.made("export", tour, "--format", "marzipano", "-o", tmp_path / "site", "--texture", 512)
    scenes = json.loads((tmp_path / "site" / "tour.json").read_text())["scenes"]
    for name, scene in zip(PLACES, scenes, strict=True):
        picture = read_panorama(tmp_path / "site" / scene["panorama"]).image
        assert picture.shape == (256, 512, 3)
        for colour, place in LANDMARKS.values():
            np.testing.assert_allclose(sample_bilinear(picture, direction_of(*place)), np.divide(colour, 255), atol=0.1)
        for link in scene["linkHotspots"]:
            towards = direction_of(*np.degrees([link["yaw"], -link["pitch"]]))
            np.testing.assert_allclose(sample_bilinear(picture, towards), np.divide(NEIGHBOUR, 255), atol=0.1)
            there = list(PLACES)[[other["id"] for other in scenes].index(link["target"])]
            assert towards @ normalize(pose_of(there).position - pose_of(name).position) > 1 - 1e-9
    targets = [[link["target"] for link in scene["linkHotspots"]] for scene in scenes]
    assert sum(map(len, targets)) == 2 * len(LINKS)


def test_clips_begin_and_end_with_the_panoramas(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Level like them, in both directions; made of the depth files and masks of the tour, by the options of the job."""
    chain = CHAIN[1:]
    job = job_in(tmp_path, "site", chain=chain, format="marzipano", clips=True, preset="fast", cut=0.3)
    masks = tuple(tmp_path / f"mask{k}.png" for k in range(2))
    for mask in masks:
        write_image(mask, np.full((*read_panorama(job.images[0]).image.shape[:2], 3), 255, np.uint8))
    plans: list[InterpolationPlan] = []

    def made(plan: InterpolationPlan) -> Summary:
        plans.append(plan)
        return run_interpolation(plan)

    monkeypatch.setattr(writers, "run_interpolation", made)
    run_export(plan_export(replace(job, masks=masks)))
    (video,) = plans
    assert [entry.depth and entry.depth.resolve() for entry in video.entries] == [
        tmp_path / f"p{k}_depth.exr" for k in range(2)
    ]
    assert (video.config.depth.kind, video.config.cut, video.job.masks) == ("file", 0.3, masks)
    size = read_panorama(tmp_path / "site" / "panoramas" / "0000_p0.jpg").image.shape[:2]
    names = ("0000_p0", "0001_p1")
    ends = [read_panorama(tmp_path / "site" / "panoramas" / f"{name}.jpg").image for name in names]
    assert {file.name for file in (tmp_path / "site" / "clips").iterdir()} == {
        f"{names[0]}--{names[1]}.mp4", f"{names[1]}--{names[0]}.mp4",
    }  # fmt: skip
    for first, last in ((0, 1), (1, 0)):
        clip = tmp_path / "site" / "clips" / f"{names[first]}--{names[last]}.mp4"
        frames = list(read_frames(clip, size, 100))
        assert len(frames) == 37
        begin, half, end = (
            [np.abs(frames[k] / 255 - panorama).mean() for panorama in (ends[first], ends[last])] for k in (0, 18, -1)
        )
        assert 1.2 * max(begin[0], end[1]) < min(begin[1], *half, end[0])  # videos blur coloured waves of a few pixels


@pytest.mark.parametrize("kind", ["glb", "krpano", "photo-sphere-viewer"])
def test_only_pages_that_play_clips_get_them(tmp_path: Path, kind: str) -> None:
    with pytest.raises(InputError, match=r"expected clips with 'pannellum', 'marzipano', got"):
        plan_export(job_in(tmp_path, "site.glb" if kind == "glb" else "site", format=kind, clips=True))


def krpano_depth_file(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles as the parser does in krpano's documentation of the format: split at whitespace."""
    parsed = path.read_text().split()
    assert parsed[0] == "DEPTH"
    count = 3 * int(parsed[1])
    vertices = np.array(parsed[2 : 2 + count], np.float32).reshape(-1, 3)
    triangles = np.array(parsed[2 + count + 1 :], np.uint16).reshape(-1, 3)
    assert int(parsed[2 + count]) == len(triangles)
    return vertices, triangles


def krpano_numbers(element: ElementTree.Element | None, *names: str) -> np.ndarray:
    return np.array([float(element.attrib[name]) for name in names])


@pytest.fixture(scope="module")
def krpano(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("krpano")
    run_export(plan_export(job_in(folder, "site", format="krpano")))
    return folder / "site"


def test_krpano_has_the_surface_where_it_is(krpano: Path) -> None:
    """Vertices, moved to the place of their panorama in krpano's world, lie on the wall of the hall."""
    scenes = ElementTree.parse(krpano / "tour.xml").getroot().findall("scene")  # noqa: S314 - the test's own file
    assert len(scenes) == len(CHAIN)
    for scene, pose in zip(scenes, CHAIN, strict=True):
        image, model = scene.find("image"), scene.find("image/depthmap")
        assert model.attrib["axis"] == "+x+y+z"
        place = krpano_numbers(image, "ox", "oy", "oz")
        np.testing.assert_allclose(place / 100 * KRPANO_AXES, pose.position, atol=1e-4)
        vertices, triangles = krpano_depth_file(krpano / model.attrib["url"])
        assert len(vertices) < 65536
        assert triangles.max() == len(vertices) - 1
        world = (vertices * float(model.attrib["scale"]) + place) / 100 * KRPANO_AXES
        assert off_wall(world).max() < 0.02


def test_krpano_meets_its_neighbours_where_links_say(krpano: Path) -> None:
    root = ElementTree.parse(krpano / "tour.xml").getroot()  # noqa: S314 - the test's own file
    scenes = {scene.attrib["name"]: scene for scene in root.findall("scene")}
    places = {name: krpano_numbers(scene.find("image"), "ox", "oy", "oz") for name, scene in scenes.items()}
    links = [(name, link) for name, scene in scenes.items() for link in scene.findall("hotspot")]
    assert len(links) == 4
    for name, link in links:
        np.testing.assert_allclose(krpano_numbers(link, "tx", "ty", "tz"), places[link.attrib["linkedscene"]])
        yaw, down = krpano_numbers(link, "ath", "atv")
        ahead = KRPANO_AXES * (places[link.attrib["linkedscene"]] - places[name])
        assert direction_of(yaw, -down) @ normalize(ahead) > 1 - 1e-6
    actions = {action.attrib["name"]: action.text for action in root.findall("action")}
    assert "KEEPVIEW" in str(actions["omnisyn_go"])
    assert f"loadscene('{next(iter(scenes))}'" in str(actions["omnisyn_start"])


def test_krpano_runs_nothing_that_texts_and_addresses_say(tour: Path, tmp_path: Path, monkeypatch) -> None:
    """``,()`` end arguments of its actions; in texts ``[…]`` are tags or expressions, and ``get:`` begins one."""
    document = json.loads((tour / "tour.json").read_text())
    document["hotspots"][0]["text"] = "get:[b]x[/b]"
    document["panoramas"]["hall.png"]["hotspots"][0]["link"] = "https://example.org/);js(alert(1));("
    (tour / "tour.json").write_text(json.dumps(document))
    monkeypatch.setattr(loading, "make_estimator", lambda *_, **__: flat)
    run_export(plan_export(job_of_tour(tour, tmp_path / "site")))
    root = ElementTree.parse(tmp_path / "site" / "tour.xml").getroot()  # noqa: S314 - the test's own file
    spot = next(each for each in root.iter("hotspot") if "address" in each.attrib)
    assert spot.attrib["onclick"] == "openurl(get(address));"
    assert spot.attrib["text"] == "Red &lt;i&gt;thing&lt;/i&gt;"
    texts = [each.attrib["text"] for each in root.iter("hotspot") if "b" in each.attrib["text"]]
    assert "get&#58;&#91;b&#93;x&#91;/b&#93;" in texts
    assert not any(sign in text for text in texts for sign in "[]:")


def test_krpano_needs_links_to_all(tour: Path, tmp_path: Path) -> None:
    document = json.loads((tour / "tour.json").read_text())
    (tour / "tour.json").write_text(json.dumps({**document, "links": [["hall.png", "stairs.png"]]}))
    with pytest.raises(InputError, match=r"links to every panorama, got none to 'a b & <c>\.png', 'garden\.png'"):
        plan_export(job_of_tour(tour, tmp_path / "site"))
