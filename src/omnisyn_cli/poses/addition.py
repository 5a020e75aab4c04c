"""New panoramas placed into a tour whose poses are known; those stay exactly as they are."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, nearest_rotation
from omnisyn_cli.poses.estimation import (
    FoundPoses,
    PictureOptions,
    PoseGraph,
    check_images,
    solve_pose_graph,
    usable_pictures,
)
from omnisyn_cli.poses.file import PosedPanorama, PoseFile, add_entries
from omnisyn_cli.poses.registration.scan import scan_panorama
from omnisyn_cli.poses.tour import links_between

MIN_SPREAD_METRES = 1e-6  # root mean square of distances to the middle: less is one place
MAX_GOOD_MISFIT = 0.1  # of the known places to the pictures, as a share of their spread. Set by hand.


def add_poses(
    images: Sequence[Path], new: Sequence[Path], pose_file: PoseFile, options: PictureOptions | None = None
) -> FoundPoses:
    """Find new panoramas against those that have poses, in the world of these; entries of the new ones come back.

    All are matched together. Where a new one is follows from those that match it, turned, scaled and moved to the poses
    that these have. Masks of the options are those of all, the new ones last.

    Raises InputError: unusable images, or one named twice; PoseError: a new one has a pose, lies elsewhere than the
    pose file, or does not match two panoramas at different places.
    """
    every, options = [*images, *new], options or PictureOptions()
    check_images(every, may_repeat=False)
    known = [pose_file.of(image) for image in images]
    names = [_new_name(image, pose_file) for image in new]
    if pose_file.is_geographic:
        raise PoseError(
            f"{pose_file.path}: expected positions in metres to add others to, got latitudes; have them written "
            "(omnisyn poses refine)"
        )
    masks = [*(entry.mask for entry in known), *(None for _ in new)]
    scans = [scan_panorama(*picture, options.threads) for picture in usable_pictures(every, options, masks)]
    graph = solve_pose_graph(every, scans, {}, must_place_all=False, is_ordered=False)
    given, notes, entries = {k: entry.pose for k, entry in enumerate(known)}, [], {}
    for k, name in enumerate(names, start=len(known)):
        pose, note = _placed(k, every, graph, given)
        entries[name] = PosedPanorama(pose)
        notes.append(f"{every[k].name}: {note}")
    called = [*(pose_file.name_of(image) for image in images), *names]
    matched = tuple((called[edge.first], called[edge.second]) for edge in graph.edges)
    return FoundPoses(entries, tuple(notes), len(graph.edges), tuple(every), matched)


def add_to_file(
    images: Sequence[Path], new: Sequence[Path], pose_file: PoseFile, output: Path, options: PictureOptions
) -> tuple[str, ...]:
    """Write the pose file with the entries of new panoramas, and their links if it has links; what there is to say."""
    found = add_poses(images, new, pose_file, options)
    links = None
    if pose_file.links is not None:
        entries = {**pose_file.panoramas, **found.panoramas}
        places = np.stack([entry.pose.position for entry in entries.values()])
        near = links_between([*entries], places, found.matched)
        links = tuple(link for link in near if not found.panoramas.keys().isdisjoint(link))
    add_entries(pose_file.path, output, found.panoramas, links)
    return (*found.notes, f"{output}: {len(new)} added, {len(pose_file.panoramas)} poses as they were")


def _new_name(image: Path, pose_file: PoseFile) -> str:
    folder = pose_file.path.parent.absolute()
    if not image.absolute().is_relative_to(folder):
        raise PoseError(f"{image}: expected a panorama in the folder of {pose_file.path}, got another; move it there")
    name = image.absolute().relative_to(folder).as_posix()
    if name in pose_file.panoramas:
        raise PoseError(f"{pose_file.path}: expected new panoramas, got '{name}', which has a pose; leave it out")
    return name


def _placed(number: int, images: Sequence[Path], graph: PoseGraph, given: Mapping[int, Pose]) -> tuple[Pose, str]:
    """The pose of a new panorama in the world of the given ones, and what tells it."""
    ends = [(edge.first, edge.second) for edge in graph.edges if number in (edge.first, edge.second)]
    near = [k for k in given if (k, number) in ends or (number, k) in ends]
    for chosen in (near, [k for k in given if k in graph.poses]):
        found, known = [graph.poses[k] for k in chosen], [given[k] for k in chosen]
        if number in graph.poses and len(chosen) > 1 and min(map(_spread, (found, known))) > MIN_SPREAD_METRES:
            break
    else:
        raise PoseError(
            f"{images[number]}: expected matches with two panoramas at different places, got too few; take one "
            "between, or give its pose in the file"
        )
    turned = [one.rotation @ other.rotation.T for one, other in zip(known, found, strict=True)]
    rotation = nearest_rotation(np.sum(turned, axis=0))
    places, seen = (np.stack([pose.position for pose in poses]) for poses in (known, found))
    offsets, seen_offsets = places - places.mean(axis=0), (seen - seen.mean(axis=0)) @ rotation.T
    scale = float((offsets * seen_offsets).sum() / (seen_offsets**2).sum())
    misfit = float(np.sqrt(((offsets - scale * seen_offsets) ** 2).sum(axis=1).mean()))
    position = places.mean(axis=0) + scale * rotation @ (graph.poses[number].position - seen.mean(axis=0))
    doubt = "; they fit the pictures badly (omnisyn poses check)" if misfit > MAX_GOOD_MISFIT * _spread(known) else ""
    note = f"matches {len(ends)} panoramas; those that have poses agree with it within {misfit:.3f} m{doubt}"
    return Pose(rotation @ graph.poses[number].rotation, position), note


def _spread(poses: Sequence[Pose]) -> float:
    """Metres of their places around the middle."""
    places = np.stack([pose.position for pose in poses]) if poses else np.zeros((1, 3))
    return float(np.sqrt(((places - places.mean(axis=0)) ** 2).sum(axis=1).mean()))
