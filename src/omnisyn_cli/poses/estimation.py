"""Poses checked against the pictures, corrected by them, or found in them alone.

Pairs are taken in the order of the panoramas; every picture is read once. What pictures cannot tell is kept or assumed:
the distance between two panoramas, and how the first one was held.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.geometry.pose import Pose, distance_between, rotation_from_rotation_vector, rotation_taking
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sphere import FORWARD, UP, normalize
from omnisyn_cli.io import MAX_PIXELS, read_panorama
from omnisyn_cli.io.decode import check_is_file
from omnisyn_cli.io.images import usable_part
from omnisyn_cli.io.outputs import real_path
from omnisyn_cli.io.placement import DEFAULT_READING, Reading
from omnisyn_cli.poses.file import PosedPanorama, PoseFile, PoseUncertainty, check_names_tell_apart, distinct_names
from omnisyn_cli.poses.floor import FLOOR_SIZE, floor_heights, height_above_points, level_of_points, spread_above
from omnisyn_cli.poses.gravity import REMEDIES, find_vertical, gravity_of
from omnisyn_cli.poses.registration import pose_graph
from omnisyn_cli.poses.registration.bundle import Adjustment, adjust
from omnisyn_cli.poses.registration.diagnosis import Diagnosis, diagnose
from omnisyn_cli.poses.registration.features import Matches, find_features, grey_of, match_features
from omnisyn_cli.poses.registration.least_squares import relative_pose
from omnisyn_cli.poses.registration.pose_graph import Edge, Given
from omnisyn_cli.poses.registration.robust import Estimate, support_mask
from omnisyn_cli.poses.registration.scan import Scan, forget_tables, register_pair, scan_panorama, without_repeats
from omnisyn_cli.poses.tour import links_between
from omnisyn_cli.types import View

DEFAULT_BASELINE = 1.0  # Metres between two panoramas where no baseline is given

# Of the heights that pairs see: pavements, carpets and decks lie above the floor, and nothing below it.
FLOOR_QUANTILE = 0.75
# Pairs that are enough to tell a floor; relative difference up to which matched points confirm what fewer see.
MIN_FLOOR_PAIRS, MAX_LEVEL_ERROR = 3, 0.05
MIN_HEIGHT_SPREAD = 0.02  # of heights, relative: kerbs and rugs. Of 20 generated tours 19 were within twice this
MAX_CLIMB = math.tan(math.radians(10.0))  # between cameras at one height above a floor that may slope
MAX_KNOWN_SPREAD = 0.25  # Relative standard deviation of a distance beyond which it is not known
MIN_ZENITH_AGREEMENT = 0.8  # Cosine between a zenith and the mean of a set from which on they are the same
# Of a set that each panorama is compared with, besides its neighbours: those that share most features.
LIKE_PANORAMAS = 2


class Reason(Enum):
    """Why a pair that was compared is not used, in words about its number of matches."""

    FEW = "too few matches (of {})"
    AMBIGUITY = "two poses that fit about equally well (repeated tiles or windows?)"
    PLANE = "matches on one plane only, a floor or wall that other places may have as well"
    CONTRADICTION = "a pose that contradicts other pairs"
    APART = "a pose that nothing connects with the larger group"


Unused = dict[tuple[int, int], tuple[Reason, int]]
"""Pairs that were compared and are not used, why, and how many matches they have."""


@dataclass(frozen=True)
class PictureOptions:
    """How pictures are read."""

    allow_aspect: bool = False  # see :func:`omnisyn_cli.io.read_panorama`
    threads: int | None = None  # at most this many; None is one per core
    max_pixels: int = MAX_PIXELS  # see :func:`omnisyn_cli.io.read_panorama`
    # an image for every panorama that is black where it must not be used, besides those of poses; or none
    masks: tuple[Path, ...] = ()
    nadir: float = 0.0  # radians around straight down that must not be used: tripod, roof of a car
    reading: Reading = DEFAULT_READING  # what the files do not say of their pictures


@dataclass(frozen=True)
class PairDiagnosis:
    """A pair and what is wrong with its poses."""

    # the images
    first: Path
    second: Path
    diagnosis: Diagnosis  # what the matches say
    matches: Matches  # of both
    fits: Bool[np.ndarray, " n"]  # the matches that agree with the poses given
    views: tuple[View, View]  # both, reduced, with the poses given

    def camera_height(self) -> float | None:
        """Metres of both cameras above the floor, the mean; None where poses do not fit, or no floor is found."""
        heights = floor_heights([self.views]) if self.diagnosis.verdict in ("fits", "close") else []
        return heights[0] if heights else None


@dataclass(frozen=True)
class FoundPoses:
    """Poses that come from the pictures."""

    panoramas: Mapping[str, PosedPanorama]  # entries by what a pose file calls the images
    notes: tuple[str, ...]  # what was assumed, changed or left as it was, one sentence each
    changed: int  # number of pairs whose relative pose comes from the pictures
    # the images that have poses, in walking order, where poses were looked for without any given
    order: tuple[Path, ...] = ()
    matched: tuple[tuple[str, str], ...] = ()  # names of the pairs whose pictures match, likewise

    @property
    def links(self) -> tuple[tuple[str, str], ...] | None:
        """Those of a tour, where matches say more than positions: not through walls, for example; else None."""
        names, positions = [*self.panoramas], np.stack([entry.pose.position for entry in self.panoramas.values()])
        links = links_between(names, positions, self.matched)
        return None if links == links_between(names, positions) else links


@dataclass(frozen=True)
class PoseGraph:
    """The panoramas of a set that matching pictures connect, by their numbers."""

    poses: dict[int, Pose]  # in a world of their own; the unit is a baseline
    edges: list[Edge]  # pairs whose relative poses agree
    unused: Unused  # pairs that are not among them
    adjusted: Adjustment | None  # all poses adjusted together; None of a single pair


def check_poses(
    images: Sequence[Path], pose_file: PoseFile, options: PictureOptions | None = None
) -> Iterator[PairDiagnosis]:
    """Judge the poses of all neighbours, one after the other.

    InputError: fewer than two panoramas, another number of masks, unusable files; PoseError: no entry, or two, for one.
    """
    check_images(images)
    check_names_tell_apart(images, pose_file)
    entries = [pose_file.of(image) for image in images]
    options = options or PictureOptions()
    pictures = usable_pictures(images, options, [entry.mask for entry in entries])
    views = (
        (View(resize_area(image, FLOOR_SIZE), own.pose, usable), find_features(grey_of(image), usable, options.threads))
        for own, (image, usable) in zip(entries, pictures, strict=True)
    )
    for (first, second), ((a, seen_by_a), (b, seen_by_b)) in zip(pairwise(images), pairwise(views), strict=True):
        matches = match_features(seen_by_a, seen_by_b)
        fits = support_mask(relative_pose(a.pose, b.pose), matches)
        yield PairDiagnosis(first, second, diagnose(a.pose, b.pose, matches), matches, fits, (a, b))


def refine_poses(images: Sequence[Path], pose_file: PoseFile, options: PictureOptions | None = None) -> FoundPoses:
    """Correct rotation and direction of every panorama but the first where that makes the pictures fit better.

    Distances between neighbours stay, and later panoramas move along. A pair stays where too few matches agree, nothing
    is gained, or poses contradict the pictures (a mistake to be found). InputError, PoseError: as :func:`check_poses`;
    also for a panorama that is named twice.
    """
    check_images(images, may_repeat=False)
    entries, notes, changed = dict(pose_file.panoramas), [], 0
    for pair in check_poses(images, pose_file, options):
        first, second = (pose_file.of(image).pose for image in (pair.first, pair.second))
        relative = first.inverse() @ second
        former, name = (pose_file.name_of(image) for image in (pair.first, pair.second))
        if pair.diagnosis.is_refinable and pair.diagnosis.estimate is not None:
            found = pair.diagnosis.estimate.first_from_second
            relative = Pose(found.rotation, found.position * np.linalg.norm(relative.position))
            entries[name] = replace(entries[name], uncertainty=_of_pair(pair.diagnosis.estimate))
            changed += 1
        entries[name] = replace(entries[name], pose=entries[former].pose @ relative)
        notes.append(f"{pair.first.name} and {pair.second.name}: {_refinement_note(pair.diagnosis)}")
    return FoundPoses(entries if changed else pose_file.panoramas, tuple(notes), changed)


def estimate_poses(
    images: Sequence[Path], baselines: Sequence[float] = (), options: PictureOptions | None = None, *,
    camera_height: float | None = None, must_place_all: bool = True, finds_order: bool = False,
) -> FoundPoses:  # fmt: skip
    """Find the poses of panoramas in the pictures.

    Vertical edges level the world. The first panorama that is placed stands at the origin and looks towards −z. Images
    are in walking order; with ``finds_order`` that is looked for as well, a short way along pairs that match. With
    ``must_place_all`` panoramas that do not fit the others are refused, else left out and named.

    Baselines are metres between neighbours: their mean (:data:`DEFAULT_BASELINE` without any), or one for each pair.
    Points that several pairs share tell other ratios. ``camera_height``, metres above the floor, stands in for
    baselines. InputError: unusable images, fewer than two, or one named twice; another number of baselines. PoseError:
    too few matches, or no floor.
    """
    check_images(images, may_repeat=False)
    if len(baselines) not in (0, 1, count := len(images) - 1):
        raise InputError(f"expected one baseline, or one for each of {count} pairs, got {len(baselines)}; name as many")
    if not all(np.isfinite(length) and length > 0 for length in baselines):
        raise InputError(f"expected baselines above 0 m, got {', '.join(map(str, baselines))}; measure them")
    given = {(k, k + 1): length for k, length in enumerate(baselines)} if len(baselines) > 1 else {}
    options = options or PictureOptions()
    scans = [scan_panorama(*picture, options.threads) for picture in usable_pictures(images, options)]
    repeats: list[str] = []
    if not given:  # distances that are given say that no two are from one place
        images, scans, repeats = without_repeats(images, scans)
    graph = solve_pose_graph(images, scans, given, must_place_all=must_place_all, is_ordered=not finds_order)
    edges, order = graph.edges, sorted(graph.poses)
    if finds_order:
        order = pose_graph.shortest_path({k: pose.position for k, pose in graph.poses.items()}, edges)
    world, level_note = _levelled({k: graph.poses[k] for k in order}, scans)
    scale, scale_note = _scale(world, order, scans, edges, baselines, camera_height)
    known = {pair: _relative_uncertainty(*pair, graph) for pair in pairwise(order)}
    notes = [f"{images[order[0]].name} is at the origin; {level_note}", scale_note, *_pair_notes(images, edges, known)]
    notes += [*_partial_notes(images, scans), *repeats, *_attitude_notes(images, scans, world)]
    reasons = {pair: why.value for pair, (why, _) in graph.unused.items() if why is not Reason.FEW}
    notes += [f"{' and '.join(images[k].name for k in pair)} are not used: {why}" for pair, why in reasons.items()]
    if left_out := [image.name for k, image in enumerate(images) if k not in graph.poses]:
        notes.append(f"left out, as nothing tells where they are: {', '.join(left_out)}")
    few, others = len(graph.unused) - len(reasons), math.comb(len(images), 2) - len(edges) - len(graph.unused)
    if few + others:
        notes.append(f"{few} pairs have too few matches, and {others} that look less alike were not compared")
    if finds_order:
        notes.append(f"order: {', '.join(images[k].name for k in order)}")
    names, spreads = distinct_names(images), [None, *known.values()]
    entries = {
        names[k]: PosedPanorama(Pose(world[k].rotation, scale * world[k].position), uncertainty=spread)
        for k, spread in zip(order, spreads, strict=True)
    }
    pairs = tuple((names[edge.first], names[edge.second]) for edge in edges)
    return FoundPoses(entries, tuple(notes), len(edges), tuple(images[k] for k in order), pairs)


def solve_pose_graph(
    images: Sequence[Path], scans: Sequence[Scan], given: Given, *, must_place_all: bool, is_ordered: bool
) -> PoseGraph:
    """Rotations averaged over all pairs, positions from directions and lengths, then both adjusted to the matches."""
    matched, unused = _matched_edges(scans, is_ordered=is_ordered)
    rotations = pose_graph.average_rotations(matched, pose_graph.placed_panoramas(matched, len(images)))
    edges = pose_graph.consistent_edges(matched, rotations)
    placed = pose_graph.placed_panoramas(edges, len(images))
    if len(placed) < 2 or (must_place_all and len(placed) < len(images)):
        pair = next(pair for pair in unused if len(placed) < 2 or not set(pair) <= set(placed))
        (reason, number), names = unused[pair], " and ".join(str(images[k]) for k in pair)
        remedies = [*_partial_notes(images, scans), "give their poses in a file, or take a panorama between them"]
        raise PoseError(
            f"{names}: expected more matches that agree with a pose than by chance, got {reason.value.format(number)}; "
            f"{'; '.join(remedies)}"
        )
    rotations = {k: rotations[k] for k in placed}
    edges = pose_graph.agreeing_edges(
        [edge for edge in edges if edge.first in placed], rotations, is_ordered=is_ordered
    )
    positions = pose_graph.positions_of(edges, *pose_graph.baseline_lengths(edges, given), rotations)
    poses = {k: Pose(rotations[k], positions[k]) for k in placed}
    adjusted = adjust(poses, edges, given) if len(placed) > 2 else None
    kept = {(edge.first, edge.second) for edge in edges}
    for edge in matched:
        if (pair := (edge.first, edge.second)) not in kept:
            why = Reason.CONTRADICTION if set(pair) <= poses.keys() else Reason.APART
            unused[pair] = why, len(edge.estimate.inliers)
    return PoseGraph(adjusted.poses if adjusted else poses, edges, unused, adjusted)


def _matched_edges(scans: Sequence[Scan], *, is_ordered: bool) -> tuple[list[Edge], Unused]:
    """Pairs whose relative pose is found, and why it is not found of others that were tried."""
    count, unused = len(scans), Unused()
    alike = {pair: scans[pair[0]].likeness(scans[pair[1]]) for pair in combinations(range(count), 2)}
    ranked = sorted(alike, key=lambda pair: (-alike[pair], pair))
    wanted = {pair for k in range(count) for pair in [p for p in ranked if k in p][:LIKE_PANORAMAS]}
    edges: list[Edge] = []

    def attempt(pair: tuple[int, int]) -> None:
        estimate, matches = register_pair(scans[pair[0]], scans[pair[1]])
        if estimate is None:
            unused[pair] = Reason.FEW, len(matches)
        elif estimate.is_planar or estimate.rival is not None:
            unused[pair] = Reason.PLANE if estimate.is_planar else Reason.AMBIGUITY, len(matches)
        else:
            agreeing, others = (matches.select(mask) for mask in (estimate.inliers, ~estimate.inliers))
            edges.append(Edge(*pair, estimate, agreeing, others))

    neighbours = set(pairwise(range(count))) if is_ordered else set()
    for pair in sorted(wanted | neighbours):
        attempt(pair)
    more = LIKE_PANORAMAS * count
    for pair in ranked:
        if more > 0 and pair not in unused and pose_graph.is_worthwhile(pair, edges, count):
            attempt(pair)
            more -= 1
    return edges, unused


def _partial_notes(images: Sequence[Path], scans: Sequence[Scan]) -> list[str]:
    """About pictures that do not seem to show the whole sphere."""
    partial = [image.name for image, scan in zip(images, scans, strict=True) if not scan.meets_at_seam]
    names = ", ".join(partial)
    return [f"left and right edges do not meet in {names}; is that all of the sphere? (--hfov)"] if partial else []


def _attitude_notes(images: Sequence[Path], scans: Sequence[Scan], world: Mapping[int, Pose]) -> list[str]:
    """About cameras that do not seem to have been held upright, unless most of the others tell another zenith."""
    held = [gravity_of(scan.small, scan.lines, scan.usable) for scan in scans]
    zeniths = {k: pose.rotation @ held[k].vertical.up for k, pose in world.items()}
    most = normalize(np.sum([*zeniths.values()], axis=0))
    return [
        f"{image.name} looks {held[k].attitude}; {REMEDIES[held[k].attitude]}"
        for k, image in enumerate(images)
        if held[k].attitude in REMEDIES and zeniths.get(k, most) @ most > MIN_ZENITH_AGREEMENT
    ]


def _levelled(world: Mapping[int, Pose], scans: Sequence[Scan]) -> tuple[dict[int, Pose], str]:
    """The same poses in a world whose y axis is up, in which the first one is at the origin and looks towards −z."""
    first = next(iter(world.values()))
    upright = np.sum([pose.rotation @ UP for pose in world.values()], axis=0)
    lines = np.concatenate([scans[k].lines @ pose.rotation.T for k, pose in world.items()])
    vertical = find_vertical(lines, np.asarray(normalize(upright)))
    if not vertical.is_certain:
        level, note = np.eye(3), "it is taken for level, as no vertical edges tell better"
    else:
        level = rotation_taking(vertical.up, UP)
        tilt = math.degrees(math.acos(min(1.0, float(first.rotation[:, 1] @ vertical.up))))
        note = f"vertical edges say that it was tilted by {tilt:.1f}° ± {math.degrees(vertical.std):.2f}°"
    ahead = level @ first.rotation @ FORWARD
    level = rotation_from_rotation_vector(math.atan2(ahead[0], -ahead[2]) * UP) @ level
    return {k: Pose(level @ pose.rotation, level @ (pose.position - first.position)) for k, pose in world.items()}, note


def _scale(
    world: Mapping[int, Pose], order: Sequence[int], scans: Sequence[Scan], edges: Sequence[Edge],
    baselines: Sequence[float], camera_height: float | None,
) -> tuple[float, str]:  # fmt: skip
    """Metres per unit, and where they come from."""
    steps = [distance_between(world[a], world[b]) for a, b in pairwise(order)]
    mean = float(np.mean(steps)) or 1.0
    if camera_height is not None:
        height, spread, source = _camera_height(world, scans, edges)
        metres = camera_height / height
        return metres, (
            f"{camera_height:g} m above the floor, which {source}: neighbours are {mean * metres:.2f} m apart on "
            f"average, {_known_within(max(spread, MIN_HEIGHT_SPREAD))}"
        )
    if len(baselines) > 1:
        return 1.0, f"distances between neighbours as given ({', '.join(f'{length:g}' for length in baselines)} m)"
    length = baselines[0] if baselines else DEFAULT_BASELINE
    said = "as given" if baselines else "as pictures do not tell how far (--baseline)"
    return length / mean, f"neighbours are taken to be {length:g} m apart{' on average' * (len(steps) > 1)}, {said}"


def _camera_height(world: Mapping[int, Pose], scans: Sequence[Scan], edges: Sequence[Edge]) -> tuple[float, float, str]:
    """Height of the cameras above the floor in the unit of the positions, its relative spread, and who sees it."""
    steps = [world[edge.second].position - world[edge.first].position for edge in edges]
    # pairs on stairs do not count
    chosen = [edge for edge, step in zip(edges, steps, strict=True) if abs(step[1]) < MAX_CLIMB * np.hypot(*step[::2])]
    views = {k: View(scans[k].small, pose, scans[k].usable) for k, pose in world.items()}
    heights = floor_heights([(views[edge.first], views[edge.second]) for edge in chosen])
    if len(heights) >= MIN_FLOOR_PAIRS:
        height = float(np.quantile(heights, FLOOR_QUANTILE))
        spread = float(np.median(np.abs(np.array(heights) - height))) / height
        return height, spread, f"{len(heights)} of {len(edges)} pairs see"
    # a few pairs may see nothing but furniture: matched points have to agree, many closely, or some with none below
    above = [height_above_points(world[edge.first], world[edge.second], edge.matches) for edge in chosen]
    points = np.concatenate([np.zeros(0), *above])
    level = level_of_points(points)
    if level is None and heights and (off := spread_above(min(heights), points)) is not None:
        level = min(heights), off
    if level is None or any(abs(height / level[0] - 1.0) > MAX_LEVEL_ERROR for height in heights):
        found = "none" if chosen else "cameras at different heights (stairs?)"
        found = "planes that matched points do not confirm (furniture?)" if heights else found
        raise PoseError(
            f"expected a floor that two panoramas see, to measure the height of the camera from, got {found}; give the "
            "distance between neighbours instead (--baseline)"
        )
    source = f"{len(heights)} of {len(edges)} pairs see" if heights else "matched points tell"
    return float(np.mean(heights or level[:1])), level[1], source


def _known_within(spread: float) -> str:
    """Twice a relative standard deviation in words."""
    return f"known to within {max(200.0 * spread, 1.0):.0f} %"


def check_images(images: Sequence[Path], *, may_repeat: bool = True) -> None:
    """Refuse (InputError) fewer than two, what is no file, and unless it may, one that is named twice."""
    if len(images) < 2:
        raise InputError(f"expected two or more panoramas, got {len(images)}; name at least a first and a second one")
    image, count = Counter(map(real_path, images)).most_common(1)[0]
    if count > 1 and not may_repeat:
        raise InputError(f"expected every panorama once, got '{image.name}' several times; name it once")
    for image in images:
        check_is_file(image)


def usable_pictures(
    images: Sequence[Path], options: PictureOptions, masks: Sequence[Path | None] = ()
) -> Iterator[tuple[np.ndarray, np.ndarray | None]]:
    """The panoramas one after the other, each with where it may be used: by the masks of poses and those given."""
    if options.masks and len(options.masks) != len(images):
        raise InputError(f"expected one mask for each of {len(images)} panoramas, got {len(options.masks)}")
    limits: dict[str, Any] = {"allow_aspect": options.allow_aspect, "max_pixels": options.max_pixels}
    none = [None] * len(images)
    for image, *both in zip(images, masks or none, options.masks or none, strict=True):
        panorama = read_panorama(image, reading=options.reading, **limits)
        size = panorama.image.shape[:2]
        yield panorama.image, usable_part(panorama.mask, size, both, options.nadir, reading=options.reading, **limits)
    forget_tables()


def _relative_uncertainty(first: int, second: int, graph: PoseGraph) -> PoseUncertainty:
    if graph.adjusted is None:
        return _of_pair(graph.edges[0].estimate)
    rotation, position = graph.adjusted.relative_std(first, second)
    return PoseUncertainty(rotation, position if math.isfinite(position) else None)


def _of_pair(estimate: Estimate) -> PoseUncertainty:
    """Of a pair whose distance is given: only its direction is uncertain."""
    spread = estimate.uncertainty
    return PoseUncertainty(spread.rotation, None if estimate.have_same_position else math.tan(spread.direction))


def _pair_notes(
    images: Sequence[Path], edges: Sequence[Edge], known: Mapping[tuple[int, int], PoseUncertainty]
) -> list[str]:
    """About the neighbours whose uncertainty is known, and how many pairs besides."""
    notes = []
    for edge in edges:
        ends = edge.first, edge.second
        if spread := known.get(ends) or known.get(ends[::-1]):
            notes.append(f"{' and '.join(images[k].name for k in ends)}: {_estimate_note(edge, spread)}")
    if len(edges) > len(notes):
        notes.append(f"{len(edges) - len(notes)} other pairs match as well and are taken into account")
    return notes


def _estimate_note(edge: Edge, spread: PoseUncertainty) -> str:
    agreed = f"{edge.weight} of {len(edge.estimate.inliers)} matches agree"
    if spread.position is None:
        return f"{agreed} with a turn on the spot, no distance between them can be seen; both get one position"
    residual, rotation = np.degrees([edge.estimate.residual, spread.rotation])
    place = f"place {_known_within(spread.position)} of the distance"
    if spread.position > MAX_KNOWN_SPREAD:
        place = "distance not known: too few points that other pairs see as well (take a panorama between)"
    return f"{agreed} within {residual:.3f}° (median); rotation ± {rotation:.2g}°, {place}"


def _refinement_note(diagnosis: Diagnosis) -> str:
    given, estimate = diagnosis.given, diagnosis.estimate
    if given is None or estimate is None:
        return f"too few of {diagnosis.matches} matches agree; the poses stay as they are"
    if diagnosis.is_refinable:
        before, after = np.degrees([given.residual, estimate.residual])
        turned, moved = np.degrees([given.rotation, given.direction])
        return (
            f"rotation corrected by {turned:.3f}° and direction by {moved:.3f}°; median residual {before:.3f}° before, "
            f"{after:.3f}° now"
        )
    see = "; the poses stay as they are, see `omnisyn poses check`"
    if diagnosis.explanations:
        return f"it looks as if {diagnosis.explanations[0].hypothesis.words}{see}"
    if diagnosis.verdict == "contradiction":
        return f"they contradict the pictures (rotation off by {np.degrees(given.rotation):.1f}°){see}"
    if diagnosis.verdict == "in place":
        return "taken from one place, so that no direction can be seen; the poses stay as they are"
    return "refining gains nothing; the poses stay as they are"
