"""What the diagrams show: lines through the means, and files that are pictures."""

import math

import cv2
import numpy as np
import pytest
from report_samples import absent, some_records, unit

from omnisyn_cli.evaluation import plots


def test_every_diagram_is_a_picture_with_something_in_it():
    drawn = plots.report_plots(some_records())
    assert set(drawn) == set(plots.PLOT_TITLES)
    for data in drawn.values():
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert image.shape[1] == plots.FIGURE_WIDTH * plots.DOTS_PER_INCH
        assert (image[0] == 255).all(), "white all around"
        assert len(np.unique(image @ [1, 256, 256**2])) > 20


def test_lines_go_through_the_means_of_the_distances():
    axes = plots._diagrams(some_records())["ws-psnr-by-distance"].axes[0]
    lines = {line.get_label(): line.get_xydata().tolist() for line in axes.lines}
    assert lines["matching"] == [[1.0, 25.0], [2.0, 22.0]]
    assert lines["crossfade"] == [[1.0, 16.0], [2.0, 14.5]]
    points = np.concatenate([collection.get_offsets() for collection in axes.collections])
    assert len(points) == 15
    assert [2.0, 20.0] in points.tolist()


def test_many_frames_are_shown_as_means_alone(monkeypatch):
    monkeypatch.setattr(plots, "MAX_POINTS", 10)
    axes = plots._diagrams(some_records())["ws-psnr-by-share"].axes[0]
    assert len(axes.lines) == 3
    assert not axes.collections


def test_bars_add_up_to_the_mean_seconds():
    axes = plots._seconds_by_stage(some_records()).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["oracle-depth", "matching", "crossfade"]
    ends = np.max([[bar.get_x() + bar.get_width() for bar in stage] for stage in axes.containers], axis=0)
    assert ends == pytest.approx([8.0, 8.0, 0.6])


def test_quality_is_shown_against_mean_seconds():
    axes = plots._quality_by_seconds(some_records()).axes[0]
    assert {line.get_label(): line.get_xydata()[0].tolist() for line in axes.lines}["crossfade"] == [0.6, 15.5]


def test_reliability_is_that_of_all_panoramas_and_right_on_the_diagonal():
    axes = plots._reliability(some_records()).axes[0]
    lines = {line.get_label(): line.get_xydata().tolist() for line in axes.lines}
    assert lines["matching"] == [[pytest.approx(x), pytest.approx(y)] for x, y in ((0.1, 0.3), (0.9, 0.8))]
    assert axes.lines[0].get_xydata().tolist() == [[0, 0], [1, 1]]
    assert plots._reliability([unit("hall", "crossfade")]) is None


def test_infinite_scores_are_left_out():
    records = [unit("hall", "matching", (math.inf, 20.0)), unit("hall", "still", (math.inf,))]
    axes = plots._diagrams(records)["ws-psnr-by-share"].axes[0]
    assert {line.get_label(): line.get_xydata()[:, 1].tolist() for line in axes.lines} == {"matching": [20.0]}
    assert set(plots.report_plots([unit("hall", "still", (math.inf,))])) == {"seconds-by-stage"}


def test_names_are_no_formulas_and_are_not_hidden():
    records = [unit("hall", "$a_b$ $", (20.0,)), unit("hall", "_private", (21.0,))]
    legend = plots._diagrams(records)["ws-psnr-by-share"].legends[0]
    assert [text.get_text() for text in legend.get_texts()] == ["\u200b_private", r"\$a_b\$ \$"]
    assert plots.report_plots(records)


def test_nothing_measured_gives_no_diagram():
    assert plots.report_plots([]) == {}
    assert plots.report_plots([absent("hall", "flow", "failed", "x")]) == {}
