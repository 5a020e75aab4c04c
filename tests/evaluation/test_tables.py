"""Tables against means computed by hand, and who is called the best."""

import math
from dataclasses import replace

import numpy as np
import pytest
from report_samples import absent, depth, frame, some_records, unit

from omnisyn_cli.evaluation.grouping import distance_band, gaps, is_oracle, pair_names, ranked_methods, time_band
from omnisyn_cli.evaluation.tables import Table, format_cell, format_value, mean_table, report_tables


def table(title: str, records=None) -> Table:
    return next(t for t in report_tables(some_records() if records is None else records) if t.title == title)


def figures(shown: Table) -> dict[str, dict[str, float]]:
    titles = [column.title for column in shown.columns]
    return {row.name: dict(zip(titles, (c.value for c in row.cells), strict=True)) for row in shown.rows if row.cells}


def in_scenes(records, scenes: str = "abc"):
    """The same records in several scenes, so that there is something to tell chance by."""
    return [replace(record, scene=f"{record.scene}-{scene}") for scene in scenes for record in records]


def best(shown: Table) -> set[tuple[str, str]]:
    return {
        (row.name, column.title)
        for row in shown.rows
        for cell, column in zip(row.cells, shown.columns, strict=False)
        if cell.is_best
    }


def test_methods_are_averaged_over_all_their_frames_and_ranked():
    shown = table("Means per method")
    assert [row.name for row in shown.rows] == ["oracle-depth", "matching", "crossfade", "synsin"]
    matching = figures(shown)["matching"]
    assert matching["WS-PSNR, dB"] == pytest.approx(np.mean([26, 24, 28, 22, 20, 24]))
    assert matching["PSNR, dB"] == pytest.approx(matching["WS-PSNR, dB"] + 0.5)
    assert matching["Frames"] == 6
    assert "Misplacement, degrees" not in matching


def test_tours_are_compared_with_pairs_frame_by_frame():
    """Only frames that both have count; the standard error is that of the means of the scenes."""
    records = [
        unit("hall", "matching", (20.0, 22.0)), unit("hall", "matching:neighbours=2", (21.0, 22.5)),
        unit("street", "matching", (30.0,)), unit("street", "matching:neighbours=2", (30.25,)),
        unit("street", "flat", (30.0,)), unit("yard", "matching:neighbours=2", (10.0,)),
    ]  # fmt: skip
    shown = figures(table("In tours", records))
    assert list(shown) == ["matching"]
    assert list(shown["matching"].values()) == pytest.approx([(1 + 0.5 + 0.25) / 3, 0.25, 0.25, 1.0, 3])
    assert "In tours" not in [each.title for each in report_tables(some_records())]


def test_errors_stand_by_kind_of_pixel_and_none_is_best():
    """Kinds without pixels have no column; every method has kinds of its own, so none is compared."""
    errors, areas = table("Error by kind of pixel, dB"), table("Area by kind of pixel")
    matching = figures(errors)["matching"]
    assert set(matching) == {"Both views agree", "one view only", "Frames"}
    assert matching["Both views agree"] == pytest.approx(np.mean([26, 24, 28, 22, 20, 24]) + 2)
    assert figures(areas)["oracle-depth"]["one view only"] == 0.25
    assert figures(table("Share of the squared error by kind of pixel"))["matching"]["one view only"] == 0.75
    assert not best(errors) | best(areas)


def test_a_mean_over_frames_is_not_one_over_scenes():
    records = [unit("a", "matching", (10.0,)), unit("b", "matching", (20.0, 30.0, 40.0))]
    assert figures(table("Means per method", records))["matching"]["WS-PSNR, dB"] == 25.0


def test_a_method_that_measured_nothing_is_listed_with_its_reasons():
    row = table("Means per method").rows[-1]
    assert (row.name, row.cells) == ("synsin", ())
    assert row.reason == "unavailable: expected the network 'synsin', this version has none"
    several = [
        absent("a", "flow", "failed", "x"),
        absent("b", "flow", "failed", "y"),
        absent("c", "flow", "failed", "y"),
    ]
    assert mean_table(several).rows[0].reason == "failed: y; failed: x"


def test_the_best_is_marked_in_the_direction_of_the_column():
    quick = {"fuse": 1.0, "total": 1.0}
    records = in_scenes([
        unit("hall", "one", (20.0,), seconds=quick, depths=(depth("a", 0.2),)),
        unit("hall", "two", (30.0,), depths=(depth("a", 0.1),)),
    ])  # fmt: skip
    assert best(table("Means per method", records)) == {("two", "WS-PSNR, dB"), ("two", "PSNR, dB")}, "equal: no best"
    depths = best(table("Depth, every pixel counts alike", records))
    assert {("two", "IMAE, 1/m"), ("two", "δ < 1.05")} <= depths
    assert not any(name == "one" for name, _ in depths)
    assert best(table("Seconds per pair", records)) == {("one", "Total")}
    assert not best(table("Scenes", records)), "one scene says nothing about chance"


def test_the_best_is_marked_only_where_chance_does_not_explain_it():
    """A tenth of a decibel over two frames is nothing; a tenth in each of six scenes is something."""
    few = [unit("a", "one", (20.0, 22.0)), unit("a", "two", (20.1, 22.1))]
    assert not best(table("Means per method", few))
    assert math.isnan(table("Means per method", few).rows[0].cells[0].error)
    steady = [unit(s, m, (20.0 + k + more,)) for k, s in enumerate("abcdef") for m, more in (("one", 0), ("two", 0.1))]
    assert ("two", "WS-PSNR, dB") in best(table("Means per method", steady))
    noise = (0.4, -0.3, 0.5, -0.2, 0.3, -0.1)
    noisy = [unit(s, m, (20.0 + (m == "two") * noise[k],)) for k, s in enumerate("abcdef") for m in ("one", "two")]
    assert not best(table("Means per method", noisy))
    third = [*noisy, *(unit(s, "bad", (10.0,)) for s in "abcdef")]
    assert {name for name, column in best(table("Means per method", third)) if "WS" in column} == {"one", "two"}


def test_the_standard_error_is_over_scenes_and_over_pairs_of_a_single_one():
    """Frames of one scene are alike: ten of them say no more about others than one does."""
    scores = {"a": 20.0, "b": 24.0, "c": 25.0}
    records = [unit(scene, "m", (score,) * 10) for scene, score in scores.items()]
    cell = table("Means per method", records).rows[0].cells[0]
    assert cell.error == pytest.approx(np.std(list(scores.values()), ddof=1) / math.sqrt(3))
    assert format_cell(cell, 2) == "23.00 ± 1.53"
    pairs = [replace(record, scene="tour", first=record.scene) for record in records]
    assert table("Means per method", pairs).rows[0].cells[0].error == pytest.approx(cell.error)


def test_who_is_told_the_truth_or_measured_less_is_not_called_the_best():
    shown = table("Means per method", in_scenes(some_records()))
    assert {name for name, _ in best(shown)} == {"matching"}
    assert ("matching", "WS-PSNR, dB") in best(shown)
    both = [unit(s, m, (score,) * 3) for s in "abc" for m, score in (("one", 20.0), ("two", 30.0))]
    lazy = [unit("a", "lazy", (40.0,)), *both]
    assert {"two"} == {name for name, _ in best(table("Means per method", lazy))}
    assert is_oracle("oracle-depth:metres=2")
    assert not is_oracle("oracle")


def test_who_lacks_one_frame_is_not_called_the_best_even_where_nobody_has_more():
    """One method failed on the one scene, another on the other: equal counts, but not of the same frames."""
    lucky = [unit("a", "lucky", (40.0, 40.0, 40.0)), unit("b", "unlucky", (10.0, 10.0, 10.0))]
    assert not best(table("Means per method", lucky))
    both = [*lucky, *(unit(s, m, (score,) * 3) for s in "abc" for m, score in (("one", 20.0), ("two", 30.0)))]
    assert ("two", "WS-PSNR, dB") in best(table("Means per method", both))
    assert {name for name, column in best(table("Means per method", both)) if "PSNR" in column} == {"two"}
    almost = [unit("a", "almost", (40.0, 40.0)), *both]
    assert {name for name, column in best(table("Means per method", almost)) if "PSNR" in column} == {"two"}


def test_a_single_method_is_not_compared_with_anything():
    assert not best(table("Means per method", [unit("hall", "matching")]))


def test_groups_by_scene_time_distance_and_baseline():
    assert figures(table("Scenes"))["street"]["matching"] == 22.0
    assert math.isnan(figures(table("Scenes"))["street"]["oracle-depth"])
    times = figures(table("Share of the way"))
    assert times["0.4 to 0.6"]["matching"] == np.mean([24, 20])
    assert list(times) == ["0.2 to 0.4", "0.4 to 0.6", "0.6 to 0.8"]
    distances = figures(table("Distance to the nearer panorama"))
    assert distances["0.75 to 1 m"]["crossfade"] == np.mean([16, 17, 15, 16])
    assert distances["1.5 to 2 m"]["crossfade"] == np.mean([15, 14])
    baselines = figures(table("Baseline"))
    assert baselines["3 to 5 m"]["matching"] == 26.0
    assert baselines["5 to 10 m"]["matching"] == 22.0


@pytest.mark.parametrize(
    ("median", "name"), [(20.0, "narrow (0 to 0.25)"), (8.0, "medium (0.25 to 0.6)"), (2.0, "wide (from 0.6)")]
)
def test_groups_by_baseline_over_median_depth(median: float, name: str) -> None:
    shown = figures(table("Baseline over median depth", [unit("hall", "matching", median_depth=median)]))
    assert shown[name]["matching"] == 20.0


def test_depth_is_averaged_over_panoramas_plain_and_weighted():
    plain = figures(table("Depth, every pixel counts alike"))["matching"]
    weighted = figures(table("Depth, weighted by solid angle"))["matching"]
    assert plain["IMAE, 1/m"] == pytest.approx(np.mean([0.1, 0.3, 0.2]))
    assert plain["δ < 1.25³"] == pytest.approx(np.mean([0.9, 0.7, 0.8]))
    assert weighted["RMSE, m"] == pytest.approx(0.1)
    assert plain["Panoramas"] == 3


def test_changes_are_counted_where_there_is_a_frame_before():
    shown = figures(table("Changes, flying pixels and shards"))["matching"]
    assert shown["Change from frame to frame, dB"] == pytest.approx(np.mean([24, 28, 20, 24]) + 3)
    assert shown["Flying pixels, share of the sphere"] == pytest.approx(0.001)
    assert shown["Shards, share of edges"] == pytest.approx(0.02)
    assert shown["Frames"] == 6


def test_the_worst_frames_of_each_pair_are_named():
    frames, changes = table("Worst frame of each pair"), table("Worst change of each pair")
    assert [column.title for column in frames.columns] == ["oracle-depth", "matching", "crossfade"]
    assert [row.name for row in frames.rows] == ["hall", "street"]
    assert [(cell.value, cell.name) for cell in frames.rows[0].cells] == [
        (30.0, "t0.50.png"), (24.0, "t0.50.png"), (15.0, "t0.50.png"),
    ]  # fmt: skip
    falling = [unit("hall", "matching", (30.0, 28.0, 26.0))]
    (row,) = table("Worst change of each pair", falling).rows
    assert [(cell.value, cell.name) for cell in row.cells] == [(29.0, "t0.75.png")]
    assert math.isnan(frames.rows[1].cells[0].value)
    assert frames.rows[1].cells[0].name == changes.rows[1].cells[0].name == ""


def test_doubt_is_averaged_over_panoramas_and_has_no_column_that_nobody_fills():
    doubt = figures(table("What is known of errors of depth"))["matching"]
    assert doubt["Unsure area"] == pytest.approx(np.mean([0.2, 0.6, 0.4]))
    assert doubt["within 5 % there"] == 0.25
    assert "Calibration error" not in doubt


def test_seconds_are_averaged_over_pairs_and_missing_stages_took_none():
    seconds = figures(table("Seconds per pair"))
    assert seconds["crossfade"] == pytest.approx(
        {"depth": 0, "mesh": 0, "render": 0, "fuse": 0.6, "Total": 0.6, "Pairs": 2}
    )
    without_total = [unit("hall", "matching", seconds={"depth": 1.0, "fuse": 2.0})]
    assert figures(table("Seconds per pair", without_total))["matching"]["Total"] == 3.0


def test_pairs_of_one_scene_are_told_apart():
    records = [unit("hall", "m"), unit("hall", "m", first="c.jpg"), unit("street", "m")]
    assert [row.name for row in table("Scenes", records).rows] == [
        "hall: a.jpg → b.jpg",
        "hall: c.jpg → b.jpg",
        "street",
    ]
    assert list(pair_names(records).values()) == [row.name for row in table("Scenes", records).rows]


def test_equal_pictures_are_infinitely_good():
    records = [unit("hall", "one", (math.inf, 20.0)), unit("hall", "two", (30.0, 20.0))]
    assert ranked_methods(records) == ["one", "two"]
    assert format_value(figures(table("Means per method", records))["one"]["WS-PSNR, dB"], 2) == "∞"


def test_figures_as_text():
    assert [format_value(value, 2) for value in (math.nan, -math.inf, 1.005, 12.0)] == ["–", "−∞", "1.00", "12.00"]


def test_nothing_gives_no_tables():
    assert report_tables([]) == []
    assert [t.title for t in report_tables([absent("a", "flow", "failed", "x")])] == ["Means per method"]
    assert report_tables([absent("a", "", "skipped", "x")]) == []


@pytest.mark.parametrize(
    ("metres", "name"),
    [(0.0, "0 to 0.25 m"), (0.25, "0 to 0.25 m"), (1.0, "0.75 to 1 m"), (1.004, "0.75 to 1 m"), (1.01, "1 to 1.5 m"),
     (50.0, "20 to 50 m"), (1e6, "more than 50 m")],
)  # fmt: skip
def test_every_distance_has_one_band(metres, name):
    assert distance_band(metres)[1] == name


def test_every_share_of_the_way_has_one_part():
    assert time_band(0.0) == (0.0, "0.0 to 0.2")
    assert time_band(0.6) == (0.6, "0.6 to 0.8"), "although 0.6 · 5 is less than 3 in binary"
    assert time_band(1.0) == (0.8, "0.8 to 1.0")


def test_equal_reasons_are_told_once_and_scenes_come_first():
    found = gaps(some_records())
    assert [(gap.method, gap.pairs) for gap in found] == [
        ("", ("campus",)),
        ("oracle-depth", ("street",)),
        ("synsin", ("hall", "street")),
    ]
    assert found[0].status == "skipped"


def test_a_score_that_some_frames_lack_is_averaged_over_the_others():
    frames = (frame(0.25, 20.0), frame(0.75, 30.0))
    with_more = frames[0].scores | {"misplacement": 0.3}
    record = unit("hall", "matching", (), frames=(type(frames[0])("x", 0.25, 1.0, with_more), frames[1]))
    assert figures(table("Means per method", [record]))["matching"]["Misplacement, degrees"] == 0.3
