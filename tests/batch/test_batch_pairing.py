"""Neighbours are those of the definition, every pair is walked once, and the manifest can be done."""

import json
from pathlib import Path

import numpy as np
import pytest
from batch_samples import write_row
from hypothesis import given
from hypothesis import strategies as st

from omnisyn_cli.batch.manifest import read_manifest
from omnisyn_cli.batch.pairing import TourOptions, group_pairs, neighbours, plan_tours, write_manifest
from omnisyn_cli.errors import InputError, OutputPathError


def by_definition(positions: np.ndarray, count: int, farthest: float) -> list[tuple[int, int]]:
    pairs = set()
    for index, place in enumerate(positions):
        distances = [(float(np.linalg.norm(other - place)), k) for k, other in enumerate(positions)]
        near = sorted((d, k) for d, k in distances if 1e-9 < d <= farthest)
        pairs.update((min(index, k), max(index, k)) for _, k in near[:count])
    return sorted(pairs)


@pytest.mark.parametrize("farthest", [0.5, 3.0, 100.0])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_neighbours_are_those_of_the_definition(count, farthest):
    positions = np.random.default_rng(count).normal(size=(60, 3)) * (4, 0.2, 4)
    positions[7] = positions[8]
    assert neighbours(positions, count, farthest) == by_definition(positions, count, farthest)


def test_a_walk_of_panoramas_has_one_pair_per_step():
    positions = np.arange(6.0)[:, None] * (1.0, 0.0, 0.0)
    assert neighbours(positions, 2, 1.5) == [(k, k + 1) for k in range(5)]


graphs = st.sets(st.tuples(st.integers(0, 12), st.integers(0, 12)).filter(lambda p: p[0] < p[1]), max_size=30)


@given(pairs=graphs, share=st.integers(1, 9))
def test_walks_take_every_pair_once(pairs, share):
    groups = group_pairs(sorted(pairs), share)
    assert sorted((min(p), max(p)) for group in groups for p in group) == sorted(pairs)
    assert all(1 <= len(group) <= share for group in groups)


def test_a_street_is_walked_from_end_to_end():
    street = [(k, k + 1) for k in range(9)]
    (walk,) = group_pairs(street, 100)
    assert walk == street
    assert [len(group) for group in group_pairs(street, 4)] == [4, 4, 1]


def test_a_tour_becomes_a_manifest_without_problems(tmp_path):
    write_row(tmp_path, 4)
    (tmp_path / "jobs").mkdir()
    path = tmp_path / "jobs" / "jobs.jsonl"
    lines = plan_tours(tmp_path, TourOptions(max_baseline=1.5, options={"frames": 5}))
    write_manifest(path, lines)
    manifest = read_manifest(path)
    assert not manifest.problems
    names = [tuple(image.stem for image in job.images) for job in manifest.jobs]
    assert names == [("p0", "p1"), ("p1", "p0"), ("p1", "p2"), ("p2", "p1"), ("p2", "p3"), ("p3", "p2")]
    assert len({job.group for job in manifest.jobs}) == 1
    assert all(job.options == {"frames": 5} for job in manifest.jobs)
    assert json.loads(path.read_text().splitlines()[0])["inputs"] == ["../p0.png", "../p1.png"]
    with pytest.raises(OutputPathError, match="exists"):
        write_manifest(path, lines)


def test_a_tour_whose_poses_are_rough_can_have_them_found(tmp_path):
    (tmp_path / "tour").mkdir()
    write_row(tmp_path / "tour", 2)
    options = TourOptions(options={"poses": "auto", "baseline": 1})
    write_manifest(tmp_path / "jobs.jsonl", plan_tours(tmp_path / "tour", options))
    manifest = read_manifest(tmp_path / "jobs.jsonl")
    assert not manifest.problems
    assert {job.poses for job in manifest.jobs} == {Path("auto")}


def test_a_tour_with_depth_elsewhere_needs_what_its_jobs_need(tmp_path):
    (tmp_path / "tour").mkdir()
    write_row(tmp_path, 2)
    for name in ("p0.png", "p1.png"):
        (tmp_path / name).rename(tmp_path / "tour" / name)
    poses = json.loads((tmp_path / "poses.json").read_text())
    for entry in poses["panoramas"].values():
        entry["depth"] = f"../{entry['depth']}"
    (tmp_path / "tour" / "poses.json").write_text(json.dumps(poses))
    with pytest.raises(InputError, match="allow-outside"):
        plan_tours(tmp_path / "tour", TourOptions())
    lines = plan_tours(tmp_path / "tour", TourOptions(options={"allow_outside": True}))
    write_manifest(tmp_path / "jobs.jsonl", lines)
    assert not read_manifest(tmp_path / "jobs.jsonl").problems


def test_a_folder_of_scenes_keeps_them_apart(tmp_path):
    for name in ("hall", "the yard"):
        (tmp_path / name).mkdir()
        write_row(tmp_path / name, 2)
    (tmp_path / "notes").mkdir()
    write_manifest(tmp_path / "jobs.jsonl", plan_tours(tmp_path, TourOptions(both_directions=False)))
    manifest = read_manifest(tmp_path / "jobs.jsonl")
    assert not manifest.problems
    assert [job.id for job in manifest.jobs] == ["hall-p0-p1", "the_yard-p0-p1"]
    assert len({job.group for job in manifest.jobs}) == 2


def test_places_without_neighbours_or_poses_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"expected poses\.json"):
        plan_tours(tmp_path, TourOptions())
    write_row(tmp_path, 2)
    with pytest.raises(InputError, match="--max-baseline"):
        plan_tours(tmp_path / "poses.json", TourOptions(max_baseline=0.5))


@pytest.mark.parametrize(
    ("options", "words"),
    [({"foo": 1}, "'foo'; choose from .*fps"), ({"output": "a.mp4"}, "'output'"), ({"fps": "many"}, "fps: .*'many'")],
)
def test_options_that_no_job_could_have_are_refused_before_anything_is_planned(tmp_path, options, words):
    with pytest.raises(InputError, match=words):
        plan_tours(tmp_path / "gone", TourOptions(options=options))
