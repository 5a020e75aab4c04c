"""New panoramas placed into a tour whose poses are known; those stay exactly as they are."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, nearest_rotation
from omnisyn_cli.poses.estimation import PictureOptions, PoseGraph, check_images, solve_pose_graph, usable_pictures
from omnisyn_cli.poses.file import PosedPanorama, PoseFile, add_entries
from omnisyn_cli.poses.registration.scan import scan_panorama
from omnisyn_cli.poses.tour import links_between

NEAR_PANORAMAS = 5  # with poses that a new one is matched with: those that share most features
MIN_SPREAD_METRES = 1e-6  # of places around their middle: less is one place
MAX_GOOD_MISFIT = 0.1  # of the known places to the pictures, as a share of their spread. Set by hand.


def add_to_file(
    images: Sequence[Path], new: Sequence[Path], pose_file: PoseFile, output: Path, options: PictureOptions
) -> tuple[str, ...]:
    """Find new panoramas against those that have poses, and write the file with them, and their links if it has links.

    They are matched with those that look most like them, and these with each other. Where a new one is follows from
    those that match it, turned, scaled and moved to the poses that these have. Masks of the options are those of all,
    the new ones last. Notes come back. InputError: unusable images, or one named twice; PoseError: a new one has a
    pose, lies in another folder, or does not match two panoramas at different places.
    """
    every = [*images, *new]
    check_images(every, may_repeat=False)
    known = [pose_file.of(image) for image in images]
    names = [*(pose_file.name_of(image) for image in images), *(_new_name(image, pose_file) for image in new)]
    masks = [*(entry.mask for entry in known), *(None for _ in new)]
    scans = [scan_panorama(*picture, options.threads) for picture in usable_pictures(every, options, masks)]
    count, near = len(images), set[int]()
    for scan in scans[count:]:
        alike = np.array([each.likeness(scan) for each in scans[:count]])
        near.update(np.argsort(-alike, kind="stable")[:NEAR_PANORAMAS].tolist())
    chosen = [*sorted(near), *range(count, len(every))]
    some = [every[k] for k in chosen], [scans[k] for k in chosen]
    graph = solve_pose_graph(*some, {}, must_place_all=False, is_ordered=False)
    given, notes, found = {index: known[k].pose for index, k in enumerate(sorted(near))}, [], {}
    for index, k in enumerate(chosen[len(near) :], len(near)):
        pose, note = _placed(index, every[k], graph, given)
        found[names[k]] = PosedPanorama(pose)
        notes.append(f"{every[k].name}: {note}")
    links = None
    if pose_file.links is not None:
        entries = {**pose_file.panoramas, **found}
        places = np.stack([entry.pose.position for entry in entries.values()])
        matched = [(names[chosen[edge.first]], names[chosen[edge.second]]) for edge in graph.edges]
        links = [link for link in links_between([*entries], places, matched) if not found.keys().isdisjoint(link)]
    add_entries(pose_file, output, found, links)
    return (*notes, f"{output}: {len(new)} added, {len(pose_file.panoramas)} poses as they were")


def _new_name(image: Path, pose_file: PoseFile) -> str:
    folder = pose_file.path.parent.absolute()
    name = image.absolute().relative_to(folder).as_posix() if image.absolute().is_relative_to(folder) else ""
    if not name or name in pose_file.panoramas:
        found = "one that has a pose; leave it out" if name else "another folder; move it there"
        raise PoseError(f"{image}: expected a new panorama in the folder of {pose_file.path}, got {found}")
    return name


def _placed(number: int, image: Path, graph: PoseGraph, given: Mapping[int, Pose]) -> tuple[Pose, str]:
    """The pose of a new panorama in the world of the given ones, and what tells it."""
    matched = {end for edge in graph.edges if number in (edge.first, edge.second) for end in (edge.first, edge.second)}
    for chosen in ([k for k in given if k in matched], [k for k in given if k in graph.poses]):
        found, known = [graph.poses[k] for k in chosen], [given[k] for k in chosen]
        if number in graph.poses and chosen and min(_spread(found), _spread(known)) > MIN_SPREAD_METRES:
            break
    else:
        raise PoseError(
            f"{image}: expected matches with two panoramas at different places, got too few; take one between, or give "
            "its pose in the file"
        )
    turns = [one.rotation @ other.rotation.T for one, other in zip(known, found, strict=True)]
    rotation = nearest_rotation(np.sum(turns, axis=0))
    places, seen = (np.stack([pose.position for pose in poses]) for poses in (known, found))
    offsets, seen_offsets = places - places.mean(axis=0), (seen - seen.mean(axis=0)) @ rotation.T
    scale = float((offsets * seen_offsets).sum() / (seen_offsets**2).sum())
    misfit = float(np.sqrt(((offsets - scale * seen_offsets) ** 2).sum(axis=1).mean()))
    position = places.mean(axis=0) + scale * rotation @ (graph.poses[number].position - seen.mean(axis=0))
    advice = "; they fit the pictures badly (omnisyn poses check)" if misfit > MAX_GOOD_MISFIT * _spread(known) else ""
    note = f"matches {len(matched) - 1} panoramas; known poses agree with it within {misfit:.3f} m{advice}"
    return Pose(rotation @ graph.poses[number].rotation, position), note


def _spread(poses: Sequence[Pose]) -> float:
    """Metres of their places around the middle, the root mean square."""
    return float(np.linalg.norm(np.std([pose.position for pose in poses], axis=0)))
