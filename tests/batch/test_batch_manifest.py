"""A manifest is understood whole or refused with every reason, before anything starts."""

import csv
import json
from pathlib import Path
from typing import Any

import pytest
from batch_samples import line, write_lines, write_row

from omnisyn_cli.batch.manifest import read_manifest
from omnisyn_cli.batch.schema import Line
from omnisyn_cli.cli.interpolate import interpolate
from omnisyn_cli.errors import InputError


def problems(folder: Path, *lines: Any) -> list[str]:
    return list(read_manifest(write_lines(folder / "jobs.jsonl", list(lines))).problems)


def test_a_line_becomes_the_interpolation_it_describes(tmp_path):
    write_row(tmp_path, 3)
    options = {"frames": 9, "size": "64x32", "cut_metres": 2, "encoder_preset": "slow", "output": "d/a.mp4", "crf": 20}
    manifest = read_manifest(write_lines(tmp_path / "jobs.jsonl", [line(0, 1, **options, save_depth="depth")]))
    assert not manifest.problems
    job = manifest.jobs[0].interpolation(tmp_path / "out", threads=3)
    assert job.images == (tmp_path / "p0.png", tmp_path / "p1.png")
    assert (job.poses, job.output) == (tmp_path / "poses.json", tmp_path / "out" / "d" / "a.mp4")
    assert (job.frames, job.size, job.encoder_preset) == (9, (32, 64), "slow")
    assert (job.cut, job.cut_metres) == (None, 2.0)
    assert (job.save_depth, job.threads, job.crf, job.fps) == (tmp_path / "out" / "depth", 3, 20, 30)


def test_a_scene_is_its_first_and_last_panorama_unless_inputs_say_otherwise(tmp_path):
    (tmp_path / "hall").mkdir()
    write_row(tmp_path / "hall", 4)
    lines = [{"id": "a", "scene": "hall"}, {"id": "b", "scene": "hall", "inputs": ["p2.png", "p1.png"]}]
    first, second = read_manifest(write_lines(tmp_path / "jobs.jsonl", lines)).jobs
    assert [path.name for path in first.images] == ["p0.png", "p3.png"]
    assert [path.name for path in second.images] == ["p2.png", "p1.png"]
    assert first.places == ["a.mp4"]


def test_every_option_of_interpolate_is_one_of_a_line():
    """But for those of a run, a video, and a budget; ``--view`` is two keys of a line, ``--path`` its ``inputs``."""
    of_the_run = {"images", "threads", "overwrite", "dry_run", "as_json", "verbose", "quiet", "budget", "help_all"}
    of_a_line = {option.name for option in interpolate.params} - of_the_run - {"every", "views", "path"}
    assert of_a_line | {"view", "projection"} <= set(Line.model_fields)


def test_csv_says_the_same_as_jsonl(tmp_path):
    write_row(tmp_path, 3)
    lines = [line(0, 1, fps=25, allow_aspect=True), line(1, 2, size="64x32", masks=["p0.png", "p1.png"])]
    columns = ["id", "inputs", "poses", "output", "frames", "fps", "allow_aspect", "size", "masks"]
    with (tmp_path / "jobs.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(
            {key: ";".join(cell) if isinstance(cell, list) else cell for key, cell in one.items()} for one in lines
        )
    from_csv = read_manifest(tmp_path / "jobs.csv")
    assert not from_csv.problems
    assert from_csv.jobs == read_manifest(write_lines(tmp_path / "jobs.jsonl", lines)).jobs


def test_all_problems_are_listed_with_their_lines(tmp_path):
    write_row(tmp_path, 3)
    found = problems(
        tmp_path, line(0, 1), '{"id": ', "", "[1]", line(1, 2, framse=3, fps="many"), line(0, 7),
        line(1, 0) | {"id": "0-1"}, {"id": "../x", "scene": "no"}, {"id": "none"}, line(0, 2, poses="gone.json"),
    )  # fmt: skip
    words = {2: "JSON", 4: "object", 5: "fps", 6: "p7.png", 7: "as in line 1", 8: "id:", 9: "scene", 10: "gone.json"}
    for number, word in words.items():
        assert any(text.startswith(f"line {number}: ") and word in text for text in found), (number, found)
    assert any("framse" in text for text in found)
    assert {int(text.split(":")[0].split()[1]) for text in found} == set(words)


@pytest.mark.parametrize(
    ("changes", "word"),
    [({"output": "/abs.mp4"}, "relative"), ({"output": "a/../../b.mp4"}, "relative"), ({"output": "C:\\x.mp4"}, "rel"),
     ({"output": "results.jsonl"}, "itself"), ({"output": ".omnisyn-x/y.mp4"}, "itself"),
     ({"output": "%05d.png"}, "folder"), ({"frames": 1}, "frames"), ({"frames": 3, "duration": 2}, "either"),
     ({"size": "64x64"}, "twice"), ({"size": "64"}, "size"), ({"cut": 0.1, "cut_metres": 1}, "either"),
     ({"cut": 0}, "cut"), ({"depth": "guess"}, "depth"), ({"preset": "best"}, "preset"), ({"renderer": "x"}, "rend"),
     ({"inputs": ["p0.png"]}, "inputs"), ({"inputs": ["p0.png", "p2.exr"]}, "p2.exr"), ({"fps": 1e999}, "finite"),
     ({"nadir": 90}, "nadir"), ({"masks": ["p0.png"]}, "one mask"), ({"masks": ["p0.png", "m.png"]}, "m.png"),
     ({"baseline": 2}, "baseline"), ({"poses": "auto", "baseline": 0}, "baseline"),
     ({"codec": "mpeg"}, "codec"), ({"output": "a.mp4", "codec": "prores"}, ".mov"), ({"crf": 99}, "quality"),
     ({"heading": "up"}, "heading"), ({"output": "a/", "codec": "h265"}, "png"), ({"output": "a.png"}, "one image"),
     ({"output": "a.mp4", "size": "62x31"}, "even"), ({"encoder_preset": "warp"}, "preset"),
     ({"fallback": "hope"}, "fallback"), ({"frames": None, "duration": 0.01}, "2 frames"),
     ({"save_frames": "b.mp4x"}, ".mp4"), ({"method": "synsin", "fusion": "network"}, "synsin"),
     ({"threads": 2}, "threads"), ({"overwrite": True}, "overwrite")],
)  # fmt: skip
def test_what_no_job_may_say_is_refused(tmp_path, changes, word):
    write_row(tmp_path, 2)
    found = problems(tmp_path, line(0, 1) | changes)
    assert len(found) == 1
    assert word in found[0]


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [({"frames": "x"}, "frames: expected a valid integer, got 'x'; correct it"),
     ({"nadir": 90}, "nadir: expected a number less than 90, got 90; correct it"),
     ({"size": "64"}, "size: expected WIDTHxHEIGHT such as 2048x1024, got '64'; correct it"),
     ({"allow_aspect": "perhaps"}, "allow_aspect: expected true or false, got 'perhaps'; correct it"),
     ({"framse": 3}, "framse: expected a known key, got 'framse'; did you mean 'frames'?"),
     ({"inputs": ["p0.png"]}, "inputs: expected at least 2 items, got ['p0.png']; correct it"),
     ({"poses": None}, "expected inputs with poses, or a scene, got neither; name one of them")],
)  # fmt: skip
def test_problems_say_expected_got_and_what_to_do(tmp_path, changes, sentence):
    write_row(tmp_path, 2)
    assert problems(tmp_path, line(0, 1) | changes) == [f"line 1: {sentence}"]


def test_what_is_said_twice_or_is_no_number_is_refused(tmp_path):
    write_row(tmp_path, 2)
    text = json.dumps(line(0, 1))
    twice, endless = (f"{text[:-1]}, {more}}}" for more in ('"frames": 4', '"crf": NaN'))
    assert problems(tmp_path, twice, endless) == [
        "line 1: expected every key once, got 'frames' twice in one object; remove one",
        "line 2: expected finite numbers, got NaN; write a number",
    ]
    table = tmp_path / "jobs.csv"
    table.write_text("id,inputs,poses,frames,frames\na,p0.png;p1.png,poses.json,3,4\n")
    assert read_manifest(table).problems == (
        "line 1: expected every column once, got 'frames' twice; remove one of them",
    )


@pytest.mark.parametrize(
    ("one", "two"), [("a.mp4", "a.mp4"), ("a", "a/b.mp4"), ("a/b.mp4", "a"), ("a/%05d.png", "a"), ("./a.mp4", "a.mp4")]
)
def test_no_two_jobs_write_to_one_place(tmp_path, one, two):
    write_row(tmp_path, 3)
    found = problems(tmp_path, line(0, 1, output=one), line(1, 2, output=two), line(0, 2, output="b.mp4"))
    assert len(found) == 1
    assert "of line 1;" in found[0]
    assert found[0].startswith("line 2: ")


def test_of_ten_thousand_lines_the_wrong_one_is_named(tmp_path):
    write_row(tmp_path, 3)
    lines = [line(k % 2, 2, id=f"job-{k}", output=f"{k}.mp4", size="512x256", fps=24) for k in range(9_999)]
    path = write_lines(tmp_path / "jobs.jsonl", [*lines, {**lines[0], "frames": "none"}])
    manifest = read_manifest(path)
    assert len(manifest.jobs) == 9_999
    assert [text.split(":")[0] for text in manifest.problems] == ["line 10000"]


@pytest.mark.parametrize("content", [None, b"", b"\n\n", b"\xff\xfe{"])
def test_what_is_no_manifest_is_refused(tmp_path, content):
    path = tmp_path / "jobs.jsonl"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match="expected"):
        read_manifest(path)


def test_file_names_are_the_manifests_not_the_working_directorys(tmp_path, monkeypatch):
    write_row(tmp_path, 2)
    (tmp_path / "jobs").mkdir()
    inputs = ["../p0.png", "../p1.png"]
    path = tmp_path / "jobs" / "jobs.jsonl"
    path.write_text(json.dumps({"id": "a", "inputs": inputs, "poses": "../poses.json"}))
    monkeypatch.chdir(tmp_path / "jobs")
    for name in (path, Path("jobs.jsonl")):
        assert read_manifest(name).jobs[0].images == (tmp_path / "p0.png", tmp_path / "p1.png")
