"""A site in the words of the viewer that shows it; ``docs/tours.md`` tells users what each of them gets.

Sources: Pannellum, "JSON Configuration File Options"; Photo Sphere Viewer, "VirtualTourPlugin" and "MarkersPlugin";
Marzipano, "RectilinearView" and what its tool writes; krpano, "XML Reference", "Coordinate Systems", "Depth File
Format".
"""

import html
import json
import math
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from jinja2 import Environment, PackageLoader, StrictUndefined

from omnisyn_cli.geometry.sphere import angles_to_direction
from omnisyn_cli.interpolation.export.site import DEPTH, Site, SiteMark, SitePanorama
from omnisyn_cli.poses.formats.files import WORLD_UP

VENDOR = "vendor"  # folder of a site for the viewer's own files, which are not part of it
WINDOW_ASPECT = 16 / 9  # width by height of the window for which a vertical field of view becomes a horizontal one
# Degrees from top to bottom at its greatest and least zoom; and where nobody says, as it has no default of its own.
PHOTO_SPHERE_VIEWER_FOVS, MARZIPANO_FOV = (30.0, 90.0), 75.0
CENTIMETRES = 100.0  # in a metre: krpano's unit


@dataclass(frozen=True)
class Viewer:
    """What there is to know of a viewer."""

    document: tuple[str, Callable[[Site], str]]  # the file that describes the tour, and what makes its text
    packages: Mapping[str, str]  # on npm, with the versions that are known to show it; none where it is not there
    has_depth: bool = False
    plays_clips: bool = False  # videos of the ways, in its page

    def advice(self, folder: Path) -> str:
        """How to get its own files."""
        place = shlex.quote(str(folder / VENDOR))
        return f"npm install --prefix {place}" if self.packages else f"copy krpano.js of your licence into {place}"


def site_files(name: str, site: Site) -> dict[str, bytes]:
    """The texts of a site by their names: its page, its document, and the list of the viewer's packages."""
    viewer = VIEWERS[name]
    document, text_of = viewer.document
    packages = {"private": True, "description": f"{name}, for the page in the folder above"}
    page = _templates().get_template(f"{name}.html").render(title=site.title)
    return {
        "index.html": page.encode(),
        document: text_of(site).encode(),
        f"{VENDOR}/package.json": _json({**packages, "dependencies": dict(viewer.packages)}).encode(),
    }


@cache
def _templates() -> Environment:
    loader = PackageLoader("omnisyn_cli.interpolation.export", "web")
    templates = Environment(loader=loader, undefined=StrictUndefined, autoescape=True)
    templates.filters |= {
        "degrees": math.degrees, "place": _krpano_place, "place_in": _krpano_mark_place, "as_text": _krpano_text,
    }  # fmt: skip
    return templates


def _json(value: Any) -> str:
    return json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _pannellum(site: Site) -> str:
    """Its configuration; yaw and pitch in degrees."""
    scenes = {panorama.identity: _pannellum_scene(panorama) for panorama in site.panoramas}
    if site.fov is not None:
        hfov = 2.0 * math.degrees(math.atan(WINDOW_ASPECT * math.tan(site.fov / 2.0)))
        scenes[site.start]["hfov"] = round(hfov, 3)
    first = {"firstScene": site.start, "autoLoad": True, "sceneFadeDuration": 800, "ignoreGPanoXMP": True}
    return _json({"escapeHTML": True, "default": {**first, "strings": {"bylineLabel": "%s"}}, "scenes": scenes})


def _pannellum_scene(panorama: SitePanorama) -> dict[str, Any]:
    marks = [_pannellum_mark(mark) for mark in (*panorama.links, *panorama.hotspots)]
    caption = {"author": panorama.caption} if panorama.caption else {}
    return {
        "type": "equirectangular", "panorama": panorama.picture, "title": panorama.title, **caption,
        **_degrees(panorama), "hotSpots": marks,
    }  # fmt: skip


def _pannellum_mark(mark: SiteMark) -> dict[str, Any]:
    place = {**_degrees(mark), "text": mark.text}
    if mark.target is not None:
        same = {"targetYaw": "sameAzimuth", "targetPitch": "same", "targetHfov": "same"}
        clip = {} if mark.clip is None else {"clip": mark.clip}
        return {"type": "scene", **place, "sceneId": mark.target, **same, **clip}
    more = {"URL": mark.link, "image": mark.image, "width": 240 if mark.image else None}
    return {"type": "info", **place, **{key: value for key, value in more.items() if value is not None}}


def _photo_sphere_viewer(site: Site) -> str:
    """Options of the viewer and of its plug-in for tours; angles in radians, texts as HTML."""
    start = next(panorama for panorama in site.panoramas if panorama.identity == site.start)
    viewer: dict[str, Any] = {"defaultYaw": start.yaw, "defaultPitch": start.pitch}
    if site.fov is not None:
        least, greatest = PHOTO_SPHERE_VIEWER_FOVS
        greatest = max(greatest, math.degrees(site.fov))
        level = 100.0 * (greatest - math.degrees(site.fov)) / (greatest - least)
        viewer |= {"minFov": least, "maxFov": greatest, "defaultZoomLvl": min(max(level, 0.0), 100.0)}
    nodes = [_photo_sphere_viewer_node(panorama) for panorama in site.panoramas]
    tour = {"positionMode": "manual", "renderMode": "2d", "startNodeId": site.start, "nodes": nodes}
    return _json({"viewer": viewer, "virtualTour": tour})


def _photo_sphere_viewer_node(panorama: SitePanorama) -> dict[str, Any]:
    title, caption = html.escape(panorama.title), html.escape(panorama.caption)
    links = [{"nodeId": link.target, "position": _radians(link)} for link in panorama.links]
    markers = [
        {"id": f"{panorama.identity}-{index}", "position": _radians(mark), **_photo_sphere_viewer_mark(mark)}
        for index, mark in enumerate(panorama.hotspots)
    ]
    named = {"name": title, "caption": f"<b>{title}</b> {caption}".strip()}
    return {"id": panorama.identity, "panorama": panorama.picture, **named, "links": links, "markers": markers}


def _photo_sphere_viewer_mark(mark: SiteMark) -> dict[str, Any]:
    text = html.escape(mark.text)
    picture = f'<p><img src="{html.escape(mark.image)}" alt=""></p>' if mark.image else ""
    link = (
        f'<p><a href="{html.escape(mark.link)}" target="_blank">{html.escape(mark.link)}</a></p>' if mark.link else ""
    )
    shown = {"html": '<span class="mark">i</span>', "anchor": "center center", "tooltip": text}
    return {**shown, **({"content": f"<h1>{text}</h1>{picture}{link}"} if picture or link else {})}


def _marzipano(site: Site) -> str:
    """As Marzipano's own tool describes tours; radians, and pitch grows downwards."""
    fov = math.radians(MARZIPANO_FOV) if site.fov is None else site.fov
    scenes = [_marzipano_scene(panorama, fov) for panorama in site.panoramas]
    return _json({"name": site.title, "start": site.start, "scenes": scenes})


def _marzipano_scene(panorama: SitePanorama, fov: float) -> dict[str, Any]:
    links = [
        {**_downwards(link), "target": link.target, "title": link.text, "clip": link.clip} for link in panorama.links
    ]
    infos = [
        {**_downwards(mark), "title": mark.text, "link": mark.link, "image": mark.image} for mark in panorama.hotspots
    ]
    return {
        "id": panorama.identity, "name": panorama.title, "caption": panorama.caption, "panorama": panorama.picture,
        "initialViewParameters": {**_downwards(panorama), "fov": fov}, "linkHotspots": links, "infoHotspots": infos,
    }  # fmt: skip


def _krpano(site: Site) -> str:
    """Scenes with their place in the world and a model of their depth; centimetres, x right, y down, z forward."""
    numbers = {"depth_folder": DEPTH, "scale": CENTIMETRES, "default_fov": math.radians(MARZIPANO_FOV)}
    return _templates().get_template("krpano.xml.j2").render(site=site, **numbers) + "\n"


def _krpano_place(position: Float[np.ndarray, " 3"]) -> list[str]:
    return [f"{value:.2f}" for value in WORLD_UP["-y"].T @ position * CENTIMETRES]


def _krpano_mark_place(mark: SiteMark, panorama: SitePanorama) -> list[str]:
    """Of one without a position a metre away in its direction."""
    polar_angle = math.radians(90.0) - mark.pitch
    beside = panorama.position + np.asarray(angles_to_direction(np.array(mark.yaw), np.array(polar_angle)))
    return _krpano_place(beside if mark.position is None else mark.position)


def _krpano_text(text: str) -> str:
    """As HTML, without what krpano reads as a tag or expression (``[…]``) or as the begin of one (``get:``)."""
    return html.escape(text).translate({ord(sign): f"&#{ord(sign)};" for sign in "[]:"})


def krpano_depth(vertices: Float[np.ndarray, "vertices 3"], triangles: np.ndarray) -> bytes:
    """A model of depth, in our axes and metres, as krpano's format for it."""
    places = (vertices @ WORLD_UP["-y"]).round(3)
    points = " ".join(f"{number:g}" for number in places.ravel())
    corners = " ".join(map(str, triangles.ravel()))
    return f"DEPTH {len(vertices)} {points} {len(triangles)} {corners}\n".encode()


def _degrees(at: SiteMark | SitePanorama) -> dict[str, float]:
    return {"yaw": round(math.degrees(at.yaw), 4), "pitch": round(math.degrees(at.pitch), 4)}


def _radians(at: SiteMark | SitePanorama) -> dict[str, float]:
    return {"yaw": at.yaw, "pitch": at.pitch}


def _downwards(at: SiteMark | SitePanorama) -> dict[str, float]:
    return {"yaw": at.yaw, "pitch": -at.pitch}


# By the name of the format.
VIEWERS: Mapping[str, Viewer] = {
    "pannellum": Viewer(("tour.json", _pannellum), {"pannellum": "^2.5.6"}, plays_clips=True),
    "photo-sphere-viewer": Viewer(
        ("tour.json", _photo_sphere_viewer),
        {f"@photo-sphere-viewer/{part}": "^5.13.0" for part in ("core", "markers-plugin", "virtual-tour-plugin")},
    ),
    "marzipano": Viewer(("tour.json", _marzipano), {"marzipano": "^0.10.2"}, plays_clips=True),
    "krpano": Viewer(("tour.xml", _krpano), {}, has_depth=True),
}
