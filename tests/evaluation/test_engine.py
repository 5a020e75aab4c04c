"""Units of work: measured right, written down once, done again only when something changed."""

import json
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hall_samples import PATH, SIZE, damage, repaint, run, scores_of, write_halls

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation import engine, methods, results
from omnisyn_cli.evaluation.datasets.sources import Pair, Scene
from omnisyn_cli.evaluation.engine import EvaluationJob, evaluate, plan_evaluation
from omnisyn_cli.evaluation.measure import measure
from omnisyn_cli.evaluation.methods import ComparedMethod
from omnisyn_cli.evaluation.report import write_report
from omnisyn_cli.evaluation.results import RESULTS_NAME, UnitRecord, read_records
from omnisyn_cli.evaluation.views import LoadedPair
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import read_panorama
from omnisyn_cli.pipeline.config import DepthSource, RunConfig
from omnisyn_cli.runtime import session
from omnisyn_cli.synthesis.synthesize import Frame
from omnisyn_cli.types import DepthEstimate, View
from synthesis_samples import distance_to_wall, posed, write_hall, ws_psnr

METHODS = "crossfade,oracle-depth"


@pytest.fixture
def halls(tmp_path):
    return write_halls(tmp_path / "data", "a", "b")


def lines(folder: Path) -> list[tuple[str, str]]:
    return [(record.scene, record.method) for record in read_records(folder.parent / "report")]


def test_frames_between_are_compared_where_they_were_taken(tmp_path):
    """The true depth makes nearly the true frame, though these are off the line and turned; a cross-fade does not."""
    data = write_halls(tmp_path / "data", "hall")
    records = run(data, METHODS)
    oracle = next(record for record in records if record.method == "oracle-depth")
    assert [frame.name for frame in oracle.frames] == ["p1.png", "p2.png"]
    assert scores_of(records, "oracle-depth").min() > 45
    assert scores_of(records, "crossfade").max() < 30
    assert (oracle.first, oracle.second, oracle.size) == ("p0.png", "p3.png", SIZE)
    assert oracle.baseline == pytest.approx(1.2)
    for frame, pose in zip(oracle.frames, PATH[1:-1], strict=True):
        d0, d1 = (float(np.linalg.norm(pose.position - end.position)) for end in (PATH[0], PATH[-1]))
        assert frame.t == pytest.approx(d0 / (d0 + d1))
        assert frame.distance == pytest.approx(min(d0, d1))


def test_what_is_brighter_than_white_is_shown_as_white():
    """Videos hold nothing beyond, and neither may what is measured."""

    class Overshooting:
        depths = None

        def __init__(self, size, clock):
            self.size = size

        def frame(self, waypoint, out=None):
            return Frame(np.full((*self.size, 3), 1.2), waypoint, None)

        def inverse_depth(self, waypoint):
            return np.full(self.size, 0.1)

        def renderings(self, waypoint):
            return None

    poses = [Pose(np.eye(3), np.array([x, 0.0, 0.0])) for x in (0.0, 1.0)]
    white = np.ones((16, 32, 3), np.float32)
    pair = LoadedPair((View(white, poses[0]), View(white, poses[1])), (), (16, 32))
    measured = measure(Overshooting, pair, ("a", "b"))
    expected = dict.fromkeys(("end_first", "end_second", "warping_error", "flicker"), 0.0)
    assert measured.temporal == pytest.approx(expected, abs=1e-12)


def test_errors_are_told_by_kind_of_pixel(tmp_path):
    """In a hall that both views see all of; the ends alone where nothing is known of distances."""
    data = write_halls(tmp_path / "data", "hall")
    oracle, alone, fade = run(data, "oracle-depth,oracle-depth:views=1,crossfade")
    for frame in oracle.frames:
        assert set(frame.by_kind) == {"psnr", "area", "error"}
        assert frame.by_kind["area"]["agree"] > 0.95
        four = ("agree", "disagree", "one_view", "hole")
        for figure in ("area", "error"):
            assert sum(frame.by_kind[figure].get(kind, 0.0) for kind in four) == pytest.approx(1.0)
    for frame in alone.frames:
        assert frame.by_kind["area"]["one_view"] > 0.95
        assert not {"agree", "disagree"} & frame.by_kind["area"].keys()
    for frame in fade.frames:
        assert set(frame.by_kind["psnr"]) == {"top", "bottom"}


def test_depth_and_steadiness_of_the_truth_are_perfect(tmp_path):
    data = write_halls(tmp_path / "data", "hall")
    oracle, fade = run(data, "oracle-depth,crossfade")
    assert [depth.view for depth in oracle.depths] == ["p0.png", "p3.png"]
    for depth in oracle.depths:
        for figures in (depth.plain, depth.weighted):
            assert figures["imae"] == pytest.approx(0, abs=1e-6)
            assert figures["delta_105"] == 1
        assert depth.doubt == {}, "whoever is told the truth has none"
    assert oracle.temporal["warping_error"] < 0.01
    assert oracle.temporal["flicker"] < 0.01
    assert max(oracle.temporal["end_first"], oracle.temporal["end_second"]) < 0.01
    assert fade.depths == ()
    assert set(fade.temporal) == {"end_first", "end_second"}
    assert oracle.seconds["total"] == pytest.approx(sum(s for stage, s in oracle.seconds.items() if stage != "total"))


def test_what_matching_is_unsure_of_is_known_whatever_fills_it(tmp_path):
    """The same area for both methods; and what changes, flies and is worst stands in every record."""
    data = write_halls(tmp_path / "data", "hall")
    matching, filled, fade = run(data, "matching,omnisyn-balanced:model=none:prior=none:descriptors=none,crossfade")
    for one, other in zip(matching.depths, filled.depths, strict=True):
        assert 0 < one.doubt["unsure_area"] == other.doubt["unsure_area"] < 0.9
        assert one.doubt["within_5_sure"] > one.doubt["within_5_unsure"]
        assert one.doubt["rank_correlation"] > 0
        assert sum(one.reliability["area"].values()) == pytest.approx(1)
    first, second = matching.frames
    assert "change_psnr" not in first.scores
    assert second.scores["change_psnr"] > fade.frames[1].scores["change_psnr"]
    assert 0 <= first.scores["flying"] < 0.01
    assert 0 <= first.scores["shards"] <= 1
    assert matching.worst == {
        "ws_psnr": min((first, second), key=lambda frame: frame.scores["ws_psnr"]).name, "change_psnr": second.name
    }  # fmt: skip


def test_a_size_is_that_of_the_comparison_and_not_of_the_inputs(tmp_path):
    data = write_halls(tmp_path / "data", "hall")
    (small,) = run(data, "oracle-depth", size=(32, 64))
    assert small.size == (32, 64)
    assert min(frame.scores["ws_psnr"] for frame in small.frames) > 40


def test_nothing_is_done_twice(halls, monkeypatch):
    first = run(halls, METHODS)
    written = (halls.parent / "report" / RESULTS_NAME).read_bytes()
    monkeypatch.setattr(engine, "measure", None)
    assert run(halls, METHODS) == first
    assert run(halls, METHODS, pairs="0:3,0:3") == first
    assert (halls.parent / "report" / RESULTS_NAME).read_bytes() == written


def interrupt(done: int, _: UnitRecord) -> None:
    """After the third unit."""
    if done == 3:
        raise KeyboardInterrupt


def test_an_interrupted_run_goes_on_where_it_was(halls):
    with pytest.raises(KeyboardInterrupt):
        run(halls, METHODS, interrupt)
    assert len(lines(halls)) == 3
    path = halls.parent / "report" / RESULTS_NAME
    path.write_bytes(path.read_bytes() + b'{"key": "what was being writ')
    run(halls, METHODS)
    everything = [("a", "crossfade"), ("a", "oracle-depth"), ("b", "crossfade"), ("b", "oracle-depth")]
    assert lines(halls) == everything


def test_what_was_finished_before_an_interruption_is_in_the_report(halls):
    """In a folder that was not there."""
    report = halls.parent / "deep" / "report"
    job = EvaluationJob(halls, report, METHODS, pictures=False, threads=1)
    with pytest.raises(KeyboardInterrupt):
        evaluate(plan_evaluation(job), interrupt)
    units = json.loads((report / "report.json").read_text(encoding="utf-8"))["units"]
    assert [(unit["scene"], unit["method"]) for unit in units][1:] == [("a", "oracle-depth"), ("b", "crossfade")]
    assert "oracle-depth" in (report / "report.html").read_text(encoding="utf-8")


def test_a_changed_program_measures_again(halls, monkeypatch):
    run(halls, "crossfade")
    monkeypatch.setattr(results, "digest_of_sources", lambda _: "another")
    run(halls, "crossfade")
    assert lines(halls) == [("a", "crossfade"), ("b", "crossfade")] * 2


def test_sources_are_those_that_methods_go_through(tmp_path):
    def digest(**files: str) -> str:
        results.digest_of_sources.cache_clear()
        for name, text in files.items():
            path = tmp_path / f"{name.replace('_', '/')}.py"
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
        return results.digest_of_sources(tmp_path)

    first = digest(render_mesh="a", cli_eval="a")
    assert digest(cli_eval="b") == first
    assert digest(render_mesh="b") != first
    assert digest(render_mesh="a") == first
    assert digest(render_other="") != first


@pytest.mark.parametrize("place", ["load_pair", "choose_pairs"])
def test_errors_that_nobody_expected_are_reported_too(halls, monkeypatch, place):
    original = getattr(engine, place)

    def break_one(scene: Pair | Scene, *rest: object, **options: object) -> object:
        if Path(scene.first.image if isinstance(scene, Pair) else scene.frames[0].image).parent.name == "a":
            raise MemoryError("too large")
        return original(scene, *rest, **options) if place == "load_pair" else original(None)(scene)

    monkeypatch.setattr(engine, place, break_one if place == "load_pair" else lambda _: break_one)
    records = run(halls, "crossfade")
    assert [(r.scene, r.status) for r in records] == [("a", "failed"), ("b", "done")]
    assert records[0].reason == "MemoryError: too large"


def test_scenes_too_short_for_a_step_are_listed_and_pairs_of_no_scene_refused(halls):
    assert [(r.scene, r.status) for r in run(halls, "crossfade", pairs="every:9")] == [(s, "skipped") for s in "ab"]
    pairs = halls.parent / "pairs.txt"
    pairs.write_text("nosuch 0 3\n")
    with pytest.raises(InputError, match="expected pairs of the scenes"):
        run(halls, "crossfade", pairs=str(pairs))


def test_only_what_changed_is_done_again(halls):
    run(halls, METHODS)
    repaint(halls / "b" / "p1.png")
    run(halls, METHODS)
    assert lines(halls)[4:] == [("b", "crossfade"), ("b", "oracle-depth")]
    run(halls, "crossfade,flow")
    assert lines(halls)[6:] == [("a", "flow"), ("b", "flow")]
    run(halls, "crossfade", size=(32, 64))
    assert lines(halls)[8:] == [("a", "crossfade"), ("b", "crossfade")]
    run(halls, "crossfade", size=(32, 64), threads=2)
    assert len(lines(halls)) == 10


def test_a_moved_camera_is_a_change(halls):
    run(halls, "crossfade")
    poses = halls / "a" / "poses.json"
    poses.write_text(poses.read_text().replace("[0.25, 0.1, 0.3]", "[0.25, 0.1, 0.31]"))
    run(halls, "crossfade")
    assert lines(halls)[2:] == [("a", "crossfade")]


@pytest.mark.parametrize("name", ["p0.png", "p1.png", "p3_depth.exr"])
def test_a_broken_scene_is_reported_and_the_rest_goes_on(halls, name):
    damage(halls / "a" / name)
    records = run(halls, METHODS)
    assert [(r.scene, r.status) for r in records] == [("a", "failed")] * 2 + [("b", "done")] * 2
    assert name in records[0].reason
    write_halls(halls.parent / "new", "a")
    (halls.parent / "new" / "a" / name).replace(halls / "a" / name)
    assert [r.status for r in run(halls, METHODS)] == ["done"] * 4


def test_broken_poses_and_missing_files_are_reported_too(halls):
    (halls / "a" / "poses.json").write_text("{")
    (halls / "b" / "p2.png").unlink()
    broken, missing = run(halls, "crossfade")
    assert (broken.scene, broken.method, broken.status) == ("a", "", "failed")
    assert "expected JSON" in broken.reason
    assert (missing.scene, missing.method, missing.status) == ("b", "crossfade", "failed")
    assert "p2.png" in missing.reason


def test_a_method_that_breaks_does_not_end_the_others(halls, monkeypatch):
    original = engine.find_methods
    bad = ComparedMethod("bad", "", RunConfig(DepthSource("network", model="any")))
    monkeypatch.setattr(session, "open_model", Mock(side_effect=ZeroDivisionError("by\nzero")))
    monkeypatch.setattr(engine, "find_methods", lambda text: [bad, *original(text)])
    records = run(halls, "crossfade")
    assert [(r.method, r.status) for r in records] == [("bad", "failed"), ("crossfade", "done")] * 2
    assert records[0].reason == "ZeroDivisionError: by zero"


def test_without_true_frames_a_frame_half_way_is_judged_by_what_photographs_show(tmp_path):
    data = write_halls(tmp_path / "data", "pair", frames=2, with_depth=False)
    write_halls(data, "full")
    full, alone = run(data, "crossfade", pictures=True)
    assert [frame.name for frame in full.frames] == ["p1.png", "p2.png"]
    (frame,) = alone.frames
    assert (alone.scene, alone.status, frame.name, frame.t) == ("pair", "done", "half way", 0.5)
    assert frame.distance == pytest.approx(alone.baseline / 2)
    assert frame.scores.keys() == {"shards"}
    assert (frame.pictures.keys(), frame.by_kind) == ({"frame"}, {})
    write_report(tmp_path / "report", [full, alone])
    table = json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))["tables"]
    assert [t["rows"][0]["cells"][-1]["value"] for t in table if "shards" in t["title"]] == [3]
    rows = (tmp_path / "report" / "report.csv").read_text(encoding="utf-8").splitlines()
    assert [row for row in rows if row.startswith("pair") and ",frame,half way,0.5,0.6," in row and ",shards," in row]
    assert "0.60 m from the nearer panorama" in (tmp_path / "report" / "report.html").read_text(encoding="utf-8")


def test_scenes_without_panoramas_are_listed_once(tmp_path):
    data = write_halls(tmp_path / "data", "full")
    (data / "none").mkdir()
    (data / "none" / "poses.json").write_text('{"version": 1, "panoramas": {}}')
    for _ in range(2):
        run(data, "crossfade")
    assert sorted(lines(data)) == [("full", "crossfade"), ("none", "")]


def test_what_cannot_run_says_why(tmp_path, monkeypatch):
    monkeypatch.setattr(session, "open_model", Mock(side_effect=InputError("expected the network, got none")))
    data = write_halls(tmp_path / "data", "hall", with_depth=False)
    records = run(data, "oracle-depth,omnisyn-paper")
    assert [record.status for record in records] == ["unavailable"] * 2
    assert "true depth" in records[0].reason
    assert "expected the network" in records[1].reason


def test_pictures_are_kept_and_made_again_when_they_are_gone(tmp_path):
    data = write_halls(tmp_path / "data", "hall")
    (record,) = run(data, "oracle-depth", pictures=True)
    report = tmp_path / "report"
    for frame in record.frames:
        assert set(frame.pictures) == {"frame", "truth", "error"}
        shown, truth, error = (read_panorama(report / frame.pictures[key]).image for key in ("frame", "truth", "error"))
        assert ws_psnr(shown, truth) > 30
        assert error.max() < 0.3
    for depth in record.depths:
        found, truth = (read_panorama(report / depth.pictures[key]).image for key in ("depth", "truth"))
        np.testing.assert_allclose(found, truth, atol=0.05)
    (report / record.frames[0].pictures["error"]).unlink()
    (again,) = run(data, "oracle-depth", pictures=True)
    assert (report / again.frames[0].pictures["error"]).is_file()
    assert len(lines(data)) == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [({"methods": "nosuch"}, "expected one of"), ({"methods": ","}, "expected 'usual', 'all' or names"),
     ({"size": (64, 64)}, "twice as wide"), ({"pairs": "0"}, "expected pairs"),
     ({"layout": "carla"}, "layout 'carla'")],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_before_any_work(tmp_path, options, message):
    data = write_halls(tmp_path / "data", "hall")
    with pytest.raises(InputError, match=message):
        plan_evaluation(EvaluationJob(data, tmp_path / "report", **options))
    assert not (tmp_path / "report").exists()


def test_methods_are_compared_with_themselves_in_tours(tmp_path, monkeypatch):
    """Each pair knows half of the middle panorama, in a tour it has the other half too."""
    data = tmp_path / "data" / "walk"
    data.mkdir(parents=True)
    poses = [posed((0, 0, 0.8 - 0.4 * k)) for k in range(5)]
    write_hall(data, poses)
    truths = {pose.position.tobytes(): distance_to_wall(pose, SIZE) for pose in poses}

    def half_blind(first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        found = []
        for view, is_left in ((first, False), (second, True)):
            knows = np.broadcast_to((np.arange(SIZE[1]) < SIZE[1] // 2) == is_left, SIZE).astype(np.float32)
            rho = np.where(knows > 0, 1 / truths[view.pose.position.tobytes()], 0.9)
            found.append(DepthEstimate(rho.astype(np.float32), knows))
        return found[0], found[1]

    monkeypatch.setattr(methods, "make_estimator", lambda *_, **__: half_blind)
    tour = "matching:neighbours=2"
    records = run(data.parent, f"crossfade,matching,{tour},oracle-depth", pairs="every:2")
    assert [record.method for record in records[:4]] == ["crossfade", "matching", tour, "oracle-depth"]
    assert [(record.first, record.second) for record in records[::4]] == [("p0.png", "p2.png"), ("p2.png", "p4.png")]
    alone, joined = (
        [frame.scores["ws_psnr"] for record in records if record.method == method for frame in record.frames]
        for method in ("matching", tour)
    )
    assert (np.subtract(joined, alone) > 1).all()


def test_a_tour_is_measured_again_where_a_panorama_beside_it_changed(tmp_path, monkeypatch):
    flat = DepthEstimate(np.full(SIZE, 0.25, np.float32), np.ones(SIZE, np.float32))
    monkeypatch.setattr(methods, "make_estimator", lambda *_, **__: lambda *_: (flat, flat))
    data = tmp_path / "data" / "walk"
    data.mkdir(parents=True)
    write_hall(data, [posed((0, 0, 0.8 - 0.4 * k)) for k in range(5)])
    names = "matching,matching:neighbours=2"
    before = {(r.first, r.method): r.key for r in run(data.parent, names, pairs="every:2")}
    repaint(data / "p4.png")
    after = {(r.first, r.method): r.key for r in run(data.parent, names, pairs="every:2")}
    changed = {unit for unit in before if before[unit] != after[unit]}
    assert changed == before.keys() - {("p0.png", "matching")}
