"""Diagrams: lines through the means, colours of errors and depth; what settings cost and are worth."""

import json
import math
from dataclasses import replace

import cv2
import matplotlib
import numpy as np
import pytest
from report_samples import absent, some_records, unit

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation import plots, visualization
from omnisyn_cli.interpolation.planning.figures import (
    STANDARD_FRAMES,
    Figures,
    Setting,
    gain,
    pareto_front,
    read_table,
    standard_seconds,
    write_table,
)


def test_every_diagram_is_a_picture_with_something_in_it():
    drawn = plots.report_plots(some_records())
    assert set(drawn) == set(plots.PLOT_TITLES)
    for data in drawn.values():
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert image.shape[1] == plots.FIGURE_WIDTH * plots.DOTS_PER_INCH
        assert (image[0] == 255).all(), "white all around"
        assert len(np.unique(image @ [1, 256, 256**2])) > 20


def test_quality_is_shown_against_mean_seconds():
    axes = plots._quality_by_seconds(some_records()).axes[0]
    assert {line.get_label(): line.get_xydata()[0].tolist() for line in axes.lines}["crossfade"] == [0.6, 15.5]


def test_names_are_no_formulas_and_are_not_hidden():
    records = [unit("hall", "$a_b$ $", (20.0,)), unit("hall", "_private", (21.0,))]
    legend = plots._quality_by_seconds(records).axes[0].figure.legends[0]
    assert [text.get_text() for text in legend.get_texts()] == ["\u200b_private", r"\$a_b\$ \$"]


def test_nothing_measured_gives_no_diagram():
    assert plots.report_plots([]) == {}
    assert plots.report_plots([unit("hall", "still", (math.inf,))]) == {}
    assert plots.report_plots([absent("hall", "flow", "failed", "x")]) == {}


SECONDS = {
    "start": 3.0, "decode": 0.2, "depth": 5.0, "check": 0.5, "mesh": 0.3,
    "render": 0.1, "fuse": 0.04, "encode": 0.06,
}  # fmt: skip
MEASURED = Figures(
    Setting("omnisyn-fast", (512, 1024), 2), source=(512, 1024), seconds=SECONDS, probe=0.02, scores={"hall": 27.0},
    pairs=2,
)  # fmt: skip


def figures(seconds: float, ws_psnr: float | None) -> Figures:
    """Figures of a setting whose clips take so long and are so good."""
    stages = dict.fromkeys(SECONDS, 0.0) | {"depth": seconds}
    return replace(MEASURED, seconds=stages, scores={} if ws_psnr is None else {"hall": ws_psnr})


def test_a_standard_clip_is_once_plus_a_pair_plus_its_frames():
    assert standard_seconds(MEASURED) == pytest.approx(3.0 + 0.2 + 5.0 + 0.5 + 0.3 + STANDARD_FRAMES * 0.2)


def test_a_gain_is_the_mean_of_paired_differences_and_its_error_shrinks_with_agreement():
    """Scenes that are hard for both do not count as a spread of the difference."""
    base = replace(MEASURED, scores={"a": 20.0, "b": 30.0, "c": 25.0})
    better = replace(MEASURED, scores={"c": 25.5, "a": 20.5, "b": 30.5, "only here": 99.0})
    assert gain(better, base) == pytest.approx((0.5, 0.0))
    assert gain(base, better)[0] == pytest.approx(-0.5)
    mixed = replace(MEASURED, scores={"a": 21.0, "b": 30.0})
    assert gain(mixed, base) == pytest.approx((0.5, 0.5))
    assert all(map(math.isnan, gain(replace(MEASURED, scores={}), base)))


@pytest.mark.parametrize("seed", range(20))
def test_the_front_is_what_nothing_else_beats(seed):
    rng = np.random.default_rng(seed)
    drawn = rng.integers(1, 8, (12, 2))  # few values, so that there are ties
    settings = [figures(float(seconds), float(score)) for seconds, score in drawn]
    front = {(standard_seconds(f), f.ws_psnr) for f in pareto_front(settings)}
    brute = {
        (float(s), float(q))
        for s, q in drawn
        if not any((t <= s and r >= q) and (t, r) != (s, q) for t, r in drawn)
    }  # fmt: skip
    assert front == brute
    found = pareto_front(settings)
    assert found == sorted(found, key=standard_seconds)


def test_what_failed_or_has_no_accuracy_is_not_in_the_front():
    broken = Figures(MEASURED.setting, "failed", "no memory")
    assert pareto_front([broken, figures(1.0, None), figures(2.0, 20.0)]) == [figures(2.0, 20.0)]


def test_a_table_reads_back(tmp_path):
    other = replace(MEASURED, scores={}, memory=123)
    write_table(tmp_path / "table.json", "a machine", [MEASURED, other, Figures(MEASURED.setting, "failed", "why")])
    assert read_table(tmp_path / "table.json") == (MEASURED, other)
    assert json.loads((tmp_path / "table.json").read_text())["machine"] == "a machine"


@pytest.mark.parametrize("text", ["", "[]", "{", '{"version": 1, "figures": []}', '{"version": 2, "figures": [{}]}'])
def test_what_is_no_table_is_refused(tmp_path, text):
    (tmp_path / "table.json").write_text(text)
    with pytest.raises(InputError, match=r"table\.json: expected a table"):
        read_table(tmp_path / "table.json")


def expected(name: str, share: np.ndarray) -> np.ndarray:
    return np.rint(255 * matplotlib.colormaps[name](np.rint(255 * share).astype(int))[..., :3])


def test_errors_have_the_inferno_colours_up_to_the_scale():
    share = np.linspace(0, 1, 64).reshape(4, 16)
    truth = np.full((4, 16, 3), 0.5)
    signs = np.where(np.arange(16) % 2 == 0, 1, -1)[None, :]
    image = truth + (share * signs * visualization.ERROR_SCALE)[..., None]
    coloured = visualization.error_map(image, truth)
    assert coloured.dtype == np.uint8
    assert np.abs(coloured - expected("inferno", share)).max() <= 3
    assert visualization.error_map(truth, truth).max() <= 4, "black"


def test_the_error_is_the_mean_of_the_channels_and_ends_at_the_scale():
    truth = np.zeros((2, 4, 3))
    one_channel = truth + np.array([3 * visualization.ERROR_SCALE / 2, 0.0, 0.0])
    all_channels = truth + visualization.ERROR_SCALE / 2
    assert np.array_equal(visualization.error_map(one_channel, truth), visualization.error_map(all_channels, truth))
    assert np.array_equal(
        visualization.error_map(truth + 1.0, truth), visualization.error_map(truth + visualization.ERROR_SCALE, truth)
    )
    with pytest.raises(ValueError, match="one size"):
        visualization.error_map(truth, truth[:1])


def test_depth_has_the_turbo_colours_of_the_root():
    inverse_depth = np.linspace(0, 2, 64).reshape(4, 16)
    coloured = visualization.turbo(inverse_depth, largest=2.0)
    assert coloured.dtype == np.uint8
    assert np.abs(coloured - expected("turbo", np.sqrt(inverse_depth / 2))).max() <= 3
    assert np.array_equal(visualization.turbo(inverse_depth * 7, largest=14.0), coloured)


def test_near_is_red_far_is_blue_and_unknown_is_black():
    near, far, negative, unknown = visualization.turbo(np.array([[1.0, 0.0, -1.0, np.nan]]), largest=1.0)[0]
    assert near[0] > 2 * near[2] > 0 or near[2] == 0
    assert far[2] > far[1]
    assert not negative.any()
    assert not unknown.any()


def test_without_a_largest_value_a_few_stray_pixels_change_nothing():
    inverse_depth = np.full((20, 40), 0.25)
    stray = inverse_depth.copy()
    stray[0, :4] = [100.0, np.inf, np.nan, -3.0]
    assert np.array_equal(visualization.turbo(stray)[1:], visualization.turbo(inverse_depth)[1:])
    assert np.array_equal(visualization.turbo(inverse_depth), visualization.turbo(4 * inverse_depth))


def test_a_sky_alone_is_far():
    assert np.array_equal(visualization.turbo(np.zeros((2, 4))), visualization.turbo(np.zeros((2, 4)), largest=1.0))
