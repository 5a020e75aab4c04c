"""Agisoft Metashape's cameras (File, Export, Export Cameras, as XML), of spherical sensors.

A camera's ``transform`` is the 4×4 matrix from its own axes (x right, y down, z forward) to those of the chunk. The
``transform`` of its component, formerly of the chunk, takes these to the world by rotation, translation and scale: to
earth-centred metres in a chunk with a geographic or projected reference, to its own axes with z up in one with a local
reference. Without it scale and axes mean nothing.

Source: Agisoft, "Metashape Professional User Manual", appendices on camera models and on the export of cameras.
"""

from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, enu_from_ecef, geographic_from_ecef
from omnisyn_cli.io.documents import listed, read_xml
from omnisyn_cli.poses.entries import checked_rotation
from omnisyn_cli.poses.formats import files
from omnisyn_cli.poses.formats.files import CAMERAS_UP, ImportedPoses, ImportedView, ImportOptions
from omnisyn_cli.poses.formats.geographic import origin_note

MIN_EARTH_RADIUS = 6.2e6  # metres from the centre of the earth that no camera is nearer to


def read_metashape(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of the aligned cameras of spherical sensors, of the largest component."""
    root = read_xml(source)
    chunk = root if root.tag == "chunk" else root.find("chunk")
    if chunk is None:
        raise PoseError(
            f"{source}: expected cameras exported by Metashape, got XML without a chunk; export them as XML"
        )
    sensors = {sensor.get("id"): sensor.get("type") for sensor in chunk.iter("sensor")}
    cameras = [camera for camera in chunk.iter("camera") if sensors.get(camera.get("sensor_id")) == "spherical"]
    aligned: dict[str, list[Element]] = {}
    for camera in cameras:
        if camera.find("transform") is not None:
            aligned.setdefault(camera.get("component_id", ""), []).append(camera)
    if not aligned:
        found = f"{len(cameras)} that are not aligned" if cameras else f"sensors {listed(map(str, sensors.values()))}"
        raise PoseError(
            f"{source}: expected aligned cameras of a spherical sensor, got {found}; only panoramas are read"
        )
    component, chosen = max(aligned.items(), key=lambda pair: len(pair[1]))
    posed = [(_label(camera), _pose(f"{source}: camera '{_label(camera)}'", camera)) for camera in chosen]
    similarity = next((e for e in chunk.iter("component") if e.get("id") == component), chunk).find("transform")
    is_local = (chunk.findtext("reference") or "LOCAL_CS").startswith("LOCAL_CS")
    views, notes = _in_world(source, posed, similarity, options, is_local=is_local)
    left_out = [_label(camera) for camera in chunk.iter("camera") if camera not in chosen]
    return ImportedPoses(views, files.noted({**notes, f"left out: {listed(left_out)}": left_out}))


def _in_world(
    source: Path, posed: Sequence[tuple[str, Pose]], transform: Element | None, options: ImportOptions,
    *, is_local: bool,
) -> tuple[tuple[ImportedView, ...], dict[str, object]]:  # fmt: skip
    """Panoramas in our world, and what there is to say about it."""
    scale, world = 1.0, Pose.identity()
    if transform is not None:
        where = f"{source}: transform of the chunk"
        turn = _values(where, transform, "rotation", 9, np.eye(3)).reshape(3, 3)
        world = Pose(checked_rotation(where, turn), _values(where, transform, "translation", 3, np.zeros(3)))
        scale = float(_values(where, transform, "scale", 1, np.ones(1))[0])
        if scale <= 0:
            raise PoseError(f"{where}: expected a scale above 0, got {scale:g}; export the cameras anew")
    poses = [world @ Pose(pose.rotation, scale * pose.position) for _, pose in posed]
    is_on_earth = not is_local and float(np.linalg.norm(poses[0].position)) > MIN_EARTH_RADIUS
    if options.origin is not None and not is_on_earth:
        raise PoseError(f"{source}: expected a chunk with a reference on earth for --origin, got none; leave it out")
    notes: dict[str, object] = {"distances: metres, as Metashape's chunk has them": transform is not None}
    if is_on_earth:
        origin = options.origin or geographic_from_ecef(poses[0].position)
        poses = [enu_from_ecef(origin) @ pose for pose in poses]
        notes[origin_note(origin)] = True
    ours = [options.pose(pose, camera="opencv", up="z") for pose in poses]
    if transform is None:
        notes["distances: the chunk has no scale; its units are taken as metres"] = True
        if options.up is None:
            ours, notes[CAMERAS_UP] = files.levelled(ours), True
    folders = [source.parent, source.parent / "images"]
    named = zip(posed, ours, strict=True)
    return tuple(files.find_view(str(source), name, pose, folders, options) for (name, _), pose in named), notes


def _label(camera: Element) -> str:
    return camera.get("label") or f"camera {camera.get('id')}"


def _pose(where: str, camera: Element) -> Pose:
    matrix = files.numbers(where, (camera.findtext("transform") or "").split(), 16, "a 4×4 matrix").reshape(4, 4)
    return Pose(checked_rotation(where, matrix[:3, :3]), matrix[:3, 3])


def _values(where: str, parent: Element, name: str, count: int, default: np.ndarray) -> np.ndarray:
    text = parent.findtext(name)
    return default if text is None else files.numbers(where, text.split(), count, name)
